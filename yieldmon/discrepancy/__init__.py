"""Diagnosis of a model: where it disagrees with measurements, which effect is missing, and validation of the effects found."""

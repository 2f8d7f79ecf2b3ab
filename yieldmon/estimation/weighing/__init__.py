"""Calibration from weighed loads: density, impact gain and load curve, and detection of wrong tickets."""

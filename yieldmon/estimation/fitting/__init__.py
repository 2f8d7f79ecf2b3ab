"""Rows of known load: least squares, calibration, what a fit leaves unknown."""

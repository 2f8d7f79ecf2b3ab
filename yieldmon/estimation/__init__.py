"""Estimators: pure functions of arrays, parameters and covariances."""

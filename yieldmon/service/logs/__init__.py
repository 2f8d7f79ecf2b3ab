"""Logs and recorded seconds: measured, held against their configuration, and read back."""

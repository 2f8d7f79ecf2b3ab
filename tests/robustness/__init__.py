"""Long and hard runs of the service: ``python -m tests.robustness NAME``."""

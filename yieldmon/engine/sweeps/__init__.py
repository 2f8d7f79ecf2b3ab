"""The plate and its sweeps."""

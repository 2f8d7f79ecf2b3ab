"""Virtual combine and monitor together: lock-step runs and their accuracy against the truth."""

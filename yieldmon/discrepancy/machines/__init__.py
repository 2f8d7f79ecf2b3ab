"""Sweeps of many machines together: what all show is the model's, what one shows beside the others its own."""

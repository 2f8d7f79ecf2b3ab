"""What is remembered of loads and parameters, over restarts and what is taken back."""

"""Pictures, a module each: arrays in, a matplotlib figure out. Needs the `plot` extra."""

"""Seconds, loads and yield points as other programs read them, a module a format."""

"""The demo over many seeds."""

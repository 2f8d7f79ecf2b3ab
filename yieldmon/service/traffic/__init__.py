"""Frames in and out: inputs, results, the daemon as a node of the network."""

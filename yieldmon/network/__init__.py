"""A node on a J1939 and ISO 11783 network, sans I/O: frames in, frames out, times as arguments."""

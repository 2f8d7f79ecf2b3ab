"""The yield monitor itself, sans I/O: frames in, frames out."""

"""Frames as Parquet, by message and exactly: the packed form of logs (the parquet extra)."""

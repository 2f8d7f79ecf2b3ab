"""The virtual combine: an independent source of frames and truth."""

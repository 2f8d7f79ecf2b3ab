"""Text logs of other makers' loggers, one module per format: a line in, a frame out."""

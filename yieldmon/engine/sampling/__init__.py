"""From sample frames to one window a second, and its zero."""

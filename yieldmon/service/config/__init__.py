"""The configuration file: its sections, what is wrong in one, and what a running daemon can take of a new one."""

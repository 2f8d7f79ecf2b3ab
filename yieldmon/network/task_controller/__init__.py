"""Client of an ISO 11783-10 task controller, sans I/O."""

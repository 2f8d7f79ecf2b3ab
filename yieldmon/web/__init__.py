"""The page for the cab and the office: a process of its own that reads the daemon's control socket and its store."""

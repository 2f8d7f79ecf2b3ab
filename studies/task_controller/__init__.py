"""Task controller client against the server of AgIsoStack++."""

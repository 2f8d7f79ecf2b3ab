"""Mass, loads, area, and what they are uncertain by."""

"""The parts of `yieldmon monitor`: where frames come from, what records them, the cab's view, and what it prints as JSON."""

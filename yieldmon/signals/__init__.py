"""Quantities and where they come from: any DBC's signals bound to what the engine takes in."""

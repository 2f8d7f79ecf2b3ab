"""The store: tables, writing and reading back, damage and repair."""

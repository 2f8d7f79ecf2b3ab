"""Harvest tables to yield maps: readers, delay, transport, swath geometry, cleaning, loads, products and a report."""

"""YAML and CSV at the edges: machines, parameters, tables."""

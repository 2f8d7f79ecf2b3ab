"""yieldmon: grain mass flow measured on a combine, over CAN, with a model that recalibrates itself."""

__version__ = "0.1.0"

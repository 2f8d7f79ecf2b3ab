"""yieldmon: grain mass flow measured on a combine, over CAN, with a model that recalibrates itself."""

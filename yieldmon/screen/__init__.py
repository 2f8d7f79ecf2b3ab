"""The live frame monitor: what was seen on the bus, how it is shown, which keys do what."""

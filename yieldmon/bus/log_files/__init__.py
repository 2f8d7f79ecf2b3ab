"""CAN logs as files: reading and writing every format, damaged ones up to the damage, and several as one record."""

"""CAN frames: codec, buses, receive loop, logs."""

"""Elevator speeds that files may hold, of the upper sprocket's shaft."""

from __future__ import annotations

from yieldmon.physics.machine import FASTEST_ELEVATOR_RPM

LEAST_SPEED_RPM = 150.0
"""Slower, no paddle throws grain; rad/s and the speed of another shaft are below it."""
LARGEST_SPEED_RPM = FASTEST_ELEVATOR_RPM

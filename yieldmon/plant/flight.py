"""From the paddle's tip to the plate's plane: a throw under gravity, with drag by steps of equal time where drag is on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from yieldmon.physics.machine import Machine
from yieldmon.physics.numerics import Array
from yieldmon.plant.effects import AirDrag

GRAVITY_M_S2 = 9.81
_DRAG_LEGS = (12, 4, 2)
"""Steps towards the plate, then towards it from there, and again: drag makes every leg end short of it."""


@dataclass(frozen=True, slots=True)
class Path:
    """Position (m) and velocity (m/s) of parcels; x to the right, y down."""

    x: Array
    y: Array
    vx: Array
    vy: Array


@dataclass(frozen=True, slots=True)
class Arrival:
    """A parcel in the plate's plane.

    below_edge_m: place along the plate from its low edge, positive below it. normal_speed_m_s, tangential_speed_m_s: into the
    plate and down along it. time_s: flight time. nan where the parcel never gets there.
    """

    below_edge_m: Array
    normal_speed_m_s: Array
    tangential_speed_m_s: Array
    time_s: Array


def leave_tip(angle_rad: Array, radial_speed: Array, paddle_length_m: float, speed_rad_s: float, turn_rad: Array) -> Path:
    """Position and velocity on leaving the tip of a paddle angle_rad past vertical, the velocity turned by turn_rad (down +)."""
    tip = paddle_length_m * speed_rad_s
    sine, cosine = np.sin(angle_rad), np.cos(angle_rad)
    vx = tip * (radial_speed * sine + cosine)
    vy = tip * (sine - radial_speed * cosine)
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    return Path(paddle_length_m * sine, -paddle_length_m * cosine, vx * c - vy * s, vx * s + vy * c)


def reach_plate(path: Path, machine: Machine, plate_angle_rad: Array, gravity_m_s2: float, drag: AirDrag | None) -> Arrival:
    """Fly to the plane of a plate at plate_angle_rad; arrays broadcast."""
    normal_x, normal_y = np.sin(plate_angle_rad), -np.cos(plate_angle_rad)
    edge_x = machine.plate_pivot_x_m + machine.plate_length_m * np.cos(plate_angle_rad)
    edge_y = machine.plate_pivot_y_m + machine.plate_length_m * np.sin(plate_angle_rad)
    flown = np.zeros(np.broadcast(path.x, plate_angle_rad).shape)
    if drag is not None:
        path, flown = _fly_with_drag(path, machine, plate_angle_rad, gravity_m_s2, drag)
    gap = normal_x * (edge_x - path.x) + normal_y * (edge_y - path.y)
    closing = normal_x * path.vx + normal_y * path.vy
    pull = gravity_m_s2 * np.cos(plate_angle_rad)
    discriminant = closing**2 - 2.0 * pull * gap
    with np.errstate(invalid="ignore", divide="ignore"):
        time = 2.0 * gap / (closing + np.sqrt(discriminant))
    time = np.where((closing > 0.0) & (discriminant > 0.0), time, np.nan)
    x, y = path.x + path.vx * time, path.y + path.vy * time + 0.5 * gravity_m_s2 * time**2
    vx, vy = path.vx, path.vy + gravity_m_s2 * time
    return Arrival(
        below_edge_m=(x - edge_x) * np.cos(plate_angle_rad) + (y - edge_y) * np.sin(plate_angle_rad),
        normal_speed_m_s=vx * normal_x + vy * normal_y,
        tangential_speed_m_s=vx * np.cos(plate_angle_rad) + vy * np.sin(plate_angle_rad),
        time_s=flown + time,
    )


def _fly_with_drag(
    path: Path, machine: Machine, plate_angle_rad: Array, gravity_m_s2: float, drag: AirDrag
) -> tuple[Path, Array]:
    """Runge-Kutta (midpoint) up to just before the plate; the last bit is left to the throw without drag."""
    flown = np.zeros(np.broadcast(path.x, plate_angle_rad).shape)

    def acceleration(vx: Array, vy: Array) -> tuple[Array, Array]:
        speed = np.hypot(vx, vy)
        rate = GRAVITY_M_S2 * (speed / drag.terminal_speed_m_s) ** drag.exponent / speed
        return -rate * vx, gravity_m_s2 - rate * vy

    for steps in _DRAG_LEGS:
        left = reach_plate(path, machine, plate_angle_rad, gravity_m_s2, None).time_s
        h = left / steps
        x, y, vx, vy = path.x, path.y, path.vx, path.vy
        for _ in range(steps):
            ax, ay = acceleration(vx, vy)
            middle_x, middle_y = vx + 0.5 * h * ax, vy + 0.5 * h * ay
            ax, ay = acceleration(middle_x, middle_y)
            x, y, vx, vy = x + h * middle_x, y + h * middle_y, vx + h * ax, vy + h * ay
        path, flown = Path(x, y, vx, vy), flown + left
    return path, flown

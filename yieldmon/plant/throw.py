"""One paddle's throw, from heap to plate, parcel by parcel.

Nothing here knows the monitor's model: heaps are cut into parcels, every parcel slides, flies and strikes by itself, and its
impulse lands at its own time. Layers that lie ahead of the paddle pass the tip's place sooner by their angle; they leave in the
direction of the paddle's face unless stream_spread fans them out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from yieldmon.physics.machine import Machine
from yieldmon.physics.numerics import Array
from yieldmon.plant import flight, heap, impact
from yieldmon.plant.effects import Effects
from yieldmon.plant.grain import Grain
from yieldmon.plant.paddle import Friction, release_curve

LAYERS = 7
"""Of a heap ahead of its paddle; what a cell of some milliseconds shows needs no more."""


@dataclass(frozen=True, slots=True)
class Throw:
    """Parcels of throws at one speed: arrays of shape (plate angles, heaps, cells, layers of the heap ahead of the paddle).

    mass_kg: in the parcel when its paddle points up. landed_kg: of it, on the plate. impulse_n_s: horizontal, on the plate.
    arrival_s: time from the paddle's pointing up; nan for a parcel that never reaches the plate's plane.
    """

    mass_kg: Array
    landed_kg: Array
    impulse_n_s: Array
    arrival_s: Array


def paddle_length_m(machine: Machine, effects: Effects) -> float:
    """Length of the paddle that is left, m."""
    return machine.paddle_length_m - (effects.paddle_wear.length_mm * 1e-3 if effects.paddle_wear else 0.0)


def shape_ratio(machine: Machine, grain: Grain, effects: Effects, speed_rad_s: float) -> float:
    """Shape ratio of the heap at an elevator speed."""
    if effects.speed_dependent_shape is None:
        return grain.shape_ratio
    relative = speed_rad_s / machine.nominal_elevator_speed_rad_s
    return float(grain.shape_ratio * relative**effects.speed_dependent_shape.exponent)


def full_paddle_kg(machine: Machine, grain: Grain, effects: Effects, speed_rad_s: float) -> float:
    """Mass of a heap that fills the paddle to the sprocket's centre, kg."""
    unit = grain.bulk_density_kg_m3 * machine.paddle_width_m * paddle_length_m(machine, effects) ** 2
    return 0.5 * shape_ratio(machine, grain, effects, speed_rad_s) * unit


def throw(
    machine: Machine,
    grain: Grain,
    effects: Effects,
    paddle_mass_kg: Array | float,
    plate_angle_rad: Array | float,
    speed_rad_s: float,
    *,
    cells: int = 400,
    layers: int = LAYERS,
) -> Throw:
    """Throw heaps (paddle_mass_kg, 1-D) at plates (plate_angle_rad, 1-D) with the elevator at speed_rad_s.

    Angles and speed are the true ones; chain slip has been taken off the speed. Heaps are cut into cells along the paddle and
    layers ahead of it. Raises ValueError for a heap above a full paddle.
    """
    masses = np.atleast_1d(np.asarray(paddle_mass_kg, dtype=float))
    angles = np.atleast_1d(np.asarray(plate_angle_rad, dtype=float))[:, None, None, None]
    length = paddle_length_m(machine, effects)
    unit = grain.bulk_density_kg_m3 * machine.paddle_width_m * length**2
    gravity = effects.gravity_m_s2
    ratio = shape_ratio(machine, grain, effects, speed_rad_s)

    kept = masses * (1.0 - _leaked_share(effects, machine, masses / (0.5 * ratio * unit), speed_rad_s))
    parcels = heap.cut(kept / unit, ratio, cells)
    start = np.deg2rad(effects.release_angle.angle_deg) if effects.release_angle else 0.0
    radial = effects.residual_radial_speed.share_of_tip_speed if effects.residual_radial_speed else 0.0
    friction = _friction(effects, grain, length * speed_rad_s)
    release = release_curve(friction, gravity / (length * speed_rad_s**2), radial, float(start))(parcels.radius)

    layer = (2.0 * np.arange(layers) + 1.0) / layers - 1.0
    fan = np.deg2rad(effects.stream_spread.half_width_deg) * layer if effects.stream_spread else np.zeros(1)
    path = flight.leave_tip(release.angle_rad[None, :, :, None], release.radial_speed[None, :, :, None], length, speed_rad_s, fan)
    arrival = flight.reach_plate(path, machine, angles, gravity, effects.air_drag)

    mass = (unit * parcels.area)[None, :, :, None] / layers
    depth = _stream_depth_m(unit * parcels.area, release.angle_rad, machine, grain, length, speed_rad_s)
    e = impact.restitution(arrival, depth[None, :, :, None], grain.restitution, effects)
    landed = mass * impact.landed_share(arrival, machine.plate_length_m, effects)
    per_kg = impact.horizontal_impulse(arrival, e, angles, machine.plate_length_m, effects)
    passage = release.angle_rad[:, :, None] - parcels.reach_rad[:, :, None] * 0.5 * (layer + 1.0)
    shape = (len(angles), *passage.shape)
    return Throw(
        mass_kg=np.broadcast_to(mass, shape),
        landed_kg=np.broadcast_to(landed, shape),
        impulse_n_s=np.broadcast_to(landed * np.nan_to_num(per_kg), shape),
        arrival_s=passage[None] / speed_rad_s + arrival.time_s,
    )


def _friction(effects: Effects, grain: Grain, tip_speed_m_s: float) -> Friction:
    law = effects.speed_dependent_friction
    return Friction(grain.friction, law.rise, law.speed_m_s / tip_speed_m_s) if law else Friction(grain.friction)


def _leaked_share(effects: Effects, machine: Machine, fill: Array, speed_rad_s: float) -> Array:
    leak = effects.paddle_leakage
    if leak is None:
        return np.zeros_like(fill)
    share = leak.share_at_full * fill**leak.fill_exponent * machine.nominal_elevator_speed_rad_s / speed_rad_s
    return np.minimum(share, 0.95)


def _stream_depth_m(
    mass_kg: Array, release_angle_rad: Array, machine: Machine, grain: Grain, length_m: float, speed_rad_s: float
) -> Array:
    """Depth of the stream at bulk density, m: what leaves the tip per second, spread over width and tip speed."""
    seconds = np.gradient(release_angle_rad, axis=1) / speed_rad_s
    per_second = mass_kg / seconds
    return per_second / (grain.bulk_density_kg_m3 * machine.paddle_width_m * length_m * speed_rad_s)

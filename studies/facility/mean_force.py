"""Mean force of steady flow without going through samples: what the cell shows over whole repeats of the paddle pattern."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yieldmon.physics.machine import Machine
from yieldmon.plant.effects import Effects
from yieldmon.plant.pulse_table import QUANTILES, PulseTable

Array = NDArray[np.float64]

_HARMONICS = 24


def true_speed_rad_s(effects: Effects, reported_rad_s: Array) -> Array:
    """Sprocket speed that the paddles follow, from the speed in the frame."""
    return np.asarray(reported_rad_s * (1.0 - (effects.chain_slip.share if effects.chain_slip else 0.0)))


def true_angle_rad(effects: Effects, reported_rad: Array | float) -> Array:
    """Plate angle, from the angle in the feedback."""
    offset = effects.plate_angle_offset.angle_deg if effects.plate_angle_offset else 0.0
    return np.asarray(reported_rad + np.deg2rad(offset))


def shown_force_n(
    table: PulseTable,
    effects: Effects,
    mass_flow_kg_s: Array,
    plate_angle_rad: Array,
    speed_rad_s: Array,
    response_s: float,
    coordinate: Array | float = 0.0,
) -> Array:
    """Mean force that the cell shows, N, with its zero taken at the home plate angle and the elevator empty.

    plate_angle_rad, speed_rad_s: as the frames have them. Arrays broadcast. Raises ValueError outside the table.
    """
    machine = table.machine
    angle, speed = true_angle_rad(effects, plate_angle_rad), true_speed_rad_s(effects, speed_rad_s)
    impulses = pattern_impulses_n_s(table, mass_flow_kg_s, angle, speed, coordinate)
    period = machine.pattern_length_m / (speed * machine.sprocket_pitch_radius_m)
    force = impulses.sum(axis=0) / period
    if (cell := effects.cell_nonlinearity) is not None:
        full_scale = machine.sensor.full_scale_mv * machine.sensor.gain_n_per_mv
        square = _mean_square(table, mass_flow_kg_s, angle, speed, response_s, coordinate)
        force = force - cell.share * square / full_scale
    if (stuck := effects.plate_buildup) is not None:
        home = true_angle_rad(effects, machine.home_plate_angle_rad)
        force = force + stuck.mass_kg * 9.81 * (np.sin(angle) * np.cos(angle) - np.sin(home) * np.cos(home))
    if (offset := effects.zero_offset) is not None:
        force = force + offset.force_n * (mass_flow_kg_s > 0.0)
    return np.asarray(force)


def pattern_impulses_n_s(
    table: PulseTable, mass_flow_kg_s: Array, angle_rad: Array, speed_rad_s: Array, coordinate: Array | float = 0.0
) -> Array:
    """Impulse of each paddle of the pattern at steady flow; first axis the paddles. True angle and speed."""
    return np.stack(
        [
            table.impulse_n_s(_load_kg(table.machine, gap, mass_flow_kg_s, speed_rad_s), angle_rad, speed_rad_s, coordinate)
            for gap in table.machine.paddle_spacings_m
        ]
    )


def _load_kg(machine: Machine, gap_m: float, mass_flow_kg_s: Array, speed_rad_s: Array) -> Array:
    return np.asarray(mass_flow_kg_s * gap_m / (speed_rad_s * machine.sprocket_pitch_radius_m))


def _mean_square(
    table: PulseTable, flow: Array, angle: Array, speed: Array, response_s: float, coordinate: Array | float
) -> Array:
    """Mean of the squared force behind the cell's response, N^2, as the sum over harmonics of the paddle pattern."""
    machine = table.machine
    flow, angle, speed = np.broadcast_arrays(flow, angle, speed)
    period = machine.pattern_length_m / (speed * machine.sprocket_pitch_radius_m)
    impulses = pattern_impulses_n_s(table, flow, angle, speed, coordinate)
    starts = np.cumsum(machine.paddle_spacings_m) / (speed * machine.sprocket_pitch_radius_m)[..., None]
    shares = np.diff(QUANTILES)
    middles = [
        starts[..., j, None] + _middles(table.arrival_times_s(_load_kg(machine, gap, flow, speed), angle, speed, coordinate))
        for j, gap in enumerate(machine.paddle_spacings_m)
    ]
    square = (impulses.sum(axis=0) / period) ** 2
    for harmonic in range(1, _HARMONICS + 1):
        omega = 2.0 * np.pi * harmonic / period
        line = sum(p * (shares * np.exp(-1j * omega[..., None] * m)).sum(axis=-1) for p, m in zip(impulses, middles, strict=True))
        square = square + 2.0 * np.abs(line / period) ** 2 / (1.0 + (omega * response_s) ** 2) ** 2
    return np.asarray(square)


def _middles(times: Array) -> Array:
    return 0.5 * (times[..., 1:] + times[..., :-1])

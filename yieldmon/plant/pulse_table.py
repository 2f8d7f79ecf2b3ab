"""Pulses on a smooth grid: what one throw does to the plate, fast enough for seasons.

Nodes are computed parcel by parcel (:mod:`yieldmon.plant.throw`); between them cubic splines run over the square root of the
paddle's mass, the plate angle, the elevator speed and, where crop or machine change with time, a condition coordinate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.numerics import Array
from yieldmon.plant.effects import Effects
from yieldmon.plant.grain import Grain
from yieldmon.plant.throw import LAYERS, full_paddle_kg, throw

Values = Array | float

QUANTILES = np.concatenate([[0.0, 0.002, 0.01, 0.03], np.linspace(0.06, 0.94, 23), [0.97, 0.99, 0.998, 1.0]])
"""Shares of a pulse's impulse whose arrival times describe its shape."""


@dataclass(frozen=True, slots=True)
class Condition:
    """Crop and machine at one place of the condition coordinate (a moisture, a time; any unit)."""

    coordinate: float
    grain: Grain
    effects: Effects


@dataclass(frozen=True, slots=True)
class Detail:
    """Numbers of nodes; plate angles in deg, sprocket speeds in rpm at equal ratios (both true values: from, to, number)."""

    masses: int = 44
    angles_deg: tuple[float, float, int] = (36.0, 94.0, 15)
    speeds_rpm: tuple[float, float, int] = (240.0, 620.0, 14)
    cells: int = 128
    layers: int = LAYERS
    shapes: bool = True
    """Whether pulse shapes are kept; impulses alone build faster."""


SEASON = Detail(masses=24, angles_deg=(38.0, 92.0, 12), speeds_rpm=(300.0, 500.0, 5), cells=96, shapes=False)
"""Coarser, for studies whose conditions change: speeds of 300-500 rpm and impulses only."""


class PulseTable:
    """Impulse and shape of a paddle's pulse.

    `conditions` one, or at least four with rising coordinates. Masses run from 0 to `largest_mass_kg`, 97 % of the smallest full
    paddle among the conditions and speeds.
    """

    def __init__(self, machine: Machine, conditions: Sequence[Condition], detail: Detail | None = None) -> None:
        """Raises ValueError for two or three conditions, which a cubic spline cannot join."""
        if len(conditions) in (0, 2, 3):
            raise ValueError(f"{len(conditions)} conditions, expected one, or at least four")
        detail = detail or Detail()
        self.machine = machine
        self._tip_speed_length_m = machine.paddle_length_m
        speeds = RPM * np.geomspace(*detail.speeds_rpm[:2], detail.speeds_rpm[2])
        angles = np.deg2rad(np.linspace(*detail.angles_deg[:2], detail.angles_deg[2]))
        self.speed_range_rad_s = (float(speeds[0]), float(speeds[-1]))
        self.angle_range_rad = (float(angles[0]), float(angles[-1]))
        self.largest_mass_kg = 0.97 * min(
            full_paddle_kg(machine, c.grain, c.effects, speed) for c in conditions for speed in speeds
        )
        roots = np.linspace(0.02, 1.0, detail.masses) * np.sqrt(self.largest_mass_kg)
        self._root_range = (float(roots[0]), float(roots[-1]))
        shape = (len(conditions), len(speeds), len(roots), len(angles))
        gain = np.empty(shape)
        times = np.empty((*shape, len(QUANTILES) if detail.shapes else 0))
        for i, condition in enumerate(conditions):
            for j, speed in enumerate(speeds):
                gain[i, j], times[i, j] = _nodes(machine, condition, roots**2, angles, speed, detail)
        axes = [np.array([c.coordinate for c in conditions]), speeds, roots, angles]
        self._axes = axes[1:] if len(conditions) == 1 else axes
        if len(conditions) == 1:
            gain, times = gain[0], times[0]
        self._gain = _spline(self._axes, gain)
        self._times = _spline(self._axes, times) if detail.shapes else None

    def impulse_n_s(
        self, paddle_mass_kg: Values, plate_angle_rad: Values, speed_rad_s: Values, coordinate: Values = 0.0
    ) -> Array:
        """Horizontal impulse of one pulse, N s; arrays broadcast. Arguments are true values (see :func:`throw`).

        Raises ValueError outside the table's speeds, plate angles or masses.
        """
        mass, points = self._points(paddle_mass_kg, plate_angle_rad, speed_rad_s, coordinate)
        return np.asarray(self._gain(points) * mass * np.asarray(speed_rad_s) * self._tip_speed_length_m)

    def arrival_times_s(
        self, paddle_mass_kg: Values, plate_angle_rad: Values, speed_rad_s: Values, coordinate: Values = 0.0
    ) -> Array:
        """Times after the paddle points up at which the shares QUANTILES of the impulse have arrived; last axis QUANTILES.

        Raises ValueError for a table built without shapes.
        """
        if self._times is None:
            raise ValueError("this table was built without pulse shapes")
        _, points = self._points(paddle_mass_kg, plate_angle_rad, speed_rad_s, coordinate)
        turns = np.asarray(self._times(points))
        return np.asarray(np.maximum.accumulate(turns, axis=-1) / np.asarray(speed_rad_s)[..., None])

    def _points(self, mass: Values, angle: Values, speed: Values, coordinate: Values) -> tuple[Array, Array]:
        masses, angles, speeds, places = np.broadcast_arrays(
            *(np.asarray(q, dtype=float) for q in (mass, angle, speed, coordinate))
        )
        for name, value, (low, high) in (
            ("speed_rad_s", speeds, self.speed_range_rad_s),
            ("plate_angle_rad", angles, self.angle_range_rad),
            ("paddle_mass_kg", masses, (0.0, self.largest_mass_kg * (1 + 1e-9))),
        ):
            if value.size and not (low <= value.min() and value.max() <= high):
                raise ValueError(f"{name} {value.min():.5g} to {value.max():.5g} outside the table's {low:.5g} to {high:.5g}")
        root = np.clip(np.sqrt(masses), *self._root_range)
        columns = [speeds, root, angles]
        if len(self._axes) == 4:
            columns.insert(0, np.clip(places, self._axes[0][0], self._axes[0][-1]))
        return masses, np.stack(columns, axis=-1)


def _nodes(
    machine: Machine, condition: Condition, masses: Array, angles: Array, speed: float, detail: Detail
) -> tuple[Array, Array]:
    """Impulse per kg and tip speed, and arrival turns (rad of sprocket) of shape (masses, angles, ...)."""
    result = throw(machine, condition.grain, condition.effects, masses, angles, speed, cells=detail.cells, layers=detail.layers)
    impulse = result.impulse_n_s.sum(axis=(2, 3)).T
    gain = impulse / (masses[:, None] * speed * machine.paddle_length_m)
    if not detail.shapes:
        return gain, np.empty((*gain.shape, 0))
    turns = np.empty((len(masses), len(angles), len(QUANTILES)))
    for a in range(len(angles)):
        for m in range(len(masses)):
            turns[m, a] = speed * _quantiles(result.arrival_s[a, m].ravel(), result.impulse_n_s[a, m].ravel())
    return gain, turns


def _quantiles(arrival_s: Array, impulse: Array) -> Array:
    """Times by which the shares QUANTILES of the impulse have arrived."""
    struck = impulse > 1e-12 * impulse.max(initial=0.0)
    if not struck.any():
        return np.zeros(len(QUANTILES))
    order = np.argsort(arrival_s[struck], kind="stable")
    time, weight = arrival_s[struck][order], impulse[struck][order]
    share = (np.cumsum(weight) - 0.5 * weight) / weight.sum()
    return np.asarray(np.interp(QUANTILES, share, time))


def _spline(axes: list[Array], values: Array) -> scipy.interpolate.NdBSpline:
    """Tensor-product cubic interpolant; values may carry trailing axes."""
    coefficients, knots = values, []
    for axis, nodes in enumerate(axes):
        spline = scipy.interpolate.make_interp_spline(nodes, np.moveaxis(coefficients, axis, 0), k=3)
        coefficients = np.moveaxis(spline.c, 0, axis)
        knots.append(spline.t)
    return scipy.interpolate.NdBSpline(tuple(knots), coefficients, 3)

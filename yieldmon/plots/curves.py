"""Force by plate angle and by flow: the model's curves, and a table's readings on them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.machine import RPM
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array

from .canvas import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST_CURVES = 9


@dataclass(frozen=True)
class Readings:
    """Rows of a table at one elevator speed: plate_angle_rad, mass_flow_kg_s, force_n, all (n,)."""

    plate_angle_rad: Array
    mass_flow_kg_s: Array
    force_n: Array


def draw(
    model: ForwardModel,
    parameters: ParameterSet,
    flows_kg_s: Array,
    angles_rad: Array,
    *,
    elevator_speed_rad_s: float,
    moisture_pct: float,
    readings: Readings | None = None,
) -> Figure:
    """A curve for each flow over the machine's angles, and for each angle over the flow up to the largest."""
    from matplotlib import colormaps

    figure, (by_angle, by_flow) = new_figure(1, 2, size_in=(13.0, 6.0), sharey=True)
    machine = model.machine
    angle = np.linspace(machine.min_plate_angle_rad, machine.max_plate_angle_rad, 61)
    flow = np.linspace(0.0, float(flows_kg_s.max()), 81)
    colours = colormaps["viridis"]

    def force(plate_rad: Array | float, rate_kg_s: Array | float) -> Array:
        conditions = Conditions(plate_rad, elevator_speed_rad_s, mass_flow_kg_s=rate_kg_s, moisture_pct=moisture_pct)
        found: Array = np.real(model.force(conditions, parameters.values))
        spread: Array = found + np.zeros(np.broadcast(plate_rad, rate_kg_s).shape)
        return spread

    for k, rate in enumerate(flows_kg_s):
        colour = colours(0.9 * k / max(len(flows_kg_s) - 1, 1))
        by_angle.plot(np.degrees(angle), force(angle, float(rate)), color=colour, label=f"{rate:g} kg/s")
        if readings is not None:
            near = np.isclose(readings.mass_flow_kg_s, rate, rtol=1e-3)
            by_angle.plot(np.degrees(readings.plate_angle_rad[near]), readings.force_n[near], ".", color=colour, ms=4)
    for k, plate in enumerate(angles_rad):
        colour = colours(0.9 * k / max(len(angles_rad) - 1, 1))
        by_flow.plot(flow, force(float(plate), flow), color=colour, label=f"{np.degrees(plate):g}°")
        if readings is not None:
            near = np.isclose(readings.plate_angle_rad, plate, atol=1e-3)
            by_flow.plot(readings.mass_flow_kg_s[near], readings.force_n[near], ".", color=colour, ms=4)
    by_angle.set_xlabel("plate angle, deg")
    by_angle.set_ylabel("horizontal force, N")
    by_flow.set_xlabel("mass flow, kg/s")
    for axes in (by_angle, by_flow):
        axes.legend(fontsize=8)
    shown = "lines: model, points: readings" if readings is not None else "model"
    figure.suptitle(f"{shown}; elevator at {elevator_speed_rad_s / RPM:.0f} rpm", fontsize=10)
    return figure


def some(values: Array) -> Array:
    """The distinct values, thinned out to as many as a picture can show apart."""
    distinct = np.unique(values)
    if len(distinct) <= _MOST_CURVES:
        return distinct
    thinned: Array = distinct[np.unique(np.linspace(0, len(distinct) - 1, _MOST_CURVES).round().astype(int))]
    return thinned

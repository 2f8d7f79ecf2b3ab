"""Mass flow and accumulated mass over time, beside the truth or the weighed loads."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from yieldmon.physics.numerics import Array
from yieldmon.units import Units

from .canvas import FACTORY, MEASURED, TRUTH, band, legend_above, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LEVELS = (0.02, 0.35, 0.68)
_LABEL_WIDTH = 0.03
"""Of a turned label of two lines, a fraction of the axes."""


def draw(
    time_s: Array,
    mass_flow_kg_s: Array,
    std_dev_kg_s: Array,
    total_kg: Array,
    *,
    truth: tuple[Array, Array, Array] | None = None,
    weighed: list[tuple[float, float, float]] | None = None,
    factory_kg_s: Array | None = None,
    units: Units = Units(),  # noqa: B008 - frozen
) -> Figure:
    """Measured columns (n,), nan where there is no flow. truth: time_s, mass_flow_kg_s, total_mass_kg of any length. weighed:
    end in s, measured kg and weighed kg of each load with a ticket. factory_kg_s: flow of the factory's own monitor (n,).
    units: of the axes."""
    figure, (flow, mass) = new_figure(2, 1, size_in=(11.0, 8.0), sharex=True, height_ratios=(2, 1))
    rate, weight = units.flow_unit, units.mass_unit
    start_s = time_s[0] if len(time_s) else 0.0
    minutes = (time_s - start_s) / 60.0
    if truth is not None:
        at = (truth[0] - start_s) / 60.0
        flow.plot(at, truth[1] / rate.si, color=TRUTH, lw=1.2, label="true")
        mass.plot(at, truth[2] / weight.si, color=TRUTH, lw=1.2, label="true")
    band(flow, minutes, mass_flow_kg_s / rate.si, std_dev_kg_s / rate.si, color=MEASURED, label="90 % interval")
    flow.plot(minutes, mass_flow_kg_s / rate.si, color=MEASURED, lw=1.0, label="measured, 1 Hz")
    if factory_kg_s is not None and np.isfinite(factory_kg_s).any():
        flow.plot(minutes, factory_kg_s / rate.si, color=FACTORY, lw=1.0, label="factory monitor")
    mass.plot(minutes, total_kg / weight.si, color=MEASURED, lw=1.4, label="measured")
    levels = _levels([(end_s - start_s) / 60.0 for end_s, _, _ in weighed or []], float(minutes[-1]) if len(minutes) else 0.0)
    labelled = False
    for (end_s, measured_kg, weighed_kg), level in zip(weighed or [], levels, strict=True):
        place = (end_s - start_s) / 60.0
        mass.axvline(place, color="gray", lw=0.6, label=None if labelled else "ticket: weighed mass, error of the measured")
        labelled = True
        text = f"{weight.of(weighed_kg):.0f} {weight.name}\n{100.0 * (measured_kg / weighed_kg - 1.0):+.1f} %"
        mass.annotate(text, (place, level), xycoords=("data", "axes fraction"), fontsize=7, ha="right", rotation=90)
    if truth is not None and len(truth[2]) and truth[2][-1] > 0.0:
        error_pct = 100.0 * (total_kg[-1] / float(np.interp(time_s[-1], truth[0], truth[2])) - 1.0)
        mass.set_title(f"measured less true at the end: {error_pct:+.2f} %", fontsize=9, loc="right")
    flow.set_ylabel(f"mass flow, {rate.name}")
    mass.set_ylabel(f"accumulated mass, {weight.name}")
    mass.set_xlabel("time, min")
    for axes in (flow, mass):
        legend_above(axes)
    return figure


def _levels(places: list[float], span: float) -> list[float]:
    """Height of each label, a fraction of the axes: neighbours that would overprint each other stand above one another."""
    free = dict.fromkeys(_LEVELS, -np.inf)
    found = []
    for place in places:
        level = next((level for level in _LEVELS if place - free[level] >= _LABEL_WIDTH * span), min(free, key=lambda k: free[k]))
        free[level] = place
        found.append(level)
    return found

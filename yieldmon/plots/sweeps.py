"""Plate sweeps: force over plate angle, a line for each sweep, and the flow before and after."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from yieldmon.physics.numerics import Array
from yieldmon.units import Units

from .canvas import band, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw(
    sweep_id: NDArray[np.int64],
    usable: NDArray[np.bool_],
    *,
    time_s: Array,
    plate_angle_deg: Array,
    force_n: Array,
    force_std_dev_n: Array,
    mass_flow_kg_s: Array,
    units: Units = Units(),  # noqa: B008 - frozen
) -> Figure:
    """Columns of seconds (n,). sweep_id 0: outside sweeps. usable: counts for its step."""
    from matplotlib import colormaps

    figure, (curve, course) = new_figure(1, 2, size_in=(13.0, 5.5))
    sweeps = [number for number in np.unique(sweep_id) if number > 0]
    colours = colormaps["viridis"](np.linspace(0.0, 0.9, max(len(sweeps), 1)))
    for number, colour in zip(sweeps, colours, strict=False):
        rows = (sweep_id == number) & usable
        angles = np.unique(np.round(plate_angle_deg[rows], 1))
        if not len(angles):
            continue
        near = np.abs(plate_angle_deg[rows, None] - angles) < 0.75
        force = np.array([force_n[rows][column].mean() for column in near.T])
        spread = np.array([np.sqrt((force_std_dev_n[rows][column] ** 2).sum()) / column.sum() for column in near.T])
        curve.plot(angles, force, ".-", color=colour, label=f"sweep {number}")
        band(curve, angles, force, spread, color=colour)
        inside = np.flatnonzero(sweep_id == number)
        shown = slice(max(0, inside[0] - 20), inside[-1] + 21)
        course.plot(time_s[shown] - time_s[inside[0]], mass_flow_kg_s[shown] / units.flow_unit.si, color=colour, lw=1.0)
    curve.set_xlabel("plate angle, deg")
    curve.set_ylabel("horizontal force, N")
    course.set_xlabel("time from the sweep's start, s")
    course.set_ylabel(f"mass flow, {units.flow_unit.name}")
    if sweeps:
        curve.legend(fontsize=8)
    return figure

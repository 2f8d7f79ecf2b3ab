"""The published momentum table and closed-loop estimates beside ours."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array

from .canvas import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LOOPS = {
    "generated_closed_loop": ("generated data, kg/s", "true_kg_s", "estimated_kg_s"),
    "drifted_closed_loop": ("drifted parameters, kg/s", "true_kg_s", "estimated_kg_s"),
    "dem_closed_loop": ("discrete elements, kg a paddle", "true_kg", "estimated_kg"),
    "bench_closed_loop": ("bench, kg a paddle", "true_kg", "estimated_kg"),
}


def momentum_table(published: Mapping[str, Any], machine: Machine) -> tuple[Array, Array, Array, Array]:
    """Table 11.2: angles in deg (a,), flows in kg/s (f,), the printed and our momentum in kg m/s (f, a)."""
    table, made = published["generated_momentum"], published["verification"]
    angles = np.array(table["plate_angle_deg"], dtype=float)
    flows = np.array([key for key in table if not isinstance(key, str)], dtype=float)
    printed = np.array([table[key] for key in table if not isinstance(key, str)], dtype=float)
    values = {
        "friction": made["friction"],
        "restitution": made["restitution"],
        "density": made["density_kg_m3"],
        "shape_ratio": made["shape_ratio"],
    }
    conditions = Conditions(np.radians(angles), made["elevator_speed_rpm"] * RPM, mass_flow_kg_s=flows[:, None])
    return angles, flows, printed, np.real(ForwardModel(machine).paddle_momentum(conditions, values))


def draw(published: Mapping[str, Any], machine: Machine) -> Figure:
    """Left: momentum, printed (points) and ours (lines). Right: the published closed loop's errors. Raises KeyError."""
    from matplotlib import colormaps

    figure, (left, right) = new_figure(1, 2, size_in=(13.0, 6.0))
    angles, flows, printed, ours = momentum_table(published, machine)
    for k, flow in enumerate(flows):
        colour = colormaps["viridis"](0.9 * k / (len(flows) - 1))
        left.plot(angles, ours[k], color=colour, label=f"{flow:g} kg/s")
        left.plot(angles, printed[k], ".", color=colour)
    left.set_title(
        f"printed (points) and ours (lines); largest difference {100 * np.abs(ours / printed - 1).max():.2f} %", fontsize=10
    )
    left.set_xlabel("plate angle, deg")
    left.set_ylabel("momentum of a paddle, kg m/s")
    for key, (label, true, estimated) in _LOOPS.items():
        truth, found = np.array(published[key][true]), np.array(published[key][estimated])
        right.plot(truth / truth.max(), 100.0 * (found / truth - 1.0), ".-", label=label)
    right.axhline(0.0, color="black", lw=0.8)
    right.set_title("published closed loop", fontsize=10)
    right.set_xlabel("true load / largest")
    right.set_ylabel("error, %")
    for axes in (left, right):
        axes.legend(fontsize=8)
    return figure

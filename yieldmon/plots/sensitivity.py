"""How force depends on each grain parameter: one varied, the others typical.

Source: "Self-Calibrating Mass Flow Sensor" (Univ. of Illinois / Deere), chapter 12.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from yieldmon.physics.grain import GRAIN
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array

from .canvas import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TYPICAL: Mapping[str, float] = {"friction": 0.5, "restitution": 0.5, "density": 1500.0, "shape_ratio": 2.0}
RANGES: Mapping[str, tuple[float, float]] = {
    "friction": (0.1, 2.0),
    "restitution": (0.1, 1.0),
    "density": (750.0, 2000.0),
    "shape_ratio": (1.5, 2.5),
}
FLOWS_KG_S: Array = np.arange(2.0, 26.1, 4.0)


def forces_n(machine: Machine, name: str, values: Array, plate_angle_rad: float) -> Array:
    """Force, N, of shape (FLOWS_KG_S, values): `name` takes the values, the others are TYPICAL; nominal elevator speed."""
    parameters: dict[str, ArrayLike] = {**TYPICAL, name: values[None, :]}
    conditions = Conditions(plate_angle_rad, machine.nominal_elevator_speed_rad_s, mass_flow_kg_s=FLOWS_KG_S[:, None])
    shape = (len(FLOWS_KG_S), len(values))
    return np.broadcast_to(np.real(ForwardModel(machine).force(conditions, parameters)), shape)


def draw(machine: Machine, plate_angle_rad: float) -> Figure:
    """A panel for each parameter: force against it, a line for each flow."""
    from matplotlib import colormaps

    figure, grid = new_figure(2, 2, size_in=(11.0, 8.5), sharey=True)
    for axes, (name, (low, high)) in zip(np.ravel(grid), RANGES.items(), strict=True):
        values = np.linspace(low, high, 60)
        for k, force in enumerate(forces_n(machine, name, values, plate_angle_rad)):
            colour = colormaps["viridis"](0.9 * k / (len(FLOWS_KG_S) - 1))
            axes.plot(values, force, color=colour, label=f"{FLOWS_KG_S[k]:g} kg/s")
        axes.axvline(TYPICAL[name], color="black", lw=0.8, ls=":")
        axes.set_xlabel(GRAIN[name].axis_label)
    for axes in grid[:, 0]:
        axes.set_ylabel("horizontal force, N")
    grid[0, 1].legend(fontsize=8)
    figure.suptitle(
        f"plate at {np.degrees(plate_angle_rad):g}°, {machine.nominal_elevator_speed_rad_s * 30 / np.pi:.0f} rpm; "
        "dotted: the value while another parameter is varied",
        fontsize=10,
    )
    return figure

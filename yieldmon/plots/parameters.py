"""Parameters over time with their 90 % intervals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from yieldmon.estimation.parameter_origin import ParameterOrigin
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.effects import effect_parameter

from .canvas import MODEL, band, legend_above, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MARKERS = {
    ParameterOrigin.FILE: "s",
    ParameterOrigin.HARDWARE: "P",
    ParameterOrigin.CROP: "v",
    ParameterOrigin.SWEEP: "o",
    ParameterOrigin.TICKET: "^",
    ParameterOrigin.KERNELS: "D",
    ParameterOrigin.DRIFT: ".",
    ParameterOrigin.UNDO: "x",
}
"""Of each change, by what brought it."""


def unit_of(name: str) -> str:
    """The unit of a parameter, "" for a pure number."""
    if "." in name:
        return effect_parameter(name).unit
    return "kg/m³" if name == "density" else ""


def draw(time_s: Sequence[float], sets: Sequence[ParameterSet], origins: Sequence[str]) -> Figure:
    """A panel for each parameter that any set is uncertain of or that changes; times rise, one for each set."""
    names = [
        name
        for name in sets[-1].values
        if len({known.values.get(name) for known in sets}) > 1
        or any(known.standard_deviation(name) > 0.0 for known in sets if name in known.values)
    ] or list(sets[-1].values)
    figure, grid = new_figure(len(names), 1, size_in=(10.0, 1.8 * len(names) + 1.0), sharex=True, squeeze=False)
    hours = (np.asarray(time_s, dtype=float) - time_s[0]) / 3600.0
    for axes, name in zip(grid[:, 0], names, strict=True):
        value = np.array([known.values.get(name, np.nan) for known in sets])
        spread = np.array([known.standard_deviation(name) if name in known.values else np.nan for known in sets])
        held = (np.append(column, column[-1]) for column in (value, spread))
        shown = np.append(hours, hours[-1] + 0.05 * max(hours[-1], 0.1))
        values, spreads = held
        band(axes, shown, values, spreads, color=MODEL, step="post", label="90 % interval")
        axes.step(shown, values, where="post", color=MODEL, lw=1.2)
        for origin, marker in _MARKERS.items():
            chosen = np.array([one == origin for one in origins])
            if chosen.any():
                axes.plot(hours[chosen], value[chosen], marker, color=MODEL, ms=4, label=f"from {origin}")
        unit = unit_of(name)
        axes.set_ylabel(name.replace(".", "\n") + (f"\n{unit}" if unit else ""), fontsize=8)
    legend_above(grid[0, 0])
    grid[-1, 0].set_xlabel("time, h")
    return figure

"""Parameters over time with their 90 % intervals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from yieldmon.estimation.parameters import ParameterSet

from .canvas import MODEL, band, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw(time_s: Sequence[float], sets: Sequence[ParameterSet], origins: Sequence[str]) -> Figure:
    """A panel for each parameter that any set is uncertain of or that changes; times rise, one for each set."""
    names = [
        name for name in sets[-1].values
        if len({known.values.get(name) for known in sets}) > 1 or any(known.standard_deviation(name) > 0.0 for known in sets
                                                                     if name in known.values)
    ] or list(sets[-1].values)
    figure, grid = new_figure(len(names), 1, size_in=(10.0, 1.8 * len(names) + 1.0), sharex=True, squeeze=False)
    hours = (np.asarray(time_s, dtype=float) - time_s[0]) / 3600.0
    for axes, name in zip(grid[:, 0], names, strict=True):
        value = np.array([known.values.get(name, np.nan) for known in sets])
        spread = np.array([known.standard_deviation(name) if name in known.values else np.nan for known in sets])
        band(axes, hours, value, spread, color=MODEL, step="post")
        axes.step(hours, value, where="post", color=MODEL, lw=1.2)
        for origin, marker in (("file", "s"), ("sweep", "o"), ("ticket", "^")):
            chosen = np.array([one == origin for one in origins])
            if chosen.any():
                axes.plot(hours[chosen], value[chosen], marker, color=MODEL, ms=4, label=origin)
        axes.set_ylabel(name.replace(".", "\n"), fontsize=8)
    grid[0, 0].legend(fontsize=8)
    grid[-1, 0].set_xlabel("time, h")
    return figure

"""Error of the one-second flow by band of true flow."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from yieldmon.physics.numerics import Array
from yieldmon.units import Units, rounded

from .canvas import MEASURED, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_EDGE = 0.5


def at_edges(seconds_s: Array, time_s: Array, true_kg_s: Array) -> NDArray[np.bool_]:
    """Seconds (n,) in which the true flow starts or stops: there a fraction of a second decides on the error in per cent.

    time_s, true_kg_s: the truth, of any length. An edge is a change by more than _EDGE of the larger flow within a second on
    either side.
    """
    before, at, after = (np.interp(seconds_s + step, time_s, true_kg_s) for step in (-1.0, 0.0, 1.0))
    largest = np.maximum(np.maximum(before, at), after)
    least = np.minimum(np.minimum(before, at), after)
    return np.asarray(largest - least > _EDGE * largest)


def draw(
    true_kg_s: Array,
    measured_kg_s: Array,
    edges_kg_s: Array,
    limit_pct: float = 5.0,
    units: Units = Units(),  # noqa: B008 - frozen
    left_out: int = 0,
) -> Figure:
    """A box for each band between neighbouring edges that holds seconds: quartiles, 5th to 95th percentile, and their number.

    Errors are measured less true, as everywhere. left_out: seconds that are not drawn, for the title.
    """
    unit = units.flow_unit
    figure, axes = new_figure()
    with np.errstate(divide="ignore", invalid="ignore"):
        error_pct = 100.0 * (measured_kg_s / true_kg_s - 1.0)
    rated = np.isfinite(error_pct)
    bands = [
        (0.5 * (low + high), high - low, error_pct[rated & (true_kg_s >= low) & (true_kg_s < high)])
        for low, high in pairwise(edges_kg_s)
    ]
    bands = [entry for entry in bands if len(entry[2])]
    axes.axhspan(-limit_pct, limit_pct, color="tab:green", alpha=0.12, lw=0, label=f"±{limit_pct:g} %")
    axes.axhline(0.0, color="black", lw=0.8)
    if bands:
        axes.boxplot(
            [entry[2] for entry in bands],
            positions=[entry[0] for entry in bands],
            widths=[0.6 * entry[1] for entry in bands],
            whis=(5, 95),
            showfliers=False,
            manage_ticks=False,
            medianprops={"color": MEASURED, "lw": 1.6},
        )
    for centre, _, errors in bands:
        axes.annotate(f"n={len(errors)}", (centre, 0.98), xycoords=("data", "axes fraction"), ha="center", va="top", fontsize=8)
    axes.set_xlim(edges_kg_s[0], edges_kg_s[-1])
    axes.set_xticks(edges_kg_s, [rounded(unit.of(edge)) for edge in edges_kg_s] if unit.si != 1.0 else None)
    title = "box: quartiles and median; whiskers: 5th and 95th percentile; n: seconds"
    if left_out:
        title += f"; {left_out} s in which the flow starts or stops are left out"
    axes.set_title(title, fontsize=9, loc="right")
    axes.set_xlabel(f"true mass flow, {unit.name}")
    axes.set_ylabel("error of a second, %")
    axes.legend(loc="lower right")
    return figure

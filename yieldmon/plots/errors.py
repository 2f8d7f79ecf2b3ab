"""Error of the one-second flow by band of true flow."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from .canvas import MEASURED, Array, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw(true_kg_s: Array, measured_kg_s: Array, edges_kg_s: Array, limit_pct: float = 5.0) -> Figure:
    """A box for each band between neighbouring edges that holds seconds: quartiles, 5th to 95th percentile, and their number."""
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
    axes.set_xticks(edges_kg_s)
    axes.set_title("box: quartiles and median; whiskers: 5th and 95th percentile; n: seconds", fontsize=9, loc="right")
    axes.set_xlabel("true mass flow, kg/s")
    axes.set_ylabel("error of a second, %")
    axes.legend(loc="lower right")
    return figure

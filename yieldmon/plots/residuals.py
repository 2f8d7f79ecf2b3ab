"""Residual map: model less measured, as in diagnose and its report, over plate angle and load."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from yieldmon.physics.numerics import Array

from .canvas import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw(plate_angle_deg: Array, load: Array, load_label: str, residual_pct: Array) -> Figure:
    """Rows (n,) of residuals in per cent of the largest reading; each distinct condition shows the mean of its rows."""
    figure, axes = new_figure(size_in=(9.0, 6.0))
    cells, index = np.unique(np.column_stack((plate_angle_deg, load)), axis=0, return_inverse=True)
    index = np.ravel(index)
    count = np.bincount(index)
    mean = np.bincount(index, residual_pct) / count
    largest = max(float(np.abs(mean).max()), 1e-9)
    shown = axes.scatter(
        cells[:, 0],
        cells[:, 1],
        c=mean,
        cmap="RdBu_r",
        vmin=-largest,
        vmax=largest,
        s=520,
        marker="s",
        edgecolors="gray",
        linewidths=0.4,
    )
    digits = 1 if largest >= 1.0 else 2
    for (angle, mass), value in zip(cells, mean, strict=True):
        # Adding 0 takes the sign off a zero.
        text = f"{round(value, digits) + 0.0:.{digits}f}"
        colour = "white" if abs(value) > 0.6 * largest else "black"
        axes.annotate(text, (angle, mass), ha="center", va="center", fontsize=7, color=colour)
    figure.colorbar(shown, ax=axes, label="model less measured, % of the largest reading")
    axes.set_title(f"rms {np.sqrt(np.mean(residual_pct**2)):.2f} % over {len(residual_pct)} rows", fontsize=10)
    axes.margins(0.08)
    axes.set_axisbelow(True)
    axes.set_xlabel("plate angle, deg")
    axes.set_ylabel(load_label)
    return figure

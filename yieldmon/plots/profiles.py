"""Profiles of a calibration: how fast the misfit grows when one parameter is moved and the others follow.

A straight line crosses both limits: the parameter is determined. A curve that stays between them on one side: it is not.
Source: Bates and Watts, "Nonlinear Regression Analysis and Its Applications", chapter 6 (profile t plots).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from yieldmon.estimation.fitting.calibration_result import CONFIDENCE, ProfileCurve

from .canvas import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw(curves: Sequence[ProfileCurve]) -> Figure:
    """A panel for each parameter."""
    columns = min(len(curves), 3)
    rows = -(-len(curves) // columns)
    figure, grid = new_figure(rows, columns, size_in=(4.2 * columns, 3.6 * rows))
    panels = np.ravel(grid)
    for axes, curve in zip(panels, curves, strict=False):
        axes.axhspan(-curve.limit, curve.limit, color="tab:green", alpha=0.15, lw=0)
        axes.axhline(0.0, color="black", lw=0.6)
        axes.plot(curve.values, curve.rise, lw=1.6)
        axes.set_xlabel(curve.name)
        shown = 2.5 * curve.limit
        axes.set_ylim(-shown, shown)
    for axes in panels[len(curves) :]:
        axes.set_axis_off()
    for axes in panels[: len(curves) : columns]:
        axes.set_ylabel("± root of the rise of chi-square")
    figure.suptitle(f"profiles; shaded: within the {100 * CONFIDENCE:.0f} % interval", fontsize=10)
    return figure

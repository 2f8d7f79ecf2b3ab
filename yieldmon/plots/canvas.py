"""What all pictures share: the figure, its file, and bands of flow."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from yieldmon.errors import InputError
from yieldmon.estimation.gaussian import REACH_90
from yieldmon.files.whole_file import scratch_for
from yieldmon.physics.numerics import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


SUFFIXES = (".png", ".svg")
MEASURED, TRUTH, MODEL, FACTORY = "tab:orange", "black", "tab:blue", "tab:purple"


def new_figure(rows: int = 1, columns: int = 1, *, size_in: tuple[float, float] = (10.0, 6.0), **how: Any) -> tuple[Figure, Any]:
    """A figure and its axes (one, or an array of shape (rows, columns)), with grids. Raises ImportError without matplotlib."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=size_in, layout="constrained")
    axes = figure.subplots(rows, columns, **how)
    for one in np.ravel(axes):
        one.grid(alpha=0.3)
    return figure, axes


def check_name(path: Path, where: str) -> None:
    """To be asked before the work: raises InputError for a name that is no PNG's or SVG's, ImportError without matplotlib.

    where: the option that gave the name.
    """
    import matplotlib  # noqa: F401 - is it there?

    if path.suffix.lower() not in SUFFIXES:
        raise InputError(where, f"is {path}", f"a name that ends in {' or '.join(SUFFIXES)}")


def save(figure: Figure, path: Path) -> None:
    """Write a PNG or an SVG whole or not at all; the same picture gives the same file.

    Raises InputError for another ending or a path that cannot be a file's.
    """
    check_name(path, "picture")
    import matplotlib

    with matplotlib.rc_context({"svg.hashsalt": "yieldmon", "svg.fonttype": "none"}), scratch_for(path) as scratch:
        figure.savefig(scratch, dpi=110, metadata={"Date": None} if path.suffix.lower() == ".svg" else None)


def legend_above(axes: Axes) -> None:
    """The legend in one line above the axes, where it covers nothing."""
    _, labels = axes.get_legend_handles_labels()
    count = max(len(labels), 1)
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=count, frameon=False, fontsize=9, borderaxespad=0.2)


def band(axes: Axes, x: Array, y: Array, std_dev: Array, **how: Any) -> None:
    """The 90 % interval around y."""
    axes.fill_between(x, y - REACH_90 * std_dev, y + REACH_90 * std_dev, alpha=0.25, lw=0, **how)

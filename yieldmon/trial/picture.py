"""Picture of true against measured flow. Needs matplotlib (the `plot` extra)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from yieldmon.estimation.gaussian import REACH_90
from yieldmon.plots import canvas

from .accuracy import RATED_FROM_KG_S, Accuracy


def draw(accuracy: Accuracy, path: Path) -> None:
    """Write a PNG or SVG: both flows over time, and the error of each rated window. Raises as `canvas.save`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 7), layout="constrained")
    flow, error = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    t, true, measured = accuracy.time_s, accuracy.true_kg_s, accuracy.measured_kg_s
    band = REACH_90 * accuracy.std_dev_kg_s
    flow.fill_between(t, measured - band, measured + band, color="tab:orange", alpha=0.25, lw=0, label="90 % interval")
    flow.plot(t, true, color="black", lw=1.5, label="true")
    flow.plot(t, measured, color="tab:orange", lw=1.2, marker=".", ms=3, label="measured, 1 Hz")
    flow.set_ylabel("mass flow, kg/s")
    flow.set_title(
        f"|error| from {RATED_FROM_KG_S:g} kg/s: mean {accuracy.mean_abs_pct:.2f} %, "
        f"95th percentile {accuracy.p95_abs_pct:.2f} %;"
        f" accumulated mass {accuracy.mass_error_pct:+.2f} %",
        pad=26,
    )
    canvas.legend_above(flow)
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(true >= RATED_FROM_KG_S, 100.0 * (measured - true) / true, np.nan)
    error.axhspan(-5.0, 5.0, color="tab:green", alpha=0.12, lw=0)
    error.axhline(0.0, color="black", lw=0.8)
    error.plot(t, relative, ".", color="tab:orange", ms=4)
    error.set_ylabel("error, %")
    error.set_xlabel("bus time, s")
    for axes in (flow, error):
        axes.grid(alpha=0.3)
    canvas.save(figure, path)

"""Pulses with their fits, and the volume flow found against the true one; discrete elements."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from studies.waveform.fill import FOLDER, LOADS_KG, MACHINE, TABLES, Judge, volume_flow_m3_s
from yieldmon.physics.machine import RPM

SHOWN = ((400.0, 0.3, 0.9, 70.0), (400.0, 0.3, 1.3, 55.0), (500.0, 0.15, 0.9, 80.0), (400.0, 0.3, 0.2, 40.0))
"""Speed, friction, load, plate angle; the last is one for which the calibration says nothing."""


def draw_pulses(path: Path) -> None:
    """Each pulse through a cell of 8 ms, as a steady train, and the fit of a law that has seen neither its load nor its angle."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 6.5), layout="constrained")
    judge = Judge(0.1, True, True)
    for axes, (rpm, friction, load, angle) in zip(figure.subplots(2, 2).ravel(), SHOWN, strict=True):
        wave = judge.waves[rpm, friction, load, angle]
        found = judge.estimate(wave, rpm, friction, load, angle)
        base = judge.model(friction, judge.law(rpm, friction, load, angle))
        theta = np.array([found.values[name] for name in found.names])
        fit = base.waves(theta, rpm * RPM, np.deg2rad(angle))
        period_s = 2.0 * np.pi / base.fundamental_rad_s(rpm * RPM)
        time = np.linspace(0.0, period_s, 400)
        mean = volume_flow_m3_s(load, rpm)
        for amplitudes, style, name in ((wave.amplitudes_n, "k-", "discrete elements"), (fit, "C1--", "fit")):
            order = np.arange(1, amplitudes.size + 1)
            force = 2.0 * (amplitudes[:, None] * np.exp(2j * np.pi * np.outer(order, time / period_s))).real.sum(axis=0)
            axes.plot(1e3 * time, force - force.min(), style, label=name)
        said = found.outside or f"volume flow {100.0 * (found.volume_flow_m3_s / mean - 1.0):+.1f} %"
        axes.set_title(f"{load:g} kg, {angle:g} deg, {rpm:g} rpm, friction {friction:g}: {said}", fontsize=8)
        axes.set_xlabel("ms of the paddle's period")
        axes.set_ylabel("force behind the cell above its least, N", fontsize=8)
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    figure.savefig(path, dpi=110)


def draw_fill(document: dict[str, Any], path: Path) -> None:
    """Of fill.json: every pulse left out, and the groups of other grain."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 5), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    rows = [r for r in document["left_out"] if r["pooled"] and r["indexed"] and r["left_out"] == "both" and r["rpm"] != "all"]
    for shift, (rpm, friction) in enumerate(TABLES):
        row = next(r for r in rows if (r["rpm"], r["friction"]) == (rpm, friction))
        told = np.array(row["told"], dtype=bool)
        truth = np.broadcast_to(np.array(LOADS_KG)[:, None] * (1.0 + 0.03 * (shift - 1.5)), told.shape)
        errors = np.array(row["errors_pct"])
        colour, name = f"C{shift}", f"{rpm:g} rpm, friction {friction:g}"
        left.plot(truth[told], errors[told], "o", color=colour, label=f"{name}: published")
        left.plot(truth[~told], errors[~told], "o", mfc="none", color=colour, alpha=0.6)
    left.set_title("load and plate angle left out (hollow: refused)", fontsize=9)
    left.set_ylabel("error of ln(volume flow), %")
    for n, restitution in enumerate(sorted({g["restitution"] for g in document["other_grain"]})):
        for kernel_g, mark in ((0.4048, "o"), (0.8096, "s")):
            groups = [g for g in document["other_grain"] if (g["restitution"], g["kernel_g"]) == (restitution, kernel_g)]
            for published in (True, False):
                some = [g for g in groups if (g["published"] > 0) == published]
                right.errorbar(
                    [g["load_kg"] * (1.0 + 0.03 * (n - 1)) for g in some], [g["mean_pct"] for g in some],
                    yerr=[g["heap_sd_pct"] for g in some], fmt=mark, color=f"C{n}", mfc=f"C{n}" if published else "none",
                    label=f"restitution {restitution:g}, kernels of {1e3 * kernel_g:.0f} mg" if published else None,
                )  # fmt: skip
    right.set_title("other heaps, kernels and restitutions (bars: from heap to heap)", fontsize=9)
    for axes in (left, right):
        axes.axhspan(-10.0, 10.0, color="tab:green", alpha=0.12, lw=0)
        axes.set_xscale("log")
        axes.set_xticks(LOADS_KG, labels=map(str, LOADS_KG))
        axes.minorticks_off()
        axes.set_xlabel(f"true load, kg a paddle ({MACHINE.paddle_spacing_m:.3f} m apart)")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=7)
    figure.savefig(path, dpi=110)


def draw(out: Path) -> dict[str, Any]:
    """pulse.png and fill.png in a folder."""
    draw_pulses(out / "pulse.png")
    draw_fill(json.loads((FOLDER / "fill.json").read_text()), out / "fill.png")
    return {"pictures": ["pulse.png", "fill.png"]}

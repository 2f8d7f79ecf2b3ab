"""The published model, stage by stage, against a discrete-element campaign: tables and pictures of studies/dem/results.md.

Reads tests/data/dem_campaign*, dem_clumps* and dem_table.csv; needs no engine. The sections diagnosis and open-loop take
minutes; edges needs the folder of each throw, which the repository does not hold.
"""

from __future__ import annotations

import argparse
import csv
import re
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import pairwise, product
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from studies.dem import stages
from studies.dem.job import Grain
from studies.dem.records import PlateFrame, crossing
from yieldmon.discrepancy import diagnosis
from yieldmon.estimation.fitting.calibration import calibrate, default_start
from yieldmon.estimation.fitting.measurements import Measurements
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files import parameter_file, table
from yieldmon.physics import release, settling
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.stages import Setting

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "tests" / "data"
PICTURES = Path(__file__).resolve().parent / "img"
THROWS: Path | None = None
MACHINE = Machine()
RESTITUTION = 0.75
DIAMETER_M = 2.0 * Grain().radius_m
Rows = dict[str, np.ndarray]


def read(name: str) -> Rows:
    """Columns of a campaign table; text columns stay text."""
    with (DATA / name).open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    out: Rows = {}
    for key in rows[0]:
        values = [r[key] for r in rows]
        try:
            out[key] = np.array([float(v) for v in values])
        except ValueError:
            out[key] = np.array(values)
    return out


def select(rows: Rows, **wanted: float) -> Rows:
    keep = np.ones(len(next(iter(rows.values()))), dtype=bool)
    for key, value in wanted.items():
        keep &= np.isclose(rows[key], value)
    return {k: v[keep] for k, v in rows.items()}


def markdown(header: Sequence[str], body: Iterable[Sequence[object]]) -> str:
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    lines += ["| " + " | ".join(str(cell) for cell in row) + " |" for row in body]
    return "\n".join(lines)


def published(friction: float, speed_rpm: float) -> Setting:
    """What stage 3 of the published model needs to know."""
    one = np.ones(1)
    return Setting(
        machine=MACHINE,
        plate_angle_rad=one,
        elevator_speed_rad_s=one * speed_rpm * RPM,
        moisture_pct=one * np.nan,
        paddle_length_m=one * MACHINE.paddle_length_m,
        plate_pivot_x_m=one * MACHINE.plate_pivot_x_m,
        plate_pivot_y_m=one * MACHINE.plate_pivot_y_m,
        friction=one * friction,
        density=one * 1000.0,
        shape_ratio=one * 2.0,
        restitution=None,
        k1=None,
        k2=None,
    )


def published_release(radius: np.ndarray, friction: float, speed_rpm: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time to the tip (s), speed there (of tip speed) and direction (deg below the horizontal) of grain let go at radius."""
    setting = published(friction, speed_rpm)
    tau = release.rotation_to_empty(np.asarray(radius), setting, np.full(np.shape(radius), 2.0 * np.pi))
    flow = release.outflow(tau, setting)
    _, _, vx, vy = release.at_tip(flow, setting)
    tip = MACHINE.paddle_length_m * speed_rpm * RPM
    return tau / (speed_rpm * RPM), np.hypot(vx, vy) / tip, np.degrees(np.arctan2(vy, vx))


def save(figure: Figure, name: str) -> None:
    PICTURES.mkdir(parents=True, exist_ok=True)
    figure.savefig(PICTURES / f"{name}.png", dpi=110, metadata={"Software": None})
    plt.close(figure)


def means(rows: Rows, by: Sequence[str], values: Sequence[str]) -> list[tuple[float, ...]]:
    """Cells of `by`, with the mean of each of `values`."""
    keys = np.column_stack([rows[b] for b in by])
    cells = np.unique(keys, axis=0)
    return [(*cell, *(float(rows[v][np.all(np.isclose(keys, cell), axis=1)].mean()) for v in values)) for cell in cells]


def section_heap() -> dict[str, str]:
    heaps = read("dem_campaign_heaps.csv")
    body = []
    for speed, friction, mass, h0, reach, ratio, rough, density in means(
        heaps,
        ("elevator_speed_rpm", "friction", "paddle_mass_kg"),
        ("inner_radius_m", "reach_deg", "shape_ratio", "straightness_mm", "bulk_density_kg_m3"),
    ):
        fraction = mass / (density * MACHINE.paddle_width_m * MACHINE.paddle_length_m**2)
        predicted = float(settling.inner_radius(np.array([fraction]), np.array([2.0]))[0])
        body.append(
            (
                f"{speed:.0f}",
                f"{friction:.2f}",
                f"{mass:.1f}",
                f"{h0 / MACHINE.paddle_length_m:.3f}",
                f"{predicted:.3f}",
                f"{reach:.0f}",
                f"{ratio:.2f}",
                f"{rough * 1e-3 / DIAMETER_M:.2f}",
                f"{density:.0f}",
            )
        )
    header = ("rpm", "friction", "kg", "h0/l", "h0/l with h_f = 2", "psi_f, deg", "h_f", "off straight, kernels rms", "kg/m3")
    with np.load(DATA / "dem_campaign_grains.npz") as grains:
        loads = [float(m) for m in grains["paddle_mass_kg"]]
        chosen = [m for m in loads if m in (0.5, 0.9, 1.8)] or loads
        figure, axes = plt.subplots(1, len(chosen), figsize=(4.2 * len(chosen), 4.0), sharey=True, layout="constrained")
        for axis, load in zip(np.atleast_1d(axes), chosen, strict=True):
            tag = f"{load:g}"
            along, ahead = grains[f"along_mm_{tag}"].astype(float), grains[f"ahead_mm_{tag}"].astype(float)
            axis.scatter(ahead, along, s=3, alpha=0.35, linewidths=0, color="tab:brown")
            cell = select(heaps, elevator_speed_rpm=400.0, friction=0.3, paddle_mass_kg=load)
            reach, h0 = np.radians(cell["reach_deg"].mean()), 1e3 * cell["inner_radius_m"].mean()
            length = 1e3 * MACHINE.paddle_length_m
            axis.plot([0, length * np.sin(reach)], [h0, length * np.cos(reach)], "k-", label="fitted line")
            fraction = load / (cell["bulk_density_kg_m3"].mean() * MACHINE.paddle_width_m * MACHINE.paddle_length_m**2)
            x = float(settling.inner_radius(np.array([fraction]), np.array([2.0]))[0])
            psi = 2.0 * (1.0 - x)
            axis.plot([0, length * np.sin(psi)], [length * x, length * np.cos(psi)], "b--", label="published, h_f = 2")
            arc = np.linspace(0, 1.6, 60)
            axis.plot(length * np.sin(arc), length * np.cos(arc), color="grey")
            axis.set(title=f"{load:g} kg", xlabel="ahead of the paddle, mm", xlim=(-5, 165), ylim=(0, 165), aspect="equal")
        np.atleast_1d(axes)[0].set_ylabel("along the paddle, mm")
        np.atleast_1d(axes)[0].legend(loc="lower right", fontsize=8)
    save(figure, "heap")
    return {"heap": markdown(header, body)}


def section_release() -> dict[str, str]:
    layers = read("dem_campaign_layers.csv")
    blocks = []
    middle = select(layers, elevator_speed_rpm=400.0, friction=0.3, paddle_mass_kg=0.9)
    body = []
    for layer, rho, lead, travel, speed, below, spread in means(
        middle,
        ("layer",),
        ("let_go_radius_over_l", "lead_deg", "travel_s", "speed_over_tip", "below_horizontal_deg", "below_horizontal_sd_deg"),
    ):
        t, v, angle_deg = (float(q[0]) for q in published_release(np.array([rho]), 0.3, 400.0))
        body.append(
            (
                f"{layer:.0f}",
                f"{rho:.3f}",
                f"{lead:.0f}",
                f"{1e3 * travel:.1f}",
                f"{1e3 * t:.1f}",
                f"{speed:.3f}",
                f"{v:.3f}",
                f"{below:.1f} ± {spread:.1f}",
                f"{angle_deg:.1f}",
            )
        )
    blocks.append(
        markdown(
            (
                "layer",
                "rho_0",
                "lead, deg",
                "travel, ms",
                "published",
                "speed / tip",
                "published",
                "below horizontal, deg",
                "published",
            ),
            body,
        )
    )
    summary = []
    for speed_rpm, friction in sorted({(a, b) for a, b in zip(layers["elevator_speed_rpm"], layers["friction"], strict=True)}):
        part = select(layers, elevator_speed_rpm=speed_rpm, friction=friction)
        times, speeds, angles = published_release(part["let_go_radius_over_l"], friction, speed_rpm)
        summary.append(
            (
                f"{speed_rpm:.0f}",
                f"{friction:.2f}",
                f"{100 * np.mean(part['travel_s'] / times - 1):+.1f}",
                f"{100 * np.std(part['travel_s'] / times):.1f}",
                f"{100 * np.mean(part['speed_over_tip'] / speeds - 1):+.1f}",
                f"{100 * np.std(part['speed_over_tip'] / speeds):.1f}",
                f"{np.mean(part['below_horizontal_deg'] - angles):+.1f}",
                f"{np.std(part['below_horizontal_deg'] - angles):.1f}",
            )
        )
    blocks.append(
        markdown(("rpm", "friction", "travel time, % off", "sd", "speed, % off", "sd", "direction, deg off", "sd"), summary)
    )
    leads = leads_table()
    figure, axes = plt.subplots(1, 3, figsize=(12.5, 3.8), layout="constrained")
    radii = np.linspace(0.45, 0.985, 120)
    columns = ("travel_s", "speed_over_tip", "below_horizontal_deg")
    labels = ("travel time to the tip, ms", "speed at release / tip speed", "direction, deg below horizontal")
    for axis, column, curve, label in zip(axes, columns, published_release(radii, 0.3, 400.0), labels, strict=True):
        factor = 1e3 if column == "travel_s" else 1.0
        axis.plot(radii, factor * curve, "k-", label="published")
        part = select(layers, elevator_speed_rpm=400.0, friction=0.3)
        for mass in np.unique(part["paddle_mass_kg"]):
            one = select(part, paddle_mass_kg=mass)
            axis.plot(one["let_go_radius_over_l"], factor * one[column], "o", ms=4, label=f"{mass:g} kg")
        axis.set(xlabel="radius when let go / paddle length", ylabel=label)
        axis.grid(alpha=0.3)
    axes[0].legend(fontsize=8)
    save(figure, "release")
    return {"release": "\n\n".join(blocks), "leads": leads}


def leads_table() -> str:
    """Mean velocity of single grains at release, by radius when let go and by how far ahead of the paddle they lay."""
    bins_deg = ((-5.0, 5.0), (5.0, 15.0), (15.0, 30.0), (30.0, 90.0))
    tip = MACHINE.paddle_length_m * 400.0 * RPM
    body = []
    with np.load(DATA / "dem_campaign_grains.npz") as grains:
        for load in (float(m) for m in grains["paddle_mass_kg"]):
            along, ahead, radius, speed, below = (
                grains[f"{name}_{load:g}"].astype(float)
                for name in ("along_mm", "ahead_mm", "let_go_radius_mm", "speed_m_s", "below_horizontal_deg")
            )
            rho, lead = radius / (1e3 * MACHINE.paddle_length_m), np.degrees(np.arctan2(ahead, along))
            level, down = speed * np.cos(np.radians(below)) / tip, speed * np.sin(np.radians(below)) / tip
            for inner, outer in ((0.65, 0.75), (0.75, 0.85), (0.85, 0.93), (0.93, 1.0)):
                cells = []
                for least, most in bins_deg:
                    cell = (rho >= inner) & (rho < outer) & (lead >= least) & (lead < most)
                    cells.append(f"{level[cell].mean():.2f} {down[cell].mean():+.2f}" if cell.sum() >= 10 else "")
                if any(cells) and load in (0.5, 0.9, 1.8):
                    body.append((f"{load:g}", f"{inner:.2f}-{outer:.2f}", f"{0.25 * (inner + outer) + 0.5:.2f}", *cells))
    return markdown(("kg", "rho_0", "half way, (rho_0 + 1) / 2", *(f"{a:.0f} to {b:.0f} deg ahead" for a, b in bins_deg)), body)


def section_edges() -> dict[str, str]:
    """Normal momentum lost, of what arrives in free fall, by where a grain aims; needs the throws of a campaign's folder."""
    assert THROWS is not None
    edges_m = (-0.05, -0.02, -0.01, 0.0, 0.01, 0.02)
    low_m = (-0.02, 0.0, 0.02, 0.05, 0.3)
    rows = select(read("dem_campaign.csv"), elevator_speed_rpm=400.0, friction=0.3, trial=1)
    body = []
    for i in np.lexsort((rows["plate_angle_deg"], rows["paddle_mass_kg"])):
        load, angle_deg = rows["paddle_mass_kg"][i], rows["plate_angle_deg"][i]
        if load not in (0.5, 0.9, 1.8):
            continue
        frame = PlateFrame.of(MACHINE, np.radians(angle_deg))
        with np.load(THROWS / str(rows["throw_key"][i]) / f"plate-{angle_deg:07.3f}.npz") as plate:
            met = crossing(frame, plate["free_position_m"], plate["free_velocity_m_s"], 9.81)
            leaving, mass = plate["end_velocity_m_s"] @ (*frame.inward, 0.0), plate["mass_kg"]
        place, arriving = met.place_m, met.into_m_s
        cells = []
        for origin, cuts in ((0.0, edges_m), (MACHINE.plate_length_m, low_m)):
            for least, most in pairwise(cuts):
                cell = (place >= origin + least) & (place < origin + most)
                lost = 1.0 - (mass * leaving)[cell].sum() / (mass * arriving)[cell].sum() if cell.sum() >= 10 else np.nan
                cells.append("" if np.isnan(lost) else f"{lost:.2f}")
        body.append((f"{load:g}", f"{angle_deg:.0f}", *cells))
    heads = [f"top {1e2 * a:+.0f} to {1e2 * b:+.0f} cm" for a, b in pairwise(edges_m)]
    heads += [f"low {1e2 * a:+.0f} to {1e2 * b:+.0f} cm" for a, b in pairwise(low_m)]
    return {"edges": markdown(("kg", "plate, deg", *heads), body)}


def section_landing() -> dict[str, str]:
    rows = select(read("dem_campaign.csv"), elevator_speed_rpm=400.0, friction=0.3)
    fractions = ("fraction_aim", "fraction_aim_with_gravity", "fraction_touch", "fraction_deflected", "fraction_miss")
    body = [
        (f"{mass:.1f}", f"{angle:.0f}", *(f"{100 * v:.0f}" for v in values))
        for mass, angle, *values in means(rows, ("paddle_mass_kg", "plate_angle_deg"), fractions)
        if angle in (40.0, 70.0, 90.0)
    ]
    header = ("kg", "plate, deg", "aim straight, %", "aim with gravity, %", "touch, %", "deflected, %", "pass by, %")
    figure, axes = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained", sharey=True)
    for axis, mass in zip(axes, (rows["paddle_mass_kg"].min(), rows["paddle_mass_kg"].max()), strict=True):
        part = select(rows, paddle_mass_kg=mass)
        for name in fractions:
            cells = np.array(means(part, ("plate_angle_deg",), (name,)))
            axis.plot(cells[:, 0], 100 * cells[:, 1], "o-", ms=4, label=name.removeprefix("fraction_").replace("_", " "))
        axis.set(title=f"{mass:g} kg", xlabel="plate angle, deg", ylim=(0, 102))
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("share of grains, %")
    axes[0].legend(fontsize=8)
    save(figure, "landing")
    return {"landing": markdown(header, body)}


def arrivals_of(rows: Rows) -> Rows:
    """How the stream meets the plate, row by row of `rows` of the campaign's table."""
    arrivals = read("dem_campaign_arrivals.csv")
    columns = ("plate_angle_deg", "paddle_mass_kg", "elevator_speed_rpm", "friction", "trial")
    order = {tuple(key): i for i, key in enumerate(zip(*(arrivals[name] for name in columns), strict=True))}
    found = [order[key] for key in zip(*(rows[name] for name in columns), strict=True)]
    return {name: values[found] for name, values in arrivals.items()}


def plate_end_table(rows: Rows) -> str:
    """Impulse on the face over the momentum that crosses it, and the end's part of the normal-only reading, at 400 rpm."""
    rows = select(rows, elevator_speed_rpm=400.0)
    met, angle = arrivals_of(rows), np.radians(rows["plate_angle_deg"])
    rows |= {
        "gain": met["on_face_kg_m_s"] / met["on_plate_kg_m_s"],
        "end": 100.0 * met["on_end_kg_m_s"] * np.cos(angle) / rows["momentum_kg_m_s"],
        "over": 100.0 * met["over_top_kg_m_s"] / (met["on_plate_kg_m_s"] + met["over_top_kg_m_s"] + met["below_low_kg_m_s"]),
    }
    body = []
    for friction, mass in sorted(set(zip(rows["friction"], rows["paddle_mass_kg"], strict=True))):
        one = select(rows, friction=friction, paddle_mass_kg=mass)
        cells = means(one, ("plate_angle_deg",), ("over", "gain", "end"))
        body.append((f"{friction:.2f}", f"{mass:.1f}", *(f"{o:.0f} / {g:.2f} / {e:.1f}" for _, o, g, e in cells)))
    return markdown(("friction", "kg", *(f"{a:.0f} deg" for a in np.unique(rows["plate_angle_deg"]))), body)


def section_impact() -> dict[str, str]:
    rows = read("dem_campaign.csv")
    angles = np.unique(rows["plate_angle_deg"])
    blocks = []
    body = []
    for speed, friction in sorted({(a, b) for a, b in zip(rows["elevator_speed_rpm"], rows["friction"], strict=True)}):
        part = select(rows, elevator_speed_rpm=speed, friction=friction)
        for mass in np.unique(part["paddle_mass_kg"]):
            one = select(part, paddle_mass_kg=mass)
            ratio = {cell[0]: cell[1] for cell in means(one, ("plate_angle_deg",), ("impact_ratio",))}
            body.append(
                (
                    f"{speed:.0f}",
                    f"{friction:.2f}",
                    f"{mass:.1f}",
                    f"{one['stream_thickness_kernels'].mean():.1f}",
                    *(f"{ratio[a]:.2f}" if a in ratio else "" for a in angles),
                )
            )
    blocks.append(markdown(("rpm", "friction", "kg", "thickness, kernels", *(f"{a:.0f} deg" for a in angles)), body))
    share = (rows["momentum_total_kg_m_s"] - rows["momentum_kg_m_s"]) / rows["momentum_kg_m_s"]
    body = []
    for friction in np.unique(rows["friction"]):
        cells = [np.isclose(rows["friction"], friction) & np.isclose(rows["plate_angle_deg"], a) for a in angles]
        body.append((f"{friction:.2f}", *(f"{100 * share[cell].mean():.1f}" for cell in cells)))
    blocks.append(markdown(("friction", *(f"{a:.0f} deg" for a in angles)), body))
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.0), layout="constrained")
    for angle in angles:
        part = select(rows, plate_angle_deg=angle)
        axes[0].plot(part["stream_thickness_kernels"], part["impact_ratio"], "o", ms=4, alpha=0.7, label=f"{angle:.0f} deg")
    axes[0].axhline(1.0 + RESTITUTION, color="k", lw=1)
    axes[0].text(axes[0].get_xlim()[0], 1.0 + RESTITUTION, " 1 + e", va="bottom")
    axes[0].axhline(1.0, color="k", lw=1, ls="--")
    axes[0].set(xlabel="stream thickness, kernels", ylabel="normal impulse / aimed normal momentum", ylim=(0.7, 1.85))
    axes[0].legend(fontsize=8)
    part = select(rows, elevator_speed_rpm=400.0, friction=0.3)
    for mass in np.unique(part["paddle_mass_kg"]):
        curve = np.array(means(select(part, paddle_mass_kg=mass), ("plate_angle_deg",), ("momentum_kg_m_s",)))
        axes[1].plot(curve[:, 0], curve[:, 1] / mass, "o-", ms=4, label=f"{mass:g} kg")
    axes[1].set(xlabel="plate angle, deg", ylabel="normal-only momentum per kg, m/s")
    axes[1].legend(fontsize=8)
    for axis in axes:
        axis.grid(alpha=0.3)
    save(figure, "impact")
    return {"impact": blocks[0], "plate-friction": blocks[1], "plate-end": plate_end_table(rows)}


#: Kernels compared: name on the page, file prefix, what `kernel` holds (None: the file has no such column).
KERNELS = (
    ("sphere, rolling 0.1", "dem_campaign", None),
    ("sphere, rolling 0.01", "dem_clumps", "sphere"),
    ("clump, rolling 0.01", "dem_clumps", "clump"),
)


def of_kernel(prefix: str, kernel: str | None, part: str = "") -> Rows:
    """Rows of one kernel at 400 rpm and friction 0.3, of the loads that clumps were thrown at."""
    loads = np.unique(read("dem_clumps.csv")["paddle_mass_kg"])
    rows = select(read(f"{prefix}{part}.csv"), elevator_speed_rpm=400.0, friction=0.3)
    keep = np.isin(rows["paddle_mass_kg"], loads)
    if kernel is not None:
        keep &= rows["kernel"] == kernel
    return {k: v[keep] for k, v in rows.items()}


def section_clumps() -> dict[str, str]:
    """The clumped kernel beside single spheres: heap, release, impulse, and the profile of the published table."""
    heaps, releases, impulses, gains = [], [], [], []
    cells: dict[str, dict[tuple[float, float], float]] = {}
    columns: tuple[str, ...]
    for name, prefix, kernel in KERNELS:
        columns = ("inner_radius_m", "reach_deg", "shape_ratio", "straightness_mm", "bulk_density_kg_m3")
        for mass, h0, reach, ratio, rough, density in means(of_kernel(prefix, kernel, "_heaps"), ("paddle_mass_kg",), columns):
            heaps.append(
                (
                    f"{mass:.1f}",
                    name,
                    f"{h0 / MACHINE.paddle_length_m:.3f}",
                    f"{reach:.0f}",
                    f"{ratio:.2f}",
                    f"{rough * 1e-3 / DIAMETER_M:.2f}",
                    f"{density:.0f}",
                )
            )
        layers = of_kernel(prefix, kernel, "_layers")
        time, speed, angle = published_release(layers["let_go_radius_over_l"], 0.3, 400.0)
        layers |= {
            "time": layers["travel_s"] / time - 1.0,
            "speed": layers["speed_over_tip"] / speed - 1.0,
            "angle": layers["below_horizontal_deg"] - angle,
        }
        rows = of_kernel(prefix, kernel)
        direction = "release_below_horizontal"
        columns = ("release_speed_m_s", f"{direction}_deg", f"{direction}_sd_deg", "stream_thickness_kernels")
        off = {mass: values for mass, *values in means(layers, ("paddle_mass_kg",), ("time", "speed", "angle"))}
        for mass, fast, below, spread, thick in means(rows, ("paddle_mass_kg",), columns):
            t, v, a = off[mass]
            releases.append(
                (
                    f"{mass:.1f}",
                    name,
                    f"{100 * t:+.1f}",
                    f"{100 * v:+.1f}",
                    f"{a:+.1f}",
                    f"{fast:.2f}",
                    f"{below:.1f} ± {spread:.1f}",
                    f"{thick:.1f}",
                )
            )
        columns = ("momentum_kg_m_s", "impact_ratio", "momentum_total_kg_m_s")
        cells[name] = {}
        for mass in np.unique(rows["paddle_mass_kg"]):
            found = means(select(rows, paddle_mass_kg=mass), ("plate_angle_deg",), columns)
            shared = [cell for cell in found if cell[0] in (40.0, 55.0, 70.0, 90.0)]
            cells[name] |= {(float(mass), cell[0]): cell[1] for cell in shared}
            rubbed = 100 * (shared[0][3] / shared[0][1] - 1.0)
            gains.append((f"{mass:.1f}", name, *(f"{cell[2]:.2f}" for cell in shared), f"{rubbed:.0f}"))
    first, second, clumped = (cells[name] for name, *_ in KERNELS)
    loads, angles = sorted({m for m, _ in clumped}), sorted({a for _, a in clumped})
    for mass in loads:
        impulses.append((f"{mass:.1f}", "clump, kg m/s", *(f"{clumped[mass, a]:.2f}" for a in angles)))
        for sphere, rolling in ((second, 0.01), (first, 0.1)):
            change = (f"{100 * (clumped[mass, a] / sphere[mass, a] - 1):+.1f}" for a in angles)
            impulses.append((f"{mass:.1f}", f"against the sphere, rolling {rolling:g}, %", *change))
    profile = [
        (name, f"{scale:.2f}", f"{rms:.1f}", f"{worst:.1f}", f"{growth:.2f}", f"{fall:.3f}")
        for name, scale, rms, worst, growth, fall in published_profile(cells)
    ]
    draw_clumps(cells, loads)

    def by_kernel(body: Iterable[tuple[str, ...]]) -> list[tuple[str, ...]]:
        return sorted(body, key=lambda row: float(row[0]))

    header = [f"{a:.0f} deg" for a in angles]
    return {
        "clump-heap": markdown(
            ("kg", "kernel", "h0/l", "psi_f, deg", "h_f", "off straight, kernels rms", "kg/m3"), by_kernel(heaps)
        ),
        "clump-release": markdown(
            (
                "kg",
                "kernel",
                "travel time, % off",
                "speed, % off",
                "direction, deg off",
                "speed, m/s",
                "below horizontal, deg",
                "thickness, kernels",
            ),
            by_kernel(releases),
        ),
        "clump-gain": markdown(("kg", "kernel", *header, f"total less normal at {header[0]}, %"), by_kernel(gains)),
        "clump-impulse": markdown(
            ("kg", "normal-only impulse", *header),
            impulses,
        ),
        "clump-published": markdown(
            ("runs", "scale", "rms, %", "largest, %", "90 deg: heaviest / lightest", "40 / 90 deg, mean"), profile
        ),
    }


Cells = Mapping[str, Mapping[tuple[float, float], float]]


def published_profile(cells: Cells) -> list[tuple[str, float, float, float, float, float]]:
    """Each kernel's cells (kg, deg) against the published table but for one scale factor, which the unknown speed leaves open.

    The table is taken linearly between its loads and angles. Per kernel: its name, scale (table over campaign), rms and largest
    deviation in %, growth with load at 90 deg, and mean of 40 over 90 deg; the table itself comes first, against itself.
    """
    rows = read("dem_table.csv")
    table_cells = {(m, a): p for m, a, p in means(rows, ("paddle_mass_kg", "plate_angle_deg"), ("momentum_kg_m_s",))}
    loads, angles = (sorted({key[i] for key in table_cells}) for i in range(2))
    grid = np.array([[table_cells[m, a] for a in angles] for m in loads])
    out = []
    wanted = list(next(iter(cells.values())))
    wanted = [key for key in wanted if all(key in found for found in cells.values())]
    told = {(m, a): float(np.interp(m, loads, [np.interp(a, angles, line) for line in grid])) for m, a in wanted}
    for name, found in {"published table": told, **cells}.items():
        log = np.log([told[key] / found[key] for key in wanted])
        rest = np.expm1(log - log.mean())
        low, high = min(m for m, _ in wanted), max(m for m, _ in wanted)
        fall = float(np.mean([found[m, 40.0] / found[m, 90.0] for m in sorted({m for m, _ in wanted})]))
        out.append(
            (
                name,
                float(np.exp(log.mean())),
                100 * float(np.sqrt(np.mean(rest**2))),
                100 * float(np.abs(rest).max()),
                found[high, 90.0] / found[low, 90.0],
                fall,
            )
        )
    return out


def draw_clumps(cells: Cells, loads: Sequence[float]) -> None:
    """The heap of clumps, and momentum per kg over plate angle for the kernels."""
    length = 1e3 * MACHINE.paddle_length_m
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    with np.load(DATA / "dem_clumps_grains.npz") as grains:
        load = max(float(m) for m in grains["paddle_mass_kg"] if m <= 0.9)
        axes[0].scatter(
            grains[f"ahead_mm_{load:g}"].astype(float),
            grains[f"along_mm_{load:g}"].astype(float),
            s=4,
            alpha=0.4,
            linewidths=0,
            color="tab:brown",
        )
    for (name, prefix, kernel), style in zip(KERNELS, ("b:", "b--", "k-"), strict=True):
        heap = select(of_kernel(prefix, kernel, "_heaps"), paddle_mass_kg=load)
        reach, h0 = np.radians(heap["reach_deg"].mean()), 1e3 * heap["inner_radius_m"].mean()
        axes[0].plot([0, length * np.sin(reach)], [h0, length * np.cos(reach)], style, label=name)
    arc = np.linspace(0, 1.6, 60)
    axes[0].plot(length * np.sin(arc), length * np.cos(arc), color="grey")
    axes[0].set(
        title=f"{load:g} kg of clumps; fitted lines",
        xlabel="ahead of the paddle, mm",
        ylabel="along the paddle, mm",
        xlim=(-5, 165),
        ylim=(0, 165),
        aspect="equal",
    )
    axes[0].legend(loc="lower right", fontsize=8)
    for (name, *_), style in zip(KERNELS, (":", "--", "-"), strict=True):
        for mass, colour in zip(loads, ("tab:blue", "tab:orange", "tab:green", "tab:red"), strict=False):
            line = sorted((a, p / m) for (m, a), p in cells[name].items() if m == mass)
            label = f"{mass:g} kg" if style == "-" else None
            axes[1].plot(*zip(*line, strict=True), style, marker="o", ms=3, color=colour, label=label)
    axes[1].set(
        xlabel="plate angle, deg",
        ylabel="normal-only momentum per kg, m/s",
        title="clump (solid), sphere rolling 0.01 (dashed), 0.1 (dotted)",
    )
    axes[1].legend(fontsize=8)
    axes[1].grid(alpha=0.3)
    save(figure, "clumps")


def measurements(rows: Rows, column: str) -> Measurements:
    return Measurements(stages.conditions(rows), rows[column])


#: Of a reading: the engine's own accuracy, to which halving its time step may move an impulse (`python -m studies.dem check`).
ENGINE_ACCURACY = 0.02


def campaign_table(friction: float, column: str, folder: Path, accuracy: float = 0.0) -> Path:
    """One crop of the campaign as a table with the reading to judge in momentum_kg_m_s.

    accuracy: share of each reading stated as its sigma; 0: none stated, noise from the seeds.
    """
    rows = select(read("dem_campaign.csv"), friction=friction)
    path = folder / f"{column}-{friction:g}.csv"
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        names: tuple[str, ...] = ("plate_angle_deg", "paddle_mass_kg", "elevator_speed_rpm", "trial", "momentum_kg_m_s")
        columns = [*(rows[name] for name in names[:3]), rows["trial"].astype(int), rows[column]]
        if accuracy:
            names, columns = (*names, "sigma"), [*columns, accuracy * rows[column]]
        writer.writerow(names)
        writer.writerows(zip(*columns, strict=True))
    return path


READINGS = {"momentum_kg_m_s": "normal only", "momentum_total_kg_m_s": "total"}


@cache
def diagnosed(friction: float, column: str, accuracy: float, *, given: bool) -> diagnosis.Diagnosis:
    """The workflow on one crop and one reading, seed and split as by default.

    given: what is known without a throw, gravity and the thickness of the plate's end, belongs to the model from the start.
    """
    with tempfile.TemporaryDirectory() as folder:
        data = table.load(campaign_table(friction, column, Path(folder), accuracy))
    start = parameter_file.load(None)
    if given:
        start = replace(start, values={**start.values, **stages.KNOWN})
    return diagnosis.diagnose(data, MACHINE, start, diagnosis.Options(keep_effects=given))


def section_diagnosis() -> dict[str, str]:
    body = []
    for given, accuracy in product((False, True), (0.0, ENGINE_ACCURACY)):
        for friction in np.unique(read("dem_campaign.csv")["friction"]):
            for column, name in READINGS.items():
                found = diagnosed(float(friction), column, accuracy, given=given)
                held, choice = found.held_out, found.choice
                body.append(
                    (
                        "gravity, plate's end" if given else "-",
                        f"{100 * accuracy:g} %" if accuracy else "seeds",
                        f"{friction:.2f}",
                        name,
                        found.verdict,
                        said(found),
                        f"{found.before.rms_over_max_pct:.2f}",
                        f"{choice.lack_of_fit_before.f:.1f} → {choice.lack_of_fit_after.f:.1f}",
                        "-"
                        if held is None
                        else f"{held.before.rms:.3f} → {held.after.rms:.3f} (noise {held.noise_floor_rms:.3f})",
                        "-" if held is None or held.closed_pct is None else f"{held.closed_pct:.0f}",
                    )
                )
    header = (
        "told",
        "noise",
        "friction",
        "reading",
        "verdict",
        "named",
        "rms/max, %",
        "lack of fit F, with these",
        "held out, kg m/s",
        "gap closed, %",
    )
    return {"diagnosis": markdown(header, body)}


def said(found: diagnosis.Diagnosis) -> str:
    """Effects with their values; those of a partial explanation are marked as such."""
    fit = found.choice.best
    effects = []
    for step in found.choice.steps:
        own = [p.name for p in fit.parameters if p.name.startswith(f"{step.law}.")]
        values = ", ".join(f"{name.partition('.')[2]} = {fit.values[name]:.3g}" for name in own)
        ties = f"; or {', '.join(step.equivalent)}" if step.equivalent else ""
        effects.append(f"{step.added} ({values}; confidence {step.confidence:.2f}{ties})")
    text = "; ".join(effects) or "-"
    return text if found.verdict == "effect" else f"helps, but does not explain: {text}"


#: Two loads: of all pairs, the lightest and the heaviest say most about k1 and k2 (D-optimal at equal relative errors).
CALIBRATED_WITH_KG = (0.2, 1.8)
CALIBRATED_AT_RPM = 400.0


def open_loop_fit(
    friction: float, column: str, known: dict[str, float], angle_deg: float, loads_kg: tuple[float, float] = CALIBRATED_WITH_KG
) -> tuple[ForwardModel, ParameterSet, np.ndarray]:
    """k1 and k2 fitted to the rows at one angle, one speed and two loads; all else is `known`. Last: which rows were used."""
    rows = select(read("dem_campaign.csv"), friction=friction)
    used = np.isclose(rows["plate_angle_deg"], angle_deg) & np.isclose(rows["elevator_speed_rpm"], CALIBRATED_AT_RPM)
    used &= np.isin(rows["paddle_mass_kg"], loads_kg)
    names = tuple(sorted({name.partition(".")[0] for name in known if "." in name}))
    model = ForwardModel(MACHINE, names)
    data = measurements({k: v[used] for k, v in rows.items()}, column)
    fitted = calibrate(
        model,
        data,
        default_start(model, data, ("k1", "k2"), known),
        ("k1", "k2"),
        bounds={"k1": (-20.0, 20.0), "k2": (-5.0, 20.0)},
        rng=np.random.default_rng(0),
        intervals=False,
    )
    return model, fitted.parameter_set, used


def open_loop_gain(friction: float, column: str, known: dict[str, float], angle_deg: float) -> dict[str, float]:
    """The k1 and k2 of `open_loop_fit`."""
    _, parameters, _ = open_loop_fit(friction, column, known, angle_deg)
    return {name: float(parameters.values[name]) for name in ("k1", "k2")}


def open_loop_error(
    friction: float, column: str, known: dict[str, float], angle_deg: float, loads_kg: tuple[float, float] = CALIBRATED_WITH_KG
) -> tuple[Rows, np.ndarray]:
    """Rows not used for the calibration, and the error of their estimated load (share of the load)."""
    model, parameters, used = open_loop_fit(friction, column, known, angle_deg, loads_kg)
    rest = {k: v[~used] for k, v in select(read("dem_campaign.csv"), friction=friction).items()}
    spin = rest["elevator_speed_rpm"] * RPM
    passes = MACHINE.passes_per_s(spin)
    flow = OpenLoop(model, parameters).invert(rest[column] * passes, np.radians(rest["plate_angle_deg"]), spin)
    return rest, flow / passes / rest["paddle_mass_kg"] - 1.0


def grain_of(friction: float, *, shape_ratio: float | None = None) -> dict[str, float]:
    """What an experimenter knows of a crop without throwing it: friction, settled density and shape of the heap."""
    heaps = select(read("dem_campaign_heaps.csv"), friction=friction)
    shape = float(heaps["shape_ratio"].mean()) if shape_ratio is None else shape_ratio
    return {"friction": friction, "density": float(heaps["bulk_density_kg_m3"].mean()), "shape_ratio": shape}


@cache
def recorded_sizes(friction: float) -> dict[str, float]:
    """Sizes of the effects that the per-grain records show, from one crop's records and both its readings."""
    rows = select(read("dem_campaign.csv"), friction=friction)
    release = stages.learn_release(grain_of(friction), rows, arrivals_of(rows))
    return {**release, **stages.learn_impact(grain_of(friction), rows, release)}


def transferred(sizes: dict[str, float], learnt_at: float, used_at: float, column: str) -> dict[str, float]:
    """Sizes learnt on one crop, for a reading of another; friction on the plate is in total readings only."""
    name = "plate_friction.coefficient"
    moved = {**grain_of(used_at), **stages.KNOWN, **sizes, name: stages.friction_on_plate(sizes[name], learnt_at, used_at)}
    if column != "momentum_total_kg_m_s":
        del moved[name]
    return moved


def open_loop_models(friction: float, other: float, column: str) -> list[tuple[str, dict[str, float], dict[str, float]]]:
    """Models to judge: name, values for the crop judged, and values on the other crop, on which the angle is chosen."""
    found = diagnosed(other, column, ENGINE_ACCURACY, given=True)
    learnt = {k: float(v) for k, v in found.choice.best.values.items() if k not in ("k1", "k2", "restitution")} | stages.KNOWN
    what = "named" if found.verdict == "effect" else "partial"
    sizes = recorded_sizes(other)
    return [
        ("published", grain_of(friction, shape_ratio=2.0), grain_of(other, shape_ratio=2.0)),
        (f"{what}: {' + '.join(found.choice.best.effects) or 'nothing'}", learnt, learnt),
        ("recorded effects", transferred(sizes, other, friction, column), transferred(sizes, other, other, column)),
    ]


def error_pct(
    friction: float, column: str, values: dict[str, float], angle_deg: float, *loads: tuple[float, float]
) -> tuple[float, float, int]:
    """Mean and largest error, %, and the number of rows without an estimate."""
    _, error = open_loop_error(friction, column, values, angle_deg, *loads)
    size = 100.0 * np.abs(error)
    return float(np.nanmean(size)), float(np.nanmax(size)), int(np.isnan(size).sum())


def chosen_angle(friction: float, column: str, values: dict[str, float]) -> float:
    """The angle of calibration with the smallest largest error on a crop, among those that leave the fewest rows unestimated."""
    angles = [float(a) for a in np.unique(read("dem_campaign.csv")["plate_angle_deg"])]
    rank = {a: error_pct(friction, column, values, a) for a in angles}
    return min(angles, key=lambda a: (rank[a][2], rank[a][1]))


def section_open_loop() -> dict[str, str]:
    frictions = [float(f) for f in np.unique(read("dem_campaign.csv")["friction"])]
    angles = [float(a) for a in np.unique(read("dem_campaign.csv")["plate_angle_deg"])]
    summary, detail, designs = [], [], []
    learnt = [(f"{friction:.2f}", *(f"{size:.3g}" for size in recorded_sizes(friction).values())) for friction in frictions]
    for column, reading in READINGS.items():
        for friction in frictions:
            other = next(f for f in frictions if f != friction)
            for label, values, there in open_loop_models(friction, other, column):
                angle = chosen_angle(other, column, there)
                rest, error = open_loop_error(friction, column, values, angle)
                size = 100.0 * np.abs(error)
                summary.append(
                    (
                        reading,
                        f"{friction:.2f}",
                        label,
                        f"{angle:.0f}",
                        f"{np.nanmean(size):.1f}",
                        f"{np.nanmedian(size):.1f}",
                        f"{np.nanpercentile(size, 95):.1f}",
                        f"{np.nanmax(size):.1f}",
                        int(np.isnan(size).sum()),
                    )
                )
                tried = [error_pct(friction, column, values, a) for a in angles]
                tried.append(error_pct(friction, column, values, 70.0, (0.5, 1.3)))
                designs.append((reading, f"{friction:.2f}", label, *(f"{mean:.1f} / {most:.0f}" for mean, most, _ in tried)))
                if friction == frictions[-1]:
                    for mass in np.unique(rest["paddle_mass_kg"]):
                        cells = []
                        for a in angles:
                            cell = np.isclose(rest["paddle_mass_kg"], mass) & np.isclose(rest["plate_angle_deg"], a)
                            cells.append(f"{100 * np.mean(error[cell]):+.1f}" if cell.any() else "")
                        detail.append((reading, label, f"{mass:g}", *cells))
    header = (
        "reading",
        "friction",
        "model",
        "calibrated at, deg",
        "mean error, %",
        "median",
        "95 %",
        "largest",
        "rows without estimate",
    )
    columns = [f"{a:.0f} deg" for a in angles]
    return {
        "open-loop": markdown(header, summary),
        "open-loop-cells": markdown(("reading", "model", "kg", *columns), detail),
        "open-loop-designs": markdown(("reading", "friction", "model", *columns, "70 deg, 0.5 and 1.3 kg"), designs),
        "open-loop-sizes": markdown(("learnt at friction", *recorded_sizes(frictions[0])), learnt),
        "open-loop-budget": open_loop_budget(frictions),
    }


def open_loop_budget(frictions: Sequence[float]) -> str:
    """Where the error of the normal-only reading comes from, stage by stage, with the sizes of the other crop."""
    said = {
        "stream": "heap, release and flight: what lands on the face",
        "gain": "gain on the face, grain caught past the edges",
        "end": "the plate's end",
        "whole": "together",
    }
    column, body = "momentum_kg_m_s", []
    for friction in frictions:
        other = next(f for f in frictions if f != friction)
        values = transferred(recorded_sizes(other), other, friction, column)
        angle = chosen_angle(other, column, transferred(recorded_sizes(other), other, other, column))
        rows = select(read("dem_campaign.csv"), friction=friction)
        parts = stages.budget_pct(values | open_loop_gain(friction, column, values, angle), rows, arrivals_of(rows))
        for name, text in said.items():
            cells = [parts[name][np.isclose(rows["plate_angle_deg"], a)] for a in np.unique(rows["plate_angle_deg"])]
            body.append(
                (
                    f"{friction:.2f}",
                    text,
                    *(f"{cell.mean():+.1f} ± {cell.std():.1f}" for cell in cells),
                    f"{np.sqrt(np.mean(parts[name] ** 2)):.1f}",
                )
            )
    angles = np.unique(read("dem_campaign.csv")["plate_angle_deg"])
    return markdown(("friction", "stage", *(f"{a:.0f} deg" for a in angles), "rms"), body)


SECTIONS: dict[str, Callable[[], dict[str, str]]] = {
    "heap": section_heap,
    "release": section_release,
    "landing": section_landing,
    "impact": section_impact,
    "clumps": section_clumps,
    "edges": section_edges,
    "diagnosis": section_diagnosis,
    "open-loop": section_open_loop,
}


def _filled(block: str, place: re.Match[str]) -> str:
    return f"{place[1]}{block}\n{place[2]}"


def fill(page: Path, blocks: dict[str, str]) -> None:
    """Puts each block between its markers in the page."""
    text = page.read_text(encoding="utf-8")
    for name, block in blocks.items():
        pattern = re.compile(rf"(<!-- {name} -->\n).*?(<!-- /{name} -->)", re.S)
        text, count = pattern.subn(partial(_filled, block), text)
        if count == 0:
            print(f"dem-report: {page.name} has no place for {name}", file=sys.stderr)
    page.write_text(text, encoding="utf-8")


def main() -> int:
    global DATA, PICTURES, THROWS
    parser = argparse.ArgumentParser(
        prog="python -m studies.dem.report", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sections", nargs="*", help=f"default: all of {', '.join(SECTIONS)}")
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--page", type=Path, help="fill the tables of this page; default: print them")
    parser.add_argument("--pictures", type=Path, default=PICTURES)
    parser.add_argument("--throws", type=Path, help="throws/ of the reference campaign's folder, for the section edges alone")
    args = parser.parse_args()
    DATA, PICTURES, THROWS = args.data, args.pictures, args.throws
    if THROWS is None and "edges" in args.sections:
        parser.error("section edges needs --throws")
    for name in args.sections or [name for name in SECTIONS if name != "edges" or THROWS is not None]:
        if name not in SECTIONS:
            parser.error(f"no section {name}, expected one of {', '.join(SECTIONS)}")
        blocks = SECTIONS[name]()
        if args.page is None:
            for key, block in blocks.items():
                print(f"<!-- {key} -->\n{block}\n<!-- /{key} -->\n")
        else:
            fill(args.page, blocks)
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Cases from three generators that share no law with the library.

    python -m studies.hidden_effects.law_cases OUT.jsonl [--cases N] [--salt N] [--part 1/2] [--only KIND...]

third: the study's generator by its third laws. combine: the virtual combine. engine: impulses recorded on the discrete-element
engine, with an effect put in by other labels (angle, load), by the other reading (friction) or on the reading (cell). One JSON
line a case: what was hidden, the verdict, names with their classes, what a confidence can be learnt from, seed and commit.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import sys
import time
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from studies.facility import facility
from studies.hidden_effects import cases, study
from studies.hidden_effects import generator as g
from yieldmon.discrepancy import confidence, diagnosis
from yieldmon.discrepancy.alternatives import needed
from yieldmon.discrepancy.merit import misfit
from yieldmon.discrepancy.observations import Rows, with_cells
from yieldmon.discrepancy.policy import Policy
from yieldmon.estimation import model_error
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.machine import RPM, Machine
from yieldmon.plant.scenario import Scenario

DEVELOPMENT_SALT = 4177
"""Of cases that were looked at while the policy was made."""
REPORT_SALT = 60611
"""Of cases that are reported: none was looked at before the policy was fixed."""
START = {"friction": 0.2, "density": 1100.0, "shape_ratio": 2.0, "restitution": 0.6}
AVERAGES_S = (5.0, 20.0, 60.0, 200.0, 600.0)
VISIBLE = 6.0
"""Length, in standard deviations of the cell means, of what recalibration cannot follow, from which an effect is visible."""
LAW_TIMES = (0.0, 1.0, 2.0, 4.0)
"""Multiples of the error of an effect's law for which records keep what is left."""

#: Sizes of the virtual combine's effects, from small to large.
COMBINE: dict[str, tuple[str, float, float]] = {
    "plate_friction": ("friction", 0.05, 0.3),
    "jet_shielding": ("thickness_m", 0.15, 0.02),
    "residual_radial_speed": ("share_of_tip_speed", 0.05, 0.3),
    "release_angle": ("angle_deg", 2.0, 10.0),
    "stream_spread": ("half_width_deg", 4.0, 15.0),
    "speed_dependent_shape": ("exponent", -0.5, -1.5),
    "miss_capture": ("captured_share", 0.3, 0.9),
    "speed_dependent_restitution": ("exponent", 0.1, 0.5),
    "secondary_impact": ("share", 0.2, 0.8),
    "resting_grain": ("time_s", 0.05, 0.2),
    "paddle_leakage": ("share_at_full", 0.2, 0.7),
    "zero_offset": ("force_n", 1.0, 8.0),
    "plate_angle_offset": ("angle_deg", 1.0, 5.0),
    "lever_arm": ("slope", 0.2, 1.0),
    "cell_nonlinearity": ("share", 0.1, 0.4),
    "air_drag": ("terminal_speed_m_s", 14.0, 7.0),
    "speed_dependent_friction": ("rise", 0.5, 4.0),
}


def combine_rows(effects: dict[str, Any], averaging_s: float, rng: np.random.Generator) -> tuple[Rows, Grain]:
    """270 rows of the virtual combine, 6 angles, 5 flows, 3 speeds, 3 trials, and its grain.

    With an angle offset the angles are 1 deg less: its table of pulses ends at 94 deg.
    """
    angles_deg = tuple(range(39, 90, 10) if "plate_angle_offset" in effects else range(40, 91, 10))
    grain = {
        "friction": float(rng.uniform(0.15, 0.45)),
        "restitution": float(rng.uniform(0.35, 0.65)),
        "bulk_density_kg_m3": float(rng.uniform(950.0, 1350.0)),
    }
    scenario = Scenario.model_validate({"duration_s": 10, "crop": grain, "effects": {"gravity": "on"} | effects})
    columns = facility.measure(
        scenario, Machine(), (1.5, 4.0, 8.0, 12.0, 17.0), angles_deg, (340.0, 400.0, 460.0),
        averaging_s=averaging_s, trials=3, seed=int(rng.integers(2**31)),
    )  # fmt: skip
    nothing = np.full(len(columns["force_n"]), np.nan)
    rows = with_cells(
        Rows(
            Machine(), "mass_flow_kg_s", "force", True, np.radians(columns["plate_angle_deg"]),
            columns["elevator_speed_rpm"] * RPM, columns["mass_flow_kg_s"], nothing, columns["force_n"], nothing,
            tuple(f"{t:g}" for t in columns["trial"]), np.zeros(len(nothing), dtype=np.int64),
        )
    )  # fmt: skip
    return rows, {k: grain[k] for k in ("friction", "restitution")} | {"density": grain["bulk_density_kg_m3"]}


#: The discrete-element campaign's hidden effects, from small to large, by how they are put into its recorded impulses.
ENGINE: dict[str, tuple[float, float]] = {
    "plate_friction": (0.6, 1.0),
    "plate_angle_offset": (2.0, 5.0),
    "zero_offset": (2.0, 8.0),
    "plate_buildup": (3.0, 12.0),
    "cell_nonlinearity": (0.05, 0.2),
    "paddle_leakage": (0.1, 0.3),
    "lever_arm": (0.3, 1.0),
    "heap_shape": (1.0, 1.0),
    "unpushed_layers": (1.0, 1.0),
}
CAMPAIGN = Path(__file__).resolve().parents[2] / "tests" / "data" / "dem_campaign.csv"
#: Heap and release of the campaign's two crops, by friction, as its heaps and arrivals show them, and the thickness of its
#: plate's end, which takes 3 to 7 % of the reading at 55 deg (studies/dem).
TOLD = {
    0.3: {"shape_ratio": 2.95, "stream_rise.ratio": 0.129, "unpushed_layers.rate_per_rad": 1.6, "top_edge.thickness_m": 0.0102},
    0.15: {"shape_ratio": 3.65, "stream_rise.ratio": 0.139, "unpushed_layers.rate_per_rad": 1.4, "top_edge.thickness_m": 0.0102},
}
EXACT = ("gravity", "zero_offset", "plate_angle_offset", "plate_buildup", "heap_shape", "chain_slip", "paddle_wear")
THIRD = (*g.THIRD_LAWS, *EXACT)
Grain = dict[str, float]
"""friction, restitution and density."""
PAIRED = tuple(name for name in THIRD if name not in ("chain_slip", "paddle_wear", *cases.LATER))


def todo(count: int) -> Iterator[tuple[str, str, int]]:
    """(generator, what is hidden, number): in each round every kind advances together."""
    for number in range(count):
        rng = np.random.default_rng([number, 77])
        pairs = ["+".join(sorted(map(str, rng.choice(PAIRED, 2, replace=False)))) for _ in range(6)]
        groups = [
            [("third", name, number) for name in THIRD if name not in cases.LATER],
            [("combine", name, number) for name in COMBINE if name not in cases.LATER],
            [("engine", name, number) for name in ENGINE],
            [("clean", f"{average:g}", number) for average in AVERAGES_S],
            [("third-clean", "", 2 * number + i) for i in range(2)],
            [("engine-clean", "", number)],
            [("third-pair", pair, 6 * number + i) for i, pair in enumerate(pairs)],
            [("third-removed", str(name), number) for name in rng.choice(PAIRED, 6, replace=False)],
        ]
        for group in groups:
            rng.shuffle(group)
        groups += [_later(name, number) for name in cases.LATER]
        placed = [((i + 0.5) / len(group), n, case) for n, group in enumerate(groups) for i, case in enumerate(group)]
        yield from ((str(kind), str(name), int(i)) for _, _, (kind, name, i) in sorted(placed, key=lambda p: p[:2]))


def _later(name: str, number: int) -> list[tuple[str, str, int]]:
    """A round's cases of an effect that came after the records: each generator's, one removed, one beside another effect."""
    other = str(np.random.default_rng([number, 78]).choice(PAIRED))
    pair = "+".join(sorted((name, other)))
    kinds = [("third", name), ("combine", name), ("third-removed", name), ("third-pair", pair)]
    return [(kind, hidden, number) for kind, hidden in kinds]


def engine_rows(name: str, rng: np.random.Generator) -> tuple[Rows, dict[str, float], float]:
    """Rows of the discrete-element campaign, both speeds, 3 % noise, with an effect put in; what is told; the size.

    From 55 deg on: at 40 deg the plate's end takes a large share.
    """
    with open(CAMPAIGN, newline="", encoding="utf-8") as file:
        recorded = list(csv.DictReader(file))
    friction = float(rng.choice([0.15, 0.3]))
    ours = [r for r in recorded if float(r["friction"]) == friction and r["trial"] == "1"]
    chosen = [r for r in ours if float(r["plate_angle_deg"]) > 50.0]
    columns = (
        "plate_angle_deg", "elevator_speed_rpm", "paddle_mass_kg", "momentum_kg_m_s", "momentum_total_kg_m_s", "landing_place_m",
    )  # fmt: skip
    angle, speed, mass, normal, total, place = (np.repeat([float(r[c]) for r in chosen], 3) for c in columns)
    low, high = ENGINE.get(name, (0.0, 0.0))
    size = low + (high - low) * float(rng.random())
    told = {"gravity.acceleration_m_s2": 9.81} | TOLD[friction]
    machine = Machine()
    passes = machine.passes_per_s(speed * RPM)
    force = (normal + size * (total - normal) if name == "plate_friction" else normal) * passes
    top = float(force.max())
    sense = float(rng.choice([-1.0, 1.0]))
    if name == "plate_angle_offset":
        angle = angle - sense * size
    elif name == "zero_offset":
        force = force + sense * size
    elif name == "plate_buildup":
        force = force + size * np.cos(np.radians(angle))
    elif name == "cell_nonlinearity":
        force = force * (1.0 - size * (force / top) ** 1.5)
    elif name == "paddle_leakage":
        mass = mass / (1.0 - size * (mass / 1.8) ** 1.3)
    elif name == "lever_arm":
        force = force * (1.0 + sense * size * (place / machine.plate_length_m - 0.5))
    elif name in ("heap_shape", "unpushed_layers"):
        told = {k: v for k, v in told.items() if not k.startswith({"heap_shape": "shape_ratio"}.get(name, name))}
    sd = 0.03 * np.hypot(force, 0.15 * top)
    nothing = np.full(len(force), np.nan)
    rows = Rows(
        machine, "paddle_mass_kg", "force", True, np.radians(angle), speed * RPM, mass, nothing,
        force + sd * rng.standard_normal(len(force)), nothing, tuple("123" * (len(force) // 3)),
        np.zeros(len(force), dtype=np.int64),
    )  # fmt: skip
    return with_cells(rows), told, size


def own_rows(hidden: tuple[str, ...], rng: np.random.Generator, third: bool, shape: float = 2.0) -> tuple[Rows, Grain]:
    """Rows of the study's own generator by its second or third laws, and its grain: 1 % noise, each effect scaled to 5 to 20 %
    of full scale."""
    case = cases.Case("hidden", hidden, int(rng.integers(2**20)), 1.0, "many")
    angle, flow, speed, moisture, trial = cases._design(case, rng)
    grain = g.Grain(float(rng.uniform(0.1, 0.6)), float(rng.uniform(0.3, 0.75)), float(rng.uniform(900.0, 1500.0)), shape)
    clean = g.force(angle, speed, flow, moisture, grain, {})
    full, sizes = float(np.nanmax(clean)), dict[str, float]()
    for name in hidden:
        wanted = float(rng.uniform(0.05, 0.2))
        low, high = (-0.3, 0.6) if name == "heap_shape" else cases.SIZES[name]
        sign = -1.0 if low < 0.0 and rng.random() < 0.5 else 1.0
        size = high if low == high else 0.3 * high
        for _ in range(4 if low != high else 0):
            changed = g.force(angle, speed, flow, moisture, grain, {name: sign * size}, other_laws=not third, third_laws=third)
            size = min(size * wanted * full / max(float(np.nanmax(np.abs(changed - clean))), 1e-6), high)
        sizes[name] = sign * size
    clean = g.force(angle, speed, flow, moisture, grain, sizes, other_laws=not third, third_laws=third)
    sd = 0.01 * np.hypot(clean, 0.15 * float(np.nanmax(clean)))
    reading = clean + sd * rng.standard_normal(len(clean))
    nothing = np.full(len(angle), np.nan)
    rows = Rows(
        Machine(), "mass_flow_kg_s", "force", True, angle, speed, flow, moisture, reading, nothing, trial,
        np.zeros(len(angle), dtype=np.int64),
    ).take(np.isfinite(reading))  # fmt: skip
    return with_cells(rows), {"friction": grain.friction, "restitution": grain.restitution, "density": grain.density}


def rows_of(kind: str, name: str, rng: np.random.Generator) -> tuple[Rows, dict[str, float], Grain]:
    """Rows of a case, the parameters that are known beforehand, and the true ones of its grain, as far as there are any."""
    gravity = {"gravity.acceleration_m_s2": 9.81}
    if kind == "clean":
        rows, grain = combine_rows({}, float(name), rng)
        return rows, gravity, grain
    if kind == "combine":
        key, small, large = COMBINE[name]
        size = small + (large - small) * float(rng.random())
        average = float(rng.choice(AVERAGES_S[1:4]))
        rows, grain = combine_rows({name: {key: size}}, average, rng)
        return rows, gravity, grain
    if kind.startswith("engine"):
        rows, told, _ = engine_rows(name, rng)
        return rows, told, {}
    rows, grain = own_rows(tuple(name.split("+")) if name else (), rng, kind.startswith("third"))
    return rows, {}, grain


def record(kind: str, name: str, number: int, salt: int) -> dict[str, Any]:
    """Make and diagnose one case, whatever the confidence in what is named."""
    key = f"{kind}/{name}/{number}"
    rng = np.random.default_rng([zlib.crc32(key.encode()), salt])
    rows, known, grain = rows_of(kind, name, rng)
    began = time.process_time()
    truth = tuple(name.split("+")) if "clean" not in kind else ()
    options = diagnosis.Options(
        keep_effects=any("." in parameter for parameter in known),
        without=truth if kind.endswith("removed") else (),
        policy=Policy(least_confidence=0.0),
    )
    seen = diagnosis.examine(rows, ParameterSet(values=START | known), options)
    choice = seen.choice
    classes = [[s.added, *s.equivalent] for s in choice.steps]
    return {
        "case": key,
        "generator": kind,
        "salt": salt,
        "commit": study.commit(),
        "hidden": list(truth),
        # What the published model leaves beyond noise, in standard deviations: what could be seen at all.
        "visible_sd": float(np.sqrt(max(choice.base.chi2 - choice.base.dof, 0.0))),
        "verdict": choice.verdict,
        "classes": classes,
        "against": choice.objection,
        "undone": choice.best.cancelled,
        # Each of several effects beside other laws of the others: twice the log evidence, and gain in chi-square.
        "needed": [[n.effect, n.evidence, n.gain] for n in needed(choice.best, misfit([choice.best]), Policy().per_parameter)],
        "laws": [s.law for s in choice.steps],
        "features": confidence.features(choice),
        "f": [choice.lack_of_fit_before.f, choice.lack_of_fit_after.f],
        "p": [choice.lack_of_fit_before.p_value, choice.lack_of_fit_after.p_value],
        "chi2": [choice.base.chi2, choice.best.chi2],
        "dof": [choice.base.dof, choice.best.dof],
        # Chi-square that the model's own error makes in the mean, and what is left where laws may be off by so many times more.
        "own": [float(np.sum(model_error.off(f.own_error, f.tangent()) ** 2)) for f in (choice.base, choice.best)],
        "left_by_law": [choice.best.marginal(times * choice.best.shape_error)[0] for times in LAW_TIMES],
        "agrees": None if seen.validation is None else seen.validation.agrees,
        "share": None if seen.validation is None else [seen.validation.cross_fitted.value, seen.validation.cross_fitted.sd],
        "sealed": None
        if seen.validation is None or seen.validation.held_out is None
        else [seen.validation.held_out.value, seen.validation.held_out.sd],
        "worse": [] if seen.validation is None else list(seen.validation.worse),
        # The grain's parameters: true ones, as the published model fits them, and as the model with the effects does.
        "grain": {"true": grain}
        | {what: {k: f.values.get(k) for k in grain} for what, f in (("published", choice.base), ("fitted", choice.best))},
        "cpu_s": time.process_time() - began,
    }


def run(out: Path, wanted: Sequence[tuple[str, str, int]], salt: int) -> None:
    """Append the cases that are not in `out` yet, one line each; safe to stop and start again."""
    done = {r["case"] for r in study.read(out)} if out.exists() else set()
    with open(out, "a", encoding="utf-8") as file:
        for kind, name, number in wanted:
            if f"{kind}/{name}/{number}" not in done:
                file.write(json.dumps(record(kind, name, number, salt)) + "\n")
                file.flush()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--cases", type=int, default=4, help="of each effect and generator")
    parser.add_argument("--salt", type=int, default=REPORT_SALT, help="of every case's seed")
    parser.add_argument("--part", default="1/1", help="which share of the cases, such as 2/3")
    parser.add_argument("--only", nargs="+", help="generators: third, combine, engine, clean, third-clean, third-pair...")
    args = parser.parse_args()
    part, parts = (int(v) for v in args.part.split("/"))
    wanted = [c for c in todo(args.cases) if args.only is None or c[0] in args.only][part - 1 :: parts]
    run(args.out, wanted, args.salt)
    return 0


if __name__ == "__main__":
    sys.exit(main())

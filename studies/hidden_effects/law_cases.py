"""Cases from generators that share no law with the library: the effects' second laws, and the virtual combine's own.

    python -m studies.hidden_effects.law_cases OUT.jsonl [--cases N] [--part 1/2] [--only laws | combine | clean]

One JSON line a case: what was hidden, the verdict, the names with their classes and confidences, whether it was right.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from studies.facility import facility
from studies.hidden_effects import cases
from studies.hidden_effects import generator as g
from yieldmon.discrepancy import diagnosis
from yieldmon.discrepancy.observations import Rows, with_cells
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.machine import RPM, Machine
from yieldmon.plant.scenario import Scenario

SALT = 4177
START = {"friction": 0.2, "density": 1100.0, "shape_ratio": 2.0, "restitution": 0.6}
AVERAGES_S = (5.0, 20.0, 60.0, 200.0, 600.0)
VISIBLE = 6.0
"""Length, in standard deviations of the cell means, of what recalibration cannot follow, from which an effect is visible."""

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
}


def combine_rows(effects: dict[str, Any], averaging_s: float, rng: np.random.Generator) -> Rows:
    """270 rows of the virtual combine: 6 angles, 5 flows, 3 speeds, 3 trials."""
    grain = {
        "friction": float(rng.uniform(0.15, 0.45)),
        "restitution": float(rng.uniform(0.35, 0.65)),
        "bulk_density_kg_m3": float(rng.uniform(950.0, 1350.0)),
    }
    scenario = Scenario.model_validate({"duration_s": 10, "crop": grain, "effects": {"gravity": "on"} | effects})
    columns = facility.measure(
        scenario, Machine(), (1.5, 4.0, 8.0, 12.0, 17.0), tuple(range(40, 91, 10)), (340.0, 400.0, 460.0),
        averaging_s=averaging_s, trials=3, seed=int(rng.integers(2**31)),
    )  # fmt: skip
    nothing = np.full(len(columns["force_n"]), np.nan)
    return with_cells(
        Rows(
            Machine(), "mass_flow_kg_s", "force", True, np.radians(columns["plate_angle_deg"]),
            columns["elevator_speed_rpm"] * RPM, columns["mass_flow_kg_s"], nothing, columns["force_n"], nothing,
            tuple(f"{t:g}" for t in columns["trial"]), np.zeros(len(nothing), dtype=np.int64),
        )
    )  # fmt: skip


def todo(count: int) -> Iterator[tuple[str, str, int]]:
    """(generator, effect or "", number), every kind in turn."""
    for number in range(count):
        yield from (("laws", name, number) for name in g.OTHER_LAWS)
        yield from (("combine", name, number) for name in COMBINE)
        yield from (("clean", f"{average:g}", number) for average in AVERAGES_S)
        yield from (("shape", f"{ratio:g}", number) for ratio in (2.8, 3.5))


def rows_of(kind: str, name: str, rng: np.random.Generator) -> tuple[Rows, dict[str, float]]:
    """Rows of a case and the parameters that are known beforehand."""
    if kind == "clean":
        return combine_rows({}, float(name), rng), {"gravity.acceleration_m_s2": 9.81}
    if kind == "combine":
        key, small, large = COMBINE[name]
        size = small + (large - small) * float(rng.random())
        average = float(rng.choice(AVERAGES_S[1:4]))
        return combine_rows({name: {key: size}}, average, rng), {"gravity.acceleration_m_s2": 9.81}
    case = cases.Case("hidden", (name,) if kind == "laws" else (), int(rng.integers(2**20)), 1.0, "many")
    angle, flow, speed, moisture, trial = cases._design(case, rng)
    shape = float(name) if kind == "shape" else 2.0
    grain = g.Grain(
        float(rng.uniform(0.1, 0.6)), float(rng.uniform(0.3, 0.75)), float(rng.uniform(900.0, 1500.0)), shape
    )
    clean = g.force(angle, speed, flow, moisture, grain, {})
    if kind == "laws":
        full, wanted, high = float(np.nanmax(clean)), float(rng.uniform(0.05, 0.2)), cases.SIZES[name][1]
        size = 0.3 * high
        for _ in range(4):
            changed = g.force(angle, speed, flow, moisture, grain, {name: size}, other_laws=True)
            size = min(size * wanted * full / max(float(np.nanmax(np.abs(changed - clean))), 1e-6), 3.0 * high)
        clean = g.force(angle, speed, flow, moisture, grain, {name: size}, other_laws=True)
    sd = 0.01 * np.hypot(clean, 0.15 * float(np.nanmax(clean)))
    reading = clean + sd * rng.standard_normal(len(clean))
    nothing = np.full(len(angle), np.nan)
    rows = Rows(
        Machine(), "mass_flow_kg_s", "force", True, angle, speed, flow, moisture, reading, nothing, trial,
        np.zeros(len(angle), dtype=np.int64),
    ).take(np.isfinite(reading))  # fmt: skip
    return with_cells(rows), {}


def record(kind: str, name: str, number: int) -> dict[str, Any]:
    """Make and diagnose one case."""
    rng = np.random.default_rng([zlib.crc32(f"{kind}/{name}/{number}".encode()), SALT])
    rows, known = rows_of(kind, name, rng)
    began = time.process_time()
    seen = diagnosis.examine(rows, ParameterSet(values=START | known), diagnosis.Options(keep_effects=bool(known)))
    choice = seen.choice
    truth = {"laws": name, "combine": name, "shape": "heap_shape"}.get(kind, "")
    classes = [[s.added, *s.equivalent] for s in choice.steps]
    named = choice.verdict == "effect"
    return {
        "generator": kind,
        "hidden": truth,
        "case": f"{kind}/{name}/{number}",
        # What the published model leaves beyond noise, in standard deviations: what could be seen at all.
        "visible_sd": float(np.sqrt(max(choice.base.chi2 - choice.base.dof, 0.0))),
        "verdict": choice.verdict,
        "classes": classes,
        "confidence": [s.confidence for s in choice.steps],
        "first": bool(named and truth and choice.steps[0].added == truth),
        "within": bool(named and truth and truth in classes[0] and len(classes[0]) <= 4),
        "wrong": bool(named and not any(truth in c for c in classes)),
        "f": [choice.base_gap.f, choice.best_gap.f],
        "share": None if seen.proof is None else [seen.proof.crossed.value, seen.proof.crossed.sd],
        "sealed": None if seen.proof is None or seen.proof.sealed is None else [seen.proof.sealed.value, seen.proof.sealed.sd],
        "worse": [] if seen.proof is None else list(seen.proof.worse),
        "cpu_s": time.process_time() - began,
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--cases", type=int, default=4, help="of each effect and generator")
    parser.add_argument("--part", default="1/1", help="which share of the cases, such as 2/3")
    parser.add_argument("--only", help="one generator: laws, combine, clean or shape")
    args = parser.parse_args()
    done = {json.loads(line)["case"] for line in args.out.read_text().splitlines()} if args.out.exists() else set()
    part, parts = (int(v) for v in args.part.split("/"))
    wanted = [c for c in todo(args.cases) if args.only in (None, c[0])][part - 1 :: parts]
    with open(args.out, "a", encoding="utf-8") as out:
        for kind, name, number in wanted:
            if f"{kind}/{name}/{number}" not in done:
                out.write(json.dumps(record(kind, name, number)) + "\n")
                out.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Where a model is wrong, and how far its parameters are off: the two measures of LISDD (arXiv 2606.23215), on our cases.

    python -m studies.hidden_effects.locality regions OUT.jsonl [--tables N] [--salt N]   # localisation F1
    python -m studies.hidden_effects.locality bias RESULTS.jsonl...                       # of law_cases, with `grain`

regions: tables of the study's generator, 1 % noise, whose reading is wrong in one regime by 6 to 15 %: one band of angles, one
speed, or the highest flows. A cell is planted where the planted change is at least half of its largest; flagged where it is in a
region that `yieldmon diagnose` shows. F1 = 2 TP / (2 TP + FP + FN) of the cells of a table.

bias: |fitted - true| over the range that fits search (`physics/grain.py`), by the published model and by the one with the
effects that the search found.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from studies.hidden_effects import cases, law_cases, study
from studies.hidden_effects import generator as g
from yieldmon.discrepancy.base_fit import base_frame, fit_base
from yieldmon.discrepancy.lack_of_fit import where
from yieldmon.discrepancy.noise import estimate
from yieldmon.discrepancy.observations import Rows, cells, with_cells
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.grain import GRAIN
from yieldmon.physics.machine import Machine

KINDS = ("bent_bracket", "speed_resonance", "overfull_spill")
"""Of `generator.OUTSIDE` those that act in one regime: a band of angles, one speed, flows above a limit."""
PLANTED_SHARE = 0.5
DEVELOPMENT_SALT = 4178
REPORT_SALT = 90307


def planted(kind: str, rng: np.random.Generator) -> tuple[Rows, g.Array]:
    """Rows of a table that is wrong in one regime, and each row's planted change as a share of its reading."""
    case = cases.Case("outside", (kind,), 0, 1.0, "many")
    angle, flow, speed, moisture, trial = cases._design(case, rng)
    grain = g.Grain(float(rng.uniform(0.1, 0.6)), float(rng.uniform(0.3, 0.75)), float(rng.uniform(900.0, 1500.0)))
    right = g.force(angle, speed, flow, moisture, grain, {})
    wrong = g.outside(kind, right, angle, speed, flow, float(rng.uniform(0.06, 0.15)))
    sd = 0.01 * np.hypot(wrong, 0.15 * float(np.nanmax(wrong)))
    reading = wrong + sd * rng.standard_normal(len(wrong))
    made = np.isfinite(reading)
    nothing = np.full(len(angle), np.nan)
    rows = Rows(
        Machine(), "mass_flow_kg_s", "force", True, angle, speed, flow, moisture, reading, nothing, trial,
        np.zeros(len(angle), dtype=np.int64),
    ).take(made)  # fmt: skip
    return with_cells(rows), np.abs(wrong / right - 1.0)[made]


def regions(kind: str, number: int, salt: int) -> dict[str, Any]:
    """Cells of one table: planted, flagged, both, and F1."""
    key = f"{kind}/{number}"
    rng = np.random.default_rng([zlib.crc32(key.encode()), salt])
    rows, change = planted(kind, rng)
    noise, outlier = estimate(rows)
    grouped = cells(rows.take(~outlier))
    fitted = fit_base(base_frame(grouped, noise.of_cells(grouped), ParameterSet(values=law_cases.START), "restitution"))
    flagged = np.zeros(len(grouped), dtype=bool)
    for region in where(fitted, noise, np.random.default_rng([salt, number])):
        flagged[list(region.cells)] = True
    of_cell = np.bincount(grouped.rows.cell, change[~outlier]) / grouped.count
    truly = of_cell >= PLANTED_SHARE * float(np.max(of_cell))
    both = int(np.count_nonzero(truly & flagged))
    total = int(truly.sum() + flagged.sum())
    return {
        "case": key, "kind": kind, "salt": salt, "commit": study.commit(), "cells": len(grouped), "planted": int(truly.sum()),
        "flagged": int(flagged.sum()), "both": both, "f1": 2.0 * both / total,
    }  # fmt: skip


def run_regions(out: Path, tables: int, salt: int) -> None:
    """Append the tables that are not in `out` yet; then the mean F1 of each kind and of all."""
    done = {(r["case"], r["salt"]) for r in study.read(out)} if out.exists() else set()
    with open(out, "a", encoding="utf-8") as file:
        for kind, number in ((kind, number) for number in range(tables) for kind in KINDS):
            if (f"{kind}/{number}", salt) not in done:
                file.write(json.dumps(regions(kind, number, salt)) + "\n")
                file.flush()
    records = [r for r in study.read(out) if r["salt"] == salt]
    print("| wrong in | tables | F1, mean | planted cells found | flagged cells right |\n|---|---|---|---|---|")
    for kind in (*KINDS, "all"):
        of_kind = [r for r in records if kind in ("all", r["kind"])]
        planted_cells, flagged, both = (sum(r[k] for r in of_kind) for k in ("planted", "flagged", "both"))
        f1 = float(np.mean([r["f1"] for r in of_kind]))
        print(f"| {kind} | {len(of_kind)} | {f1:.2f} | {both / planted_cells:.2f} | {both / max(flagged, 1):.2f} |")


def biases(records: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Rows of a table: each parameter's signed mean and mean absolute error over its range, without and with the effects."""
    known = [r for r in records if r.get("grain", {}).get("true") and r["generator"] in ("third", "combine")]
    seen = [r for r in known if r["visible_sd"] >= law_cases.VISIBLE and r["grain"]["published"]["restitution"] is not None]
    yield "| cases | number | parameter | range | published: mean, absolute | with effects: mean, absolute, median absolute |"
    yield "|---|---|---|---|---|---|"
    for what, alone in (("the true effect, and no other, in the first place", True), ("all visible", False)):
        chosen = [r["grain"] for r in seen if not alone or [c[0] for c in r["classes"]] == r["hidden"]]
        for name in ("friction", "restitution", "density") if chosen else ():
            low, high = GRAIN[name].search
            off = {
                model: np.array([(grain[model][name] - grain["true"][name]) / (high - low) for grain in chosen])
                for model in ("published", "fitted")
            }
            before, after = off["published"], off["fitted"]
            yield (
                f"| {what} | {len(chosen)} | {name} | {low:g} to {high:g} | {before.mean():+.3f}, {np.abs(before).mean():.3f} | "
                f"{after.mean():+.3f}, {np.abs(after).mean():.3f}, {np.median(np.abs(after)):.3f} |"
            )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    of_regions = commands.add_parser("regions", help="localisation F1")
    of_regions.add_argument("out", type=Path)
    of_regions.add_argument("--tables", type=int, default=20, help="of each kind")
    of_regions.add_argument("--salt", type=int, default=REPORT_SALT)
    of_bias = commands.add_parser("bias", help="parameter bias")
    of_bias.add_argument("results", type=Path, nargs="+")
    args = parser.parse_args()
    if args.command == "regions":
        run_regions(args.out, args.tables, args.salt)
    else:
        print("\n".join(biases([r for path in args.results for r in study.read(path)])))
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""One verdict whatever parameters one begins with: `diagnose` from random start parameters, and from what `calibrate` gives.

python -m tests.robustness verdict-starts [--starts N] [--cases N] [--only dem,bench,hidden] [--out F.jsonl] [--minutes M]

Each table (both published ones, and hidden cases of studies/hidden_effects) is diagnosed from the shipped parameters, from the
output of `calibrate` on the same rows, and from N sets drawn within the physical prior of grain (shape ratio as shipped). A
line for each run, with seed and commit, goes to --out; a run that exists already is not made again. Exit code 1 where a table
has two verdicts, other names, or lacks of fit further apart than 2 %.
"""

from __future__ import annotations

import argparse
import json
import time
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from studies.hidden_effects import cases, study
from yieldmon.discrepancy import diagnosis, observations
from yieldmon.estimation.fitting.calibration import calibrate, default_start
from yieldmon.estimation.fitting.measurements import Measurements
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files import parameter_file, table
from yieldmon.physics.grain import EXCHANGE_FORM, GRAIN, RESTITUTION_FORM
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import Conditions, ForwardModel

DATA = Path(__file__).parents[1] / "data"
SEED = 16
F_TOLERANCE = 0.02


def tables(only: set[str], count: int) -> Iterator[tuple[str, observations.Rows]]:
    """Name and rows of each table."""
    for name in ("dem", "bench"):
        if name in only:
            yield name, observations.from_table(table.load(DATA / f"{name}_table.csv"), Machine())
    if "hidden" in only:
        every = cases.all_cases(2, 0, 0, 0, 0, 0)
        for case in every[:: max(1, len(every) // count)][:count]:
            yield case.key, cases.make(case).rows


def calibrated(rows: observations.Rows) -> ParameterSet:
    """What `calibrate` gives for the rows: the exchange coefficients for a response, and where 1 + e ends at its bound."""
    load = {rows.load_name: rows.load}
    at = Conditions(rows.plate_angle_rad, rows.elevator_speed_rad_s, **load)
    passes = rows.machine.passes_per_s(rows.elevator_speed_rad_s)
    data = Measurements(at, rows.value / passes if rows.of == "force" else rows.value)
    model, unit = ForwardModel(rows.machine), "N" if rows.si else "response"
    for form in (RESTITUTION_FORM, EXCHANGE_FORM) if rows.si else (EXCHANGE_FORM,):
        start = default_start(model, data, form)
        found = calibrate(model, data, start, ("friction", "density", *form), starts=20, intervals=False, response_unit=unit)
        if not any(p.name == "restitution" and p.at_bound for p in found.parameters):
            break
    return found.parameter_set


def starts(name: str, rows: observations.Rows, count: int) -> Iterator[tuple[str, ParameterSet]]:
    """Name and parameters of each start."""
    shipped = parameter_file.load()
    yield "shipped", shipped
    yield "calibrate", calibrated(rows)
    for i in range(count):
        rng = np.random.default_rng([SEED, zlib.crc32(name.encode()), i])
        drawn = {key: float(rng.uniform(*GRAIN[key].start)) for key in ("friction", "density", "restitution")}
        yield f"random {i}", ParameterSet({**drawn, "shape_ratio": shipped.values["shape_ratio"]})


def diagnosed(rows: observations.Rows, known: ParameterSet) -> dict[str, Any]:
    """What one run says; names: of leading candidates too."""
    begin = time.process_time()
    found = diagnosis.examine(rows, known).choice
    return {
        "verdict": found.verdict,
        "names": sorted(step.added for step in found.steps),
        "f_before": found.base.chi2 / found.base.dof,
        "f_after": found.best.chi2 / found.best.dof,
        "cpu_s": round(time.process_time() - begin, 2),
    }


def agreement(records: list[dict[str, Any]]) -> dict[str, Any]:
    """Of one table's runs: verdicts and names that occur, and the spread of each lack of fit over its smallest."""
    values = {key: np.array([record[key] for record in records]) for key in ("f_before", "f_after")}
    spread = {key: float(np.ptp(v) / v.min()) for key, v in values.items()}
    verdicts = sorted({record["verdict"] for record in records})
    names = sorted({"+".join(record["names"]) for record in records})
    one = len(verdicts) == len(names) == 1 and max(spread.values()) <= F_TOLERANCE
    return {"runs": len(records), "verdicts": verdicts, "names": names, "f_spread": spread, "agrees": one}


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(
        prog="verdict-starts", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--starts", type=int, default=30)
    parser.add_argument("--cases", type=int, default=20)
    parser.add_argument("--only", default="dem,bench,hidden")
    parser.add_argument("--out", type=Path, default=Path("out/verdict-starts.jsonl"))
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin no run after so long")
    args = parser.parse_args(arguments)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    lines = args.out.read_text().splitlines() if args.out.exists() else []
    records = {(r["table"], r["start"]): r for r in map(json.loads, lines)}
    begin, failed = time.monotonic(), 0
    for name, rows in tables(set(args.only.split(",")), args.cases):
        for start, known in starts(name, rows, args.starts):
            if (name, start) in records or time.monotonic() - begin > 60.0 * args.minutes:
                continue
            origin = {"table": name, "start": start, "seed": SEED, "commit": study.commit()}
            record = {**origin, "parameters": dict(known.values), **diagnosed(rows, known)}
            records[name, start] = record
            with args.out.open("a") as stream:
                stream.write(json.dumps(record) + "\n")
        mine = [record for (its, _), record in records.items() if its == name]
        if mine:
            found = agreement(mine)
            failed += not found["agrees"]
            print(json.dumps({"table": name, **found}), flush=True)
    return 1 if failed else 0

"""Open loop: mass flow from force for each row of a table, with standard deviation and status."""

from __future__ import annotations

import argparse
import csv
import sys
from typing import Any

import numpy as np

from yieldmon.cli import _flow_curve, model_options
from yieldmon.cli._json import print_json
from yieldmon.cli._limits import within
from yieldmon.errors import InputError
from yieldmon.estimation.estimators import estimator_of
from yieldmon.estimation.open_loop import FlowStatus
from yieldmon.files import table


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "estimate",
        help="mass flow from force (open loop)",
        description=__doc__,
        epilog="example: yieldmon estimate windows.csv --params corn.yaml --json",
    )
    parser.add_argument("data", metavar="DATA.csv", help="plate_angle_deg and force_n, momentum_kg_m_s or response")
    model_options.add_model_arguments(parser)
    _flow_curve.add_file(parser)
    parser.add_argument(
        "--sigma", type=float, default=0.0, metavar="SD", help="noise of the reading where the table has no sigma (default: 0)"
    )
    parser.add_argument("--json", action="store_true", help='one JSON document, {"rows": [...]} (default: CSV)')


def run(args: argparse.Namespace) -> int:
    """A row of output for each row of the table; rows of bad input are errors, rows without a reading have a status."""
    within("--sigma", args.sigma, 0.0)
    machine, known = model_options.machine(args), _flow_curve.with_file(model_options.parameters(args), args.estimator)
    data = table.load(args.data, need_load=False)
    machine = data.at_one_position(machine)
    model_options.check_unit(known, data)
    data.check_doubled(machine)
    for note in data.notes:
        print(f"yieldmon: {note}", file=sys.stderr)
    speed = data.speed_rad_s(machine)
    passes = machine.passes_per_s(speed)
    to_force = 1.0 if data.reading == "force_n" else passes
    noise = data.columns.get("sigma", np.full(len(data), np.nan))
    noise = np.where(np.isnan(noise), args.sigma, noise) * to_force
    angle = np.radians(data.columns["plate_angle_deg"])
    force = data.columns[data.reading] * to_force
    loop = estimator_of(machine, known)
    try:
        found = loop.estimate(force, angle, speed, noise, data.columns.get("moisture_pct"))
    except ValueError as error:
        raise InputError(data.path, str(error)) from error
    rows = []
    for i in range(len(data)):
        row: dict[str, Any] = {
            "row": i + 1,
            "mass_flow_kg_s": float(found.mass_flow_kg_s[i]),
            "std_dev_kg_s": float(found.std_dev_kg_s[i]),
            "paddle_mass_kg": float(found.mass_flow_kg_s[i] / passes[i]),
            "status": FlowStatus(int(found.status[i])).name.lower(),
        }
        if data.load is not None:
            true = data.columns[data.load][i] * (passes[i] if data.load == "paddle_mass_kg" else 1.0)
            row["true_mass_flow_kg_s"] = float(true)
            row["error_pct"] = float(100.0 * (row["mass_flow_kg_s"] / true - 1.0)) if true > 0.0 else np.nan
        rows.append(row)
    if args.json:
        print_json({"file": data.path, "rows": rows}, indent=1)
    else:
        writer = csv.DictWriter(sys.stdout, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows({k: f"{v:.8g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows)
    return 0

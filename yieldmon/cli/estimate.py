"""Compute mass flow from force (open loop) for each row of a table, with standard deviation and status."""

from __future__ import annotations

import argparse
import csv
import sys

import numpy as np

from yieldmon.cli import _flow_curve, _notes, model_options
from yieldmon.cli._json import print_json
from yieldmon.cli._limits import within
from yieldmon.documents.estimate import EstimateDocument, EstimatedRow
from yieldmon.errors import InputError
from yieldmon.estimation.beyond_range import moisture_error_beyond
from yieldmon.estimation.estimators import estimator_of
from yieldmon.estimation.open_loop import FlowStatus
from yieldmon.files import table
from yieldmon.physics.numerics import Array

_CONTRADICTS_SDS = 3.0
"""Standard deviations by which half of the flows are off the table's own loads, from which it is said."""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "estimate",
        help="mass flow from force (open loop)",
        description=__doc__,
        epilog="example: yieldmon estimate windows.csv --params corn.yaml --json",
    )
    parser.add_argument("data", metavar="DATA.csv", help="table with plate_angle_deg, and force_n, momentum_kg_m_s or response")
    model_options.add_model_arguments(parser)
    _flow_curve.add_file(parser)
    parser.add_argument(
        "--sigma", type=float, default=0.0, metavar="SD", help="noise of the reading if the table has no sigma (default: 0)"
    )
    parser.add_argument("--json", action="store_true", help='one JSON document, {"rows": [...]} (default: CSV)')


def run(args: argparse.Namespace) -> int:
    """A row of output for each row of the table; rows of bad input are errors, rows without a reading have a status."""
    within("--sigma", args.sigma, 0.0)
    machine, known = model_options.machine(args), _flow_curve.with_file(model_options.parameters(args), args.estimator)
    data = table.load(args.data, need_load=False)
    machine = data.at_one_position(machine)
    known = model_options.in_unit_of(data, known, args)
    data.check_doubled(machine)
    model_options.note_unknown_errors(known)
    for note in data.notes:
        _notes.note(note)
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
    std_dev = found.std_dev_kg_s
    if "moisture_pct" in data.columns:
        std_dev = np.hypot(std_dev, moisture_error_beyond(known, data.columns["moisture_pct"]) * found.mass_flow_kg_s)
    true = None if data.load is None else data.columns[data.load] * (passes if data.load == "paddle_mass_kg" else 1.0)
    if true is not None and (note := _contradiction(found.mass_flow_kg_s, std_dev, true)):
        _notes.note(f"{data.path}: {note}")
    rows: list[EstimatedRow] = []
    for i in range(len(data)):
        row: EstimatedRow = {
            "row": i + 1,
            "mass_flow_kg_s": float(found.mass_flow_kg_s[i]),
            "std_dev_kg_s": float(std_dev[i]),
            "paddle_mass_kg": float(found.mass_flow_kg_s[i] / passes[i]),
            "status": FlowStatus(int(found.status[i])).name.lower(),
        }
        if true is not None:
            row["true_mass_flow_kg_s"] = float(true[i])
            row["error_pct"] = float(100.0 * (found.mass_flow_kg_s[i] / true[i] - 1.0)) if true[i] > 0.0 else np.nan
        rows.append(row)
    if args.json:
        document: EstimateDocument = {"file": data.path, "rows": rows}
        print_json(document, indent=1)
    else:
        writer = csv.DictWriter(sys.stdout, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows({k: f"{v:.8g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows)
    return 0


def _contradiction(flow_kg_s: Array, std_dev_kg_s: Array, true_kg_s: Array) -> str:
    """What is to be said where the flows of a table contradict its own loads, all of shape (n,); "" where they do not."""
    rated = (true_kg_s > 0.0) & (std_dev_kg_s > 0.0) & np.isfinite(flow_kg_s)
    if not rated.any():
        return ""
    flow, std_dev, true = (column[rated] for column in (flow_kg_s, std_dev_kg_s, true_kg_s))
    away = float(np.median(np.abs(flow - true) / std_dev))
    if away < _CONTRADICTS_SDS:
        return ""
    return (
        f"half of the flows differ from the table's loads by {100.0 * np.median(np.abs(flow / true - 1.0)):.3g} % or more "
        f"({away:.3g} standard deviations); expected parameters of this grain and machine (`yieldmon calibrate`), and the "
        "noise of the readings (--sigma)"
    )

"""Forward model: momentum per paddle and mean force for lists of mass flow, plate angle and elevator speed."""

from __future__ import annotations

import argparse
import csv
import sys

import numpy as np

from yieldmon.cli import _notes, model_options
from yieldmon.cli._json import print_json
from yieldmon.errors import InputError
from yieldmon.estimation.force_deviation import force_std_dev
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files.calibrated_range import calibrated_document
from yieldmon.physics.machine import RPM
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array

COLUMNS = ("mass_flow_kg_s", "plate_angle_deg", "elevator_speed_rpm", "paddle_mass_kg", "paddle_momentum_kg_m_s", "force_n")


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "predict",
        help="force from mass flow",
        description=__doc__,
        epilog="example: yieldmon predict --mass-flow 2 9 18 --plate-angle 40:90:10 --json",
    )
    parser.add_argument("--mass-flow", nargs="+", required=True, metavar="KG_S", help="kg/s, e.g. 2,5,9 or 2:26:1")
    parser.add_argument("--plate-angle", nargs="+", metavar="DEG", help="deg, e.g. 40:90:5 (default: home)")
    parser.add_argument("--plate-position", nargs="+", metavar="M", help="away from the elevator (m)")
    parser.add_argument("--elevator-speed", nargs="+", metavar="RPM", help="elevator speed (default: the machine's nominal)")
    parser.add_argument("--moisture", type=float, metavar="PCT", help="for effects that need it (%%)")
    model_options.add_model_arguments(parser)
    parser.add_argument("--json", action="store_true", help='one JSON document, {"rows": [...]} (default: CSV)')


def run(args: argparse.Namespace) -> int:
    """One row for each combination, mass flow varying slowest."""
    machine, known = model_options.machine(args), model_options.parameters(args)
    flow = model_options.numbers(args.mass_flow, "--mass-flow")
    angle = (
        np.degrees([machine.home_plate_angle_rad])
        if args.plate_angle is None
        else model_options.numbers(args.plate_angle, "--plate-angle")
    )
    speed = (
        np.array([machine.nominal_elevator_speed_rad_s / RPM])
        if args.elevator_speed is None
        else model_options.numbers(args.elevator_speed, "--elevator-speed")
    )
    model_options.check_operating_points(flow, angle, speed)
    model_options.check_moisture(args.moisture)
    place = np.zeros(1) if args.plate_position is None else model_options.numbers(args.plate_position, "--plate-position")
    nearest = [machine.plate_reach_m(float(p)) > machine.paddle_length_m for p in place]
    clear = f"above {machine.paddle_length_m - machine.plate_reach_m(0.0):.3g} m, where the plate clears the paddles"
    model_options.check_each(np.array(nearest), place, "--plate-position", clear)
    grid = np.meshgrid(flow, angle, place, speed, indexing="ij")
    flow, angle, place, speed = (axis.ravel() for axis in grid)
    moved = None if args.plate_position is None else place
    conditions = Conditions(
        np.radians(angle), speed * RPM, mass_flow_kg_s=flow, moisture_pct=args.moisture, plate_position_m=moved
    )
    try:
        model = ForwardModel(machine, known.effects)
        momentum = model.paddle_momentum(conditions, known.values)
    except ValueError as error:
        raise InputError("predict", str(error)) from error
    passes = machine.passes_per_s(speed * RPM)
    columns: tuple[str, ...] = COLUMNS
    values = [flow, angle, speed, flow / passes, momentum, momentum * passes]
    if args.moisture is not None:
        columns, values = (*COLUMNS, "moisture_pct"), [*values, np.full(flow.shape, args.moisture)]
    if moved is not None:
        columns, values = (*columns, "plate_position_m"), [*values, moved]
    if known.covariance_names or known.model_error:
        columns, values = (*columns, "force_std_dev_n"), [*values, force_std_dev(model, known, conditions)]
    if known.response_unit != "N":
        _notes.note(f"momentum and force are in the unit {known.response_unit!r} of the parameters, not in kg m/s and N")
    _say_outside(known, flow, angle, speed, args.moisture)
    table = np.stack(values, axis=-1).tolist()
    if args.json:
        rows = [dict(zip(columns, row, strict=True)) for row in table]
        print_json({"machine": machine.name, "parameters": dict(known.values), "rows": rows}, indent=1)
    else:
        writer = csv.writer(sys.stdout, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows([f"{value:.10g}" for value in row] for row in table)
    return 0


def _say_outside(known: ParameterSet, flow: Array, angle_deg: Array, speed_rpm: Array, moisture_pct: float | None) -> None:
    """Which of the rows the parameters were not calibrated for, on standard error."""
    moisture = None if moisture_pct is None else np.full(flow.shape, moisture_pct)
    outside = known.calibrated.outside(flow, np.radians(angle_deg), speed_rpm * RPM, moisture)
    if np.any(outside):
        limits = calibrated_document(known.calibrated).items()
        ranges = ", ".join(f"{name} {low:.4g} to {high:.4g}" for name, (low, high) in limits)
        print(f"yieldmon: {np.sum(outside)} of {flow.size} rows lie outside the calibrated range: {ranges}", file=sys.stderr)

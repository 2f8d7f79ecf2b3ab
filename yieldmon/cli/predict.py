"""Compute momentum per paddle and mean force from mass flow, plate angle and elevator speed."""

from __future__ import annotations

import argparse
import csv
import sys
from dataclasses import dataclass

import numpy as np

from yieldmon.cli import _notes, model_options
from yieldmon.cli._json import print_json
from yieldmon.documents.predict import PredictedRow, PredictionDocument
from yieldmon.errors import InputError
from yieldmon.estimation.force_deviation import force_std_dev
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files.calibrated_range import calibrated_document
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "predict",
        help="compute force from mass flow",
        description=__doc__,
        epilog="example: yieldmon predict --mass-flow 2 9 18 --plate-angle 40:90:10 --json",
    )
    parser.add_argument("--mass-flow", nargs="+", required=True, metavar="KG_S", help="kg/s, e.g. 2,5,9 or 2:26:1")
    parser.add_argument("--plate-angle", nargs="+", metavar="DEG", help="deg, e.g. 40:90:5 (default: home)")
    parser.add_argument("--plate-position", nargs="+", metavar="M", help="distance moved away from the elevator (m)")
    parser.add_argument("--elevator-speed", nargs="+", metavar="RPM", help="elevator speed (default: the machine's nominal)")
    parser.add_argument("--moisture", type=float, metavar="PCT", help="grain moisture for effects that need it (%%)")
    model_options.add_model_arguments(parser)
    parser.add_argument("--json", action="store_true", help='one JSON document, {"rows": [...]} (default: CSV)')


@dataclass(frozen=True)
class _Points:
    """Operating points, arrays of shape (n,). plate_position_m: None where --plate-position is not given."""

    mass_flow_kg_s: Array
    plate_angle_deg: Array
    elevator_speed_rpm: Array
    plate_position_m: Array | None

    def conditions(self, moisture_pct: float | None) -> Conditions:
        """As the model takes them."""
        return Conditions(
            np.radians(self.plate_angle_deg),
            self.elevator_speed_rpm * RPM,
            mass_flow_kg_s=self.mass_flow_kg_s,
            moisture_pct=moisture_pct,
            plate_position_m=self.plate_position_m,
        )


def run(args: argparse.Namespace) -> int:
    """One row for each combination, mass flow varying slowest."""
    machine, known = model_options.machine(args), model_options.parameters(args)
    model_options.check_moisture(args.moisture)
    points = _points(args, machine)
    conditions = points.conditions(args.moisture)
    try:
        model = ForwardModel(machine, known.effects)
        momentum = model.paddle_momentum(conditions, known.values)
    except ValueError as error:
        raise InputError("predict", str(error)) from error
    std_dev = force_std_dev(model, known, conditions) if known.covariance_names or known.model_error != 0.0 else None
    if known.response_unit != "N":
        _notes.note(f"momentum and force are in the unit {known.response_unit!r} of the parameters, not in kg m/s and N")
    model_options.note_unknown_errors(known)
    _say_outside(known, points, args.moisture)
    passes = machine.passes_per_s(points.elevator_speed_rpm * RPM)
    rows = [_row(points, i, passes[i], momentum[i], args.moisture, std_dev) for i in range(points.mass_flow_kg_s.size)]
    if args.json:
        document: PredictionDocument = {"machine": machine.name, "parameters": dict(known.values), "rows": rows}
        print_json(document, indent=1)
    else:
        writer = csv.DictWriter(sys.stdout, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows({key: f"{value:.10g}" for key, value in row.items()} for row in rows)
    return 0


def _points(args: argparse.Namespace, machine: Machine) -> _Points:
    """Each combination of what the options name. Raises InputError for a value out of range."""
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
    place = np.zeros(1) if args.plate_position is None else model_options.numbers(args.plate_position, "--plate-position")
    nearest = [machine.plate_reach_m(float(p)) > machine.paddle_length_m for p in place]
    clear = f"above {machine.paddle_length_m - machine.plate_reach_m(0.0):.3g} m, where the plate clears the paddles"
    model_options.check_each(np.array(nearest), place, "--plate-position", clear)
    flow, angle, place, speed = (axis.ravel() for axis in np.meshgrid(flow, angle, place, speed, indexing="ij"))
    return _Points(flow, angle, speed, None if args.plate_position is None else place)


def _row(
    points: _Points, i: int, passes_per_s: float, momentum_kg_m_s: float, moisture_pct: float | None, std_dev_n: Array | None
) -> PredictedRow:
    """The row of point i."""
    row: PredictedRow = {
        "mass_flow_kg_s": float(points.mass_flow_kg_s[i]),
        "plate_angle_deg": float(points.plate_angle_deg[i]),
        "elevator_speed_rpm": float(points.elevator_speed_rpm[i]),
        "paddle_mass_kg": float(points.mass_flow_kg_s[i] / passes_per_s),
        "paddle_momentum_kg_m_s": float(momentum_kg_m_s),
        "force_n": float(momentum_kg_m_s * passes_per_s),
    }
    if moisture_pct is not None:
        row["moisture_pct"] = moisture_pct
    if points.plate_position_m is not None:
        row["plate_position_m"] = float(points.plate_position_m[i])
    if std_dev_n is not None:
        row["force_std_dev_n"] = float(std_dev_n[i])
    return row


def _say_outside(known: ParameterSet, points: _Points, moisture_pct: float | None) -> None:
    """Which of the rows the parameters were not calibrated for, on standard error."""
    flow = points.mass_flow_kg_s
    moisture = None if moisture_pct is None else np.full(flow.shape, moisture_pct)
    outside = known.calibrated.outside(flow, np.radians(points.plate_angle_deg), points.elevator_speed_rpm * RPM, moisture)
    if np.any(outside):
        limits = calibrated_document(known.calibrated).items()
        ranges = ", ".join(f"{name} {low:.4g} to {high:.4g}" for name, (low, high) in limits)
        print(f"yieldmon: {np.sum(outside)} of {flow.size} rows lie outside the calibrated range: {ranges}", file=sys.stderr)

"""`calibrate --estimator`: a curve that gives the flow without a picture of the machine, from a table or from weighed loads."""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from yieldmon.cli import _by_loads, _calibrate_options, _notes, _provenance, _reading_units, model_options
from yieldmon.documents.calibrate import CurveCalibrationDocument
from yieldmon.errors import InputError
from yieldmon.estimation.flow_curve import OFFSET_SHARE, AlphaBeta
from yieldmon.estimation.weighing.flow_curve_fit import CurveFit, fit_loads, fit_table
from yieldmon.files import flow_curve_file, table, whole_file
from yieldmon.units import counted


def run(args: argparse.Namespace) -> CurveCalibrationDocument:
    """Fit and write; the report as plain data. Raises InputError."""
    physical = (*_calibrate_options.PHYSICAL_MODEL, "prior")
    _calibrate_options.refuse(args, physical, "applies to the physical model only", "none with --estimator")
    if args.out is not None:
        whole_file.check_place(args.out)
    found, facts = _of_loads(args) if args.loads is not None else _of_table(args)
    curve = replace(found.curve, provenance=facts)
    document = report(found, ", ".join(args.loads) if args.loads is not None else args.data)
    if args.out is not None:
        flow_curve_file.save(curve, args.out)
        document["written"] = args.out
    return document


def _of_table(args: argparse.Namespace) -> tuple[CurveFit, dict[str, str]]:
    if args.data is None:
        raise InputError("DATA", "is missing", "a table of a test facility, or --loads and --tickets")
    _calibrate_options.refuse_load_options(args)
    machine = model_options.machine(args)
    data = table.load(args.data)
    for note in data.notes:
        _notes.note(note)
    data.at_one_position(machine)
    if data.reading == model_options.RESPONSE and args.response_scale is None:
        raise InputError(data.path, "holds a response", "forces, momenta, or --response-scale: a curve gives flow from newtons")
    rows = model_options.measurements(data, machine, args.response_scale)
    asked = _reading_units.checked(data, machine)
    if args.plate_angle is not None:
        rows = model_options.at_plate_angle(rows, args.plate_angle, data)
    try:
        found = fit_table(machine, rows, args.estimator)
    except ValueError as error:
        raise InputError(data.path, str(error)) from error
    _reading_units.ask(asked)
    return found, _provenance.of_table(data) | {"method": "table of known loads"}


def _of_loads(args: argparse.Namespace) -> tuple[CurveFit, dict[str, str]]:
    if args.estimator != AlphaBeta.kind:
        raise InputError(f"--estimator {args.estimator}", "needs a table of known loads", "alpha_beta with --loads")
    configured, loads = _by_loads.matched(args)
    try:
        found = fit_loads(loads, configured.machine.home_plate_angle_rad)
    except ValueError as error:
        raise InputError(", ".join(args.loads), str(error)) from error
    facts = _provenance.of_loads(args.loads, args.tickets) | {"method": f"{len(loads)} weighed loads"}
    if "crop" in configured.parameters.provenance:
        facts["crop"] = configured.parameters.provenance["crop"]
    return found, facts


def report(found: CurveFit, source: str) -> CurveCalibrationDocument:
    """The result as plain data."""
    law = found.curve.law
    left, own = (100.0 * np.abs(np.array(errors)) for errors in (found.left_out_error, found.fitted_error))
    low, high = found.curve.calibrated.mass_flow_kg_s or (float("nan"), float("nan"))
    return {
        "file": source,
        "rows": found.rows,
        "estimator": law.kind,
        "plate_angles_deg": [float(np.degrees(angle)) for angle in law.angles_rad],
        "coefficients": dict(law.coefficients),
        "mass_flow_kg_s": [low, high],
        "relative_std_dev_pct": 100.0 * found.curve.relative_std_dev,
        "error_pct": {"fitted_mean": float(own.mean()), "fitted_max": float(own.max()),
                      "left_out_mean": float(left.mean()), "left_out_max": float(left.max())},
        "loads": len(found.loads),
    }  # fmt: skip


def text(document: CurveCalibrationDocument) -> str:
    """The report for people."""
    low, high = document["mass_flow_kg_s"]
    angles = ", ".join(f"{angle:g}" for angle in document["plate_angles_deg"])
    where = f"{low:.3g} to {high:.3g} kg/s, plate at {angles} deg"
    lines = [f"{document['file']}: {document['estimator']}, {counted(document['rows'], 'row')}, {where}"]
    lines += [f"{name:<34}{value:>13.6g}" for name, value in document["coefficients"].items()]
    error = document["error_pct"]
    lines.append(f"error of {document['loads']} loads, %: mean {error['fitted_mean']:.3g}, largest {error['fitted_max']:.3g}")
    lines.append(f"each left out in turn:       mean {error['left_out_mean']:.3g}, largest {error['left_out_max']:.3g}")
    lines.append(
        f"standard deviation: {document['relative_std_dev_pct']:.3g} % of (flow + {OFFSET_SHARE * high:.3g} kg/s), for this grain"
    )
    if "written" in document:
        lines.append(f"written: {document['written']}")
    return "\n".join(lines)

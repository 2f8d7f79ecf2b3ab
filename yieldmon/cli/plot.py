"""Plot measurements and the model as PNG or SVG."""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Callable
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from yieldmon import bounded
from yieldmon.cli import _named_files, _outputs, model_options
from yieldmon.cli._units import add_units
from yieldmon.errors import InputError
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files import parameter_file, strict_yaml, table, whole_file
from yieldmon.files.delimited import LARGEST_BYTES
from yieldmon.files.units import units_of
from yieldmon.physics.machine import RPM
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import Array
from yieldmon.plots import alignment, canvas, curves, errors, flow, parameters, published, residuals, sensitivity, sweeps
from yieldmon.service.logs import recorded
from yieldmon.service.logs.reprocessing import column
from yieldmon.service.storage.batch import Load, Ticket
from yieldmon.service.storage.rows import SecondRow
from yieldmon.units import Units

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TRUTH_COLUMNS = ("time_s", "mass_flow_kg_s", "total_mass_kg")
RECORD_HELP = "a daemon's store (.sqlite, .db), or a table of `process`"


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "plot",
        help="plot records, curves and comparisons",
        description=f"{__doc__} Needs the plot extra (matplotlib).",
        epilog="example: yieldmon plot flow monday.parquet --truth truth.csv --out monday.png",
    )
    kinds = parser.add_subparsers(dest="picture", metavar="PICTURE", required=True)
    _add_of_records(kinds)
    _add_of_models(kinds)


def _add_of_records(kinds: Any) -> None:
    record = _picture(
        kinds, "flow", _flow, "mass flow and accumulated mass, with the truth or the tickets", "monday.parquet --truth truth.csv"
    )
    record.add_argument("record", metavar="RECORD", help=RECORD_HELP)
    record.add_argument("--truth", metavar="FILE", help="CSV with time_s, mass_flow_kg_s, total_mass_kg (as simulate writes)")
    _add_units(record)

    record = _picture(
        kinds, "errors", _errors, "error of single seconds by band of true flow", "monday.parquet --truth truth.csv"
    )
    record.add_argument("record", metavar="RECORD", help=RECORD_HELP)
    record.add_argument("--truth", metavar="FILE", required=True, help="CSV with time_s, mass_flow_kg_s, total_mass_kg")
    record.add_argument("--bands", nargs="+", default=["1:29:4"], metavar="KG_S", help="edges of the bands (default: 1:29:4)")
    _add_units(record)

    record = _picture(kinds, "sweeps", _sweeps, "force by plate angle in each sweep, and the flow around it", "yieldmon.sqlite")
    record.add_argument("record", metavar="RECORD", help=RECORD_HELP)
    _add_units(record)

    record = _picture(kinds, "parameters", _parameters, "parameters over time with their 90 % intervals", "yieldmon.sqlite")
    record.add_argument("record", metavar="STORE", help="a daemon's store (.sqlite, .db)")


def _add_of_models(kinds: Any) -> None:
    curve = _picture(
        kinds,
        "curves",
        _curves,
        "force by plate angle and by flow: model, and readings of a table",
        "facility.csv --params corn.yaml",
    )
    curve.add_argument("data", nargs="?", metavar="DATA.csv", help="table of force or momentum (default: none)")
    model_options.add_model_arguments(curve)
    curve.add_argument("--mass-flow", nargs="+", metavar="KG_S", help="flows (default: the table's, or 2:26:4)")
    curve.add_argument("--plate-angle", nargs="+", metavar="DEG", help="angles (default: the table's, or 40:90:10)")
    curve.add_argument("--elevator-speed", type=float, metavar="RPM", help="elevator speed (default: the machine's)")
    curve.add_argument("--moisture", type=float, default=15.0, metavar="PCT", help="grain moisture (default: 15)")

    missed = _picture(
        kinds, "residuals", _residuals, "model minus measured, over plate angle and load", "facility.csv --params corn.yaml"
    )
    missed.add_argument("data", metavar="DATA.csv", help="table with a load and a reading")
    model_options.add_model_arguments(missed)

    study = _picture(
        kinds, "sensitivity", _sensitivity, "force against each grain parameter, one varied at a time", "--plate-angle 60"
    )
    study.add_argument("--machine", metavar="FILE", help="file or shipped name (default: sprocket-8)")
    study.add_argument("--plate-angle", type=float, default=70.0, metavar="DEG", help="plate angle (default: 70)")

    theirs = _picture(
        kinds,
        "published",
        _published,
        "published momentum table and closed loop, compared with this model",
        "tests/data/published_tables.yaml",
    )
    theirs.add_argument("tables", metavar="TABLES.yaml", help="the published figures (tests/data/published_tables.yaml)")
    theirs.add_argument("--machine", metavar="FILE", help="file or shipped name (default: sprocket-8)")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when the picture is written."""
    out = Path(args.out)
    canvas.check_name(out, "--out")
    whole_file.check_place(out)
    figure = args.draw(args)
    canvas.save(figure, out)
    print(f"written: {out}", file=sys.stderr)
    return 0


def _picture(
    kinds: Any, name: str, draw: Callable[[argparse.Namespace], Figure], summary: str, example: str
) -> argparse.ArgumentParser:
    """example: arguments of the kind, without --out."""
    words = " ".join(word for word in ("plot", name, example, f"--out {name}.png") if word)
    parser: argparse.ArgumentParser = kinds.add_parser(
        name, help=summary.replace("%", "%%"), description=summary, epilog=f"example: yieldmon {words}"
    )
    parser.add_argument("--out", metavar="FILE", required=True, help="picture to write, *.png or *.svg")
    _outputs.add_force(parser, "out")
    parser.set_defaults(draw=draw)
    return parser


def _add_units(parser: argparse.ArgumentParser) -> None:
    add_units(parser, "metric")
    parser.add_argument("--crop", default="", metavar="NAME", help="crop, for bushels")


def _units(args: argparse.Namespace) -> Units:
    return units_of(args.units, crop=args.crop)


def _seconds(path: str) -> list[SecondRow]:
    rows = recorded.read_seconds(path)
    if not rows:
        raise InputError(path, "holds no seconds", "a record of at least one")
    return rows


def _truth(path: str) -> tuple[Array, Array, Array]:
    expected = f"a CSV with the columns {', '.join(TRUTH_COLUMNS)}"
    content = bounded.read_whole(path, expected, LARGEST_BYTES)
    try:
        rows = list(csv.DictReader(bounded.split(content.decode("utf-8"), path, expected)))
        columns = [np.array([float(row[name]) for row in rows]) for name in TRUTH_COLUMNS]
    except InputError:
        raise
    except (KeyError, ValueError, TypeError, csv.Error) as error:
        raise InputError(path, f"is not a truth table: {error}", expected) from error
    if not rows:
        raise InputError(path, "holds no rows", "a row a second")
    return columns[0], columns[1], columns[2]


def _beside(truth: tuple[Array, Array, Array], rows: list[SecondRow]) -> tuple[Array, Array, Array]:
    """The truth in the record's time: a simulated log counts from --start-time, its truth from 0."""
    time_s = truth[0]
    if time_s[-1] < rows[0].time_s or time_s[0] > rows[-1].time_s:
        time_s = time_s + alignment.shift_s(column(rows, "time_s"), column(rows, "mass_flow_kg_s"), time_s, truth[1])
    return time_s, truth[1], truth[2]


def _flow(args: argparse.Namespace) -> Figure:
    rows = _seconds(args.record)
    truth = _beside(_truth(args.truth), rows) if args.truth else None
    weighed = None
    if recorded.is_store(args.record):
        with recorded.opened(Path(args.record)) as store:
            weighed = _weighed(store.loads(), store.tickets())
    names = ("time_s", "mass_flow_kg_s", "std_dev_kg_s", "total_kg")
    time_s, rate, spread, total = (column(rows, name) for name in names)
    factory = column(rows, "factory_mass_flow_kg_s")
    return flow.draw(time_s, rate, spread, total, truth=truth, weighed=weighed, factory_kg_s=factory, units=_units(args))


def _weighed(loads: list[Load], tickets: list[Ticket]) -> list[tuple[float, float, float]]:
    ends = {load.number: load.ended_s for load in loads}
    return [
        (end_s, ticket.measured_mass_kg, ticket.weighed_mass_kg)
        for ticket in tickets
        if (end_s := ends.get(ticket.last_load)) is not None
    ]


def _errors(args: argparse.Namespace) -> Figure:
    rows = _seconds(args.record)
    time_s, rate, _ = _beside(_truth(args.truth), rows)
    seconds = np.floor(column(rows, "time_s"))
    true = np.interp(seconds, time_s, rate, left=np.nan, right=np.nan)
    edges = model_options.numbers(args.bands, "--bands")
    if len(edges) < 2 or np.any(np.diff(edges) <= 0.0):
        raise InputError("--bands", f"is {' '.join(args.bands)!r}", "two or more rising numbers")
    edge = errors.at_edges(seconds, time_s, rate)
    measured = column(rows, "mass_flow_kg_s")
    edge &= np.isfinite(measured)
    measured[edge] = np.nan
    return errors.draw(true, measured, edges, units=_units(args), left_out=int(np.count_nonzero(edge)))


def _sweeps(args: argparse.Namespace) -> Figure:
    rows = _seconds(args.record)
    if not any(row.sweep_id for row in rows):
        raise InputError(args.record, "holds no sweep", "a record with at least one")
    names = ("time_s", "plate_angle_deg", "force_n", "force_std_dev_n", "mass_flow_kg_s")
    columns = {name: column(rows, name) for name in names}
    sweep_id = np.array([row.sweep_id for row in rows])
    usable = np.array([bool(row.usable_for_calibration) for row in rows])
    return sweeps.draw(sweep_id, usable, **columns, units=_units(args))


def _parameters(args: argparse.Namespace) -> Figure:
    path = Path(args.record)
    with recorded.opened(path) as store:
        versions = store.parameter_versions()
    if not versions:
        raise InputError(args.record, "holds no parameters", "the store of a daemon that has run")
    sets = [parameter_file.from_document(version.document, f"{path}: version {version.version}") for version in versions]
    return parameters.draw([version.time_s for version in versions], sets, [version.origin for version in versions])


def _model(args: argparse.Namespace) -> tuple[ForwardModel, ParameterSet]:
    known = model_options.parameters(args)
    return ForwardModel(model_options.machine(args), known.effects), known


def _curves(args: argparse.Namespace) -> Figure:
    model_options.check_moisture(args.moisture)
    model, known = _model(args)
    speed = model.machine.nominal_elevator_speed_rad_s if args.elevator_speed is None else args.elevator_speed * RPM
    readings = None if args.data is None else _readings(args, model, known, speed)
    if args.mass_flow is not None:
        flows = model_options.numbers(args.mass_flow, "--mass-flow")
    else:
        flows = np.arange(2.0, 26.1, 4.0) if readings is None else curves.some(np.round(readings.mass_flow_kg_s, 4))
    if args.plate_angle is not None:
        angles = np.radians(model_options.numbers(args.plate_angle, "--plate-angle"))
    else:
        angles = np.radians(np.arange(40.0, 91.0, 10.0)) if readings is None else curves.some(readings.plate_angle_rad)
    model_options.check_operating_points(flows, np.degrees(angles), np.array([speed / RPM]))
    try:
        return curves.draw(model, known, flows, angles, elevator_speed_rad_s=speed, moisture_pct=args.moisture, readings=readings)
    except ValueError as error:
        raise InputError("plot curves", str(error)) from error


def _readings(args: argparse.Namespace, model: ForwardModel, known: ParameterSet, speed_rad_s: float) -> curves.Readings:
    data = table.load(args.data)
    model_options.in_unit_of(data, known, args)
    rows = model_options.measurements(data, model.machine)
    angle, speed, load, _ = rows.columns()
    passes = model.machine.passes_per_s(speed)
    at_speed = np.isclose(speed, speed_rad_s, rtol=1e-3)
    if not at_speed.any():
        raise InputError(args.data, f"has no row at {speed_rad_s / RPM:g} rpm", "--elevator-speed as in the table")
    rate = load * passes if data.load == "paddle_mass_kg" else load
    return curves.Readings(angle[at_speed], rate[at_speed], (rows.momentum * passes)[at_speed])


def _residuals(args: argparse.Namespace) -> Figure:
    model, known = _model(args)
    data = table.load(args.data)
    known = model_options.in_unit_of(data, known, args)
    rows = model_options.measurements(data, model.machine)
    missed = np.real(model.paddle_momentum(rows.conditions, known.values)) - rows.momentum
    label = "mass flow, kg/s" if data.load == "mass_flow_kg_s" else "mass on a paddle, kg"
    angle, _, load, _ = rows.columns()
    return residuals.draw(np.degrees(angle), load, label, 100.0 * missed / np.abs(rows.momentum).max())


def _sensitivity(args: argparse.Namespace) -> Figure:
    model_options.check_each(
        np.array([0.0 < args.plate_angle < 180.0]), np.array([args.plate_angle]), "--plate-angle", "0 to 180 deg, both excluded"
    )
    return sensitivity.draw(_named_files.machine(args.machine), radians(args.plate_angle))


def _published(args: argparse.Namespace) -> Figure:
    document = strict_yaml.load(args.tables)
    try:
        return published.draw(document, _named_files.machine(args.machine))
    except (KeyError, TypeError) as error:
        raise InputError(args.tables, f"lacks {error}", "the published tables") from error

"""Calibrate: fit grain and effect parameters to a table of known flows and forces, or to weighed loads."""

from __future__ import annotations

import argparse

from yieldmon.cli import _outputs
from yieldmon.cli._json import print_document
from yieldmon.errors import InputError
from yieldmon.estimation.flow_curve import KINDS


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "calibrate",
        help="fit parameters to a table or to weighed loads",
        description=__doc__,
        epilog="example: yieldmon calibrate facility.csv --out corn.yaml; "
        "yieldmon calibrate --loads yieldmon.sqlite --tickets tickets.csv --config yieldmon.yaml --out corn.yaml",
    )
    parser.add_argument(
        "data", nargs="?", metavar="DATA.csv", help="table with plate_angle_deg, mass flow or paddle mass, and a reading"
    )
    parser.add_argument("--out", metavar="FILE.yaml", help="parameter file to write")
    parser.add_argument("--machine", metavar="FILE", help="file or shipped name (default: sprocket-8)")
    parser.add_argument("--starts", type=int, metavar="N", help="random starts (default: 20)")
    parser.add_argument("--free", metavar="A,B", help="parameters to fit (default: grain, impact and those of effects)")
    parser.add_argument("--fix", action="append", default=[], metavar="NAME=VALUE", help="hold a parameter at a value")
    parser.add_argument("--bounds", action="append", default=[], metavar="NAME=LOW:HIGH", help="search range of a parameter")
    parser.add_argument("--prior", metavar="FILE.yaml", help="parameter file for the prior (values and covariance)")
    parser.add_argument(
        "--impact",
        choices=("restitution", "exchange"),
        help="impact gain: 1 + e, or k1 M/M_full + k2 (default: 1 + e; k1, k2 for a response or if e ends at its bound)",
    )
    parser.add_argument("--effects", default="", metavar="A,B", help="effects to add to the published model")
    parser.add_argument("--response-scale", type=float, metavar="S", help="units of `response` per kg m/s, if known")
    parser.add_argument("--plate-angle", type=float, metavar="DEG", help="use only the rows at this angle")
    parser.add_argument("--robust", action="store_true", help="soft-L1 loss: outliers weigh less")
    parser.add_argument(
        "--stop-gap",
        action="store_true",
        help="fit a smooth correction by angle and load; grain stays near usual values",
    )
    parser.add_argument(
        "--by-moisture", action="store_true", help="fit each moisture_pct and write a moisture map; --out names a folder"
    )
    parser.add_argument("--estimator", choices=KINDS, help="fit a curve for estimator_file instead of the model")
    parser.add_argument("--pulse-shape", action="store_true", help="fit pulse_shape_file from logs of weighed loads instead")
    parser.add_argument(
        "--taps", nargs="+", metavar="LOG", help="fit sensor.response_s of the machine file to logs of taps on the plate"
    )
    parser.add_argument("--compare", action="store_true", help="compare with the empirical models, by cross-validation")
    parser.add_argument(
        "--identifiability", action="store_true", help="report what these rows determine, and what further rows would add"
    )
    parser.add_argument(
        "--profiles", metavar="FILE", help="plot the misfit against each parameter (*.png or *.svg; needs the plot extra)"
    )
    parser.add_argument("--seed", type=int, metavar="N", help="their seed (default: 0)")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    group = parser.add_argument_group("calibration by weighed loads")
    group.add_argument(
        "--loads", nargs="+", metavar="SOURCE", help="a daemon's store, or logs of weighed loads, instead of DATA.csv"
    )
    group.add_argument("--tickets", metavar="FILE", help="table with the columns load, weighed_kg and, if known, std_dev_kg")
    group.add_argument("--config", metavar="FILE", help="configuration for the logs (default: the shipped one)")
    _outputs.add_force(parser, "out", "profiles")


def run(args: argparse.Namespace) -> int:
    """Fit, report, write. Exit code 1 when weighed loads refuse the calibration."""
    # Each way of calibrating imports what it needs, which is half of a short command's time.
    if args.taps is not None:
        from yieldmon.cli import _taps

        taps = _taps.run(args)
        print_document(taps, _taps.text, as_json=args.json, indent=1)
        return 1 if taps["refused"] else 0
    if args.pulse_shape:
        from yieldmon.cli import _pulse_shape

        shape = _pulse_shape.run(args)
        print_document(shape, _pulse_shape.text, as_json=args.json, indent=1)
        return 1 if shape["refused"] else 0
    if args.estimator is not None:
        from yieldmon.cli import _by_curve

        print_document(_by_curve.run(args), _by_curve.text, as_json=args.json, indent=1)
        return 0
    if args.loads is not None:
        from yieldmon.cli import _by_loads

        document = _by_loads.run(args)
        print_document(document, _by_loads.text, as_json=args.json, indent=1)
        return 1 if document["refused"] else 0
    if args.data is None:
        raise InputError("DATA", "is missing", "a table of a test facility, or --loads and --tickets")
    from yieldmon.cli import _by_table

    return _by_table.run(args)

"""System calibration: grain and effect parameters from a table of known loads and measured forces."""

from __future__ import annotations

import argparse

from yieldmon.cli import (
    _by_loads,
    _by_table,
    _flow_curve,
    _outputs,
    _pulse_shape,
    _taps,
)
from yieldmon.cli._json import print_document
from yieldmon.errors import InputError


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "calibrate",
        help="fit parameters to a table",
        description=__doc__,
        epilog="example: yieldmon calibrate facility.csv --out corn.yaml; "
        "yieldmon calibrate --loads yieldmon.sqlite --tickets tickets.csv --out corn.yaml",
    )
    parser.add_argument("data", nargs="?", metavar="DATA.csv", help="plate_angle_deg, a load column and a reading column")
    parser.add_argument("--out", metavar="P.yaml", help="write the parameters here")
    parser.add_argument("--machine", metavar="F", help="file or shipped name; default: sprocket-8")
    parser.add_argument("--starts", type=int, default=20, metavar="N", help="random starts; default: 20")
    parser.add_argument("--free", metavar="A,B", help="parameters to fit; default: grain, impact and all of the effects'")
    parser.add_argument("--fix", action="append", default=[], metavar="NAME=VALUE", help="hold a parameter at a value")
    parser.add_argument("--bounds", action="append", default=[], metavar="NAME=LOW:HIGH", help="search range of a parameter")
    parser.add_argument("--prior", metavar="P.yaml", help="parameter file whose values and covariance are the prior")
    parser.add_argument(
        "--impact",
        choices=("restitution", "exchange"),
        help="1 + e, or k1 M/M_full + k2; default: 1 + e, and k1, k2 for a response or where 1 + e ends at its physical bound",
    )
    parser.add_argument("--effects", default="", metavar="A,B", help="effects to add to the published model")
    parser.add_argument("--response-scale", type=float, metavar="S", help="units of `response` in one kg m/s, where known")
    parser.add_argument("--plate-angle", type=float, metavar="DEG", help="use the rows at this angle only")
    parser.add_argument("--robust", action="store_true", help="soft-L1 loss: outliers lose weight")
    parser.add_argument(
        "--stop-gap",
        action="store_true",
        help="smooth correction by angle and load; grain stays near usual values",
    )
    parser.add_argument("--by-moisture", action="store_true", help="a fit for each moisture_pct and a map; --out names a folder")
    _flow_curve.add_argument(parser)
    _pulse_shape.add_argument(parser)
    _taps.add_argument(parser)
    parser.add_argument("--compare", action="store_true", help="compare with the empirical models, by cross-validation")
    parser.add_argument(
        "--identifiability", action="store_true", help="report what these rows determine, and what rows would add"
    )
    parser.add_argument(
        "--profiles", metavar="F", help="draw how the misfit grows with each parameter (*.png or *.svg; needs the plot extra)"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the random starts; default: 0")
    parser.add_argument("--json", action="store_true", help="one JSON document")
    _by_loads.add_arguments(parser)
    _outputs.add_force(parser, "out", "profiles")


def run(args: argparse.Namespace) -> int:
    """Fit, report, write. Exit code 1 when weighed loads refuse the calibration."""
    if args.taps is not None:
        taps = _taps.run(args)
        print_document(taps, _taps.text, as_json=args.json, indent=1)
        return 1 if taps["refused"] else 0
    if args.pulse_shape:
        shape = _pulse_shape.run(args)
        print_document(shape, _pulse_shape.text, as_json=args.json, indent=1)
        return 1 if shape["refused"] else 0
    if args.estimator is not None:
        curve = _flow_curve.run(args)
        print_document(curve, _flow_curve.text, as_json=args.json, indent=1)
        return 0
    if args.loads is not None:
        document = _by_loads.run(args)
        print_document(document, _by_loads.text, as_json=args.json, indent=1)
        return 1 if document["refused"] else 0
    if args.data is None:
        raise InputError("DATA", "is missing", "a table of a test facility, or --loads and --tickets")
    return _by_table.run(args)

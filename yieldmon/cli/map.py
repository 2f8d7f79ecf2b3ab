"""Make a map of a harvest: delay, area, cleaning, loads, products and a report."""

from __future__ import annotations

import argparse

from yieldmon.cli._units import add_units
from yieldmon.field.cleaning import NAMES, NEEDED
from yieldmon.field.products import FORMATS


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "map",
        help="a yield map of a harvest, with a report",
        description=f"{__doc__} A SOURCE is a daemon's store, a table of `process`, Ag Leader text, ISO 11783-10 task data "
        "(folder or zip), a zip of the John Deere Operations Center, a GeoPackage, GeoJSON, Parquet or shapefile of points, or "
        "CSV.",
        epilog="example: yieldmon map north_field.txt --out north; yieldmon map today.sqlite --out today",
    )
    parser.add_argument("sources", metavar="SOURCE", nargs="+", help="harvests; several make one map")
    parser.add_argument("--out", metavar="DIR", required=True, help="folder to write to; it is made, and its files are replaced")
    parser.add_argument("--json", action="store_true", help="print the numbers as one JSON document")
    parser.add_argument(
        "--products", metavar="LIST", default="all", help=f"which files, with commas: {', '.join(FORMATS)}; all (default) or none"
    )
    parser.add_argument("--tickets", metavar="FILE", help="table of load and weighed_kg, if known std_dev_kg, machine")
    parser.add_argument(
        "--without",
        metavar="REASON",
        action="append",
        default=[],
        help=f"switch a cleaning rule off; repeatable: {', '.join(n for n in NAMES if n not in NEEDED)}",
    )
    parser.add_argument("--grid", type=float, default=10.0, metavar="M", help="size of the grid's blocks (default: 10)")
    parser.add_argument(
        "--transport", action="store_true", help="sharpen the flow by deconvolution, where that beats a plain smoother"
    )
    add_units(parser, "metric")
    what = parser.add_argument_group("what the data do not state")
    what.add_argument("--flow-delay", type=float, metavar="S", help="delay of the flow (default: estimated)")
    what.add_argument("--moisture-delay", type=float, metavar="S", help="delay of the moisture (default: estimated)")
    what.add_argument("--width", type=float, metavar="M", help="working width (default: the source's)")
    what.add_argument("--crop", default="", metavar="NAME", help="crop of rows without a crop")
    what.add_argument("--field", default="", metavar="NAME", help="name of the field")
    what.add_argument(
        "--date", metavar="YYYY-MM-DD", help="date of the first point, where clocks have none or dates are ambiguous"
    )
    what.add_argument("--crs", default="", metavar="EPSG:CODE", help="coordinate system of files without one")
    what.add_argument("--header-ahead", type=float, metavar="M", help="header ahead of the antenna (default: the file's)")
    what.add_argument(
        "--header-right",
        type=float,
        metavar="M",
        help="middle of the header right of the antenna (default: the file's)",
    )
    what.add_argument(
        "--column",
        metavar="QUANTITY=NAME[:UNIT]",
        action="append",
        default=[],
        help="a file's column, e.g. yield=Yld_Mass:lb/ac; repeatable",
    )


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when all files are written."""
    # Needs the extra `map`, which help does not.
    from yieldmon.cli import _map

    return _map.run(args)

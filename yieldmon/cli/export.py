"""Export records for other programs: tables, maps of yield points, task data."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from yieldmon.cli import _outputs
from yieldmon.cli._limits import within
from yieldmon.errors import InputError
from yieldmon.export import agleader, columns, geojson, geopackage, taskdata
from yieldmon.export.points import PointSettings, YieldPoint, yield_points
from yieldmon.service.logs import recorded
from yieldmon.service.storage.ledger import LoadRecord
from yieldmon.service.storage.rows import SecondRow

ENDINGS = {
    ".csv": "csv",
    ".parquet": "parquet",
    ".geojson": "geojson",
    ".gpkg": "geopackage",
    ".txt": "agleader",
    ".zip": "taskdata",
}
FORMATS = tuple(ENDINGS.values())
TABLES = ("csv", "parquet")


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "export",
        help="records as tables, maps and task data",
        description=f"{__doc__} Yield points need position and ground speed frames in the record, and --swath.",
        epilog="example: yieldmon export monday.parquet --out monday.gpkg --swath 9.1 --flow-delay 12",
    )
    parser.add_argument("record", metavar="RECORD", help="a daemon's store (.sqlite, .db), or a table of `process`")
    parser.add_argument("--out", metavar="FILE", required=True, help=f"file to write, *{', *'.join(ENDINGS)}")
    _outputs.add_force(parser, "out")
    kinds = f"{', '.join(FORMATS)} (default: by the name's ending); taskdata without .zip writes a folder"
    parser.add_argument("--format", choices=FORMATS, metavar="FORMAT", help=kinds)
    parser.add_argument(
        "--what", choices=("seconds", "loads", "points"), help="what a table holds (default: seconds); other formats hold points"
    )
    points = parser.add_argument_group("yield points")
    points.add_argument("--swath", type=float, metavar="M", help="working width")
    points.add_argument("--flow-delay", type=float, default=12.0, metavar="S", help="from cutting to the sensor (default: 12)")
    points.add_argument("--start-delay", type=float, default=4.0, metavar="S", help="left out at a pass's start (default: 4)")
    points.add_argument("--end-delay", type=float, default=4.0, metavar="S", help="left out at a pass's end (default: 4)")
    points.add_argument("--reference-moisture", type=float, default=15.5, metavar="PCT", help="of dry mass (default: 15.5)")
    points.add_argument("--field", default="field", metavar="NAME", help="name of the field (default: field)")
    points.add_argument("--grain", default="corn", metavar="NAME", help="name of the crop (default: corn)")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when the file is written."""
    out = Path(args.out)
    kind = args.format or ENDINGS.get(out.suffix.lower())
    if kind is None:
        raise InputError("--out", f"is {args.out}", f"a name that ends in one of {', '.join(ENDINGS)}, or --format")
    if kind == "taskdata" and out.suffix.lower() != ".zip":
        _outputs.check_folder(out / taskdata.FOLDER, taskdata.FILES, "--out", force=args.force)
    what = args.what or ("seconds" if kind in TABLES else "points")
    if what != "points" and kind not in TABLES:
        raise InputError("--what", f"{what} as {kind}", f"{what} as {' or '.join(TABLES)}")
    if what == "loads":
        loads = recorded.read_loads(args.record)
        _table(kind)(out, LoadRecord, loads)
        print(f"{out}: {_counted(len(loads), 'load')}", file=sys.stderr)
        return 0
    rows = recorded.read_seconds(args.record)
    if what == "seconds":
        _table(kind)(out, SecondRow, rows)
        print(f"{out}: {_counted(len(rows), 'second')}", file=sys.stderr)
        return 0
    points = yield_points(rows, _settings(args), args.record)
    if not points:
        expected = "flow, and a position --flow-delay before it"
        raise InputError(args.record, "has no second of harvest that a place belongs to", expected)
    _write_points(kind, out, points, args)
    said = f"{out}: {_counted(len(points), 'yield point')}"
    if kind in ("agleader", "taskdata"):
        # Readers take such files for raw ones.
        said += f"; the flow delay of {args.flow_delay:g} s is taken out: read them with `yieldmon map --flow-delay 0`"
    print(said, file=sys.stderr)
    return 0


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _table(kind: str) -> Callable[[Path, type, Sequence[Any]], None]:
    return columns.write_csv if kind == "csv" else columns.write_parquet


def _write_points(kind: str, out: Path, points: list[YieldPoint], args: argparse.Namespace) -> None:
    if kind in TABLES:
        _table(kind)(out, YieldPoint, points)
    elif kind == "geojson":
        geojson.write(out, points)
    elif kind == "geopackage":
        geopackage.write(out, points)
    elif kind == "agleader":
        agleader.write(out, points, args.field, args.grain)
    else:
        taskdata.write(out, points, args.field, args.reference_moisture)


def _settings(args: argparse.Namespace) -> PointSettings:
    if args.swath is None:
        raise InputError("--swath", "is missing", "the working width in m, for yield by area")
    for name, value, low, high in (
        ("--swath", args.swath, 0.1, 50.0),
        ("--flow-delay", args.flow_delay, 0.0, 60.0),
        ("--start-delay", args.start_delay, 0.0, 600.0),
        ("--end-delay", args.end_delay, 0.0, 600.0),
        ("--reference-moisture", args.reference_moisture, 0.0, 50.0),
    ):
        within(name, value, low, high)
    return PointSettings(
        swath_m=args.swath,
        flow_delay_s=args.flow_delay,
        start_pass_delay_s=args.start_delay,
        end_pass_delay_s=args.end_delay,
        reference_moisture_pct=args.reference_moisture,
    )

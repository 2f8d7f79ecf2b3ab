"""Export records for other programs: tables, maps of yield points, task data."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from yieldmon.cli import _outputs
from yieldmon.cli._limits import within, within_if_given
from yieldmon.engine.mass.totals import CORN_MARKET_MOISTURE_PCT
from yieldmon.errors import InputError
from yieldmon.export import agleader, columns, geojson, geopackage, taskdata
from yieldmon.export.points import PointSettings, YieldPoint, yield_points
from yieldmon.files.crops import find_crop
from yieldmon.service.logs import recorded
from yieldmon.service.storage.empty_loads import empty_loads, not_listed
from yieldmon.service.storage.ledger import LoadRecord
from yieldmon.service.storage.load_ends import between_loads
from yieldmon.service.storage.rows import SecondRow
from yieldmon.units import counted

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
_FIELD, _GRAIN = "field", "corn"
_OF_POINTS = ("swath", "reference_moisture", "field", "grain")
"""Options that have no default and say something of yield points."""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "export",
        help="export records as tables, maps and task data",
        description=f"{__doc__} Yield points need --swath, and position and ground speed in the record.",
        epilog="example: yieldmon export monday.parquet --out monday.gpkg --swath 9.1 --flow-delay 12",
    )
    parser.add_argument("record", metavar="RECORD", help="a daemon's store (.sqlite, .db), or a table of `process`")
    parser.add_argument("--out", metavar="FILE", required=True, help=f"file to write, *{', *'.join(ENDINGS)}")
    _outputs.add_force(parser, "out")
    kinds = f"{', '.join(FORMATS)} (default: by the name's ending); taskdata without .zip writes a folder"
    parser.add_argument("--format", choices=FORMATS, metavar="FORMAT", help=kinds)
    parser.add_argument(
        "--what", choices=("seconds", "loads", "points"), help="rows of a table (default: seconds); other formats have points"
    )
    parser.add_argument("--all", action="store_true", help="with --what loads: also complete loads without grain")
    points = parser.add_argument_group("yield points")
    points.add_argument("--swath", type=float, metavar="M", help="working width")
    points.add_argument(
        "--flow-delay", type=float, default=12.0, metavar="S", help="delay from cutting to the sensor (default: 12)"
    )
    points.add_argument(
        "--start-delay", type=float, default=4.0, metavar="S", help="leave out the first S seconds of a pass (default: 4)"
    )
    points.add_argument(
        "--end-delay", type=float, default=4.0, metavar="S", help="leave out the last S seconds of a pass (default: 4)"
    )
    points.add_argument(
        "--reference-moisture",
        type=float,
        metavar="PCT",
        help="moisture of dry mass (default: the crop's market moisture, else 15.5)",
    )
    points.add_argument("--field", metavar="NAME", help="name of the field (default: the load's, else field)")
    points.add_argument("--grain", metavar="NAME", help="name of the crop (default: the load's, else corn)")


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
    if args.all and what != "loads":
        raise InputError("--all", f"has no meaning with {what}", "--what loads")
    for option in _OF_POINTS if what != "points" else ():
        if getattr(args, option) is not None:
            raise InputError(f"--{option.replace('_', '-')}", f"has no meaning with {what}", "--what points")
    if what == "loads":
        loads = recorded.read_loads(args.record)
        empty = frozenset() if args.all else frozenset(empty_loads(loads))
        listed = [load for load in loads if load.number not in empty]
        _table(kind)(out, LoadRecord, listed)
        print(f"{out}: {counted(len(listed), 'load')}" + (f"; {not_listed(len(empty))}" if empty else ""), file=sys.stderr)
        return 0
    rows = recorded.read_seconds(args.record)
    if what == "seconds":
        _table(kind)(out, SecondRow, rows)
        print(f"{out}: {counted(len(rows), 'second')}", file=sys.stderr)
        return 0
    _export_points(args, kind, out, rows)
    return 0


def _export_points(args: argparse.Namespace, kind: str, out: Path, rows: Sequence[SecondRow]) -> None:
    """Write yield points of seconds, and say what they are without."""
    loads = recorded.read_loads(args.record) if recorded.is_store(args.record) else []
    settings = _settings(args, rows, loads)
    points = yield_points(rows, settings, args.record)
    if not points:
        expected = "flow, and a position --flow-delay before it"
        raise InputError(args.record, "has no second of harvest with a position", expected)
    _write_points(kind, out, points, settings, _names(args, loads, "" if kind == "taskdata" else _GRAIN))
    masses = f"{sum(point.mass_kg for point in points):.0f} of {sum(row.mass_kg for row in rows):.0f} kg"
    said = f"{out}: {counted(len(points), 'yield point')} with {masses}"
    if kind == "agleader":
        # Readers take such a file for a raw one.
        said += f"; corrected for a flow delay of {args.flow_delay:g} s: read them with `yieldmon map --flow-delay 0`"
    print(said, file=sys.stderr)
    in_points = {point.load_number for point in points}
    corrected = [load for load in loads if load.number in in_points and load.corrected_mass_kg != load.mass_kg]
    if corrected:
        better = f"{sum(load.corrected_mass_kg for load in corrected):.0f} for {sum(load.mass_kg for load in corrected):.0f} kg"
        note = f"points are as measured; {counted(len(corrected), 'load')} weighed or recomputed ({better})"
        print(f"yieldmon: {note}: `yieldmon map` corrects its points", file=sys.stderr)


def _table(kind: str) -> Callable[[Path, type, Sequence[Any]], None]:
    return columns.write_csv if kind == "csv" else columns.write_parquet


def _names(args: argparse.Namespace, loads: Sequence[LoadRecord], grain: str) -> Callable[[int | None], tuple[str, str]]:
    """Field and crop of a load, by its number; of grain between loads where all loads have the same. grain: where no crop is
    known."""
    known = {load.number: (args.field or load.field or _FIELD, args.grain or load.crop or grain) for load in loads}
    of_all, unknown = set(known.values()), (args.field or _FIELD, args.grain or grain)
    between = of_all.pop() if len(of_all) == 1 else unknown
    return lambda number: between if number is None else known.get(number, unknown)


def _write_points(
    kind: str, out: Path, points: list[YieldPoint], settings: PointSettings, names_of: Callable[[int | None], tuple[str, str]]
) -> None:
    if kind in TABLES:
        _table(kind)(out, YieldPoint, points)
    elif kind == "geojson":
        geojson.write(out, points)
    elif kind == "geopackage":
        geopackage.write(out, points)
    elif kind == "agleader":
        agleader.write(out, points, names_of)
    else:
        taskdata.write(out, points, names_of, settings.reference_of)


def _settings(args: argparse.Namespace, rows: Sequence[SecondRow], loads: Sequence[LoadRecord]) -> PointSettings:
    given_pct = args.reference_moisture
    if args.swath is None:
        raise InputError("--swath", "is missing", "the working width in m, for yield by area")
    for name, value, low, high in (
        ("--swath", args.swath, 0.1, 50.0),
        ("--flow-delay", args.flow_delay, 0.0, 60.0),
        ("--start-delay", args.start_delay, 0.0, 600.0),
        ("--end-delay", args.end_delay, 0.0, 600.0),
    ):
        within(name, value, low, high)
    within_if_given("--reference-moisture", given_pct, 0.0, 50.0)
    given_pct = given_pct if given_pct is not None or not args.grain else _market_moisture_pct(args.grain)
    return PointSettings(
        swath_m=args.swath,
        flow_delay_s=args.flow_delay,
        start_pass_delay_s=args.start_delay,
        end_pass_delay_s=args.end_delay,
        reference_moisture_pct=CORN_MARKET_MOISTURE_PCT if given_pct is None else given_pct,
        between_loads=between_loads(rows, loads),
        reference_by_load={load.number: _market_moisture_pct(load.crop) for load in loads} if given_pct is None else {},
    )


def _market_moisture_pct(crop: str) -> float:
    """As loads have it: corn's where the crop is not known."""
    known = find_crop(crop)
    return CORN_MARKET_MOISTURE_PCT if known is None else known.market_moisture_pct

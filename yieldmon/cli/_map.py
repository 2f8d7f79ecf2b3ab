"""What `map` does; its arguments are apart, for the extra `map` is imported here."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from datetime import date
from math import isfinite
from pathlib import Path

import numpy as np

from yieldmon.cli import _outputs
from yieldmon.cli._json import print_json
from yieldmon.cli._limits import within_if_given
from yieldmon.errors import InputError
from yieldmon.field import harvest, sources, summary
from yieldmon.field.cleaning import NAMES, NEEDED
from yieldmon.field.copies import without_copies
from yieldmon.field.crop_figures import crop, known_crops
from yieldmon.field.header_place import FARTHEST_M, HeaderPlace
from yieldmon.field.products import FILES, FORMATS, write_products
from yieldmon.field.sources.options import ReadOptions
from yieldmon.field.table import HarvestTable, Skipped, joined
from yieldmon.files import ticket_file
from yieldmon.files.whole_file import real_path
from yieldmon.units import UnitSystem, counted


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when all files are written."""
    started = time.monotonic()
    out = Path(args.out)
    formats = _formats(args.products)
    read_options, map_options = _read_options(args), _map_options(args)
    if out.exists() and not out.is_dir():
        raise InputError("--out", f"{out} is a file", "a folder")
    _outputs.require_writable_folder(out, "--out")
    _spare_sources([real_path(name) for name in args.sources], real_path(out), formats)

    def progress(text: str) -> None:
        print(f"{time.monotonic() - started:6.1f} s  {text}", file=sys.stderr, flush=True)

    table = _read([Path(name) for name in args.sources], read_options, progress)
    result = replace(harvest.make_map(table, map_options, progress), system=UnitSystem(args.units or UnitSystem.METRIC))
    out.mkdir(parents=True, exist_ok=True)
    written = write_products(out, result, formats, args.grid, progress)
    document = summary.document(result, [str(path) for path in written])
    _print_summary(result)
    if args.json:
        print_json(document, indent=1)
    return 0


def _spare_sources(sources: Sequence[Path], out: Path, formats: Sequence[str]) -> None:
    """Raises InputError where a harvest is named twice, or what is written would replace one."""
    written = {out / name for kind in formats for name in FILES[kind]}
    for number, source in enumerate(sources):
        if source in sources[:number]:
            raise InputError(str(source), "is named twice, which would double its mass", "each harvest once")
        if source in written or (source == out and any(path.exists() for path in written)):
            raise InputError(f"--out {out}", f"has files that would replace those of {source}, which is read", "another folder")


def _read(paths: list[Path], options: ReadOptions, progress: sources.Progress) -> HarvestTable:
    tables = []
    for path in paths:
        if sys.stderr.isatty():
            progress(f"reading {path}")
        tables.append(sources.read(path, options))
    tables = _of_one_date_order(paths, tables, options)
    for table in tables:
        for source in table.sources:
            for why, parts in _by_reason(source.skipped).items():
                print(f"yieldmon: {source.path}: {', '.join(parts)}: {why}; left out", file=sys.stderr)
            for note in source.notes:
                print(f"yieldmon: {source.path}: {note}", file=sys.stderr)
    table = without_copies(joined(tables))
    said = {source.path: source.skipped for one in tables for source in one.sources}
    for source in table.sources:
        for copy in source.skipped[len(said[source.path]) :]:
            print(f"yieldmon: {source.path}: {copy.part} {copy.why}; left out", file=sys.stderr)
    return table


def _of_one_date_order(paths: Sequence[Path], tables: Sequence[HarvestTable], options: ReadOptions) -> list[HarvestTable]:
    """The tables, those read anew whose dates do not tell day from month where those of others tell another order."""
    orders = [[source.date_order for source in table.sources if source.date_order is not None] for table in tables]
    known = {order.day_first for of_table in orders for order in of_table if order.known}
    if len(known) != 1:
        return list(tables)
    day_first = known.pop()
    return [
        sources.read(path, replace(options, day_first=day_first)) if any(not order.known for order in of_table) else table
        for path, table, of_table in zip(paths, tables, orders, strict=True)
    ]


def _by_reason(skipped: Iterable[Skipped]) -> dict[str, list[str]]:
    """What was left out for the same reason stands on one line."""
    parts: dict[str, list[str]] = {}
    for one in skipped:
        parts.setdefault(one.why, []).append(one.part)
    return parts


def _print_summary(result: harvest.HarvestMap) -> None:
    totals = result.totals
    lines = summary.delay_lines(result)
    if result.transport is not None:
        lines.append(summary.transport_line(result.transport))
    units = result.units
    mass, crop_yield = units.mass_unit, units.yield_unit
    middle, low, high = (crop_yield.of(value) for value in (totals.yield_kg_m2, totals.low_kg_m2, totals.high_kg_m2))
    span = f" ({low:.2f} to {high:.2f})" if isfinite(low) else ""
    weighed = ""
    if totals.low_kg is not None and totals.high_kg is not None:
        corrected, least, most = (f"{mass.of(value):.0f}" for value in (totals.corrected_kg, totals.low_kg, totals.high_kg))
        weighed = f"{corrected} {mass.name} by weighed loads ({least} to {most}), "
    lines.append(
        f"{counted(len(result.table), 'point')}, {int(result.cleaned.kept.sum())} kept; "
        f"{mass.of(totals.measured_kg):.0f} {mass.name} "
        f"measured, {weighed}{mass.of(totals.by_reason.get('kept', 0.0)):.0f} {mass.name} kept; "
        f"{units.area(totals.area_m2)} cut; "
        + (f"{middle:.2f} {crop_yield.name}{span}" if isfinite(middle) else "no yield: no point is kept")
    )
    lines += [note for note in result.notes if "cannot be estimated" not in note]
    if result.system is UnitSystem.US and result.bushel_kg is None:
        lines += _why_no_bushels(result)
    for line in lines:
        print(f"yieldmon: {line}", file=sys.stderr)


def _why_no_bushels(result: harvest.HarvestMap) -> list[str]:
    """A note, where there is grain."""
    crops = result.crops.take(result.table["flow_kg_s"] > 0.0)
    names = [crops.names[code] for code in np.unique(crops.codes)]
    unknown = [name or "an unknown crop" for name in names if crop(name) is None]
    if unknown:
        expected = f"expected --crop, one of {', '.join(known_crops())}"
        return [f"the bushel of {' and '.join(unknown)} is not known: yields are in lb/ac; {expected}"]
    return [f"the bushels of {', '.join(names)} differ: yields are in lb/ac"] if len(names) > 1 else []


def _formats(text: str) -> tuple[str, ...]:
    if text == "all":
        return tuple(FORMATS)
    if text == "none":
        return ()
    chosen = tuple(name.strip() for name in text.split(",") if name.strip())
    for name in chosen:
        if name not in FORMATS:
            raise InputError("--products", f"names {name!r}", f"all, none or some of {', '.join(FORMATS)}")
    return chosen


def _read_options(args: argparse.Namespace) -> ReadOptions:
    columns = {}
    for text in args.column:
        quantity, _, rest = text.partition("=")
        name, _, unit = rest.rpartition(":") if ":" in rest else (rest, "", "")
        if not quantity or not name:
            raise InputError("--column", f"is {text!r}", "QUANTITY=NAME[:UNIT]")
        columns[quantity] = (name, unit)
    first = None
    if args.date:
        try:
            first = date.fromisoformat(args.date)
        except ValueError:
            raise InputError("--date", f"is {args.date!r}", "YYYY-MM-DD") from None
    return ReadOptions(columns, within_if_given("--width", args.width, 0.1, 60.0), args.crop, args.field, first, args.crs)


def _map_options(args: argparse.Namespace) -> harvest.MapOptions:
    for name in args.without:
        if name not in NAMES or name in NEEDED:
            raise InputError("--without", f"names {name!r}", f"one of {', '.join(n for n in NAMES if n not in NEEDED)}")
    within_if_given("--grid", args.grid, 1.0, 1000.0)
    return harvest.MapOptions(
        within_if_given("--flow-delay", args.flow_delay, -60.0, 120.0),
        within_if_given("--moisture-delay", args.moisture_delay, -60.0, 120.0),
        HeaderPlace(
            within_if_given("--header-ahead", args.header_ahead, -FARTHEST_M, FARTHEST_M),
            within_if_given("--header-right", args.header_right, -FARTHEST_M, FARTHEST_M),
        ),
        tuple(args.without),
        ticket_file.load(args.tickets) if args.tickets else (),
        args.transport,
    )

"""Put CAN logs through the engine: a row for each second, as the daemon would have measured it."""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from yieldmon.bus.codec import Codec
from yieldmon.bus.logs import SUFFIXES
from yieldmon.cli import _outputs
from yieldmon.engine.faults import FaultCode
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.zero import ZeroState
from yieldmon.errors import InputError
from yieldmon.resources import shipped
from yieldmon.service import configuration
from yieldmon.service.assembly import monitor_of
from yieldmon.service.bulk_processing import EndOfLog, Stretch, process_in_bulk
from yieldmon.service.factory_comparison import FactoryComparison
from yieldmon.service.processing import Summary
from yieldmon.service.rows import SecondRow
from yieldmon.service.tables import FORMATS, open_table

Progress = Callable[[Stretch | EndOfLog], None]


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "process",
        help="put CAN logs through the engine",
        description=__doc__,
        epilog="example: yieldmon process monday-*.log.gz --out monday.parquet --json",
    )
    parser.add_argument("logs", nargs="+", metavar="LOG", help="candump or any log of python-can; several are one record")
    parser.add_argument("--config", metavar="F", help="configuration (YAML); default: the shipped one")
    parser.add_argument(
        "--out",
        metavar="F",
        required=True,
        help=f"table to write, *{', *'.join(FORMATS)}; - is standard output; with --separate a folder",
    )
    parser.add_argument("--format", choices=[kind[1:] for kind in FORMATS], help="kind of table; default: by the name's ending")
    parser.add_argument("--separate", action="store_true", help="each log is a record of its own, with a table of its own")
    parser.add_argument("--jobs", type=int, metavar="N", default=os.cpu_count() or 1, help="processes (default: one a core)")
    parser.add_argument("--zero-mv", type=float, metavar="MV", help="zero-load voltage of a log that begins in grain")
    parser.add_argument("--json", action="store_true", help="print a summary as one JSON document")
    _outputs.add_force(parser, "out")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when every log was read to its end, damaged places aside."""
    if args.json and args.out == "-":
        raise InputError("--json", "standard output is taken by --out -", "a file for --out")
    resolved = [Path(log).resolve() for log in args.logs]
    for index, path in enumerate(resolved):
        if path in resolved[:index]:
            raise InputError(args.logs[index], "is named twice, which would double its mass", "each log once")
    if args.zero_mv is not None and not 0.0 <= args.zero_mv <= 100_000.0:
        raise InputError("--zero-mv", f"is {args.zero_mv:g}", "0 to 100000 mV, as a table of an earlier log has it (zero_mv)")
    if args.jobs < 1:
        raise InputError("--jobs", f"is {args.jobs}", "a whole number from 1")
    config = args.config if args.config is not None else shipped("config/yieldmon.yaml")
    loaded = configuration.load(config)
    if args.separate:
        return _separately(args, config)
    with _progress(args.logs) as progress:
        document = _one_record(args.logs, args.out, args.format, loaded, args.jobs > 1, progress, args.zero_mv)
    if args.json:
        print(json.dumps(document, indent=2))
    else:
        print(_line(document), file=sys.stderr)
    return 0


def _separately(args: argparse.Namespace, config: str | Path) -> int:
    if args.out == "-":
        raise InputError("--out", "is standard output", "a folder, with --separate")
    folder, kind = Path(args.out), args.format or "csv"
    names = [_stem(log) for log in args.logs]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError("--separate", f"several logs are named {twice}", "logs whose names differ")
    folder.mkdir(parents=True, exist_ok=True)
    work = partial(_separate_record, folder=folder, kind=kind, config=config, zero_mv=args.zero_mv)
    context = multiprocessing.get_context("fork")
    documents: dict[str, Any] = {}
    with _progress(args.logs) as progress, context.Pool(min(args.jobs, len(args.logs)), _leave_interrupts) as pool:
        for log, (document, error) in zip(args.logs, pool.imap(work, args.logs), strict=True):
            if error is not None:
                raise InputError(*error)
            documents[log] = document
            if progress is not None:
                progress(EndOfLog(log, []))
            if not args.json:
                print(f"{log}: {_line(document)}", file=sys.stderr)
    if args.json:
        print(json.dumps(documents, indent=2))
    return 0


def _separate_record(
    log: str, folder: Path, kind: str, config: str | Path, zero_mv: float | None
) -> tuple[dict[str, Any], tuple[str, str, str] | None]:
    """The record's summary, or what InputError was raised with."""
    try:
        loaded = configuration.load(config)
        return _one_record([log], str(folder / f"{_stem(log)}.{kind}"), kind, loaded, False, None, zero_mv), None
    except InputError as error:
        return {}, (error.where, error.problem, error.expected)


def _leave_interrupts() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _stem(log: str) -> str:
    name = Path(log).name.removesuffix(".gz")
    return next((name.removesuffix(suffix) for suffix in SUFFIXES if name.endswith(suffix)), name)


def _one_record(
    logs: list[str],
    out: str,
    kind: str | None,
    loaded: configuration.Configuration,
    reads_ahead: bool,
    progress: Progress | None,
    zero_mv: float | None,
) -> dict[str, Any]:
    monitor = monitor_of(loaded)
    if zero_mv is not None:
        known = ZeroState(
            zero_mv, zero_mv, loaded.machine.nominal_elevator_speed_rad_s, loaded.engine.zero.first_pulse_limit_mv
        )
        monitor.restore(replace(monitor.snapshot(), zero=known))
    factory = FactoryComparison()
    with open_table(out, f".{kind}" if kind else None) as table:

        def take(row: SecondRow) -> None:
            table.write(row)
            factory.take(row)

        summary = process_in_bulk(
            logs, monitor, Codec(), take, signals=loaded.signals, reads_ahead=reads_ahead, progress=progress
        )
    return _document(summary, monitor) | ({"factory": factory.document} if factory.document is not None else {})


def _document(summary: Summary, monitor: Monitor) -> dict[str, Any]:
    totals = monitor.totals
    return {
        "frames": summary.frames,
        "frames_of_ours": summary.ours,
        "frames_malformed": summary.malformed,
        "windows": summary.windows,
        "total_mass_kg": totals.total_kg,
        "dry_mass_kg": totals.total_dry_kg if totals.total_unknown_moisture_kg == 0.0 else None,
        "faults": {code.value: count for code in FaultCode if (count := monitor.faults.occurrences(code))},
        "damages": summary.damages,
        "zero_known": monitor.snapshot().zero is not None,
    }


def _line(document: dict[str, Any]) -> str:
    line = f"{document['frames']} frames, {document['windows']} s, {document['total_mass_kg']:.1f} kg"
    line += f", {document['frames_malformed']} malformed frames" if document["frames_malformed"] else ""
    lines = [line, *(f"damaged: {damage}" for damage in document["damages"])]
    if document["faults"]:
        lines.append("faults: " + ", ".join(f"{code} {count} x" for code, count in document["faults"].items()))
    if not document["zero_known"]:
        lines.append(
            "no mass: the log has no stretch with the elevator running empty, so there is no zero; --zero-mv gives a known one"
        )
    return "\n".join(lines)


@contextmanager
def _progress(logs: list[str]) -> Iterator[Progress | None]:
    """A bar on a terminal, nothing elsewhere; by logs, since how many frames a log holds shows at its end."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("logs, {task.fields[frames]:,} frames"), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=len(logs), frames=0)
        frames = 0

        def advance(stretch: Stretch | EndOfLog) -> None:
            nonlocal frames
            if isinstance(stretch, EndOfLog):
                bar.advance(task)
            else:
                frames += stretch.frames
                bar.update(task, frames=frames)

        yield advance

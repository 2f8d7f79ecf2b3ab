"""Measure CAN logs as the daemon would: a table with a row per second, with parameter updates from sweeps."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import partial
from math import degrees
from pathlib import Path

from yieldmon.bus.log_files.log_order import in_time_order
from yieldmon.bus.log_files.logs import SUFFIXES, require_package
from yieldmon.cli import _channels, _flow_curve, _named_files, _notes, _outputs
from yieldmon.cli._forks import in_processes
from yieldmon.cli._json import print_json
from yieldmon.cli._limits import whole_number, within
from yieldmon.cli._log_progress import log_progress
from yieldmon.cli._process_text import summary_line
from yieldmon.cli._units import add_units
from yieldmon.documents.process import ProcessSummary, ReprocessSummary, SameTimesSummary
from yieldmon.errors import InputError
from yieldmon.files import parameter_file
from yieldmon.files.units import units_of
from yieldmon.files.whole_file import real_path
from yieldmon.repeats import repeated
from yieldmon.resources import shipped
from yieldmon.service.config import configuration
from yieldmon.service.logs import log_record, recorded
from yieldmon.service.logs.bulk_processing import EndOfLog, Stretch
from yieldmon.service.logs.factory_comparison import FactoryComparison
from yieldmon.service.logs.log_copies import refuse_copies, refuse_named_twice
from yieldmon.service.logs.log_record import Progress
from yieldmon.service.logs.record_check import RecordCheck
from yieldmon.service.logs.recorded import is_store_not_log
from yieldmon.service.logs.reprocessing import loads_of_rows, recomputed
from yieldmon.service.logs.sample_spacing import SampleSpacing
from yieldmon.service.logs.tables import FORMATS, open_table
from yieldmon.service.storage.rows import SecondRow
from yieldmon.units import Units

_LONGEST_DELAY_S = 60


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "process",
        help="measure CAN logs as the daemon would",
        description=__doc__,
        epilog="example: yieldmon process monday-*.log.gz --out monday.parquet --json",
    )
    parser.add_argument(
        "logs", nargs="+", metavar="LOG", help="any supported log; several logs form one record; or a daemon's store"
    )
    parser.add_argument(
        "--params", metavar="FILE", help="file or shipped name (default: the configuration's; for a store, its newest)"
    )
    parser.add_argument("--config", metavar="FILE", help="YAML configuration (default: the shipped one)")
    _channels.add_channels(parser)
    _flow_curve.add_file(parser)
    parser.add_argument(
        "--out",
        metavar="FILE",
        required=True,
        help=f"table to write, *{', *'.join(FORMATS)}; -: standard output; with --separate a folder",
    )
    parser.add_argument(
        "--format", choices=[kind[1:] for kind in FORMATS], help="format of the table (default: by the name's ending)"
    )
    parser.add_argument("--separate", action="store_true", help="measure each log separately and write a table for each")
    parser.add_argument("--jobs", type=int, metavar="N", default=os.cpu_count() or 1, help="processes (default: one per core)")
    parser.add_argument(
        "--zero-mv", type=float, metavar="MV", help="zero-load voltage, mV, for a log that begins in grain, or a store"
    )
    parser.add_argument(
        "--delay",
        type=int,
        metavar="S",
        default=0,
        help="for a store: position and ground speed belong to the flow S seconds later",
    )
    add_units(parser, "the configuration")
    parser.add_argument("--json", action="store_true", help="print a summary as one JSON document")
    _outputs.add_force(parser, "out", or_standard_output=True)


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when every log was read to its end, damaged places aside."""
    _check(args)
    config = args.config if args.config is not None else shipped("config/yieldmon.yaml")
    loaded = _configured(config, args.params, args.estimator, args.channels)
    for note in loaded.notes:
        _notes.note(note, "note")
    units = units_of(args.units, loaded.document.units, loaded.parameters.provenance.get("crop", ""))
    if any(is_store_not_log(log) for log in args.logs):
        _store_again(args, loaded, units)
        if args.config is None:
            _note_shipped("machine", "a store")
        return 0
    if args.delay:
        raise InputError("--delay", "does not apply to a log", "a store; with the table of a log `yieldmon export --flow-delay`")
    refuse_copies(args.logs)
    if args.separate:
        _separately(args, config, units)
    else:
        _together(args, loaded, units)
    if args.config is None:
        _note_shipped("machine" if args.params or args.estimator else "machine and crop", "logs")
    if loaded.parameters.scale_error > 0.0:
        _notes.note(_notes.not_calibrated(loaded.parameters.scale_error, loaded.parameters.carried_from), "note")
    return 0


def _note_shipped(what: str, of: str) -> None:
    """On what was taken from the shipped files. of: what was measured with it."""
    _notes.note(f"measured with the shipped {what}; for {of} of another machine give --config", "note")


def _together(args: argparse.Namespace, loaded: configuration.Configuration, units: Units) -> None:
    """The logs as one record."""
    with log_progress(len(args.logs)) as progress, _says_what_is_kept(args.out):
        logs = in_time_order(args.logs)
        document = _one_record(
            logs, args.out, args.format, loaded, reads_ahead=args.jobs > 1, progress=progress, zero_mv=args.zero_mv
        )
    if args.json:
        print_json(document)
    else:
        print(summary_line(document, units), file=sys.stderr)


def _configured(
    config: str | Path, params: str | None, estimator: str | None, channels: list[str]
) -> configuration.Configuration:
    """The configuration with what --params, --estimator and --channel put in its place."""
    loaded = _channels.with_channels(configuration.load(config), channels)
    if params is not None:
        loaded = replace(loaded, parameters=parameter_file.on_a_machine(_named_files.parameters(params), loaded.machine))
    if estimator is not None:
        loaded = configuration.with_estimator(loaded, estimator)
    return loaded


def _check(args: argparse.Namespace) -> None:
    """Raises InputError for arguments that do not go together, ModuleNotFoundError for a log that needs an extra."""
    if args.json and args.out == "-":
        raise InputError("--json", "standard output is taken by --out -", "a file for --out")
    refuse_named_twice(args.logs)
    if args.zero_mv is not None and not 0.0 <= args.zero_mv <= 100_000.0:
        raise InputError("--zero-mv", f"is {args.zero_mv:g}", "0 to 100000 mV, such as zero_mv in the table of an earlier log")
    for log in args.logs:
        # Here, where a package that is not installed costs one line: processes that read would print tracebacks.
        require_package(real_path(log))
    whole_number("--jobs", args.jobs, 1)


def _store_again(args: argparse.Namespace, loaded: configuration.Configuration, units: Units) -> None:
    """A store's seconds, recomputed with what is known of them."""
    if len(args.logs) > 1 or args.separate:
        raise InputError("LOG", "names a store together with other sources", "one store alone")
    within("--delay", args.delay, 0, _LONGEST_DELAY_S, "s")
    if args.params is None and args.estimator is None and args.zero_mv is None and not args.delay:
        expected = "--params, --estimator, --zero-mv or --delay to measure it again"
        # What is no store is named as that.
        with recorded.opened(Path(args.logs[0])):
            raise InputError(args.logs[0], "is a store, measured already", expected)
    rows = recorded.read_seconds(args.logs[0])
    parameters = loaded.parameters
    if args.params is None and args.estimator is None:
        parameters = recorded.last_parameters(Path(args.logs[0]))
    between = recorded.seconds_between_loads(Path(args.logs[0]), rows)
    with recorded.opened(Path(args.logs[0])) as store:
        sets = recorded.parameter_sets(store)
    found = recomputed(
        rows, loaded.machine, parameters, loaded.engine, sets=sets, zero_mv=args.zero_mv, delay_s=args.delay, between=between
    )
    with open_table(args.out, f".{args.format}" if args.format else None) as table:
        for row in found.rows:
            table.write(row)
    loads = loads_of_rows(rows, found.rows, between)
    if args.json:
        document: ReprocessSummary = {
            "windows": len(rows), "before_mass_kg": found.before_kg, "total_mass_kg": found.after_kg, "loads": loads,
            "seconds_unusable": found.unusable,
        }  # fmt: skip
        print_json(document)
        return
    before, after = units.mass_with_bushels(found.before_kg), units.mass_with_bushels(found.after_kg)
    print(f"{len(rows)} s, {after}; as measured {before}", file=sys.stderr)
    for load in loads:
        now, was = units.mass(load["after_kg"]), units.mass(load["before_kg"])
        print(f"load {load['load']}: {now}; as measured {was}", file=sys.stderr)
    if found.unusable:
        print(f"{found.unusable} s without a known force, angle or speed are unchanged", file=sys.stderr)


def _separately(args: argparse.Namespace, config: str | Path, units: Units) -> None:
    if args.out == "-":
        raise InputError("--out", "is standard output", "a folder, with --separate")
    folder, kind = Path(args.out), args.format or "csv"
    names = [_stem(log) for log in args.logs]
    if twice := repeated(names):
        raise InputError("--separate", f"several logs are named {twice[0]}", "logs whose names differ")
    tables = [f"{name}.{kind}" for name in names]
    _outputs.check_folder(folder, tables, "--out", force=args.force, inputs=args.logs)
    folder.mkdir(parents=True, exist_ok=True)
    work = partial(
        _separate_record,
        folder=folder,
        kind=kind,
        config=config,
        params=args.params,
        estimator=args.estimator,
        zero_mv=args.zero_mv,
        channels=args.channels,
    )
    documents: dict[str, ProcessSummary] = {}
    with (
        _says_what_is_kept(args.out, documents),
        log_progress(len(args.logs)) as progress,
        closing(in_processes(work, args.logs, processes=args.jobs)) as summaries,
    ):
        for log, document in zip(args.logs, summaries, strict=True):
            documents[log] = document
            if progress is not None:
                progress(EndOfLog(log, []))
            if not args.json:
                print(f"{log}: {summary_line(document, units)}", file=sys.stderr)
    if args.json:
        print_json(documents)


def _separate_record(
    log: str,
    *,
    folder: Path,
    kind: str,
    config: str | Path,
    params: str | None,
    estimator: str | None,
    zero_mv: float | None,
    channels: list[str],
) -> ProcessSummary:
    loaded = _configured(config, params, estimator, channels)
    out = str(folder / f"{_stem(log)}.{kind}")
    return _one_record([log], out, kind, loaded, reads_ahead=False, progress=None, zero_mv=zero_mv)


def _stem(log: str) -> str:
    name = Path(log).name.removesuffix(".gz")
    return next((name.removesuffix(suffix) for suffix in SUFFIXES if name.endswith(suffix)), name)


def _one_record(
    logs: list[str],
    out: str,
    kind: str | None,
    loaded: configuration.Configuration,
    *,
    reads_ahead: bool,
    progress: Progress | None,
    zero_mv: float | None,
) -> ProcessSummary:
    factory, check = FactoryComparison(), RecordCheck(loaded.engine.zero.first_pulse_limit_mv, _home_deg(loaded))
    spacing = SampleSpacing(loaded.signals.sources.impact[0])
    same_times: list[SameTimesSummary] = []
    with open_table(out, f".{kind}" if kind else None) as table:

        def take(row: SecondRow) -> None:
            table.write(row)
            factory.take(row)
            check.take(row)

        def goes_on(part: Stretch | EndOfLog) -> None:
            spacing.take(part)
            if isinstance(part, EndOfLog):
                same_times.extend({"log": part.path, "other": each.log, "seconds": each.seconds} for each in part.same_times)
            if progress is not None:
                progress(part)

        measured = log_record.measure(logs, loaded, take, zero_mv=zero_mv, reads_ahead=reads_ahead, progress=goes_on)
    document = log_record.document(*measured)
    document |= {
        "gaps": check.gaps, "gap_s": check.gap_s, "overlap_s": check.overlap_s, "overlap_kg": check.overlap_kg,
        "missing": check.missing,
    }  # fmt: skip
    if same_times:
        document["same_times"] = same_times
    if check.frames_lost_share:
        document["frames_lost_share"] = check.frames_lost_share
    if (far_off_s := spacing.far_off_s) is not None:
        document["sensor_interval_s"], document["mapped_interval_s"] = far_off_s, spacing.mapped_s
    if check.away_share and not document["zero_known"]:
        document["plate_away_share"] = check.away_share
    if check.before_zero and document["zero_known"]:
        document["before_zero_s"] = check.before_zero
    if factory.document is not None:
        document["factory"] = factory.document
    return document


def _home_deg(loaded: configuration.Configuration) -> tuple[float, float]:
    """Angles from and to which the plate rests at home, where a zero can be taken."""
    home_deg, rest_deg = degrees(loaded.machine.home_plate_angle_rad), loaded.engine.plate.rest_tolerance_deg
    return home_deg - rest_deg, home_deg + rest_deg


@contextmanager
def _says_what_is_kept(out: str, done: Mapping[str, object] | None = None) -> Iterator[None]:
    """One line at Ctrl-C; done: the records whose tables are in the folder `out`."""
    try:
        yield
    except KeyboardInterrupt:
        kept = f"{out} is not written" if done is None else f"{out} holds the tables of {len(done)} logs"
        print(f"yieldmon: interrupted; {'the table is incomplete' if out == '-' else kept}", file=sys.stderr)
        raise

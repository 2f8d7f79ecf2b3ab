"""Check a configuration file and the machine and parameter files that it names."""

from __future__ import annotations

import argparse
import grp
import sys
from contextlib import suppress

from yieldmon.cli import _channels, _notes
from yieldmon.cli._json import print_json
from yieldmon.documents.check_config import CheckDocument, SeenDocument
from yieldmon.errors import InputError
from yieldmon.estimation.admission import sweep_refusal
from yieldmon.resources import shipped
from yieldmon.service.config import configuration, document_text
from yieldmon.service.config.document import Document


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "check-config",
        help="check a configuration file",
        description=__doc__,
        epilog="example: yieldmon check-config /etc/yieldmon/yieldmon.yaml --log drive.log",
    )
    parser.add_argument("file", nargs="?", metavar="FILE", help="YAML configuration (default: the shipped one)")
    parser.add_argument("--log", metavar="FILE", help="check the signal mapping against this log")
    _channels.add_channels(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    parser.add_argument("--defaults", action="store_true", help="print the default configuration, with comments, and exit")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 for a configuration that can run, 2 for one that cannot."""
    if args.defaults:
        print(document_text.commented_defaults(), end="")
        return 0
    path = args.file if args.file is not None else str(shipped("config/yieldmon.yaml"))
    problems: list[InputError] = []
    loaded = None
    try:
        loaded = _channels.with_channels(configuration.load(path), args.channels)
    except configuration.ConfigurationError as error:
        problems = error.problems
    except InputError as error:
        problems = [error]
    seen: dict[str, SeenDocument] | None = None
    notes: list[str] = []
    if loaded is not None:
        seen, notes, problems = _held_against(loaded, args.log)
    if args.json:
        document: CheckDocument = {
            "file": path,
            "valid": not problems,
            "problems": [{"where": p.where, "problem": p.problem, "expected": p.expected} for p in problems],
            "notes": notes,
            "signals": seen,
            "configuration": loaded.document.model_dump() if loaded is not None else None,
        }
        print_json(document)
    else:
        if seen is not None:
            _show(seen)
        for note in notes:
            print(f"note: {note}")
        for problem in problems:
            print(f"yieldmon: {problem}", file=sys.stderr)
        if loaded is not None and not problems:
            defaults = ", all defaults" if loaded.document == Document() else ""
            print(f"{path}: valid{defaults}; machine {loaded.machine_path}, parameters {loaded.parameter_path}")
    return 2 if problems else 0


def _held_against(
    loaded: configuration.Configuration, log: str | None
) -> tuple[dict[str, SeenDocument] | None, list[str], list[InputError]]:
    """What a recording shows of the mapping's quantities, what is to be known of the mapping, and what is wrong with it."""
    from yieldmon.service.config import mapping_notes, plausible

    notes, group = [*loaded.notes, *mapping_notes.notes(loaded)], loaded.document.status.group
    if group is not None and not _has_group(group):
        # Of another computer it may be one.
        notes.append(f"status.group: this computer has no group {group!r}, so the daemon would not start")
    if loaded.engine.waveform.enabled:
        # Brings the engine along, which other configurations are checked without.
        from yieldmon.service.config import waveform_needs

        notes += waveform_needs.notes(loaded)
    problems = plausible.implausible(loaded)
    if loaded.parameters.scale_error > 0.0 and not problems:
        notes.append(_notes.not_calibrated(loaded.parameters.scale_error, loaded.parameters.carried_from))
    if loaded.engine.sweep.enabled and loaded.parameters.curve is None and (refused := sweep_refusal(loaded.parameters)):
        notes.append(f"no sweep runs by schedule: {refused}")
    if log is None:
        return None, notes, [InputError(*problem) for problem in problems]
    # These run the engine, which a check without a recording does not.
    from yieldmon.cli._log_progress import log_progress
    from yieldmon.service.logs import log_faults, mapping_check, quantities_seen
    from yieldmon.service.logs.bulk_processing import EndOfLog, Stretch

    with log_progress(2) as progress:

        def goes_on(part: Stretch | EndOfLog) -> None:
            if isinstance(part, EndOfLog) and part.doubled:
                notes.append(f"{log}: {part.doubled}")
            if progress is not None:
                progress(part)

        found, incomplete = quantities_seen.seen_in(loaded, log, goes_on)
        faults = log_faults.faults_on(loaded, log, progress)
    if incomplete:
        notes.append(f"{incomplete} incomplete messages of several frames are not used")
    problems += mapping_check.problems(loaded, found, log)
    notes += mapping_check.remarks(loaded, found) + faults
    return quantities_seen.documents(found), notes, [InputError(*problem) for problem in problems]


def _has_group(name: str) -> bool:
    """Whether this system has a group."""
    with suppress(KeyError):
        return bool(grp.getgrnam(name))
    return False


def _show(seen: dict[str, SeenDocument]) -> None:
    print(f"{'quantity':18} {'unit':>6} {'per s':>8} {'low':>10} {'high':>10} {'gap s':>8}  first values")
    absent = [name for name, entry in seen.items() if not entry["values"]]
    for name, entry in seen.items():
        if name in absent:
            continue
        numbers = (entry["rate_hz"], entry["low"], entry["high"], entry["largest_gap_s"])
        shown = ["-" if value is None else f"{value:.6g}" for value in numbers]
        first = " ".join(f"{value:.5g}" for value in entry["first"]) or "none"
        print(f"{name:18} {entry['unit']:>6} {shown[0]:>8} {shown[1]:>10} {shown[2]:>10} {shown[3]:>8}  {first}")
    if absent:
        print(f"not in this log: {', '.join(absent)}")

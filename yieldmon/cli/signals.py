"""List the signals on a bus or in a log, and propose a mapping to quantities."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from yieldmon.bus.bulk import FrameBlock, block_of
from yieldmon.bus.databases import MessageBits, load_messages
from yieldmon.bus.log_files.candump import ERROR_FLAG, REMOTE_FLAG
from yieldmon.bus.log_files.doubled_frames import DoubledFrames
from yieldmon.bus.log_files.loading import iter_blocks
from yieldmon.bus.log_files.log_notes import LogNotes
from yieldmon.bus.log_files.logs import require_log
from yieldmon.bus.opening import add_bus_arguments, open_bus_from
from yieldmon.bus.waiting import receive
from yieldmon.cli import _outputs
from yieldmon.cli._channels import SharedIdentifiers
from yieldmon.cli._json import print_json
from yieldmon.cli._limits import above_0
from yieldmon.documents.signals import CandidateDocument, MessageDocument, SurveyDocument
from yieldmon.errors import InputError
from yieldmon.files import whole_file
from yieldmon.finite import finite
from yieldmon.network.name import Name
from yieldmon.resources import shipped
from yieldmon.signals.candidates import Candidate, candidates_of
from yieldmon.signals.mapping_draft import TELLING, guesses, mapping_text
from yieldmon.signals.survey import MessageSeen, Survey
from yieldmon.units import counted

_SHIPPED = ("dbc/yieldmon.dbc", "dbc/j1939.dbc")
_BLOCK_S = 0.5


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "signals",
        help="list the signals on a bus or in a log, and propose a mapping",
        description=__doc__,
        epilog="example: yieldmon signals drive.log --dbc maker.dbc --write mapping.yaml",
    )
    parser.add_argument("log", nargs="?", metavar="LOG", help="log to read instead of a bus")
    parser.add_argument("--dbc", action="append", default=[], metavar="FILE", help="DBC that names messages; repeatable")
    parser.add_argument("--seconds", type=float, default=10.0, metavar="S", help="listening time on a bus (default: 10)")
    parser.add_argument("--write", metavar="FILE", help="write the proposed mapping (YAML)")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    _outputs.add_force(parser, "write")
    add_bus_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when there was a frame to look at."""
    above_0("--seconds", args.seconds)
    paths = _dbc_paths(args.dbc)
    survey, shared, channel = Survey(_databases(paths)), SharedIdentifiers(), getattr(args, "channel", None)
    for block in _log_blocks(args.log, channel, shared) if args.log else _bus_blocks(args):
        rows = np.flatnonzero((block.can_id & np.uint32(REMOTE_FLAG | ERROR_FLAG)) == 0)
        columns = (block.time_s[rows], block.can_id[rows], block.length[rows], block.payload[rows])
        survey.add(*columns, block.long_of(rows))
    if not survey.frames:
        of_channel = f" of channel {channel}" if args.log and channel else ""
        raise InputError(args.log or "the bus", f"no data frame{of_channel}", "a bus or log with traffic")
    if shared.problem is not None:
        if args.write is not None:
            raise InputError(args.log, f"{shared.problem}, which would make the rates wrong", "one channel: -c NAME")
        print(f"yieldmon: {args.log}: {shared.problem} and count together; select one with -c NAME", file=sys.stderr)
    if survey.incomplete:
        print(f"yieldmon: {survey.incomplete} incomplete messages of several frames are not used", file=sys.stderr)
    if args.write is not None:
        whole_file.write(args.write, mapping_text(survey, _as_written(paths, Path(args.write))), mode=whole_file.READABLE)
        print(f"written: {args.write}", file=sys.stderr)
    if args.json:
        print_json(_document(survey))
    else:
        _show(survey)
    return 0


def _dbc_paths(given: Sequence[str]) -> dict[str, str]:
    """The DBC files that were given and the shipped ones, by name; of two with one name each by its path."""
    names = Counter(Path(name).name for name in dict.fromkeys(given))
    paths = {Path(name).name if names[Path(name).name] == 1 else name: str(Path(name).absolute()) for name in given}
    return paths | {Path(name).name: str(shipped(name)) for name in _SHIPPED if Path(name).name not in paths}


def _databases(paths: Mapping[str, str]) -> dict[str, dict[str, MessageBits]]:
    """Their messages; those that contradict themselves are named and not used."""
    databases = {name: load_messages(path) for name, path in paths.items()}
    for name, messages in databases.items():
        if problems := [message.contradiction for message in messages.values() if message.contradiction]:
            more = f", and {len(problems) - 1} more like it" if len(problems) > 1 else ""
            print(f"yieldmon: {name}: message ignored: {problems[0]}{more}", file=sys.stderr)
    return databases


def _as_written(paths: dict[str, str], mapping: Path) -> dict[str, str]:
    """The DBC files as a mapping names them: those beside it and the shipped ones by their bare name."""
    beside = mapping.absolute().parent
    ours = set(map(str, map(shipped, _SHIPPED)))
    return {name: Path(path).name if Path(path).parent == beside or path in ours else path for name, path in paths.items()}


def _log_blocks(path: str, channel: str | None, shared: SharedIdentifiers) -> Iterator[FrameBlock]:
    """Of one channel, or of all."""
    require_log(path)
    notes, doubled = LogNotes(on_damage=lambda _damage: None), DoubledFrames()
    for block in doubled.blocks(iter_blocks(path, notes)):
        for name in block.channels_in_use():
            if channel in (None, name):
                own = block.of_channels([name])
                shared.take(name, np.unique(own.can_id).tolist())
        yield block if channel is None else block.of_channels([channel])
    if doubled.said:
        print(f"yieldmon: {path}: {doubled.said}", file=sys.stderr)
    for damage in notes.damages[:3]:
        print(f"yieldmon: {damage}", file=sys.stderr)
    if notes.damaged_places > 3:
        print(f"yieldmon: {path}: {counted(notes.damaged_places, 'damaged record')} skipped in all", file=sys.stderr)


def _bus_blocks(args: argparse.Namespace) -> Iterator[FrameBlock]:
    with open_bus_from(args) as bus:
        end_s = time.monotonic() + args.seconds
        while (left_s := end_s - time.monotonic()) > 0.0:
            messages = []
            until_s = time.monotonic() + min(_BLOCK_S, left_s)
            while (wait_s := until_s - time.monotonic()) > 0.0:
                message = receive(bus, wait_s)
                if message is not None:
                    messages.append(message)
            yield block_of(messages)


def _document(survey: Survey) -> SurveyDocument:
    candidates = candidates_of(survey)
    return {
        "messages": [_message(message) for message in survey.messages],
        "nodes": [
            {"address": address, "name": f"0x{int(name):016X}" if name is not None else None} for address, name in survey.nodes
        ],
        "candidates": {quantity: [_candidate(one) for one in found] for quantity, found in candidates.items()},
        "guesses": guesses(candidates),
    }


def _candidate(found: Candidate) -> CandidateDocument:
    return {
        "message": found.message,
        "signal": found.signal,
        "dbc": found.dbc,
        "rate_hz": round(found.rate_hz, 3),
        "mux": found.mux,
        "source": found.source,
    }


def _message(message: MessageSeen) -> MessageDocument:
    return {
        "id": f"0x{message.identifier:08X}" if message.extended else f"0x{message.identifier:03X}",
        "name": message.name,
        "pgn": message.group,
        "source": message.source,
        "rate_hz": round(message.rate_hz, 3) if message.rate_hz is not None else None,
        "frames": message.frames,
        "dbc": message.dbc,
        "signals": {
            name: {"low": finite(seen.low), "high": finite(seen.high), "last": finite(seen.last), "unit": seen.bits.unit}
            for name, seen in message.signals.items()
        },
    }


def _fields(name: Name) -> str:
    """What distinguishes a node, as `source` of a mapping takes it."""
    return "{" + ", ".join(f"{key}: {getattr(name, key)}" for key in TELLING) + "}"


def _show(survey: Survey) -> None:
    print(f"{'id':>10}  {'pgn':>6}  {'from':>4}  {'Hz':>7}  {'frames':>7}  name")
    for message in survey.messages:
        document = _message(message)
        rate = "-" if message.rate_hz is None else f"{message.rate_hz:.1f}"
        group = "" if message.group is None else str(message.group)
        source = "" if message.source is None else str(message.source)
        print(f"{document['id']:>10}  {group:>6}  {source:>4}  {rate:>7}  {message.frames:>7}  {message.name or ''}")
        for signal, seen in message.signals.items():
            if math.isfinite(seen.low):
                print(f"{'':44}{signal} {seen.low:g} to {seen.high:g} {seen.bits.unit}")
    for address, name in survey.nodes:
        print(f"node {address}: " + ("no NAME received" if name is None else f"NAME 0x{name}, {_fields(name)}"))
    candidates = candidates_of(survey)
    uncertain = guesses(candidates)
    for quantity, found in candidates.items():
        said = " (the first is a guess)" if quantity in uncertain else ""
        print(f"{quantity}{said}: " + ", ".join(f"{c.message}.{c.signal} ({c.rate_hz:.1f} Hz)" for c in found[:4]))
    if not candidates:
        print("no signal matches a quantity; give the manufacturer's DBC with --dbc")

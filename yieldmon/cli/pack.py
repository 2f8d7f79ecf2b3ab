"""Pack CAN logs into one Parquet file: smaller, many times faster to read, every classic frame unchanged."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

from yieldmon.bus.bulk import FrameBlock
from yieldmon.bus.codec import Codec
from yieldmon.bus.log_files.loading import iter_blocks, logs_in
from yieldmon.bus.log_files.log_notes import LogNotes
from yieldmon.bus.log_files.log_order import in_time_order
from yieldmon.bus.log_files.logs import PACKED_SUFFIX, require_log
from yieldmon.bus.packed.writing import pack_logs
from yieldmon.cli import _channels, _outputs
from yieldmon.cli._json import print_json
from yieldmon.documents.pack import PackDocument
from yieldmon.errors import InputError
from yieldmon.files.whole_file import scratch_for
from yieldmon.identifiers import CLASSIC_BYTES
from yieldmon.service.logs.log_copies import refuse_copies, refuse_named_twice
from yieldmon.units import counted


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """The verb's arguments."""
    parser = subparsers.add_parser(
        "pack",
        help="pack CAN logs into one Parquet file",
        description=__doc__,
        epilog="example: yieldmon pack monday-*.log.gz --out monday-frames.parquet",
    )
    parser.add_argument(
        "logs",
        nargs="+",
        metavar="LOG",
        help="any supported log; several logs form one record; where each begins is kept",
    )
    parser.add_argument("--out", required=True, metavar="FILE.parquet", help="file to write")
    _channels.add_channels(parser)
    parser.add_argument("--json", action="store_true", help="print a summary as one JSON document")
    _outputs.add_force(parser, "out")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 when every log was read to its end, damaged places aside."""
    out = Path(args.out)
    if out.suffix.lower() != PACKED_SUFFIX:
        raise InputError("--out", f"is {out}", f"a name that ends in {PACKED_SUFFIX}")
    for log in args.logs:
        require_log(log)
    refuse_named_twice(args.logs)
    refuse_copies(args.logs)
    notes = LogNotes()
    with scratch_for(out) as scratch:
        logs = _logs(in_time_order(args.logs), notes, args.channels)
        packed = pack_logs(logs, scratch, Codec().layouts, lambda: notes.dropped_by_recorder)
        if not packed.frames:
            found = f"no frame of channel {' or '.join(args.channels)}" if args.channels and notes.frames else "no frame at all"
            raise InputError(", ".join(args.logs), found, "a log with CAN frames")
    logs_bytes = sum(Path(log).stat().st_size for log in args.logs)
    document: PackDocument = {
        "file": str(out),
        "frames": packed.frames,
        "bytes": packed.size_bytes,
        "bytes_of_logs": logs_bytes,
        "damages": [str(damage) for damage in notes.damages],
    }
    if args.json:
        print_json(document)
    else:
        share = 100.0 * packed.size_bytes / logs_bytes
        print(
            f"{out}: {counted(packed.frames, 'frame')}, {packed.size_bytes} bytes, {share:.1f} % of the logs' size",
            file=sys.stderr,
        )
    return 0


def _logs(paths: list[str], notes: LogNotes, channels: list[str]) -> Iterator[Iterator[FrameBlock]]:
    for path in paths:
        for part in range(logs_in(path)):
            yield _blocks(path, notes, channels, part)


def _blocks(path: str, notes: LogNotes, channels: list[str], part: int) -> Iterator[FrameBlock]:
    for block in iter_blocks(path, notes, part=part):
        if (block.length > CLASSIC_BYTES).any():
            raise InputError(path, "holds CAN FD frames with more than 8 bytes of data", "classic CAN frames")
        yield block.of_channels(channels) if channels else block

"""Whole logs as arrays: candump logs by the fast parser, every other format message by message."""

from __future__ import annotations

import io
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import can
import numpy as np

from yieldmon.bus.bulk import FrameBlock, block_of
from yieldmon.bus.log_files.candump import ERROR_FLAG
from yieldmon.bus.log_files.fast_candump import ParsedLines, parse_lines
from yieldmon.bus.log_files.gunzip import early_end_of, open_bytes
from yieldmon.bus.log_files.log_notes import LogNotes, refuse_unreadable
from yieldmon.bus.log_files.log_times import TIMES_LOOKED_AT, refuse_times_between_frames
from yieldmon.bus.log_files.logs import PACKED_SUFFIX, log_format, read_log, reading_log, require_log
from yieldmon.bus.log_files.text_logs import (
    CANDUMP_SUFFIXES,
    LONGEST_LINE_BYTES,
    candump_frame,
    endless,
    is_candump,
    line_problem,
    read_stream,
    without_byte_order_mark,
)
from yieldmon.bus.packed.reading import Wanted, dropped_by_recorder, packed_logs, read_blocks

_CHUNK_BYTES = 4 * 1024 * 1024
_MESSAGES_PER_BLOCK = 100_000


def iter_blocks(
    path: Path | str,
    notes: LogNotes | None = None,
    *,
    chunk_bytes: int = _CHUNK_BYTES,
    compiled: bool | None = None,
    wanted: Wanted | None = None,
    part: int | None = None,
) -> Iterator[FrameBlock]:
    """The log in blocks of some 100,000 frames: the frames that logs.read_log() gives, in the same order.

    Damage is treated, reported and raised as there.

    Parameters
    ----------
    path : Path or str
        The log; its suffix names the format.
    notes : LogNotes, optional
        Counts and damages are added to it.
    chunk_bytes : int
        How much of a candump log is read at a time.
    compiled : bool, optional
        As for fast_candump.parse_lines().
    wanted : callable, optional
        Of identifiers with flags, shape (n,): frames of others may be left out of the blocks; they are counted all the same.
    part : int, optional
        Number from 0 of the one log that is read, of those in a file of packed logs (`logs_in`); by default all.

    Yields
    ------
    FrameBlock
    """
    path = Path(path)
    notes = notes if notes is not None else LogNotes()
    suffix = log_format(path)[0]
    if suffix == PACKED_SUFFIX:
        require_log(path)

        def count(can_id: int, frames: int) -> None:
            notes.count(frames)
            notes.error_frames += frames if can_id & ERROR_FLAG else 0

        yield from read_blocks(path, wanted, count, part)
        # The file has the sum of all logs.
        notes.dropped_by_recorder += dropped_by_recorder(path) if not part else 0
        return
    if suffix in CANDUMP_SUFFIXES:
        for block in _candump_blocks(path, notes, chunk_bytes, compiled):
            yield block if wanted is None else block.take(np.flatnonzero(wanted(block.can_id)))
        return
    yield from _blocks_of(read_log(path, notes))


def logs_in(path: Path | str) -> int:
    """How many logs a file holds: 1, but for packed logs. Raises InputError where that cannot be read."""
    if log_format(Path(path))[0] != PACKED_SUFFIX:
        return 1
    require_log(path)
    return packed_logs(path)


def _blocks_of(messages: Iterator[can.Message]) -> Iterator[FrameBlock]:
    while batch := list(islice(messages, _MESSAGES_PER_BLOCK)):
        yield block_of(batch)


def _candump_blocks(path: Path, notes: LogNotes, chunk_bytes: int, compiled: bool | None) -> Iterator[FrameBlock]:
    channels: list[str] = []
    line = 1
    with reading_log(path), open_bytes(path, log_format(path)[1]) as stream:
        if not is_candump(stream):
            yield from _blocks_of(_counted(read_stream(stream, path, CANDUMP_SUFFIXES[0], notes), notes))
            refuse_unreadable(notes)
            return
        try:
            for chunk in _whole_lines(stream, path, chunk_bytes):
                parsed = _parse(chunk, path, notes, channels, line, compiled)
                if line == 1:
                    refuse_times_between_frames(path, parsed.time_s[:TIMES_LOOKED_AT].tolist())
                line += parsed.lines
                columns = (parsed.time_s, parsed.can_id, parsed.length, parsed.payload, parsed.channel)
                yield FrameBlock(*columns, tuple(channels), parsed.long)
            early_end = early_end_of(stream)
        except _Endless as given_up:
            early_end = str(given_up)
    if early_end is not None:
        notes.damage(f"{path}:{line}", early_end)
    refuse_unreadable(notes)


def _counted(messages: Iterator[can.Message], notes: LogNotes) -> Iterator[can.Message]:
    for message in messages:
        notes.frame(message)
        yield message


class _Endless(Exception):
    """A line is given up."""


def _whole_lines(stream: io.BufferedReader, path: Path, chunk_bytes: int) -> Iterator[bytes]:
    """Chunks that end with a line's end, but for the last. A cut line at the early end of a stream is left out."""
    carried = without_byte_order_mark(stream.read(chunk_bytes), path)
    left_out = 0
    while piece := stream.read(chunk_bytes):
        end = carried.rfind(b"\n") + 1
        if end:
            yield carried[:end]
            left_out = 0
        rest = carried[end:]
        if len(rest) > 2 * LONGEST_LINE_BYTES:
            # Too long for a line already: its beginning is enough to say so.
            left_out += len(rest) - 2 * LONGEST_LINE_BYTES
            rest = rest[: 2 * LONGEST_LINE_BYTES]
            given_up = endless(left_out + len(rest))
            if given_up is not None:
                raise _Endless(given_up)
        carried = rest + piece
    if early_end_of(stream) is not None:
        carried = carried[: carried.rfind(b"\n") + 1]
    if carried:
        yield carried


def _parse(chunk: bytes, path: Path, notes: LogNotes, channels: list[str], first_line: int, compiled: bool | None) -> ParsedLines:
    def parse_slowly(index: int, raw: bytes) -> can.Message | None:
        def damage(problem: str) -> None:
            notes.damage(f"{path}:{first_line + index}", problem)

        problem = line_problem(raw)
        if problem is not None:
            damage(problem)
            return None
        return candump_frame(raw.decode("utf-8", errors="replace"), notes, damage)

    parsed = parse_lines(chunk, channels, parse_slowly, compiled=compiled)
    notes.count(len(parsed.time_s))
    notes.error_frames += int(np.count_nonzero(parsed.can_id & np.uint32(ERROR_FLAG)))
    return parsed

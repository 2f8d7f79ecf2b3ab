"""candump logs into arrays, millions of lines at a time.

Nearly all lines of a log look alike: same places of brackets, blanks and '#', only the digits differ. Lines of one
length are taken together as a matrix of bytes, checked against the shape of one of them and turned into numbers column
by column. Whatever does not fit a shape goes through candump.parse_line(), so that the result is that of the slow way.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from types import ModuleType

import can
import numpy as np
from numpy.typing import NDArray

from yieldmon.bus.interrupts import interrupts_held
from yieldmon.bus.log_files.candump import channel_name, flagged_id
from yieldmon.identifiers import CLASSIC_BYTES, EXTENDED_FLAG, LARGEST_EXTENDED_ID, LARGEST_STANDARD_ID

Bytes = NDArray[np.uint8]

#: A line of a common shape: classic data frame, up to 8 bytes, no dots, R or T or neither.
_COMMON = re.compile(
    rb"\((?P<seconds>\d{1,10})\.(?P<fraction>\d{6}|\d{9})\) (?P<channel>\S+) "
    rb"(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#(?P<data>(?:[0-9A-Fa-f]{2}){0,8})(?: [RTrt])?\r?"
)

#: Shapes tried on the lines of one length before the rest goes the slow way: channel names and directions in a log are
#: few.
_SHAPES_TRIED = 8

INVALID = 0xFF
"""In HEX: no hexadecimal digit."""

#: Loading the compiled pass takes about a second: smaller chunks are done before.
_COMPILED_FROM_BYTES = 2 * 1024 * 1024


def _hex_values() -> Bytes:
    values = np.full(256, INVALID, np.uint8)
    for digits in (b"0123456789abcdef", b"0123456789ABCDEF"):
        values[np.frombuffer(digits, np.uint8)] = np.arange(16)
    return values


HEX = _hex_values()
"""Value of each byte as a hexadecimal digit."""
MICROS_PER_S = 1e6
LARGEST_EXACT = 2**53
"""Whole numbers below it are doubles."""


@dataclass(frozen=True)
class ParsedLines:
    """Frames of a chunk of `lines` lines. Arrays of shape (n,) in the order of the lines, as in bulk.FrameBlock;
    `channel` indexes the list of names that parse_lines() was given and extends."""

    lines: int
    time_s: NDArray[np.float64]
    can_id: NDArray[np.uint32]
    length: NDArray[np.uint8]
    payload: NDArray[np.uint64]
    channel: NDArray[np.int32]
    long: dict[int, bytes] = field(default_factory=dict)


@dataclass(frozen=True)
class _Shape:
    """Where the parts of a line are, as column ranges, and the bytes that must be as they are."""

    seconds: slice
    fraction: slice
    can_id: slice
    data: slice
    fixed: NDArray[np.intp]
    fixed_bytes: Bytes
    channel: str

    @property
    def is_extended(self) -> bool:
        return bool(self.can_id.stop - self.can_id.start > 3)


def parse_lines(
    chunk: bytes,
    channels: list[str],
    parse_slowly: Callable[[int, bytes], can.Message | None],
    *,
    compiled: bool | None = None,
) -> ParsedLines:
    """Frames of whole lines (the last one may lack its line end).

    Parameters
    ----------
    chunk : bytes
        The lines.
    channels : list of str
        Channel names known so far; new ones are appended.
    parse_slowly : callable
        Asked with (index, line) for each line that has no common shape, in order; index counts lines from 0. Returns the
        frame, or None for a line without one (having reported it where it is damaged).
    compiled : bool, optional
        Whether to use the compiled pass; by default for large chunks where the fast extra is installed. The result is the
        same.

    Returns
    -------
    ParsedLines
    """
    buffer = np.frombuffer(chunk, np.uint8)
    starts, ends = _line_bounds(buffer)
    lines = len(starts)
    parsed = ParsedLines(
        lines,
        np.zeros(lines),
        np.zeros(lines, np.uint32),
        np.zeros(lines, np.uint8),
        np.zeros(lines, np.uint64),
        np.zeros(lines, np.int32),
    )
    module = _compiled_module() if compiled or (compiled is None and len(chunk) >= _COMPILED_FROM_BYTES) else None
    done = np.zeros(lines, bool) if module is None else _compiled_pass(module, chunk, buffer, starts, ends, channels, parsed)
    _parse_by_shape(chunk, buffer, starts, ends, channels, parsed, done)
    for index in np.flatnonzero(~done).tolist():
        message = parse_slowly(index, chunk[starts[index] : ends[index]])
        if message is not None:
            done[index] = True
            _fill_slowly(parsed, index, message, channels)
    return parsed if done.all() else _only(parsed, done)


def _line_bounds(buffer: Bytes) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First byte of each line, and the byte after its last, without the line end."""
    ends = np.flatnonzero(buffer == ord("\n"))
    starts = np.concatenate([[0], ends + 1])
    if len(buffer) == 0 or buffer[-1] == ord("\n"):
        return starts[:-1], ends
    return starts, np.append(ends, len(buffer))


def _parse_by_shape(
    chunk: bytes,
    buffer: Bytes,
    starts: NDArray[np.intp],
    ends: NDArray[np.intp],
    channels: list[str],
    parsed: ParsedLines,
    done: NDArray[np.bool_],
) -> None:
    """Parses lines of one width together, by the shapes of the first few; marks those that had one of them as done."""
    widths = ends - starts
    left = widths[~done]
    for width in np.flatnonzero(np.bincount(left)) if left.size else ():
        rows = np.flatnonzero((widths == width) & ~done)
        for _ in range(_SHAPES_TRIED):
            if len(rows) == 0:
                break
            shape = _shape_of(chunk[starts[rows[0]] : ends[rows[0]]])
            if shape is None:
                rows = rows[1:]
                continue
            fits = _fill(parsed, rows, _columns(buffer, starts[rows], int(width)), shape, channels)
            done[rows[fits]] = True
            rows = rows[~fits]


def _only(parsed: ParsedLines, kept: NDArray[np.bool_]) -> ParsedLines:
    """The frames of the lines that have one."""
    places = np.cumsum(kept) - 1
    return ParsedLines(
        parsed.lines,
        parsed.time_s[kept],
        parsed.can_id[kept],
        parsed.length[kept],
        parsed.payload[kept],
        parsed.channel[kept],
        {int(places[row]): data for row, data in parsed.long.items()},
    )


@cache
def _compiled_module() -> ModuleType | None:
    """compiled_candump, None where the fast extra is not installed."""
    try:
        with interrupts_held():
            from yieldmon.bus.log_files import compiled_candump
    except ImportError:
        return None
    return compiled_candump


def _compiled_pass(
    module: ModuleType,
    chunk: bytes,
    buffer: Bytes,
    starts: NDArray[np.intp],
    ends: NDArray[np.intp],
    channels: list[str],
    parsed: ParsedLines,
) -> NDArray[np.bool_]:
    """The lines that compiled code has parsed."""
    known = list(channels)
    if not known:
        shape = _shape_of(chunk[starts[0] : ends[0]]) if len(starts) else None
        if shape is None:
            return np.zeros(len(starts), bool)
        known = [shape.channel]
    into = (parsed.time_s, parsed.can_id, parsed.length, parsed.payload, parsed.channel)
    done: NDArray[np.bool_] = module.parse_common(buffer, starts, ends, known, into)
    if not channels and done.any():
        channels += known
    return done


def _shape_of(line: bytes) -> _Shape | None:
    match = _COMMON.fullmatch(line)
    if match is None:
        return None
    variable = np.zeros(len(line), bool)
    for name in ("seconds", "fraction", "id", "data"):
        variable[slice(*match.span(name))] = True
    fixed = np.flatnonzero(~variable)
    return _Shape(
        seconds=slice(*match.span("seconds")),
        fraction=slice(*match.span("fraction")),
        can_id=slice(*match.span("id")),
        data=slice(*match.span("data")),
        fixed=fixed,
        fixed_bytes=np.frombuffer(line, np.uint8)[fixed],
        channel=match["channel"].decode("utf-8", errors="replace"),
    )


def _columns(buffer: Bytes, starts: NDArray[np.intp], width: int) -> Bytes:
    """Lines of one width as a matrix (width, lines): what is done to a column is done to contiguous bytes."""
    return np.ascontiguousarray(np.lib.stride_tricks.sliding_window_view(buffer, width)[starts].T)


def _fill(parsed: ParsedLines, rows: NDArray[np.intp], columns: Bytes, shape: _Shape, channels: list[str]) -> NDArray[np.bool_]:
    """Writes the rows whose lines have the shape; says which those are."""
    time_s, fits = _times(columns, shape)
    for place, byte in zip(shape.fixed, shape.fixed_bytes, strict=True):
        fits &= columns[place] == byte
    nibbles = HEX[columns[shape.can_id]]
    can_id = np.zeros(len(rows), np.uint32)
    for nibble in nibbles:
        can_id = can_id << np.uint32(4) | nibble
    data = HEX[columns[shape.data]]
    fits &= can_id <= (LARGEST_EXTENDED_ID if shape.is_extended else LARGEST_STANDARD_ID)
    fits &= nibbles.max(axis=0) < INVALID
    fits &= data.max(axis=0, initial=0) < INVALID
    length = len(data) // 2
    payload = np.zeros((len(rows), 8), np.uint8)
    payload[:, :length] = (data[0::2] << 4 | data[1::2]).T
    into = rows[fits]
    parsed.time_s[into] = time_s[fits]
    parsed.can_id[into] = can_id[fits] | np.uint32(EXTENDED_FLAG if shape.is_extended else 0)
    parsed.length[into] = length
    parsed.payload[into] = payload.view("<u8")[fits, 0]
    parsed.channel[into] = _channel_index(shape.channel, channels)
    return fits


def _times(columns: Bytes, shape: _Shape) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Seconds as float() reads them, and the lines where they are digits throughout."""
    digits = np.concatenate([columns[shape.seconds], columns[shape.fraction]]) - ord("0")
    fits = np.asarray(digits.max(axis=0) <= 9)
    if shape.fraction.stop - shape.fraction.start == 6:
        # A quotient of two exact numbers is the double nearest to the decimal number, as float() finds it.
        powers = np.power(10.0, np.arange(len(digits) - 1, -1, -1))
        micros = np.asarray(powers @ digits.astype(np.float64), np.float64)
        return micros / MICROS_PER_S, np.asarray(fits & (micros < LARGEST_EXACT))
    text = columns[shape.seconds.start : shape.fraction.stop].T.copy()
    text[~fits] = ord("0")
    return text.view(f"S{text.shape[1]}")[:, 0].astype(np.float64), fits


def _fill_slowly(parsed: ParsedLines, row: int, message: can.Message, channels: list[str]) -> None:
    parsed.time_s[row] = message.timestamp
    parsed.can_id[row] = flagged_id(message)
    parsed.length[row] = message.dlc if message.is_remote_frame else len(message.data)
    parsed.payload[row] = int.from_bytes(message.data[:CLASSIC_BYTES], "little")
    parsed.channel[row] = _channel_index(channel_name(message), channels)
    if len(message.data) > CLASSIC_BYTES:
        parsed.long[row] = bytes(message.data)


def _channel_index(name: str, channels: list[str]) -> int:
    if name not in channels:
        channels.append(name)
    return channels.index(name)

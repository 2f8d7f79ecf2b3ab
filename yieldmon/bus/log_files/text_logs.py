"""Text logs line by line: candump and those of loggers by parsers of their own, python-can's .csv by python-can; damaged lines
are reported and skipped."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

import can

from yieldmon.bus.log_files.candump import dropped_frames, is_explanation, lacks_time, parse_line
from yieldmon.bus.log_files.frame_check import impossible, with_fd_by_length
from yieldmon.bus.log_files.gunzip import early_end_of, open_bytes
from yieldmon.bus.log_files.log_notes import LogNotes
from yieldmon.bus.log_files.log_times import TIMES_LOOKED_AT, not_backwards, refuse_times_between_frames
from yieldmon.bus.log_files.loggers import busmaster, canedge, canking, clx000, kvaser, savvycan, vehicle_spy
from yieldmon.bus.log_files.loggers.fields import Parser
from yieldmon.bus.log_files.loggers.peak import Trace
from yieldmon.bus.log_files.loggers.vector import Vector
from yieldmon.errors import InputError

#: Of candump's logs, and of loggers' that are told apart by their first line.
CANDUMP_SUFFIXES = (".log", ".txt")
#: By their ending.
TEXT_SUFFIXES = (".log", ".asc", ".csv", ".trc", ".txt")

#: Longest line that is looked at. The longest line of any text format, a CAN FD frame in .asc, has under 400
#: characters.
LONGEST_LINE_BYTES = 4096
#: Of a longer line the rest is passed over, up to so much, behind which nothing more is looked for.
LONGEST_SKIPPED_BYTES = 256 * 1024 * 1024
_LONGEST_START_BYTES = 64
_COMMENT = re.compile(r"#(?:\s|$)")
"""That people put into candump's logs."""
_UTF8_MARK = b"\xef\xbb\xbf"
_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")
#: Control characters that stand in no text log: all but tab, line feed and carriage return.
_CONTROL_BYTE = re.compile(rb"[\x00-\x08\x0b\x0c\x0e-\x1f]")

_NO_FRAME = (ValueError, LookupError, TypeError, AttributeError, ArithmeticError)
"""What python-can's readers raise for a line that is none."""
#: What stands for a header when python-can's reader goes on behind a damaged line: the line it may skip without loss.
_RESUME_LINE = "header"
_IDENTIFIER_COLUMN = "arbitration_id"
_PYTHON_CAN_COLUMNS = frozenset({"timestamp", _IDENTIFIER_COLUMN, "extended", "remote", "error", "dlc", "data"})
_COLUMN, _LEAST_COLUMNS, _LEAST_KNOWN = re.compile(r"[A-Za-z_]"), 2, 3
_UNPACKED = re.compile(r"values to unpack \(expected (\d+)")
"""How Python says that a line has more or fewer fields than its reader takes."""


def read_text(path: Path, suffix: str, compressed: bool, notes: LogNotes) -> Iterator[can.Message]:
    """The frames of a text log; `notes` takes in what is wrong with it. Raises InputError for UTF-16, OSError."""
    with open_bytes(path, compressed) as stream:
        yield from read_stream(stream, path, suffix, notes)


def read_stream(stream: io.BufferedReader, path: Path, suffix: str, notes: LogNotes) -> Iterator[can.Message]:
    """As read_text(), of a stream that stands at its beginning. path: for what is said of it."""
    lines = _Lines(stream, path, notes)
    match suffix:
        case ".log" | ".txt":
            parse = _parser_of(stream.peek(_LONGEST_START_BYTES), notes)
            if parse is None:
                return _read_candump(lines, notes)
            messages = _read_lines(lines, parse)
        case ".trc":
            messages = _read_trace(lines)
        case ".csv":
            messages = _read_csv(lines, notes)
        case _:
            messages = _read_lines(lines, Vector())
    return not_backwards(messages, path)


def is_candump(stream: io.BufferedReader) -> bool:
    """Whether a log of `CANDUMP_SUFFIXES` that stands at its beginning is to be read as candump's, not as a logger's."""
    return _parser_of(stream.peek(_LONGEST_START_BYTES), LogNotes()) is None


def begins_as_log(start: bytes) -> bool:
    """Whether the first kilobytes of a text file, decompressed, are those of a log of `CANDUMP_SUFFIXES`, and not of notes; also
    where it is one that is then refused, as without times or in UTF-16."""
    if start.startswith(_UTF16_MARKS):
        start = start.decode("utf-16", errors="replace").encode()
    if _parser_of(start, LogNotes()) is not None:
        return True
    lines = (line.strip() for line in start.removeprefix(_UTF8_MARK).decode(errors="replace").splitlines())
    return any(parse_line(line) is not None or lacks_time(line) for line in lines)


def _parser_of(start: bytes, notes: LogNotes) -> Parser | None:
    start = start.removeprefix(_UTF8_MARK)
    if busmaster.begins(start):
        return busmaster.Busmaster()
    if clx000.begins(start):
        return clx000.Clx000(notes.lost)
    return canking.parse if canking.begins(start) else None


class _Lines:
    """Line by line what a text reader of python-can may see; damaged bytes never reach it.

    Stands in for an open text file: iterable, with close(). `number` is the line handed out last, from 1.
    """

    def __init__(self, stream: io.BufferedReader, path: Path, notes: LogNotes) -> None:
        self.number = 0
        self.damaged = False
        self.resume_with: str | None = None
        self.path = path
        self._stream = stream
        self._notes = notes

    def __iter__(self) -> _Lines:
        return self

    def __next__(self) -> str:
        if self.resume_with is not None:
            line, self.resume_with = self.resume_with, None
            return line
        while True:
            raw = self._read_line()
            self.number += 1
            if self.number == 1:
                raw = without_byte_order_mark(raw, self.path)
            problem = line_problem(raw)
            given_up = self._skip_rest_of_long_line(raw)
            if given_up is not None:
                self.damage(given_up)
                raise StopIteration
            if problem is None:
                return raw.decode("utf-8", errors="replace").rstrip("\r\n")
            self.damage(problem)

    def close(self) -> None:
        """The stream belongs to whoever opened it."""

    def damage(self, problem: str) -> None:
        """Reports the line handed out last."""
        self.damaged = True
        self._notes.damage(f"{self.path}:{self.number}", problem)

    def _read_line(self) -> bytes:
        raw = self._stream.readline(LONGEST_LINE_BYTES + 2)
        if not raw.endswith(b"\n") and len(raw) <= LONGEST_LINE_BYTES:
            early_end = early_end_of(self._stream)
            if early_end is not None:
                # The line is cut; what is left of it may look like a frame.
                self.number += 1
                self.damage(early_end)
                raise StopIteration
        if not raw:
            raise StopIteration
        return raw

    def _skip_rest_of_long_line(self, raw: bytes) -> str | None:
        """Why it is given up, None where the line came to its end."""
        length = len(raw)
        if length > LONGEST_LINE_BYTES:
            while raw and not raw.endswith(b"\n"):
                given_up = endless(length)
                if given_up is not None:
                    return given_up
                try:
                    raw = self._read_line()
                except StopIteration:
                    break
                length += len(raw)
        return None


def without_byte_order_mark(start: bytes, path: Path) -> bytes:
    """The start of a text file without the mark that some editors put before UTF-8. Raises InputError for UTF-16."""
    if start.startswith(_UTF16_MARKS):
        raise InputError(str(path), "UTF-16 text", "UTF-8 or ASCII")
    return start.removeprefix(_UTF8_MARK)


def endless(line_bytes: int) -> str | None:
    """Why a line of which so much has come is given up, and the file with it; None while its end may be waited for."""
    if line_bytes <= LONGEST_SKIPPED_BYTES:
        return None
    return f"a line longer than {LONGEST_SKIPPED_BYTES / 1e6:.0f} MB; reading stopped"


def line_problem(raw: bytes) -> str | None:
    """Why a line, with or without its end, is not worth parsing in any text format; None when it is."""
    if len(raw.rstrip(b"\r\n")) > LONGEST_LINE_BYTES:
        return f"line longer than {LONGEST_LINE_BYTES} bytes"
    control = _CONTROL_BYTE.search(raw)
    return f"binary junk (byte 0x{control[0][0]:02X})" if control is not None else None


def candump_frame(line: str, notes: LogNotes, damage: Callable[[str], None]) -> can.Message | None:
    """The frame of a candump line; None for a blank line, a comment, what `candump -e` says of an error frame, a drop count
    (noted) and a damaged line (reported to `damage`)."""
    text = line.strip()
    message = parse_line(text)
    if message is None:
        dropped = dropped_frames(text)
        if dropped is not None:
            notes.dropped_by_recorder += dropped
        elif lacks_time(text):
            damage(f"{text[:60]!r} has no time; record with `candump -L`")
        elif text and not is_explanation(text) and not _COMMENT.match(text):
            damage(f"{text[:60]!r} is not a candump line")
    return message


def _read_candump(lines: _Lines, notes: LogNotes) -> Iterator[can.Message]:
    first_s: list[float] = []
    for line in lines:
        message = candump_frame(line, notes, lines.damage)
        if message is not None:
            if len(first_s) < TIMES_LOOKED_AT:
                first_s.append(message.timestamp)
                if len(first_s) == TIMES_LOOKED_AT:
                    refuse_times_between_frames(lines.path, first_s)
            yield message
    if len(first_s) < TIMES_LOOKED_AT:
        refuse_times_between_frames(lines.path, first_s)


def _read_csv(lines: _Lines, notes: LogNotes) -> Iterator[can.Message]:
    """By the first line; a file whose first line no logger writes is python-can's."""
    heading = next(lines, None)
    if heading is None:
        return
    try:
        of_kvaser = kvaser.parser(heading, notes.lost)
        parse = savvycan.parser(heading) or canedge.parser(heading) or of_kvaser or vehicle_spy.parser(heading)
    except ValueError as error:
        lines.damage(str(error))
        return
    if parse is not None:
        yield from _read_lines(lines, parse)
        return
    if _is_heading_of_others(heading):
        lines.damage(f"columns {heading[:60]!r} of another program")
        return
    yield from _frame_in_place_of(heading)
    lines.resume_with = heading
    yield from _read_with_python_can(lines)


def _frame_in_place_of(heading: str) -> list[can.Message]:
    """The frame that stands where python-can's .csv has its heading, as in a part of a log that was split; else empty."""
    with suppress(*_NO_FRAME):
        found = map(with_fd_by_length, can.CSVReader(io.StringIO(f"{_RESUME_LINE}\n{heading}\n")))
        return [message for message in found if impossible(message) is None]
    return []


def _is_heading_of_others(line: str) -> bool:
    """Whether a CSV's first line names columns that are not python-can's: what stands below may pass for its frames. A line that
    names none may be its damaged heading, or a frame of a log whose beginning is cut off."""
    names = [field.strip().strip('"') for field in line.split(",")]
    known = _PYTHON_CAN_COLUMNS.intersection(names)
    named = len(names) >= _LEAST_COLUMNS and all(_COLUMN.match(name) for name in names if name)
    others = len(names) != len(_PYTHON_CAN_COLUMNS) and _IDENTIFIER_COLUMN not in known
    return named and (len(known) < _LEAST_KNOWN or others)


def _read_trace(lines: _Lines) -> Iterator[can.Message]:
    trace = Trace()
    yield from _read_lines(lines, trace)
    if trace.incomplete and not lines.damaged:
        lines.damage(trace.incomplete)


def _read_lines(lines: _Lines, parse: Parser) -> Iterator[can.Message]:
    for line in lines:
        try:
            message = parse(line)
            problem = None if message is None else impossible(message)
        except ValueError as error:
            message, problem = None, str(error)
        if problem is not None:
            lines.damage(problem)
        elif message is not None:
            yield message


def _read_with_python_can(lines: _Lines) -> Iterator[can.Message]:
    """Of python-can's .csv."""
    reader = can.CSVReader(cast("Any", lines))
    reported = -1
    while True:
        try:
            for message in map(with_fd_by_length, reader):
                problem = impossible(message)
                if problem is None:
                    yield message
                else:
                    lines.damage(problem)
            return
        except _NO_FRAME as error:
            if lines.number == reported:
                # No line has come since: it is the end of the file that the reader cannot do with.
                return
            reported = lines.number
            counted = _UNPACKED.search(str(error))
            lines.damage(f"is not {counted[1]} fields, as a line of a .csv log is" if counted else f"not as .csv has it: {error}")
            lines.resume_with = _RESUME_LINE

"""Reading CAN logs: every format of python-can, each also gzipped, and what to do with the damaged ones.

Text formats (.log, .asc, .csv, .trc): a damaged line is reported with its number and skipped, the rest is read.
Binary formats (.blf, .db, .mf4) and gzip streams: what stands before the damage is read, the damage is reported with
its place, and reading stops there. A file in which nothing at all can be read raises InputError.
"""

from __future__ import annotations

import importlib
import io
import logging
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import can

from yieldmon.bounded import is_pipe, opened, require_file
from yieldmon.bus import mf4
from yieldmon.bus.blf_check import first_flaw
from yieldmon.bus.candump import dropped_frames, parse_line
from yieldmon.bus.gunzip import Gunzip
from yieldmon.bus.mf4_reading import Mf4Log
from yieldmon.bus.sqlite_log import SqliteLog
from yieldmon.errors import InputError, reading
from yieldmon.identifiers import LARGEST_EXTENDED_ID, LARGEST_STANDARD_ID

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

_log = logging.getLogger(__name__)

TEXT_SUFFIXES = (".log", ".asc", ".csv", ".trc")
BINARY_SUFFIXES = (".blf", ".db", ".mf4")
#: Frames that `yieldmon pack` wrote.
PACKED_SUFFIX = ".parquet"
#: What read_log() takes; each but the packed one may be followed by .gz.
SUFFIXES = (*TEXT_SUFFIXES, *BINARY_SUFFIXES, PACKED_SUFFIX)

#: Longest line that is looked at. The longest line of any text format, a CAN FD frame in .asc, has under 400
#: characters.
LONGEST_LINE_BYTES = 4096
#: Of a longer line the rest is passed over, up to so much, behind which nothing more is looked for.
LONGEST_SKIPPED_BYTES = 256 * 1024 * 1024
#: Control characters that stand in no text log: all but tab, line feed and carriage return.
_CONTROL_BYTE = re.compile(rb"[\x00-\x08\x0b\x0c\x0e-\x1f]")
#: A compressed log is unpacked up to this size, and to half of the room that there is.
LARGEST_UNPACKED_BYTES = 8 * 1024**3
_UNPACK_STEP_BYTES = 1024 * 1024

#: What stands for a header when a reader goes on behind a damaged line: the line it may skip without loss.
_RESUME_LINE = {".asc": "internal events logged", ".csv": "header", ".trc": ";"}
_UNPACKED = re.compile(r"values to unpack \(expected (\d+)")
"""How Python says that a line has more or fewer fields than its reader takes."""


@dataclass(frozen=True)
class Damage:
    """One place of a log that could not be read. where: ``FILE:LINE``, or ``FILE: byte N`` in a binary file."""

    where: str
    problem: str

    def __str__(self) -> str:
        return f"{self.where}: {self.problem}"


@dataclass
class LogNotes:
    """What reading a log met beside its frames; filled while the iterator runs.

    dropped_by_recorder: frames that candump says it lost itself. damages: the first of them; damaged_places counts all.
    """

    frames: int = 0
    error_frames: int = 0
    dropped_by_recorder: int = 0
    damaged_places: int = 0
    damages: list[Damage] = field(default_factory=list)
    on_damage: Callable[[Damage], None] | None = None

    _KEPT = 20

    def damage(self, where: str, problem: str) -> None:
        """Counts a damaged place and hands it to on_damage, or to the log while there are few.

        Those before the first frame wait for it: a file without any is no log, which its error says in one line.
        """
        damage = Damage(where, " ".join(problem.split())[:200])
        self.damaged_places += 1
        if len(self.damages) < self._KEPT:
            self.damages.append(damage)
        if self.frames:
            self._tell(damage)

    def count(self, frames: int) -> None:
        """Counts frames."""
        if frames and not self.frames:
            for damage in self.damages:
                self._tell(damage)
        self.frames += frames

    def lacks(self, log: Path | str) -> list[str]:
        """What the log lacks, a line each: damaged places, how many more there are, and frames that its recorder lost."""
        lines = [str(damage) for damage in self.damages]
        if more := self.damaged_places - len(self.damages):
            lines.append(f"{log}: {more} more damaged places")
        if self.dropped_by_recorder:
            lines.append(f"{log}: the recorder lost {self.dropped_by_recorder} frames")
        return lines

    def frame(self, message: can.Message) -> None:
        """Counts a frame."""
        self.error_frames += message.is_error_frame
        self.count(1)

    def _tell(self, damage: Damage) -> None:
        if self.on_damage is not None:
            self.on_damage(damage)
        elif self.damaged_places <= self._KEPT:
            _log.warning("%s", damage)


def read_log(path: Path | str, notes: LogNotes | None = None) -> Iterator[can.Message]:
    r"""A log's frames in the order of the file, error and remote frames included.

    Parameters
    ----------
    path : path
        By its suffix candump (.log), .asc, .csv, .trc, .blf, .db, .mf4, each also with .gz behind, or a file of `yieldmon pack`.
    notes : LogNotes, optional
        Filled on the way: frames, error frames, damaged places.

    Yields
    ------
    can.Message

    Raises
    ------
    InputError
        When iterated, for a file that is missing, of an unknown format, in UTF-16, or in which every single place is damaged.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     log = pathlib.Path(folder, "drive.log")
    ...     _ = log.write_text("(1790000000.000000) can0 18FF0117#803E00FFFFFFFFFF\n")
    ...     messages = list(api.read_log(log))
    >>> hex(messages[0].arbitration_id)
    '0x18ff0117'
    """
    path = Path(path)
    notes = notes if notes is not None else LogNotes()
    suffix, compressed = log_format(path)
    read = _read_text if suffix in TEXT_SUFFIXES else _read_packed if suffix == PACKED_SUFFIX else _read_binary
    with reading_log(path):
        for message in read(path, suffix, compressed, notes):
            notes.frame(message)
            yield message
    refuse_unreadable(notes)


@contextmanager
def reading_log(path: Path | str) -> Iterator[None]:
    """Raises InputError for a log that the system does not let be read, for a device, and for a pipe in the place of a binary
    log, which is read from several places."""
    with reading(path, "a readable CAN log"):
        require_file(path, "a CAN log", or_pipe=log_format(Path(path))[0] in TEXT_SUFFIXES)
        yield


def refuse_unreadable(notes: LogNotes) -> None:
    """Raises InputError when reading to the end found damage and no frame at all."""
    if notes.damages and not notes.frames:
        first = notes.damages[0]
        raise InputError(first.where, f"{first.problem}; no frame in the whole file", "a CAN log as its name says")


def require_log(path: Path | str) -> None:
    """Raises InputError unless there is a file with the name of a known format that can be opened."""
    log_format(Path(path))
    with reading_log(path):
        if not is_pipe(Path(path)):
            Path(path).open("rb").close()


def require_package(path: Path | str) -> None:
    """Raises ModuleNotFoundError where the package of an extra that reads the log is not installed; opens nothing."""
    suffixes = [suffix.lower() for suffix in Path(path).suffixes]
    if ".mf4" in suffixes:
        mf4.require()
    if suffixes[-1:] == [PACKED_SUFFIX]:
        importlib.import_module("pyarrow")


def log_format(path: Path) -> tuple[str, bool]:
    """Suffix of the log's format in lower case, and whether it is gzipped. Raises InputError for an unknown one."""
    suffixes = [suffix.lower() for suffix in path.suffixes]
    compressed = suffixes[-1:] == [".gz"]
    suffix = (suffixes[-2:-1] if compressed else suffixes[-1:]) or [""]
    if suffix[0] not in SUFFIXES or (compressed and suffix[0] == PACKED_SUFFIX):
        raise InputError(str(path), "unknown log format", f"one of {' '.join(SUFFIXES)}, each but the last also with .gz behind")
    return suffix[0], compressed


def open_bytes(path: Path, compressed: bool) -> io.BufferedReader:
    """The log's bytes, decompressed; early_end_of() says at their end whether they are all."""
    return io.BufferedReader(Gunzip(path)) if compressed else cast("io.BufferedReader", opened(path))


def early_end_of(stream: io.BufferedReader) -> str | None:
    """Why a stream of open_bytes() ended before its time, None where it did not."""
    return stream.raw.problem if isinstance(stream.raw, Gunzip) else None


class _Lines:
    """Line by line what a text reader of python-can may see; damaged bytes never reach it.

    Stands in for an open text file: iterable, with close(). `number` is the line handed out last, from 1.
    """

    def __init__(self, stream: io.BufferedReader, path: Path, notes: LogNotes) -> None:
        self.number = 0
        self.resume_with: str | None = None
        self._stream = stream
        self._path = path
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
                raw = without_byte_order_mark(raw, self._path)
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
        self._notes.damage(f"{self._path}:{self.number}", problem)

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
    if start.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError(str(path), "UTF-16 text", "UTF-8 or ASCII")
    return start.removeprefix(b"\xef\xbb\xbf")


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
    """The frame of a candump line; None for a blank line, a drop count (noted) and a damaged line (reported to
    `damage`)."""
    text = line.strip()
    message = parse_line(text)
    if message is None:
        dropped = dropped_frames(text)
        if dropped is not None:
            notes.dropped_by_recorder += dropped
        elif text:
            damage(f"{text[:60]!r} is not a candump line")
    return message


def _read_packed(path: Path, suffix: str, compressed: bool, notes: LogNotes) -> Iterator[can.Message]:
    from yieldmon.bus.bulk import messages_of
    from yieldmon.bus.packed import dropped_by_recorder, read_blocks

    for block in read_blocks(path):
        yield from messages_of(block)
    notes.dropped_by_recorder += dropped_by_recorder(path)


def _read_text(path: Path, suffix: str, compressed: bool, notes: LogNotes) -> Iterator[can.Message]:
    with open_bytes(path, compressed) as stream:
        lines = _Lines(stream, path, notes)
        yield from _read_candump(lines, notes) if suffix == ".log" else _read_with_python_can(lines, suffix)


def _read_candump(lines: _Lines, notes: LogNotes) -> Iterator[can.Message]:
    for line in lines:
        message = candump_frame(line, notes, lines.damage)
        if message is not None:
            yield message


def _read_with_python_can(lines: _Lines, suffix: str) -> Iterator[can.Message]:
    reader: can.io.generic.MessageReader = cast("Any", can.io.player.MESSAGE_READERS[suffix])(lines)
    reported = -1
    while True:
        try:
            for message in reader:
                problem = _impossible(message)
                if problem is None:
                    yield message
                else:
                    lines.damage(problem)
            return
        except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError) as error:
            if lines.number == reported:
                # No line has come since: it is the end of the file that the reader cannot do with.
                return
            reported = lines.number
            counted = _UNPACKED.search(str(error))
            lines.damage(
                f"is not {counted[1]} fields, as a line of a {suffix} log is" if counted else f"not as {suffix} has it: {error}"
            )
            lines.resume_with = _RESUME_LINE[suffix]


def _impossible(message: can.Message) -> str | None:
    if not 0 <= message.arbitration_id <= (LARGEST_EXTENDED_ID if message.is_extended_id else LARGEST_STANDARD_ID):
        return f"identifier 0x{message.arbitration_id:X}"
    limit = 64 if message.is_fd else 8
    if message.dlc > limit or len(message.data) > limit:
        return f"{max(message.dlc, len(message.data))} bytes of data"
    if not message.is_remote_frame and not message.is_error_frame and len(message.data) != message.dlc:
        return f"{len(message.data)} bytes of data where the length says {message.dlc}"
    return None


def _read_binary(path: Path, suffix: str, compressed: bool, notes: LogNotes) -> Iterator[can.Message]:
    if suffix == ".mf4":
        mf4.require()
    with ExitStack() as stack:
        plain = stack.enter_context(_decompressed(path, suffix, notes)) if compressed else path
        plain.stat()  # SQLite would make a missing file
        reader: Any = None
        flaw: tuple[int, str] | None = None
        count = 0
        try:
            flaw = first_flaw(plain) if suffix == ".blf" else None
            reader = _binary_reader(plain, suffix, flaw[0] if flaw is not None else None)
            stack.callback(reader.stop)
            for message in reader:
                count += 1
                impossible = _impossible(message)
                if impossible is None:
                    yield message
                else:
                    notes.damage(f"{path}: frame {count}", impossible)
            if flaw is not None:
                notes.damage(f"{path}: byte {flaw[0]}", f"{flaw[1]}; reading stopped")
        except OSError:
            raise
        except Exception as error:  # noqa: BLE001 - parsers of binary formats raise anything on damaged bytes
            stream = getattr(reader, "file", None)
            place = f"frame {count + 1}" if stream is None or stream.closed else f"byte {stream.tell()}"
            problem = str(error) if suffix in (".mf4", ".db") else f"{type(error).__name__} {error}"
            if flaw is not None:
                # The reader was shown what stands before the flaw, and may have missed the rest of a frame.
                place, problem = f"byte {flaw[0]}", flaw[1]
            notes.damage(f"{path}: {place}", f"{problem}; reading stopped")


def _binary_reader(path: Path, suffix: str, end: int | None) -> Any:
    """A reader of the file; of a .blf that has a flaw at byte `end`, of what stands before it."""
    if suffix == ".db":
        return SqliteLog(str(path))
    if suffix == ".mf4":
        return Mf4Log(path)
    reader = cast("Any", can.io.player.MESSAGE_READERS[suffix])
    return reader(str(path)) if end is None else reader(io.BufferedReader(_Head(path, end)))


class _Head(io.RawIOBase):
    """The first bytes of a file, for a reader that must not see the others."""

    def __init__(self, path: Path, size: int) -> None:
        super().__init__()
        self._file = path.open("rb")
        self._size = size

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        return self._file.seek(offset, whence)

    def readinto(self, target: WriteableBuffer) -> int:
        view = memoryview(target).cast("B")
        piece = self._file.read(min(len(view), max(0, self._size - self._file.tell())))
        view[: len(piece)] = piece
        return len(piece)

    def close(self) -> None:
        self._file.close()
        super().close()


@contextmanager
def _decompressed(path: Path, suffix: str, notes: LogNotes) -> Iterator[Path]:
    """A temporary file with the decompressed bytes: SQLite and MF4 readers want a file with a name."""
    with tempfile.TemporaryDirectory(prefix="yieldmon-") as folder:
        plain = Path(folder) / f"log{suffix}"
        with open_bytes(path, compressed=True) as packed, plain.open("wb") as out:
            early_end = _unpacked(packed, out, shutil.disk_usage(folder).free)
        if early_end is not None:
            notes.damage(str(path), early_end)
        yield plain


def _unpacked(packed: io.BufferedReader, out: io.BufferedWriter, free_bytes: int) -> str | None:
    """Copies the decompressed bytes, as many as there is room for; why they are not all, None where they are."""
    limit = min(LARGEST_UNPACKED_BYTES, free_bytes // 2)
    written = 0
    while piece := packed.read(_UNPACK_STEP_BYTES):
        written += len(piece)
        if written > limit:
            return f"unpacks to more than {limit} bytes"
        out.write(piece)
    return early_end_of(packed)

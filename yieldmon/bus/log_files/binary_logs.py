"""Binary logs: what stands before the first damage, whichever reader is made for them; gzipped ones are unpacked first."""

from __future__ import annotations

import errno
import io
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import can

from yieldmon.bus.log_files import capture, mf4
from yieldmon.bus.log_files.blf_check import first_flaw
from yieldmon.bus.log_files.blf_reading import Blf
from yieldmon.bus.log_files.frame_check import impossible
from yieldmon.bus.log_files.gunzip import early_end_of, open_bytes
from yieldmon.bus.log_files.log_notes import LogNotes
from yieldmon.bus.log_files.mf4_reading import Mf4Log
from yieldmon.bus.log_files.sqlite_log import SqliteLog
from yieldmon.errors import NO_ROOM, no_room_to_unpack

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

BINARY_SUFFIXES = (".blf", ".db", ".mf4", *capture.SUFFIXES)
#: A compressed log is unpacked up to this size, and to half of the room that there is.
LARGEST_UNPACKED_BYTES = 8 * 1024**3
_UNPACK_STEP_BYTES = 1024 * 1024


def read_binary(path: Path, suffix: str, compressed: bool, notes: LogNotes) -> Iterator[can.Message]:
    """The frames of a binary log; `notes` takes in where it is damaged. Raises OSError, and ModuleNotFoundError for MF4 without
    asammdf."""
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
                problem = impossible(message)
                if problem is None:
                    yield message
                else:
                    notes.damage(f"{path}: frame {count}", problem)
            if flaw is not None:
                notes.damage(f"{path}: byte {flaw[0]}", f"{flaw[1]}; reading stopped")
        except (OSError, MemoryError):
            raise
        except Exception as error:  # noqa: BLE001 - parsers of binary formats raise anything on damaged bytes
            stream = getattr(reader, "file", None)
            place = f"frame {count + 1}" if stream is None or stream.closed else f"byte {stream.tell()}"
            problem = str(error) if suffix in (".mf4", ".db", *capture.SUFFIXES) else f"{type(error).__name__} {error}"
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
    if suffix in capture.SUFFIXES:
        return capture.Capture(path)
    return Blf(str(path)) if end is None else Blf(io.BufferedReader(_Head(path, end)))


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
    """A temporary file with the decompressed bytes: SQLite and MF4 readers want a file with a name.

    Raises InputError where there is no room for it: that the medium is full is no damage of the log.
    """
    with tempfile.TemporaryDirectory(prefix="yieldmon-") as folder:
        plain = Path(folder) / f"log{suffix}"
        try:
            with open_bytes(path, compressed=True) as packed, plain.open("wb") as out:
                early_end = _unpacked(packed, out, shutil.disk_usage(folder).free)
        except OSError as error:
            if error.errno not in NO_ROOM:
                raise
            raise no_room_to_unpack(path, error) from error
        if early_end is not None:
            notes.damage(str(path), early_end)
        yield plain


def _unpacked(packed: io.BufferedReader, out: io.BufferedWriter, free_bytes: int) -> str | None:
    """Copies the decompressed bytes; why they are not all, None where they are. Raises OSError when half of the room is used."""
    written = 0
    while piece := packed.read(_UNPACK_STEP_BYTES):
        written += len(piece)
        if written > LARGEST_UNPACKED_BYTES:
            return f"unpacks to more than {LARGEST_UNPACKED_BYTES} bytes"
        if written > free_bytes // 2:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        out.write(piece)
    return early_end_of(packed)

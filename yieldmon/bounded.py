"""Reading that comes to an end, whatever a path leads to: a device, a pipe, a line of gigabytes."""

from __future__ import annotations

import os
import select
import stat
import time
from collections.abc import Iterator
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import BinaryIO, TextIO

from yieldmon.errors import InputError, reading, refuse_nul

LONGEST_LINE = 16 * 1024 * 1024
"""Characters of a line of a table. Lines of real tables have some hundred."""
TIMEOUT_S = 5.0
"""For a pipe or a terminal that gives nothing: a reload waits for it."""
_PIPE_TIMEOUT_S = 60.0
"""For a table or DBC that a command is handed through a pipe."""
_STEP_BYTES = 1024 * 1024
_KINDS = {
    stat.S_IFREG: "a file",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
}


def require_file(path: str | Path, expected: str, *, or_pipe: bool = False) -> None:
    """For what is read several times, or at any length: neither can be done with a device, a pipe or a socket.

    Parameters
    ----------
    path : str or Path
    expected : str
        What should be there, without "that is a file".
    or_pipe : bool
        A pipe will do.

    Raises
    ------
    InputError
        For a device, a socket and, unless it will do, a pipe; a folder is left to the one who opens it.
    OSError
        For a path that leads nowhere.
    """
    kind = _KINDS.get(stat.S_IFMT(os.stat(str(path)).st_mode), "a folder")
    if kind not in ("a file", "a folder") and not (or_pipe and kind == "a pipe"):
        raise InputError(str(path), f"is {kind}", f"{expected} that is a file{' or a pipe' if or_pipe else ''}")


def is_pipe(path: Path) -> bool:
    """Whether a path leads to a pipe, of which an opening and a closing may end the writer."""
    return stat.S_ISFIFO(os.stat(path).st_mode)


def opened(path: Path) -> BinaryIO:
    """A file, or a pipe that has begun to give something, open for reading bytes.

    Parameters
    ----------
    path : Path

    Returns
    -------
    BinaryIO

    Raises
    ------
    OSError
        As the system has it.
    InputError
        A pipe gives nothing within `TIMEOUT_S`.
    """
    if not is_pipe(path):
        return path.open("rb")
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    waiting = select.poll()
    waiting.register(descriptor, select.POLLIN)
    if not waiting.poll(1000.0 * TIMEOUT_S):
        os.close(descriptor)
        raise InputError(str(path), f"is a pipe that gives nothing within {TIMEOUT_S:.0f} s", "a file, or a pipe with a writer")
    os.set_blocking(descriptor, True)
    return os.fdopen(descriptor, "rb")


def why_no_file(path: str | Path) -> str:
    """What is wrong with a path that is not a file's: nothing is there, or something else.

    >>> why_no_file("/no/such"), why_no_file("/dev/null")
    ('no such file', 'is a device')
    """
    try:
        return f"is {_KINDS.get(stat.S_IFMT(os.stat(str(path)).st_mode), 'a folder')}"
    except OSError:
        return "no such file"


def content(path: str, most_bytes: int, timeout_s: float) -> bytes:
    """A file's first bytes, or a pipe's.

    Parameters
    ----------
    path : str
    most_bytes : int
        Whatever follows is left unread.
    timeout_s : float
        For a pipe or a terminal to come to an end.

    Raises
    ------
    OSError
        As the system has it.
    InputError
        A pipe or a terminal did not come to an end, or the path holds a NUL character.
    """
    refuse_nul(path)
    end_s = time.monotonic() + timeout_s
    # A pipe without a writer is empty; opening it the usual way would wait for ever, and so would reading a terminal.
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        found = bytearray()
        waiting = select.poll()
        waiting.register(descriptor, select.POLLIN)
        while len(found) < most_bytes:
            with suppress(BlockingIOError):
                piece = os.read(descriptor, min(most_bytes - len(found), _STEP_BYTES))
                if not piece:
                    break
                found += piece
                continue
            left_s = end_s - time.monotonic()
            if left_s <= 0.0:
                raise InputError(path, f"does not end within {timeout_s:.0f} s", "a file")
            waiting.poll(1000.0 * left_s)
        return bytes(found)
    finally:
        os.close(descriptor)


def read_whole(path: str | Path, expected: str, most_bytes: int) -> bytes:
    """A file's content, or a pipe's: a device or a pipe may have no end.

    Parameters
    ----------
    path : str or Path
    expected : str
        What should be there, for the error.
    most_bytes : int

    Returns
    -------
    bytes

    Raises
    ------
    InputError
        It cannot be read, is longer, or is a pipe that does not end within a minute.
    """
    with reading(path, expected):
        found = content(str(path), most_bytes + 1, _PIPE_TIMEOUT_S)
    if len(found) > most_bytes:
        raise InputError(str(path), f"is longer than {most_bytes / 1e6:.0f} MB", expected)
    return found


def lines(stream: TextIO, where: str, expected: str) -> Iterator[str]:
    """The lines of a text stream, with their ends.

    Parameters
    ----------
    stream : TextIO
    where : str
        The stream's name, for the error.
    expected : str
        What should be there, for the error.

    Yields
    ------
    str

    Raises
    ------
    InputError
        Names the line that is longer than `LONGEST_LINE`.
    """
    for number in count(1):
        line = stream.readline(LONGEST_LINE + 1)
        if len(line) > LONGEST_LINE:
            raise _too_long(where, number, expected)
        if not line:
            return
        yield line


def split(text: str, where: str, expected: str) -> list[str]:
    """The lines of a text, without their ends.

    Parameters
    ----------
    text, where, expected : str
        As in `lines`.

    Returns
    -------
    list of str

    Raises
    ------
    InputError
        As `lines`.
    """
    found = text.splitlines()
    for number, line in enumerate(found, 1):
        if len(line) > LONGEST_LINE:
            raise _too_long(where, number, expected)
    return found


def _too_long(where: str, number: int, expected: str) -> InputError:
    return InputError(f"{where}: line {number}", f"has more than {LONGEST_LINE} characters", expected)

"""Scratch folders of files that are being written, and those that a program which was killed left behind.

Whoever writes holds a lock on the folder until it ends, however it ends. A folder without a lock is nobody's any more. Where the
file system has no such locks nothing is removed.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

#: Characters of a file's name that others made of it have as well: names have an end.
STEM = 100
_MARK = ".unfinished-"
_YOUNG_S = 60.0
"""Between a folder and its lock there is a moment."""


def make_folder(target: Path) -> Path:
    """A new folder of our own beside a file to write, with an unpredictable name and for this user alone."""
    return Path(tempfile.mkdtemp(prefix=_prefix(target), dir=target.parent))


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Around the writing in a folder of `make_folder`."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(descriptor)


def remove_abandoned(target: Path, names: Collection[str] = ()) -> None:
    """Removes the folders of `make_folder` for a file in which nobody writes any more, and nothing else is.

    Parameters
    ----------
    target : Path
        The file, links followed.
    names : collection of str
        Of the files in such a folder; empty: the target's.
    """
    prefix = _prefix(target)
    try:
        with os.scandir(target.parent) as entries:
            folders = [Path(entry.path) for entry in entries if entry.name.startswith(prefix)]
    except OSError:
        # What is wrong with the folder is said where the file is written.
        return
    for folder in folders:
        with suppress(OSError):
            _remove(folder, frozenset(names or (target.name,)))


def _prefix(target: Path) -> str:
    return f".{target.stem[:STEM]}{_MARK}"


def _remove(folder: Path, names: frozenset[str]) -> None:
    """Raises OSError where it is held, is no folder, or has just gone."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        state = os.fstat(descriptor)
        if state.st_uid != os.geteuid() or time.time() - state.st_mtime < _YOUNG_S or set(os.listdir(descriptor)) - names:
            return
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        shutil.rmtree(folder)
    finally:
        os.close(descriptor)

"""A file that appears under its name when it is whole: readers see the old one or the new one, never a half."""

from __future__ import annotations

import errno
import os
import shutil
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from itertools import count
from pathlib import Path

from yieldmon.errors import NO_ROOM, InputError, brief
from yieldmon.files.unfinished import STEM, held, make_folder, remove_abandoned

READABLE = 0o644
"""The mode of a file that the service reads as a user of its own, whatever the umask of whoever writes it."""
_SMALL_BYTES = 1_000_000
"""A medium with less room than this is full: a library may have given back what it could not complete."""


_free_names: ContextVar[frozenset[Path]] = ContextVar("free_names", default=frozenset())
"""Outputs of the command under way under whose name there was nothing when it began."""


@contextmanager
def noting_free_names(outputs: Iterable[str | Path]) -> Iterator[None]:
    """Notes which outputs of a command are not there yet: until the end, what another program makes under their names is not
    replaced."""
    before = _free_names.set(frozenset(path for path in map(real_path, outputs) if not os.path.lexists(path)))
    try:
        yield
    finally:
        _free_names.reset(before)


def real_path(path: str | Path) -> Path:
    """Where a path leads, links followed; links that lead in a circle are left as they are."""
    return Path(os.path.realpath(path))


def check_place(path: str | Path) -> None:
    """To be asked before the work: raises InputError for a folder, or a name in a folder that does not exist."""
    target = real_path(path)
    if target.is_symlink():
        raise InputError(str(path), "is a link that leads back to itself", "the name of a file to write")
    if target.is_dir():
        raise InputError(str(path), "is a folder", "the name of a file to write")
    if not target.parent.is_dir():
        raise InputError(str(path), f"there is no folder {target.parent}", "a file in a folder that exists")


def readable_folder(path: str | Path) -> None:
    """A folder that is made where it is missing, with those above it, for everybody to enter, whatever the umask."""
    folder = Path(path)
    if not folder.is_dir():
        readable_folder(folder.parent)
        folder.mkdir(exist_ok=True)
        folder.chmod(0o755)


def write(path: str | Path, content: str | bytes, *, durable: bool = False, mode: int | None = None) -> None:
    """A whole file of its own, as `scratch_for`; a text in UTF-8."""
    with scratch_for(path, durable=durable, mode=mode) as scratch:
        scratch.write_bytes(content.encode() if isinstance(content, str) else content)


@contextmanager
def scratch_for(path: str | Path, *, durable: bool = False, mode: int | None = None) -> Iterator[Path]:
    """A path to write to, in a folder beside `path`; it takes that name at the end, and goes when something fails.

    A link is followed. What is there and is no file (a pipe, /dev/stdout) is written to as it is. durable: on the medium
    before it takes the name. mode: of the file; None: that of the file it replaces, or of a plain new one. Raises InputError as
    `check_place`, and where another program made the file meanwhile (see `noting_free_names`); an OSError names `path`.
    """
    check_place(path)
    in_place = Path(path).exists() and not Path(path).is_file()
    # What /dev/stdout leads to has no path of its own where it is a pipe.
    target = Path(path) if in_place else real_path(path)
    folder = None if in_place else _private_folder(target, path)
    scratch = target if folder is None else folder / target.name
    try:
        with nullcontext() if folder is None else held(folder):
            yield scratch
            if not in_place:
                if mode is not None:
                    scratch.chmod(mode)
                elif target.exists() and scratch.is_file():
                    scratch.chmod(stat.S_IMODE(target.stat().st_mode))
                if durable:
                    sync(scratch)
                _refuse_another_programs(scratch, target, path)
                scratch.replace(target)
    except OSError as error:
        # A file opened through its Path is named by that.
        if str(error.filename) == str(scratch) or (error.filename is None and error.errno in NO_ROOM):
            error.filename = str(path)
        raise
    finally:
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def scratch_folder_for(folder: Path, names: Iterable[str], *, mode: int | None = None) -> Iterator[Path]:
    """A folder to write several files to, inside one that exists; they take their names in that one at the end, and none does
    when something fails. names: those that may be written, in the order in which they take them. mode: as in `scratch_for`. An
    OSError names the file in `folder`."""
    names = list(names)
    first = folder / min(names)
    remove_abandoned(first, names)
    scratch = _private_folder(first, folder)
    try:
        with held(scratch):
            yield scratch
            for path in sorted(scratch.iterdir(), key=lambda path: names.index(path.name)):
                target = real_path(folder / path.name)
                check_place(target)
                if mode is not None:
                    path.chmod(mode)
                elif target.exists():
                    path.chmod(stat.S_IMODE(target.stat().st_mode))
                path.replace(target)
    except OSError as error:
        if error.filename is None and error.errno in NO_ROOM:
            error.filename = str(folder)
        elif error.filename is not None and Path(str(error.filename)).parent == scratch:
            error.filename = str(folder / Path(str(error.filename)).name)
        raise
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


@contextmanager
def library_failures(path: str | Path, *kinds: type[Exception]) -> Iterator[None]:
    """What a library reports with errors of its own while it writes a file, as an OSError that names the file.

    Such an error does not give the system's number: where the medium has less than `_SMALL_BYTES` left it is ENOSPC.
    """
    try:
        yield
    except kinds as error:
        full = shutil.disk_usage(Path(path).parent).free < _SMALL_BYTES
        number = errno.ENOSPC if full else errno.EIO
        broken = f"could not be written ({brief(error)}); expected a medium with room that takes writing"
        what = os.strerror(number) if full else broken
        raise OSError(number, what, str(path)) from error


def _refuse_another_programs(scratch: Path, target: Path, path: str | Path) -> None:
    """Keeps what was written under a name of its own, and raises InputError, where the name was free and is taken now."""
    if target not in _free_names.get():
        return
    _free_names.set(_free_names.get() - {target})
    if not os.path.lexists(target):
        return
    numbers = (target.with_name(f"{target.stem[:STEM]}-{number}{target.suffix}") for number in count(2))
    aside = next(name for name in numbers if not os.path.lexists(name))
    scratch.replace(aside)
    raise InputError(str(path), f"another program made it meanwhile; what was to be written is {aside.name}", "one at a time")


def _private_folder(target: Path, path: str | Path) -> Path:
    """A new folder of our own beside `target`, with an unpredictable name and for this user alone."""
    try:
        return make_folder(target)
    except OSError as error:
        error.filename = str(path)
        raise


def sync(path: Path) -> None:
    """Puts a file or a folder's entries on the medium."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)

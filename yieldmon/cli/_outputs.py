"""Files that a verb writes: never over another file unasked, never over what it reads."""

from __future__ import annotations

import argparse
import errno
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from yieldmon.errors import InputError, remedy, this_user
from yieldmon.files import unfinished, whole_file


def add_force(parser: argparse.ArgumentParser, *names: str, or_standard_output: bool = False) -> None:
    """--force, and which of the parser's arguments (by their names in the namespace) name files that the verb writes.

    or_standard_output: "-" is that; else it is refused.
    """
    parser.add_argument("--force", action="store_true", help="replace existing files")
    parser.set_defaults(output_arguments=names, dash_is_standard_output=or_standard_output)


@contextmanager
def checked(args: argparse.Namespace) -> Iterator[None]:
    """Around the work: raises InputError for an output that is an input, exists, has no folder, or may not be written.

    What another program makes under an output's name during the work is not replaced. What a command that was killed left of its
    own unfinished output goes.
    """
    values = [getattr(args, name) for name in getattr(args, "output_arguments", ())]
    with whole_file.noting_free_names(value for value in values if isinstance(value, str | Path) and str(value) != "-"):
        check(args)
        for value in values:
            if isinstance(value, str | Path) and str(value) != "-":
                unfinished.remove_abandoned(whole_file.real_path(value))
        yield


def check(args: argparse.Namespace) -> None:
    """Raises InputError for an output that is an input, exists, has no folder, or may not be written, and for "-" where that is
    not standard output."""
    names: tuple[str, ...] = getattr(args, "output_arguments", ())
    inputs = {whole_file.real_path(path) for key, value in vars(args).items() if key not in names for path in _files(value)}
    written: dict[Path, str] = {}
    for name in names:
        value, option = getattr(args, name), f"--{name.replace('_', '-')}"
        if value == "-" and not args.dash_is_standard_output:
            raise InputError(option, "is -", "a file's name; /dev/stdout is standard output, ./- a file of that name")
        if isinstance(value, str | Path) and str(value) != "-":
            path = Path(value)
            refuse(path, option, force=args.force, inputs=inputs)
            # Standard output and the like take what several write.
            other = written.setdefault(whole_file.real_path(path), option)
            if other != option and (path.is_file() or not path.exists()):
                raise InputError(f"{option} {value}", f"is also the file of {other}", "another name")


def check_folder(folder: Path, names: Iterable[str], option: str, *, force: bool, inputs: Iterable[str | Path] = ()) -> None:
    """As `checked`, for files of these names in a folder, which need not be there."""
    require_writable_folder(folder, option)
    read = {whole_file.real_path(path) for path in inputs}
    written = [folder / name for name in names] if folder.is_dir() else []
    for path in written:
        refuse(path, option, force=force, inputs=read)
    for path in written:
        unfinished.remove_abandoned(whole_file.real_path(path))


def refuse(path: Path, option: str, *, force: bool, inputs: set[Path] = frozenset()) -> None:  # type: ignore[assignment]
    """Raises InputError for a file that is one of the inputs, that exists already and is not to be replaced, or whose folder this
    user may not write in."""
    if path.is_dir():
        return
    if whole_file.real_path(path) in inputs:
        raise InputError(f"{option} {path}", "is also an input file", "another name")
    whole_file.check_place(path)
    if path.is_file() and not force:
        raise InputError(f"{option} {path}", "exists already", "another name, or --force to replace it")
    require_writable(path, option)


def require_writable(path: Path, option: str) -> None:
    """Raises InputError for a file that is not there yet, or not writable itself, in a folder that this user may not write in."""
    taken = path.exists() and (not path.is_file() or os.access(path, os.W_OK, effective_ids=True))
    folder = whole_file.real_path(path).parent
    if not taken and folder.is_dir():
        _require_rights(folder, f"{option} {path}")


def require_writable_folder(folder: Path, option: str) -> None:
    """Raises InputError for a folder in which this user may not write, or which this user may not make."""
    there = whole_file.real_path(folder)
    while not there.exists():
        there = there.parent
    if there.is_dir():
        _require_rights(there, f"{option} {folder}")


def _require_rights(folder: Path, where: str) -> None:
    if os.statvfs(folder).f_flag & os.ST_RDONLY:
        read_only = OSError(errno.EROFS, os.strerror(errno.EROFS))
        raise InputError(where, f"the folder {folder} is on a read-only file system", remedy(read_only))
    if not os.access(folder, os.W_OK | os.X_OK, effective_ids=True):
        expected = "another folder, sudo, or rights to this one (`ls -ld` shows its owner and mode)"
        raise InputError(where, f"{this_user()} may not write in the folder {folder}", expected)


def _files(value: object) -> Iterator[Path]:
    for text in value if isinstance(value, list) else [value]:
        if isinstance(text, str) and text and len(text) < 4096 and "\0" not in text:
            path = Path(text)
            try:
                if path.is_file():
                    yield path
            except OSError:
                continue

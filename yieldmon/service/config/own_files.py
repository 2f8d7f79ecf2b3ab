"""Files that a configuration has the service write: each has to be another one than those that are read, or written as well."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from yieldmon.service.answering import answer_or
from yieldmon.service.storage.store_names import names_beside

_NO_FILE = ("", ".", "..")


def no_files(names: Mapping[str, str | None]) -> list[tuple[str, str, str]]:
    """Key, problem and what was expected for each name that is no file's. names: by key, as the configuration has them; None: no
    file is asked for."""
    found = []
    for key, name in names.items():
        if name is not None and name.rpartition("/")[2] in _NO_FILE:
            found.append((key, f"'{name}'", "the name of a file"))
        elif name is not None and name.startswith("~"):
            found.append((key, f"'{name}'", "a path without ~, which only a shell replaces by a home folder"))
    return found


def file_conflicts(store: Path, socket: Path, prometheus: Path | None, read: Iterable[Path]) -> list[tuple[str, str, str]]:
    """Key, problem and what was expected for each of the service's own files that is no file, or another one of these.

    Parameters
    ----------
    store, socket, prometheus : Path
        What the service writes, absolute.
    read : iterable of Path
        What it reads: the configuration and the files that it names.

    Returns
    -------
    list of (str, str, str)

    Notes
    -----
    Where the disk of one of them does not answer, paths are compared as they are spelt: a start must not wait for it.
    """
    read, stores = tuple(read), (store, *names_beside(store))
    written: Mapping[str, Path | None] = {"status.socket": socket, "status.prometheus_file": prometheus}
    place = _places([*read, *stores, *(path for path in written.values() if path is not None)])
    taken: dict[str, str] = {place[path]: "read for the configuration" for path in read}
    taken |= {place[path]: "the store, or one beside it" for path in stores}
    problems = []
    for key, path in written.items():
        if path is None:
            continue
        if place[path] in taken:
            problems.append((key, f"{path} is {taken[place[path]]}", "a file of its own"))
        taken.setdefault(place[path], key)
    return problems


def _places(paths: Sequence[Path]) -> Mapping[Path, str]:
    """Where each leads to, by whichever links; for all as they are spelt where a disk does not answer in time."""
    return answer_or(
        lambda: {path: os.path.realpath(path) for path in paths}, lambda: {path: os.path.abspath(path) for path in paths}
    )

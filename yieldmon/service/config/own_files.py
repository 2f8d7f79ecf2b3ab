"""Files that a configuration has the service write: each has to be another one than those that are read, or written as well."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from yieldmon.service.answering import answer_or
from yieldmon.service.storage.store_names import names_beside

#: What is said of a key that names no file at all.
_NAME = "the name of a file"


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
    if not store.name:
        return [("store.path", f"'{store}'", _NAME)]
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

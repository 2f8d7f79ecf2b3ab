"""Files that a configuration has the service write: each has to be another one than those that are read, or written as well."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path

from yieldmon.service.store_file import names_beside

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
    """
    if not store.name:
        return [("store.path", f"'{store}'", _NAME)]
    taken: dict[str, str] = {_place(path): "read for the configuration" for path in read}
    taken |= {_place(path): "the store, or one beside it" for path in (store, *names_beside(store))}
    written: Mapping[str, Path | None] = {"status.socket": socket, "status.prometheus_file": prometheus}
    problems = []
    for key, path in written.items():
        if path is None:
            continue
        if _place(path) in taken:
            problems.append((key, f"{path} is {taken[_place(path)]}", "a file of its own"))
        taken.setdefault(_place(path), key)
    return problems


def _place(path: Path) -> str:
    """Where a path leads to, by whichever links."""
    return os.path.realpath(path)

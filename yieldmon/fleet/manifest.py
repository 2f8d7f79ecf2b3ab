"""What a fleet run is to work off, from a manifest or a folder tree.

A manifest is a table (CSV) with the columns machine, day and log, a row for each log, and if wanted config, tickets and crop,
which are the same in all rows of a partition. Names of files are relative to the manifest. A tree: see `tree`.
"""

from __future__ import annotations

import os
import stat
from dataclasses import replace
from pathlib import Path

from yieldmon.errors import InputError
from yieldmon.files import delimited
from yieldmon.files.crops import misspelt
from yieldmon.fleet.filesystem import filesystem_of, is_remote
from yieldmon.fleet.partition import Manifest, Partition, checked_name
from yieldmon.fleet.tree import of_tree

_REQUIRED = ("machine", "day", "log")
_OPTIONAL = ("config", "tickets", "crop")


def load(source: str) -> Manifest:
    """The partitions of a manifest or a tree.

    Parameters
    ----------
    source : str
        A CSV file, or a folder; path or fsspec address.

    Returns
    -------
    Manifest

    Raises
    ------
    InputError
        Nothing is there; a name that cannot be one of a partition; a row or folder that makes no sense.
    """
    files, root = filesystem_of(source)
    if files.isdir(root):
        return of_tree(files, root, source)
    if not files.exists(root):
        raise InputError(source, "no such file or folder", "a manifest (CSV: machine, day, log), or a folder MACHINE/DAY/LOGS")
    if is_remote(source):
        raise InputError(source, "is a remote file", "a manifest on this machine, or a remote folder MACHINE/DAY/LOGS")
    return _of_table(source)


def _of_table(source: str) -> Manifest:
    table = delimited.read(source)
    _check_header(table, source)
    logs: dict[tuple[str, str], list[str]] = {}
    others: dict[tuple[str, str], tuple[str, ...]] = {}
    seen: set[str] = set()
    refused: list[InputError] = []
    known: dict[str, dict[str, str]] = {"machine": {}, "day": {}}
    for row in range(len(table.rows)):
        machine, day = (checked_name(table.column(name)[row], table.where(row, name), names) for name, names in known.items())
        path = _log_path(table, row, source, seen)
        rest = tuple(table.column(name)[row] if name in table.header else "" for name in _OPTIONAL)
        key = machine, day
        if meant := misspelt(rest[2]):
            raise InputError(table.where(row, "crop"), f"is {rest[2]!r}", meant)
        if others.setdefault(key, rest) != rest:
            raise InputError(table.where(row, "machine"), "differs from a row above of the day", f"one {', '.join(_OPTIONAL)}")
        if _may_be_read(path):
            logs.setdefault(key, []).append(path)
        else:
            refused.append(InputError(table.where(row, "log"), f"{table.column('log')[row]} is not a file", "a log"))
    if not logs:
        raise refused[0] if refused else InputError(source, "has no row", "a row for each log")
    found = []
    with_tickets: dict[str, list[tuple[str, str]]] = {}
    for key in sorted(logs):
        config, tickets = (_beside(source, name) if name else "" for name in others[key][:2])
        found.append(Partition(*key, tuple(logs[key]), config, tickets, others[key][2]))
        with_tickets.setdefault(tickets, []).append(key)
    shared = {tickets: tuple(keys) for tickets, keys in with_tickets.items() if tickets and len(keys) > 1}
    found = [replace(each, sharing=shared.get(each.tickets, ())) for each in found]
    return Manifest(tuple(found), refused=tuple(refused))


def _check_header(table: delimited.TextTable, source: str) -> None:
    for name in _REQUIRED:
        if name not in table.header:
            raise InputError(f"{source}: header", f"has no column {name}", ", ".join(_REQUIRED))
    unknown = [name for name in table.header if name not in (*_REQUIRED, *_OPTIONAL)]
    if unknown:
        raise InputError(f"{source}: header", f"has {unknown[0]}", ", ".join((*_REQUIRED, *_OPTIONAL)))


def _log_path(table: delimited.TextTable, row: int, source: str, seen: set[str]) -> str:
    """Of the log that a row names, which joins those seen."""
    log = table.column("log")[row]
    if not log:
        raise InputError(table.where(row, "log"), "is empty", "the name of a log")
    path = _beside(source, log)
    if path in seen:
        raise InputError(table.where(row, "log"), f"names {log} a second time", "each log once")
    seen.add(path)
    return path


def _beside(source: str, name: str) -> str:
    return name if is_remote(name) else os.path.realpath(Path(source).absolute().parent / name)


def _may_be_read(path: str) -> bool:
    """False for folders, pipes (of which one would be waited for without end) and links that lead nowhere but to themselves; a
    file that is missing is its day's affair."""
    if is_remote(path):
        return True
    try:
        return stat.S_ISREG(os.stat(path).st_mode)
    except OSError as error:
        return isinstance(error, FileNotFoundError)

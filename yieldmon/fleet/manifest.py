"""What a fleet run is to work off: partitions of one machine and one day each, from a manifest or a folder tree.

A manifest is a table (CSV) with the columns machine, day and log, a row for each log, and if wanted config, tickets and crop,
which are the same in all rows of a partition. Names of files are relative to the manifest. A tree holds MACHINE/DAY/LOGS; beside
the logs of a day, or in the machine's folder, `config.yaml` is its configuration; beside the logs `tickets.csv` its tickets.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

from yieldmon.bus.logs import SUFFIXES
from yieldmon.errors import InputError
from yieldmon.files import delimited
from yieldmon.fleet.filesystem import filesystem_of, is_remote

CONFIG, TICKETS = "config.yaml", "tickets.csv"
_MOST_BYTES = 200
"""Of a name as a folder's."""
_REQUIRED = ("machine", "day", "log")
_OPTIONAL = ("config", "tickets", "crop")


def folder_of(name: str) -> str:
    """A machine's or day's name as a partition's folder has it: what is no letter, digit, '.', '_', '-' or '~' as %XX, as Hive,
    DuckDB and Arrow read it."""
    return quote(name, safe="")


def name_of(folder: str) -> str | None:
    """The name that `folder_of` gives that folder; None where there is none."""
    name = unquote(folder)
    return name if _is_name(name) and folder_of(name) == folder else None


def _is_name(text: str) -> bool:
    plain = text[:1].isalnum() and text.isprintable() and text == text.strip() and not {"/", "\\"} & {*text}
    return plain and len(folder_of(text)) <= _MOST_BYTES


@dataclass(frozen=True, slots=True)
class Partition:
    """One machine's logs of one day, in the order in which they are one record.

    Paths or fsspec addresses; config, tickets: "" for none. crop: "" where the parameters say it.
    """

    machine: str
    day: str
    logs: tuple[str, ...]
    config: str = ""
    tickets: str = ""
    crop: str = ""

    @property
    def name(self) -> str:
        """As it stands in a dataset."""
        return f"machine={folder_of(self.machine)}/day={folder_of(self.day)}"


@dataclass(frozen=True, slots=True)
class Manifest:
    """partitions by name; left_out: what of a tree is no log of a day, and logs that lie outside the folders of days."""

    partitions: tuple[Partition, ...]
    left_out: tuple[str, ...] = ()


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
        return _of_tree(files, root, source)
    if not files.exists(root):
        raise InputError(source, "no such file or folder", "a manifest (CSV: machine, day, log), or a folder MACHINE/DAY/LOGS")
    if is_remote(source):
        raise InputError(source, "is a remote file", "a manifest on this machine, or a remote folder MACHINE/DAY/LOGS")
    return _of_table(source)


def _of_table(source: str) -> Manifest:
    table = delimited.read(source)
    for name in _REQUIRED:
        if name not in table.header:
            raise InputError(f"{source}: header", f"has no column {name}", ", ".join(_REQUIRED))
    unknown = [name for name in table.header if name not in (*_REQUIRED, *_OPTIONAL)]
    if unknown:
        raise InputError(f"{source}: header", f"has {unknown[0]}", ", ".join((*_REQUIRED, *_OPTIONAL)))
    logs: dict[tuple[str, str], list[str]] = {}
    others: dict[tuple[str, str], tuple[str, ...]] = {}
    seen: set[str] = set()
    for row in range(len(table.rows)):
        machine, day = (_name(table.column(name)[row], table.where(row, name)) for name in ("machine", "day"))
        log = table.column("log")[row]
        path = _beside(source, log)
        if not log:
            raise InputError(table.where(row, "log"), "is empty", "the name of a log")
        if path in seen:
            raise InputError(table.where(row, "log"), f"names {log} a second time", "each log once")
        seen.add(path)
        rest = tuple(table.column(name)[row] if name in table.header else "" for name in _OPTIONAL)
        key = machine, day
        if others.setdefault(key, rest) != rest:
            raise InputError(table.where(row, "machine"), "differs from a row above of the day", f"one {', '.join(_OPTIONAL)}")
        logs.setdefault(key, []).append(path)
    if not logs:
        raise InputError(source, "has no row", "a row for each log")
    found = []
    for key in sorted(logs):
        config, tickets = (_beside(source, name) if name else "" for name in others[key][:2])
        found.append(Partition(*key, tuple(logs[key]), config, tickets, others[key][2]))
    return Manifest(tuple(found))


def _beside(source: str, name: str) -> str:
    return name if is_remote(name) else str((Path(source).absolute().parent / name).resolve())


def _of_tree(files: Any, root: str, source: str) -> Manifest:
    found, left_out = [], _astray(files, root)
    for machine in _folders(files, root):
        config = _present(files, f"{machine}/{CONFIG}")
        left_out += _astray(files, machine)
        days = list(_folders(files, machine))
        if not days:
            left_out.append(machine)
        for day in days:
            logs = []
            for path in sorted(entry["name"] for entry in files.ls(day, detail=True) if entry["type"] == "file"):
                name = path.rpartition("/")[2]
                if name in (CONFIG, TICKETS):
                    continue
                if _is_log(name):
                    logs.append(files.unstrip_protocol(path) if is_remote(source) else path)
                else:
                    left_out.append(path)
            names = [_name(part.rstrip("/").rpartition("/")[2], part) for part in (machine, day)]
            if not logs:
                left_out.append(day)
                continue
            found.append(
                Partition(
                    names[0],
                    names[1],
                    tuple(logs),
                    _address(files, source, _present(files, f"{day}/{CONFIG}") or config),
                    _address(files, source, _present(files, f"{day}/{TICKETS}")),
                )
            )
    if not found:
        raise InputError(source, "holds no logs", "folders MACHINE/DAY with logs in them")
    return Manifest(tuple(found), tuple(left_out))


def _astray(files: Any, path: str) -> list[str]:
    """Logs that lie beside the folders of machines or days."""
    entries = files.ls(path, detail=True)
    return sorted(entry["name"] for entry in entries if entry["type"] == "file" and _is_log(entry["name"]))


def _folders(files: Any, path: str) -> Iterator[str]:
    for entry in sorted(files.ls(path, detail=True), key=lambda entry: entry["name"]):
        name = entry["name"].rstrip("/")
        if entry["type"] == "directory" and not name.rpartition("/")[2].startswith((".", "_")):
            yield name


def _present(files: Any, path: str) -> str:
    return path if files.exists(path) else ""


def _address(files: Any, source: str, path: str) -> str:
    return files.unstrip_protocol(path) if path and is_remote(source) else path


def _is_log(name: str) -> bool:
    lower = name.lower().removesuffix(".gz")
    return lower.endswith(SUFFIXES)


def _name(text: str, where: str) -> str:
    if not _is_name(text):
        expected = "a name that begins with a letter or digit, without '/', '\\' and control characters, at most 200 bytes (%XX)"
        raise InputError(where, f"is {text[:120]!r}", expected)
    return text

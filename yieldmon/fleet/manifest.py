"""What a fleet run is to work off: partitions of one machine and one day each, from a manifest or a folder tree.

A manifest is a table (CSV) with the columns machine, day and log, a row for each log, and if wanted config, tickets and crop,
which are the same in all rows of a partition. Names of files are relative to the manifest. A tree holds MACHINE/DAY/LOGS; beside
the logs of a day, or in the machine's folder, `config.yaml` is its configuration; beside the logs `tickets.csv` its tickets. A
text file (*.txt) is a log if it begins as one. Logs at other depths, or under names that do not end as a format does, are
refused: left out without an error, nobody would miss their mass.
"""

from __future__ import annotations

import os
import re
import stat
import unicodedata
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from yieldmon.bus.logs import SUFFIXES
from yieldmon.bus.text_logs import begins_as_log
from yieldmon.errors import InputError, reason
from yieldmon.files import delimited
from yieldmon.files.crops import misspelt
from yieldmon.fleet.filesystem import filesystem_of, is_remote
from yieldmon.fleet.names import folder_of, in_order, is_name

CONFIG, TICKETS = "config.yaml", "tickets.csv"
_TEXT = re.compile(r".*\.txt([.-]\d+)?(\.[a-z0-9]+)*")
"""A log, as it is named or also rotated, compressed or being copied; or anybody's notes."""
_GZIP, _GZIP_MAGIC = 31, b"\x1f\x8b"
_LOOKED_AT_BYTES = 16 * 1024
"""Of a file that may be notes."""
_UNREAD_COMPRESSIONS = (".zst", ".bz2", ".xz", ".lz4", ".7z", ".zip")
_ARCHIVES = (".zip", ".7z", ".rar", ".tar", ".tgz", ".tar.gz", ".tar.xz", ".tar.bz2", ".tar.zst")
_BEING_COPIED = (".part", ".partial", ".filepart", ".crdownload", ".download", ".tmp", ".temp")
"""What programs that copy or fetch a file put behind its name until it is whole."""
_OF_OTHERS_TOO = (".csv", ".db", ".parquet")
_ROTATED = re.compile(r"(.+)[.-]\d+(\.gz)?")
"""As `logrotate` names what it moves away: candump.log.1, candump.log-20261001.gz."""
_LAYOUT = "folders MACHINE/DAY with logs in them, or a manifest"
_DEEPEST = 6
"""Folders below a day in which logs are looked for."""
_NO_LOGS = ("thumbs.db",)
"""Files that file managers leave and that end as a log may."""
_REQUIRED = ("machine", "day", "log")
_OPTIONAL = ("config", "tickets", "crop")


@dataclass(frozen=True, slots=True)
class Partition:
    """One machine's logs of one day, by name or as the manifest lists them.

    Paths or fsspec addresses; config, tickets: "" for none. crop: "" where the parameters say it. copies: of the logs those that
    repeat another one of the machine, with that one. sharing: machine and day of all partitions that have this table of
    tickets, if several do.
    """

    machine: str
    day: str
    logs: tuple[str, ...]
    config: str = ""
    tickets: str = ""
    crop: str = ""
    copies: tuple[tuple[str, str], ...] = ()
    sharing: tuple[tuple[str, str], ...] = ()

    @property
    def name(self) -> str:
        """As it stands in a dataset."""
        return f"machine={folder_of(self.machine)}/day={folder_of(self.day)}"


@dataclass(frozen=True, slots=True)
class Manifest:
    """partitions by name; left_out: what of a tree is no log that is read; refused: what of a tree should be a machine, day, log,
    configuration or table of tickets and cannot be used."""

    partitions: tuple[Partition, ...]
    left_out: tuple[str, ...] = ()
    refused: tuple[InputError, ...] = ()


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
    _check_header(table, source)
    logs: dict[tuple[str, str], list[str]] = {}
    others: dict[tuple[str, str], tuple[str, ...]] = {}
    seen: set[str] = set()
    refused: list[InputError] = []
    known: dict[str, dict[str, str]] = {"machine": {}, "day": {}}
    for row in range(len(table.rows)):
        machine, day = (_name(table.column(name)[row], table.where(row, name), names) for name, names in known.items())
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
            refused.append(InputError(table.where(row, "log"), f"{table.column('log')[row]} is no file", "a log"))
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


def _of_tree(files: Any, root: str, source: str) -> Manifest:
    found: list[Partition] = []
    left_out = list[str]()
    refused = _astray(files, root, left_out)
    machines = dict[str, str]()
    for machine in _folders(files, root, left_out, refused):
        try:
            name = _name(machine.rpartition("/")[2], machine, machines)
            config = _present(files, f"{machine}/{CONFIG}")
            _refuse_other_spelling(files, machine, CONFIG)
            refused += _astray(files, machine, left_out)
            days = _folders(files, machine, left_out, refused)
            if not days:
                _without_logs(machine, left_out, refused)
        except (InputError, PermissionError) as error:
            refused.append(_refusal(machine, error))
            continue
        known_days = dict[str, str]()
        for day in days:
            if day.rpartition("/")[2].startswith("machine="):
                # A dataset of `fleet run` that lies in its own source.
                left_out.append(day)
                continue
            before = len(refused)
            try:
                day_name = _name(day.rpartition("/")[2], day, known_days)
                _refuse_other_spelling(files, day, CONFIG)
                logs = _logs(files, day, left_out, refused)
            except (InputError, PermissionError) as error:
                refused.append(_refusal(day, error))
                continue
            if not logs:
                if len(refused) == before:
                    _without_logs(day, left_out, refused)
                continue
            found.append(
                Partition(
                    name,
                    day_name,
                    tuple(files.unstrip_protocol(path) if is_remote(source) else path for path in logs),
                    _address(files, source, _present(files, f"{day}/{CONFIG}") or config),
                    _address(files, source, _present(files, f"{day}/{TICKETS}")),
                )
            )
    if not found:
        raise refused[0] if refused else InputError(source, "holds no logs", "folders MACHINE/DAY with logs in them")
    return Manifest(tuple(found), tuple(left_out), tuple(refused))


def _without_logs(folder: str, left_out: list[str], refused: list[InputError]) -> None:
    """A machine or day without a log: an archive in its place is refused, as nobody would miss the mass of the logs in it."""
    archives = [path for path in left_out if path.startswith(f"{folder}/") and path.lower().endswith(_ARCHIVES)]
    if not archives:
        left_out.append(folder)
    for path in archives:
        left_out.remove(path)
        refused.append(InputError(path, "is an archive, which is not read", "the logs that are in it"))


def _refusal(folder: str, error: InputError | PermissionError) -> InputError:
    return error if isinstance(error, InputError) else InputError(folder, reason(error), "a folder that can be read")


def _logs(files: Any, day: str, left_out: list[str], refused: list[InputError]) -> list[str]:
    """The logs of a day, by name with numbers as such; what else is in its folder goes to the other two lists."""
    logs = []
    for path, kind in _entries(files, day):
        name = path.rpartition("/")[2]
        if name in (CONFIG, TICKETS) or (kind == _FOLDER and name.startswith((".", "_"))):
            continue
        if name.lower() == TICKETS:
            refused.append(_other_spelling(path, TICKETS))
        elif kind == _FOLDER and not _is_log(name):
            if log := _log_below(files, path):
                refused.append(InputError(path, f"holds the log {log} and is no day", _LAYOUT))
            else:
                left_out.append(path)
        elif _is_left_behind(name) or _is_notes(files, path, kind):
            left_out.append(path)
        elif misnamed := _misnamed(path, name):
            refused.append(misnamed)
        elif not _is_log(name):
            left_out.append(path)
        elif kind == _FILE:
            logs.append(path)
        else:
            refused.append(InputError(path, "is not a file, or is a link to nothing", "a log"))
    return sorted(logs, key=lambda path: in_order(path.rpartition("/")[2]))


def _misnamed(path: str, name: str) -> InputError | None:
    """Why a log is not read under its name; None for one that is, and for all else."""
    if _is_rotated(name):
        return InputError(path, "is a log under a name that is not read", "one that ends in .log, .asc or the like")
    if other := _unread_compression(name):
        return InputError(path, f"is compressed as {other}, which is not read", "the log as it is, or as .gz")
    if _is_being_copied(name):
        return InputError(path, "is a log that is not whole yet, by its name", "the log under its own name")
    return None


def _astray(files: Any, path: str, left_out: list[str]) -> list[InputError]:
    """Logs and tickets that lie beside the folders of machines or days; what may be a table of another kind is left out."""
    refused = []
    for entry, kind in _entries(files, path):
        name = entry.rpartition("/")[2]
        if kind == _FOLDER or _is_left_behind(name):
            continue
        if name.lower() == TICKETS or (_is_surely_log(name) and not _is_notes(files, entry, kind)):
            refused.append(InputError(entry, "lies beside the folders of machines or days", _LAYOUT))
        elif (_is_log(name) and not _TEXT.fullmatch(name.lower())) or name.lower().endswith(_ARCHIVES):
            left_out.append(entry)
    return refused


def _log_below(files: Any, path: str, depth: int = _DEEPEST) -> str:
    """The first log in a folder or in those below it, by its name from there; "" where there is none."""
    for entry, kind in _entries(files, path):
        name: str = entry.rpartition("/")[2]
        if _is_left_behind(name):
            continue
        if kind == _FILE and _is_surely_log(name) and not _is_notes(files, entry, kind):
            return name
        if kind == _FOLDER and depth and (log := _log_below(files, entry, depth - 1)):
            return f"{name}/{log}"
    return ""


def _refuse_other_spelling(files: Any, folder: str, name: str) -> None:
    """Config.yaml or config.yml: a machine would be measured by the configuration of all others."""
    names = {path.rpartition("/")[2]: path for path, kind in _entries(files, folder) if kind == _FILE}
    for other, path in names.items():
        if name not in names and other.lower().replace(".yml", ".yaml") == name:
            raise _other_spelling(path, name)


def _other_spelling(path: str, name: str) -> InputError:
    return InputError(path, "is not read under this name", name)


def _folders(files: Any, path: str, left_out: list[str], refused: list[InputError]) -> list[str]:
    """The folders in one, by name."""
    entries = [(name, kind) for name, kind in _entries(files, path) if not name.rpartition("/")[2].startswith((".", "_"))]
    left_out += [name for name, kind in entries if kind == _OTHER and not _is_log(name)]
    refused += [
        InputError(name, "is a link that leads back to a folder it lies in", "a folder of its own")
        for name, kind in entries
        if kind == _LOOP
    ]
    return [name for name, kind in entries if kind == _FOLDER]


_FILE, _FOLDER, _LOOP, _OTHER = "file", "directory", "loop", "other"


def _entries(files: Any, path: str) -> Iterator[tuple[str, str]]:
    """What is in a folder, by name, and its kind; a link is what it leads to."""
    for entry in sorted(files.ls(path, detail=True), key=lambda entry: entry["name"]):
        name, kind = entry["name"].rstrip("/"), entry["type"]
        if entry.get("islink"):
            kind = _FOLDER if files.isdir(name) else _FILE if files.isfile(name) else _OTHER
            if kind == _FOLDER and Path(os.path.realpath(name)) in (folder := Path(os.path.realpath(path)), *folder.parents):
                kind = _LOOP
        yield name, kind


def _present(files: Any, path: str) -> str:
    return path if files.exists(path) else ""


def _address(files: Any, source: str, path: str) -> str:
    return files.unstrip_protocol(path) if path and is_remote(source) else path


def _unread_compression(name: str) -> str:
    """Of a log; "" for all else."""
    stem, dot, suffix = name.lower().rpartition(".")
    return dot + suffix if dot + suffix in _UNREAD_COMPRESSIONS and stem.endswith(SUFFIXES) else ""


def _is_being_copied(name: str) -> bool:
    """A log under the name of a copy that is not complete."""
    stem, dot, suffix = name.lower().rpartition(".")
    return dot + suffix in _BEING_COPIED and _is_log(stem)


def _is_left_behind(name: str) -> bool:
    """By a file manager or editor."""
    return name.startswith(".") or name.lower() in _NO_LOGS


def _is_notes(files: Any, path: str, kind: str) -> bool:
    """A text file that does not begin as a log does; one that cannot be read may be one."""
    if not _TEXT.fullmatch(path.rpartition("/")[2].lower()):
        return False
    if kind != _FILE:
        return True
    try:
        with files.open(path, "rb") as stream:
            start = stream.read(_LOOKED_AT_BYTES)
        if start.startswith(_GZIP_MAGIC):
            start = zlib.decompressobj(_GZIP).decompress(start, _LOOKED_AT_BYTES)
    except (OSError, zlib.error):
        return False
    return not begins_as_log(start)


def _is_surely_log(name: str) -> bool:
    """Not a table or database as other programs write them too."""
    return _is_rotated(name) or (_is_log(name) and not name.lower().removesuffix(".gz").endswith(_OF_OTHERS_TOO))


def _is_rotated(name: str) -> bool:
    found = _ROTATED.fullmatch(name.lower())
    return found is not None and found[1].endswith(SUFFIXES)


def _is_log(name: str) -> bool:
    lower = name.lower().removesuffix(".gz")
    return lower.endswith(SUFFIXES)


def _name(text: str, where: str, known: dict[str, str]) -> str:
    """A machine's or day's name. known: those of one kind so far, by their composed form."""
    if not is_name(text):
        expected = "a name that begins with a letter or digit, without '/', '\\' and control characters, at most 200 bytes (%XX)"
        raise InputError(where, f"is {text[:120]!r}", expected)
    if known.setdefault(unicodedata.normalize("NFC", text), text) != text:
        # As macOS writes names: the same to whoever reads it, and another machine to a dataset.
        problem = f"is {text[:120]!r} with its accents coded otherwise than before"
        raise InputError(where, problem, "one coding of Unicode for a name")
    return text

"""Partitions of a fleet run from a folder tree MACHINE/DAY/LOGS, also of a remote file system.

Beside the logs of a day, or in the machine's folder, `config.yaml` is its configuration; beside the logs `tickets.csv` its
tickets. A text file (*.txt) is a log if it begins as one. Logs at other depths, or under names that do not end as a format does,
are refused: left out without an error, nobody would miss their mass.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from yieldmon.bus.log_files.text_logs import begins_as_log
from yieldmon.errors import InputError, reason
from yieldmon.fleet.filesystem import is_remote
from yieldmon.fleet.log_names import ARCHIVES, TEXT, is_left_behind, is_log, is_surely_log, misnamed
from yieldmon.fleet.names import in_order
from yieldmon.fleet.partition import Manifest, Partition, checked_name

CONFIG, TICKETS = "config.yaml", "tickets.csv"
_GZIP, _GZIP_MAGIC = 31, b"\x1f\x8b"
_LOOKED_AT_BYTES = 16 * 1024
"""Of a file that may be notes."""
_LAYOUT = "folders MACHINE/DAY with logs in them, or a manifest"
_DEEPEST = 6
"""Folders below a day in which logs are looked for."""
_FILE, _FOLDER, _LOOP, _OTHER = "file", "directory", "loop", "other"


def of_tree(files: Any, root: str, source: str) -> Manifest:
    """The partitions below a folder. files: its file system; root: its path there; source: as it was named."""
    found: list[Partition] = []
    left_out = list[str]()
    refused = _astray(files, root, left_out)
    machines = dict[str, str]()
    for machine in _folders(files, root, left_out, refused):
        try:
            name = checked_name(machine.rpartition("/")[2], machine, machines)
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
                day_name = checked_name(day.rpartition("/")[2], day, known_days)
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
    archives = [path for path in left_out if path.startswith(f"{folder}/") and path.lower().endswith(ARCHIVES)]
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
        elif kind == _FOLDER and not is_log(name):
            if log := _log_below(files, path):
                refused.append(InputError(path, f"holds the log {log} and is not the folder of a day", _LAYOUT))
            else:
                left_out.append(path)
        elif is_left_behind(name) or _is_notes(files, path, kind):
            left_out.append(path)
        elif refusal := misnamed(path, name):
            refused.append(refusal)
        elif not is_log(name):
            left_out.append(path)
        elif kind == _FILE:
            logs.append(path)
        else:
            refused.append(InputError(path, "is not a file, or is a link to nothing", "a log"))
    return sorted(logs, key=lambda path: in_order(path.rpartition("/")[2]))


def _astray(files: Any, path: str, left_out: list[str]) -> list[InputError]:
    """Logs and tickets that lie beside the folders of machines or days; what may be a table of another kind is left out."""
    refused = []
    for entry, kind in _entries(files, path):
        name = entry.rpartition("/")[2]
        if kind == _FOLDER or is_left_behind(name):
            continue
        if name.lower() == TICKETS or (is_surely_log(name) and not _is_notes(files, entry, kind)):
            refused.append(InputError(entry, "lies beside the folders of machines or days", _LAYOUT))
        elif (is_log(name) and not TEXT.fullmatch(name.lower())) or name.lower().endswith(ARCHIVES):
            left_out.append(entry)
    return refused


def _log_below(files: Any, path: str, depth: int = _DEEPEST) -> str:
    """The first log in a folder or in those below it, by its name from there; "" where there is none."""
    for entry, kind in _entries(files, path):
        name: str = entry.rpartition("/")[2]
        if is_left_behind(name):
            continue
        if kind == _FILE and is_surely_log(name) and not _is_notes(files, entry, kind):
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
    left_out += [name for name, kind in entries if kind == _OTHER and not is_log(name)]
    refused += [
        InputError(name, "is a link that leads back to a folder it lies in", "a folder of its own")
        for name, kind in entries
        if kind == _LOOP
    ]
    return [name for name, kind in entries if kind == _FOLDER]


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


def _is_notes(files: Any, path: str, kind: str) -> bool:
    """A text file that does not begin as a log does; one that cannot be read may be one."""
    if not TEXT.fullmatch(path.rpartition("/")[2].lower()):
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

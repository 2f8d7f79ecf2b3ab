"""What is written beside a partition's tables: the mark of one that is there, and the note of one that could not be measured.

The mark names each file of its partition with size and SHA-256: what it does not name is not part of the dataset. Nothing of a
time or a host is in it: the same inputs give the same bytes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from yieldmon.errors import InputError
from yieldmon.files import digests
from yieldmon.fleet.dataset_files import MARK, DatasetFiles

_MARK: Mapping[str, type] = {"key": str, "files": dict, "poisoned": list}
_FAILURE: Mapping[str, type] = {"machine": str, "day": str, "problem": str}


@dataclass(frozen=True)
class Commit:
    """A partition that is there. name: machine=NAME/day=NAME; content: of its mark."""

    name: str
    content: Mapping[str, Any]

    @property
    def key(self) -> str:
        """Of what its result follows from."""
        return str(self.content["key"])

    @property
    def machine(self) -> str:
        """Name of the machine."""
        return unquote(self.name.partition("/")[0].partition("=")[2])

    @property
    def day(self) -> str:
        """Name of the day."""
        return unquote(self.name.partition("/")[2].partition("=")[2])

    @property
    def files(self) -> Mapping[str, Mapping[str, Any]]:
        """Size and SHA-256 of each file, by name."""
        files: Mapping[str, Mapping[str, Any]] = self.content["files"]
        return files


def document(content: Mapping[str, Any]) -> bytes:
    """A mark or a note, as it is written."""
    return json.dumps(content, indent=1, sort_keys=True).encode() + b"\n"


def mark_of(content: Mapping[str, Any], paths: Sequence[Path]) -> bytes:
    """The mark of a partition that consists of these files."""
    listed = {path.name: {"bytes": path.stat().st_size, "sha256": digests.of_file(path)} for path in paths}
    return document({**content, "files": listed})


def commit_of(files: DatasetFiles, name: str) -> Commit | None:
    """The partition of that name, None where it is not there. Raises InputError where its mark is damaged."""
    content = files.read(f"{name}/{MARK}")
    if content is None:
        return None
    where = files.path(f"{name}/{MARK}")
    found = _checked(where, content, _MARK)
    listed = all(isinstance(item, dict) and {*item} == {"where", "problem"} for item in found["poisoned"])
    listed = listed and isinstance(found.get("samples", {}), dict)
    if not listed or not all(isinstance(entry, dict) and "sha256" in entry for entry in found["files"].values()):
        raise _damaged(where)
    return Commit(name, found)


def failure_of(files: DatasetFiles, name: str) -> dict[str, Any] | None:
    """A note of what could not be measured: machine, day, problem; None where there is none. Raises InputError where it is
    damaged."""
    content = files.read(name)
    return None if content is None else _checked(files.path(name), content, _FAILURE)


def check(files: DatasetFiles, commit: Commit, table: str) -> None:
    """Raises InputError where a table is not what the mark says: some damage of a table still reads as one."""
    name = f"{table}.parquet"
    content, listed = files.read(f"{commit.name}/{name}"), commit.files.get(name)
    if content is None or listed is None:
        raise _damaged(files.path(f"{commit.name}/{name}"), "is missing")
    if hashlib.sha256(content).hexdigest() != listed["sha256"]:
        raise _damaged(files.path(f"{commit.name}/{name}"), "is not what its mark says")


def check_sizes(files: DatasetFiles, commit: Commit, sizes: Mapping[str, int]) -> None:
    """Raises InputError where a file has another size than the mark says. sizes: of the files that are there, bytes."""
    for name, entry in commit.files.items():
        if name not in sizes:
            raise _damaged(files.path(f"{commit.name}/{name}"), "is missing")
        if sizes[name] != entry.get("bytes", sizes[name]):
            raise _damaged(files.path(f"{commit.name}/{name}"), "is not what its mark says")


def _checked(where: str, content: bytes, fields: Mapping[str, type]) -> dict[str, Any]:
    """A JSON document that has at least these fields. Raises InputError."""
    try:
        found = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise _damaged(where) from error
    if not isinstance(found, dict) or not all(isinstance(found.get(name), kind) for name, kind in fields.items()):
        raise _damaged(where)
    return found


def _damaged(where: str, problem: str = "is damaged") -> InputError:
    measures = "it measures the day again while its logs are in the source, else remove the day's folder"
    expected = f"what `fleet run` wrote; run it again: {measures}"
    return InputError(where, problem, expected)

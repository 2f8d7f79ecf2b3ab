"""A dataset of partitions, each there whole or not at all.

    DATASET/machine=NAME/day=NAME/{records,loads,sweeps,faults,parameters,provenance}.parquet, _COMMITTED
    DATASET/_failed/machine=NAME/day=NAME.json      what could not be measured, and why
    DATASET/_run                                    which run may write
    DATASET/_temporary/                             of the run under way

NAME has what is no letter, digit, '.', '_', '-' or '~' as %XX.

`_COMMITTED` is written last and names each file with its size and SHA-256: what it does not name is not part of the dataset. In a
file system the partition's folder takes its name by one rename, with everything in it; in an object store, whose objects appear
whole, the mark is the last object. Nothing of a time or a host is written: the same inputs give the same bytes.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
import uuid
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from yieldmon.errors import InputError
from yieldmon.files import digests
from yieldmon.fleet.filesystem import filesystem_of, is_remote
from yieldmon.fleet.names import name_of

MARK = "_COMMITTED"
_FAILED, _RUN, _TEMPORARY = "_failed", "_run", "_temporary"


class Superseded(Exception):
    """Another run has taken the dataset over; this one may not write any more."""


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


class Dataset:
    """A dataset at a path or at the address of an object store."""

    def __init__(self, address: str) -> None:
        self.address = address if is_remote(address) else str(Path(address).absolute())
        if any(part.startswith(("machine=", "day=")) for part in self.address.split("/")):
            raise InputError(address, "lies in a folder that is called like a partition", "no machine= and day= in its path")
        self._files, self._root = filesystem_of(address)
        self._local = not is_remote(address) or address.startswith("file://")

    def begin(self, planned: Collection[str] | None = None, say: Callable[[InputError], None] = lambda problem: None) -> str:
        """Take the dataset over for a new run, which gets a token, and remove what runs that were killed left behind.

        Parameters
        ----------
        planned : collection of str
            Names of the partitions that the run is to measure. Of the damaged ones only these are removed: the logs of others may
            be kept elsewhere. None: all of them.
        say : callable
            Called with what is wrong of a damaged partition that stays.

        Returns
        -------
        str

        Raises
        ------
        InputError
            The folder holds something else, or links to places elsewhere; another run began meanwhile.
        """
        self._files.invalidate_cache()
        self._refuse_foreign()
        self._refuse_links()
        self._files.makedirs(self._root, exist_ok=True)
        token = uuid.uuid4().hex
        self._put(_RUN, token.encode())
        try:
            self._clean(token, planned, say)
        except Superseded:
            raise self.taken_over() from None
        return token

    def taken_over(self) -> InputError:
        """What the earlier of two runs ends with."""
        return InputError(self.address, "was taken over by another `fleet run`", "one run at a time")

    def withdraw_failures(self, names: Collection[str], token: str) -> None:
        """Remove what is noted of partitions that are there after all, as from the same inputs."""
        noted = {f"{name}.json" for name in names} & {*self._noted()}
        if noted and self._owner() == token:
            for name in noted:
                self._remove(f"{_FAILED}/{name}")

    def end(self, token: str) -> None:
        """The run is over."""
        if self._owner() == token:
            self._remove(_TEMPORARY)
            self._remove(_RUN)

    def abandon(self, token: str) -> None:
        """The run stops before its end: what was under way goes."""
        if self._owner() == token:
            self._remove(_TEMPORARY)

    def require(self, token: str) -> None:
        """Raises Superseded where the token is not that of the run under way."""
        if self._owner() != token:
            raise Superseded

    def commit_of(self, name: str) -> Commit | None:
        """The partition of that name, None where it is not there. Raises InputError where its mark is damaged."""
        content = self._read(f"{name}/{MARK}")
        return None if content is None else Commit(name, self._mark(f"{name}/{MARK}", content))

    def check(self, commit: Commit, table: str) -> None:
        """Raises InputError where a table is not what the partition's mark says: some damage of a table still reads as one."""
        name = f"{table}.parquet"
        content, listed = self._read(f"{commit.name}/{name}"), commit.content["files"].get(name)
        if content is None or listed is None:
            raise _damaged(f"{self._root}/{commit.name}/{name}", "is missing")
        if hashlib.sha256(content).hexdigest() != listed["sha256"]:
            raise _damaged(f"{self._root}/{commit.name}/{name}", "is not what its mark says")

    def names(self) -> list[str]:
        """The partitions' names, of which `commit_of` says whether they are whole."""
        return self._partitions()

    def whole(self, names: Collection[str]) -> list[str]:
        """Those of these partitions that are there and whole, by name."""
        self._files.invalidate_cache()
        return [name for name in self._partitions() if name in names and self._files.exists(f"{self._root}/{name}/{MARK}")]

    def commits(self) -> list[Commit]:
        """All partitions, by name. Raises InputError where there is no dataset, or a mark is damaged."""
        self._files.invalidate_cache()
        if not self._files.isdir(self._root):
            raise InputError(self.address, "no such dataset", "one that `yieldmon fleet run` wrote")
        return [commit for name in self._partitions() if (commit := self.commit_of(name)) is not None]

    def failures(self) -> list[dict[str, Any]]:
        """What could not be measured: machine, day, problem. Raises InputError where that is damaged."""
        names = [f"{self._root}/{_FAILED}/{name}" for name in self._noted()]
        return [_checked(name, self._files.cat_file(name), _FAILURE) for name in names]

    def _noted(self) -> list[str]:
        machines = self._entries(_FAILED, "machine=", "directory")
        found = [name for machine in machines for name in self._entries(machine, "day=", "file")]
        return [name.removeprefix(f"{_FAILED}/") for name in found]

    def path(self, name: str, table: str) -> str:
        """A table of a partition, as its file system names it."""
        return f"{self._root}/{name}/{table}.parquet"

    @property
    def filesystem(self) -> Any:
        """Of fsspec; None for files of this machine."""
        return None if self._local else self._files.raw

    def place_of(self, name: str | None) -> str | None:
        """A file that could not be written, as a person knows it: the dataset for what is under way. Writing does not always name
        its file."""
        under_way = name is None or str(name).startswith(f"{self._root}/{_TEMPORARY}/")
        return self.address if self._local and under_way else name

    @contextmanager
    def workspace(self) -> Iterator[Path]:
        """A folder of this machine to write a partition's files to; it goes at the end."""
        if self._local:
            home = Path(self._root) / _TEMPORARY
            home.mkdir(parents=True, exist_ok=True)
            folder = home / uuid.uuid4().hex
            folder.mkdir()
        else:
            folder = Path(tempfile.mkdtemp(prefix="yieldmon-fleet-"))
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def commit(self, name: str, folder: Path, content: Mapping[str, Any], token: str) -> None:
        """Make the files in the folder the partition of that name, in place of one that is there.

        Raises Superseded where the token is not that of the run under way.
        """
        paths = sorted(path for path in folder.iterdir() if path.is_file())
        listed = {path.name: {"bytes": path.stat().st_size, "sha256": digests.of_file(path)} for path in paths}
        mark = json.dumps({**content, "files": listed}, indent=1, sort_keys=True).encode() + b"\n"
        self.require(token)
        if self._local:
            self._rename(name, folder, mark)
        else:
            self._upload(name, paths, mark)
        self._remove(f"{_FAILED}/{name}.json")

    def fail(self, name: str, problem: Mapping[str, Any], token: str) -> None:
        """Note that a partition cannot be measured; what an earlier run made of it stays, with the key of that run."""
        self.require(token)
        self._put(f"{_FAILED}/{name}.json", json.dumps(problem, indent=1, sort_keys=True).encode() + b"\n")

    def _rename(self, name: str, folder: Path, mark: bytes) -> None:
        (folder / MARK).write_bytes(mark)
        target = Path(self._root) / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.exists():
            with suppress(FileNotFoundError):
                target.rename(folder.with_name(f"{folder.name}-old"))
        folder.rename(target)
        shutil.rmtree(folder.with_name(f"{folder.name}-old"), ignore_errors=True)

    def _upload(self, name: str, paths: list[Path], mark: bytes) -> None:
        self._remove(f"{name}/{MARK}")
        for path in paths:
            self._files.put_file(str(path), f"{self._root}/{name}/{path.name}")
        self._put(f"{name}/{MARK}", mark)

    def _owner(self) -> str | None:
        content = self._read(_RUN)
        return None if content is None else content.decode()

    def _mark(self, name: str, content: bytes) -> dict[str, Any]:
        found = _checked(f"{self._root}/{name}", content, _MARK)
        listed = all(isinstance(item, dict) and {*item} == {"where", "problem"} for item in found["poisoned"])
        listed = listed and isinstance(found.get("samples", {}), dict)
        if not listed or not all(isinstance(entry, dict) and "sha256" in entry for entry in found["files"].values()):
            raise _damaged(f"{self._root}/{name}")
        return found

    def _partitions(self) -> list[str]:
        found = []
        for machine in self._entries("", "machine=", "directory"):
            for name in self._entries(machine, "day=", "directory"):
                if any(name_of(part.partition("=")[2]) is None for part in name.split("/")):
                    problem = f"holds {name[:120]!r}"
                    expected = "names as `fleet run` gives them: letters, digits, '.', '_' and '-', others as %XX"
                    raise InputError(self.address, problem, expected)
                found.append(name)
        return found

    def _entries(self, folder: str, begin: str, kind: str) -> list[str]:
        """Names below the root of what is in a folder, in order. A pattern would take what is special in the root's own name."""
        path = f"{self._root}/{folder}" if folder else self._root
        try:
            entries = self._files.ls(path, detail=True)
        except (FileNotFoundError, NotADirectoryError):
            return []
        names = (entry["name"].rstrip("/").rpartition("/")[2] for entry in entries if entry["type"] == kind)
        return sorted(f"{folder}/{name}" if folder else name for name in names if name.startswith(begin))

    def _refuse_foreign(self) -> None:
        if not self._files.exists(self._root):
            return
        if not self._files.isdir(self._root):
            raise InputError(self.address, "is a file", "a folder for the dataset")
        names = [path.rstrip("/").rpartition("/")[2] for path in self._files.ls(self._root, detail=False)]
        own = (_FAILED, _RUN, _TEMPORARY, "")
        foreign = [name for name in names if name not in own and not name.startswith("machine=") and name[:1] != "."]
        if not foreign and not {_FAILED, _RUN} & {*names}:
            # What another program has partitioned the same way: not to be cleaned.
            marked = any(self._files.exists(f"{self._root}/{name}/{MARK}") for name in self._partitions())
            foreign = [] if marked else [name for name in names if name.startswith("machine=")]
        if foreign:
            raise InputError(self.address, f"holds {foreign[0]}", "an empty folder, or a dataset of `fleet run`")

    def _refuse_links(self) -> None:
        """Cleaning and writing would go through them to what is no part of the dataset."""
        if not self._local or not Path(self._root).is_dir():
            return
        for pattern in ("*", "machine=*/*", f"{_FAILED}/*"):
            for part in Path(self._root).glob(pattern):
                if part.is_symlink():
                    raise InputError(str(part), "is a link", "a file or folder of the dataset's own; remove the link")

    def _clean(self, token: str, planned: Collection[str] | None, say: Callable[[InputError], None]) -> None:
        """Remove what no mark names."""
        self._remove(_TEMPORARY)
        for name in self._partitions():
            # What a run that began meanwhile is about to write is not whole yet.
            self.require(token)
            sizes = self._sizes(name)
            try:
                commit = self.commit_of(name)
                kept = {MARK, *commit.content["files"]} if commit is not None else set[str]()
                if commit is not None:
                    self._check_sizes(commit, sizes)
            except InputError as error:
                if planned is not None and name not in planned:
                    say(error)
                    continue
                kept = set()
            for child in {*sizes} - kept:
                self._remove(f"{name}/{child}")
            if not kept:
                self._remove(name)

    def _sizes(self, name: str) -> dict[str, int]:
        """Of what is in a partition's folder, bytes."""
        try:
            entries = self._files.ls(f"{self._root}/{name}", detail=True)
        except FileNotFoundError:
            return {}
        return {entry["name"].rstrip("/").rpartition("/")[2]: int(entry.get("size") or 0) for entry in entries}

    def _check_sizes(self, commit: Commit, sizes: Mapping[str, int]) -> None:
        for file, entry in commit.content["files"].items():
            if file not in sizes:
                raise _damaged(f"{self._root}/{commit.name}/{file}", "is missing")
            if sizes[file] != entry.get("bytes", sizes[file]):
                raise _damaged(f"{self._root}/{commit.name}/{file}", "is not what its mark says")

    def _read(self, name: str) -> bytes | None:
        try:
            return bytes(self._files.cat_file(f"{self._root}/{name}"))
        except FileNotFoundError:
            return None

    def _put(self, name: str, content: bytes) -> None:
        if not self._local:
            self._files.pipe_file(f"{self._root}/{name}", content)
            return
        target = Path(self._root) / name
        target.parent.mkdir(parents=True, exist_ok=True)
        scratch = target.with_name(f".{target.name}.{uuid.uuid4().hex}")
        try:
            scratch.write_bytes(content)
            scratch.replace(target)
        except OSError as error:
            error.filename = str(target)
            with suppress(OSError):
                scratch.unlink(missing_ok=True)
            raise

    def _remove(self, name: str) -> None:
        path = f"{self._root}/{name}"
        if self._local:
            if Path(path).is_dir() and not Path(path).is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            else:
                Path(path).unlink(missing_ok=True)
            return
        # By exact names: `rm` takes what is special in the dataset's own name for a pattern.
        with suppress(FileNotFoundError):
            found = self._files.find(path, withdirs=True, detail=True)
            for child, entry in sorted({path: {"type": "directory"}, **found}.items(), reverse=True):
                if entry["type"] != "directory":
                    self._files.rm_file(child)
                elif self._files.isdir(child):
                    self._files.rmdir(child)


_MARK: Mapping[str, type] = {"key": str, "files": dict, "poisoned": list}
_FAILURE: Mapping[str, type] = {"machine": str, "day": str, "problem": str}


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
    expected = "what `fleet run` wrote; it measures the day again while its logs are in the source, else remove the day's folder"
    return InputError(where, problem, expected)

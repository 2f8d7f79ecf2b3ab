"""The files of a dataset, here or in an object store, by their names below its root.

    DATASET/machine=NAME/day=NAME/{records,loads,sweeps,faults,parameters,provenance}.parquet, _COMMITTED
    DATASET/_failed/machine=NAME/day=NAME.json      what could not be measured, and why
    DATASET/_run                                    which run may write
    DATASET/_temporary/                             of the run under way

NAME has what is no letter, digit, '.', '_', '-' or '~' as %XX. Each file, and on this machine each folder, appears whole.
"""

from __future__ import annotations

import shutil
import tempfile
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from yieldmon.errors import InputError
from yieldmon.fleet.filesystem import filesystem_of, is_remote
from yieldmon.fleet.names import name_of

MARK = "_COMMITTED"
FAILED, RUN, TEMPORARY = "_failed", "_run", "_temporary"


class DatasetFiles:
    """Reads, writes and lists. address: path, or address of an object store."""

    def __init__(self, address: str) -> None:
        self.address = address if is_remote(address) else str(Path(address).absolute())
        if any(part.startswith(("machine=", "day=")) for part in self.address.split("/")):
            raise InputError(address, "lies in a folder that is called like a partition", "no machine= and day= in its path")
        self._files, self.root = filesystem_of(address)
        self.local = not is_remote(address) or address.startswith("file://")

    @property
    def filesystem(self) -> Any:
        """Of fsspec; None for files of this machine."""
        return None if self.local else self._files.raw

    def path(self, name: str) -> str:
        """A file, as its file system names it."""
        return f"{self.root}/{name}"

    # Reading

    def forget(self) -> None:
        """Look anew, whatever was listed before."""
        self._files.invalidate_cache()

    def is_there(self) -> bool:
        """Whether there is anything at the address."""
        return bool(self._files.exists(self.root))

    def is_folder(self) -> bool:
        """Whether what is at the address is a folder."""
        return bool(self._files.isdir(self.root))

    def has(self, name: str) -> bool:
        """Whether there is such a file."""
        return bool(self._files.exists(self.path(name)))

    def read(self, name: str) -> bytes | None:
        """The content of a file; None where there is none."""
        try:
            return bytes(self._files.cat_file(self.path(name)))
        except FileNotFoundError:
            return None

    def names(self) -> list[str]:
        """Of all that is at the root."""
        return [path.rstrip("/").rpartition("/")[2] for path in self._files.ls(self.root, detail=False)]

    def partitions(self) -> list[str]:
        """Names of the folders of machines and days, in order. Raises InputError for one that no name is written as."""
        found = []
        for machine in self._entries("", "machine=", "directory"):
            for name in self._entries(machine, "day=", "directory"):
                if any(name_of(part.partition("=")[2]) is None for part in name.split("/")):
                    problem = f"holds {name[:120]!r}"
                    expected = "names as `fleet run` gives them: letters, digits, '.', '_' and '-', others as %XX"
                    raise InputError(self.address, problem, expected)
                found.append(name)
        return found

    def failures(self) -> list[str]:
        """Names of the notes of what could not be measured, in order."""
        machines = self._entries(FAILED, "machine=", "directory")
        return [name for machine in machines for name in self._entries(machine, "day=", "file")]

    def sizes(self, folder: str) -> dict[str, int]:
        """Of what is in a folder, bytes."""
        try:
            entries = self._files.ls(self.path(folder), detail=True)
        except FileNotFoundError:
            return {}
        return {_last(entry): int(entry.get("size") or 0) for entry in entries}

    def _entries(self, folder: str, begin: str, kind: str) -> list[str]:
        """Names below the root of what is in a folder, in order. A pattern would take what is special in the root's own name."""
        try:
            entries = self._files.ls(self.path(folder) if folder else self.root, detail=True)
        except (FileNotFoundError, NotADirectoryError):
            return []
        names = (_last(entry) for entry in entries if entry["type"] == kind)
        return sorted(f"{folder}/{name}" if folder else name for name in names if name.startswith(begin))

    # Writing

    def make_root(self) -> None:
        """The root is there."""
        self._files.makedirs(self.root, exist_ok=True)

    def put(self, name: str, content: bytes) -> None:
        """Write a file, in place of one that is there."""
        if not self.local:
            self._files.pipe_file(self.path(name), content)
            return
        target = Path(self.path(name))
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

    def put_marked(self, name: str, folder: Path, paths: Sequence[Path], mark: bytes) -> None:
        """Make a folder's files the folder of that name, in place of one that is there. The mark comes last: in a file system
        with all others, by one rename; in an object store behind them."""
        if self.local:
            self._rename(name, folder, mark)
            return
        self.remove(f"{name}/{MARK}")
        for path in paths:
            self._files.put_file(str(path), self.path(f"{name}/{path.name}"))
        self.put(f"{name}/{MARK}", mark)

    def _rename(self, name: str, folder: Path, mark: bytes) -> None:
        (folder / MARK).write_bytes(mark)
        target, replaced = Path(self.path(name)), folder.with_name(f"{folder.name}-old")
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.exists():
            with suppress(FileNotFoundError):
                target.rename(replaced)
        folder.rename(target)
        shutil.rmtree(replaced, ignore_errors=True)

    def remove(self, name: str) -> None:
        """Remove a file or a folder with what is in it, where there is one."""
        path = self.path(name)
        if self.local:
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

    @contextmanager
    def workspace(self) -> Iterator[Path]:
        """A folder of this machine to write a partition's files to; it goes at the end."""
        if self.local:
            home = Path(self.path(TEMPORARY))
            home.mkdir(parents=True, exist_ok=True)
            folder = home / uuid.uuid4().hex
            folder.mkdir()
        else:
            folder = Path(tempfile.mkdtemp(prefix="yieldmon-fleet-"))
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def place_of(self, name: str | None) -> str | None:
        """A file that could not be written, as a person knows it: the dataset for what is under way. Writing does not always name
        its file."""
        under_way = name is None or str(name).startswith(f"{self.path(TEMPORARY)}/")
        return self.address if self.local and under_way else name


def _last(entry: dict[str, Any]) -> str:
    """The last part of the name of what fsspec lists."""
    return str(entry["name"]).rstrip("/").rpartition("/")[2]

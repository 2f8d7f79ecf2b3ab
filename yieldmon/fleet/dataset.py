"""A dataset of partitions, each there whole or not at all: who may write to it, what is in it, and how a partition joins it.

Where its files lie: `dataset_files`; what says that a partition is there: `marks`.
"""

from __future__ import annotations

import uuid
from collections.abc import Callable, Collection, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from yieldmon.errors import InputError
from yieldmon.fleet import cleaning, marks
from yieldmon.fleet.dataset_files import FAILED, MARK, RUN, TEMPORARY, DatasetFiles
from yieldmon.fleet.marks import Commit


class Superseded(Exception):
    """Another run has taken the dataset over; this one may not write any more."""


class Dataset:
    """A dataset at a path or at the address of an object store."""

    def __init__(self, address: str) -> None:
        self._files = DatasetFiles(address)
        self.address = self._files.address

    # The run that may write

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
        self._files.forget()
        cleaning.refuse_foreign(self._files)
        cleaning.refuse_links(self._files)
        self._files.make_root()
        token = uuid.uuid4().hex
        self._files.put(RUN, token.encode())
        try:
            cleaning.clean(self._files, planned, say, lambda: self.require(token))
        except Superseded:
            raise self.taken_over() from None
        return token

    def require(self, token: str) -> None:
        """Raises Superseded where the token is not that of the run under way."""
        if not self._is_owner(token):
            raise Superseded

    def taken_over(self) -> InputError:
        """What the earlier of two runs ends with."""
        return InputError(self.address, "was taken over by another `fleet run`", "one run at a time")

    def end(self, token: str) -> None:
        """The run is over."""
        if self._is_owner(token):
            self._files.remove(TEMPORARY)
            self._files.remove(RUN)

    def abandon(self, token: str) -> None:
        """The run stops before its end, or leaves days to the next one: what was under way goes."""
        if self._is_owner(token):
            self._files.remove(TEMPORARY)

    def _is_owner(self, token: str) -> bool:
        return self._files.read(RUN) == token.encode()

    # What is there

    def commit_of(self, name: str) -> Commit | None:
        """The partition of that name, None where it is not there. Raises InputError where its mark is damaged."""
        return marks.commit_of(self._files, name)

    def check(self, commit: Commit, table: str) -> None:
        """Raises InputError where a table is not what the partition's mark says: some damage of a table still reads as one."""
        marks.check(self._files, commit, table)

    def check_sizes(self, commit: Commit) -> None:
        """Raises InputError where a file of a partition is not there, or has another size than its mark says."""
        marks.check_sizes(self._files, commit, self._files.sizes(commit.name))

    def names(self) -> list[str]:
        """The partitions' names, of which `commit_of` says whether they are whole."""
        return self._files.partitions()

    def whole(self, names: Collection[str]) -> list[str]:
        """Those of these partitions that are there and whole, by name."""
        self._files.forget()
        return [name for name in self._files.partitions() if name in names and self._files.has(f"{name}/{MARK}")]

    def commits(self) -> list[Commit]:
        """All partitions, by name. Raises InputError where there is no dataset, or a mark is damaged."""
        self._files.forget()
        if not self._files.is_folder():
            raise InputError(self.address, "no such dataset", "one that `yieldmon fleet run` wrote")
        return [commit for name in self._files.partitions() if (commit := self.commit_of(name)) is not None]

    @property
    def unfinished(self) -> bool:
        """Whether a run is under way, was interrupted, or left days to the next one."""
        return self._files.has(RUN)

    def failures(self) -> list[dict[str, Any]]:
        """What could not be measured: machine, day, problem. Raises InputError where that is damaged."""
        found = (marks.failure_of(self._files, name) for name in self._files.failures())
        return [failure for failure in found if failure is not None]

    def path(self, name: str, table: str) -> str:
        """A table of a partition, as its file system names it."""
        return self._files.path(f"{name}/{table}.parquet")

    @property
    def filesystem(self) -> Any:
        """Of fsspec; None for files of this machine."""
        return self._files.filesystem

    def place_of(self, name: str | None) -> str | None:
        """A file that could not be written, as a person knows it: the dataset for what is under way. Writing does not always name
        its file."""
        return self._files.place_of(name)

    # A partition's way into it

    def workspace(self) -> AbstractContextManager[Path]:
        """A folder of this machine to write a partition's files to; it goes at the end."""
        return self._files.workspace()

    def commit(self, name: str, folder: Path, content: Mapping[str, Any], token: str) -> None:
        """Make the files in the folder the partition of that name, in place of one that is there.

        Raises Superseded where the token is not that of the run under way.
        """
        paths = sorted(path for path in folder.iterdir() if path.is_file())
        mark = marks.mark_of(content, paths)
        self.require(token)
        self._files.put_marked(name, folder, paths, mark)
        self._files.remove(_note(name))

    def fail(self, name: str, problem: Mapping[str, Any], token: str) -> None:
        """Note that a partition cannot be measured; what an earlier run made of it stays, with the key of that run."""
        self.require(token)
        self._files.put(_note(name), marks.document(problem))

    def withdraw_failures(self, names: Collection[str], token: str) -> None:
        """Remove what is noted of partitions that are there after all, as from the same inputs."""
        noted = {*map(_note, names)} & {*self._files.failures()}
        if noted and self._is_owner(token):
            for name in noted:
                self._files.remove(name)


def _note(name: str) -> str:
    """Where it is noted that a partition cannot be measured."""
    return f"{FAILED}/{name}.json"

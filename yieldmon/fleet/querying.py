"""DuckDB over the committed partitions of a dataset."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yieldmon.errors import InputError
from yieldmon.fleet import tables
from yieldmon.fleet.dataset import Dataset
from yieldmon.fleet.marks import Commit

_TRACE = "Traceback (most recent call last)"


class Query:
    """Tables of one dataset as views of their names, each with the columns machine and day beside its own."""

    def __init__(self, database: Any, dataset: Dataset, commits: Sequence[Commit], wanted: Sequence[str]) -> None:
        self._database = database
        self.dataset = dataset
        self.commits = tuple(commits)
        self._wanted = tuple(wanted)
        self._by_place = {(commit.machine, commit.day): commit for commit in self.commits}

    def rows(self, statement: str, values: Sequence[Any] = ()) -> list[dict[str, Any]]:
        """What a statement gives, a mapping a row. Raises InputError where a table cannot be read, OSError where a
        storage fails."""
        with _readable(self.dataset, self.commits, self._wanted):
            found = self._database.execute(statement, list(values))
            names = [column[0] for column in found.description]
            return [dict(zip(names, row, strict=True)) for row in found.fetchall()]

    def columns(self, statement: str) -> dict[str, NDArray[Any]]:
        """What a statement gives, an array a column, for many rows of numbers; null is nan. Raises InputError as `rows`."""
        with _readable(self.dataset, self.commits, self._wanted):
            found = self._database.execute(statement).fetchnumpy()
        return {name: np.ma.filled(column, np.nan) if np.ma.isMaskedArray(column) else column for name, column in found.items()}

    def of_partition(self, table: str, machine: str, day: str) -> str:
        """A table of one partition, to stand behind FROM: without a look at the files of all others, as a view takes.
        Raises InputError where it is damaged."""
        commit = self._by_place[machine, day]
        self.dataset.check(commit, table)
        located = _located(self.dataset, commit, table)
        return f"read_parquet({_quoted(located)}, hive_partitioning=false)"

    def table(self, statement: str, values: Sequence[Any] = ()) -> Any:
        """The same as a pyarrow table."""
        with _readable(self.dataset, self.commits, self._wanted):
            return self._database.sql(statement, params=list(values)).to_arrow_table()


@contextmanager
def _readable(dataset: Dataset, commits: Sequence[Commit], wanted: Sequence[str]) -> Iterator[None]:
    """Raises InputError for what DuckDB cannot read: of the damaged partition where one is. wanted: tables that may be read."""
    import duckdb

    try:
        yield
    except (duckdb.Error, UnicodeDecodeError) as error:
        lines = [line for line in str(error).splitlines() if line.strip()]
        if lines and _TRACE in lines[0]:
            # DuckDB reads an object store by way of fsspec: what that said follows its calls, which are indented.
            said = [line for line in lines[1:] if not line.startswith((" ", "LINE "))]
            raise OSError(f"{dataset.address}: {(said or lines)[-1][:300]}") from error
        for commit in commits:
            for table in wanted:
                dataset.check(commit, table)
        problem = str(error).partition("\n")[0][:300]
        raise InputError(dataset.address, problem, "tables as `yieldmon fleet run` wrote them") from error


@contextmanager
def opened(address: str, wanted: Sequence[str] = tables.TABLES) -> Iterator[Query]:
    """A dataset to query.

    Parameters
    ----------
    address : str
        Of the dataset.
    wanted : sequence of str
        Tables that are asked for: before the first query the hash of each file is compared with the partition's mark, of the
        records, which are large, the size.

    Yields
    ------
    Query

    Raises
    ------
    InputError
        There is no dataset, nothing is committed in it, or a table is not what its mark says.
    """
    import duckdb

    dataset = Dataset(address)
    commits = dataset.commits()
    if not commits:
        raise InputError(address, "holds no partition", "a dataset that `yieldmon fleet run` wrote")
    # Days that another release measured may lack columns, which are null there; to find out takes half as long again.
    by_name = "true" if len({str(commit.content.get("software")) for commit in commits}) > 1 else "false"
    with duckdb.connect() as database:
        if dataset.filesystem is not None:
            database.register_filesystem(dataset.filesystem)
        for table in wanted:
            for commit in commits:
                if table == tables.RECORDS:
                    dataset.check_sizes(commit)
                else:
                    dataset.check(commit, table)
            paths = [_located(dataset, commit, table) for commit in commits]
            listed = ", ".join(_quoted(path) for path in paths)
            kinds = "{'machine': VARCHAR, 'day': VARCHAR}"
            with _readable(dataset, commits, wanted):
                options = f"union_by_name={by_name}, hive_partitioning=true, hive_types={kinds}"
                database.execute(f"CREATE VIEW {table} AS SELECT * FROM read_parquet([{listed}], {options})")
        yield Query(database, dataset, commits, wanted)


def _located(dataset: Dataset, commit: Commit, table: str) -> str:
    path = dataset.path(commit.name, table)
    located = path if dataset.filesystem is None else str(dataset.filesystem.unstrip_protocol(path))
    # DuckDB takes a path for a pattern: season[1] would be season1.
    return "".join(f"[{character}]" if character in "*?[" else character for character in located)


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"

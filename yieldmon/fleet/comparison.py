"""Two datasets of the same logs, by different parameters or software: where and how their results differ."""

from __future__ import annotations

from collections import Counter
from typing import Any, get_args

from yieldmon.documents.fleet import Cause, ColumnDifference, DayDifference, FleetCompareDocument
from yieldmon.fleet import tables
from yieldmon.fleet.marks import Commit
from yieldmon.fleet.querying import Query, opened

_SUMS = "SELECT count(*) AS seconds, coalesce(sum(mass_kg), 0.0) AS mass_kg FROM {}"
_CAUSES: tuple[Cause, ...] = get_args(Cause)
_ROWS = "SELECT * FROM {} ORDER BY number"


def compare(first: str, second: str) -> FleetCompareDocument:
    """Compare two datasets.

    Parameters
    ----------
    first, second : str
        Addresses; differences are second less first.

    Returns
    -------
    dict
        only_in_first, only_in_second: partitions; equal: how many are so to the byte; columns_only_in_first,
        columns_only_in_second: of the records, with the number of partitions, as of two releases; different: for each other
        partition its masses, its tables that differ, and by column of the records in how many seconds.

    Raises
    ------
    InputError
        One of them is no dataset, or a table of a partition that both have is not what its mark says.
    """
    with opened(first, ()) as before, opened(second, ()) as after:
        ours, theirs = ({commit.name: commit for commit in query.commits} for query in (before, after))
        both = [name for name in ours if name in theirs]
        unequal = [name for name in both if _files(ours[name]) != _files(theirs[name])]
        for name in both:
            _check(ours[name], before)
            _check(theirs[name], after)
        found = [_difference(ours[name], theirs[name], before, after) for name in unequal]
        changes = Counter(reason for item, _ in found for reason in item["because"])
        only = [Counter(name for _, lacking in found for name in lacking[side]) for side in (0, 1)]
    return {
        "first": first,
        "second": second,
        "partitions": len(both),
        "only_in_first": [name for name in ours if name not in theirs],
        "only_in_second": [name for name in theirs if name not in ours],
        "equal": len(both) - len(unequal),
        "because": dict(changes),
        "columns_only_in_first": dict(only[0]),
        "columns_only_in_second": dict(only[1]),
        "different": [item for item, _ in found],
    }


def _files(commit: Commit) -> dict[str, str]:
    """What the results are: all tables but where they came from."""
    return {name: entry["sha256"] for name, entry in commit.content["files"].items() if name != f"{tables.PROVENANCE}.parquet"}


def _check(commit: Commit, query: Query) -> None:
    """Raises InputError where a table is not what the mark says: the marks of damaged tables are equal too."""
    for name in _files(commit):
        query.dataset.check(commit, name.removesuffix(".parquet"))


def _difference(ours: Commit, theirs: Commit, before: Query, after: Query) -> tuple[DayDifference, tuple[list[str], list[str]]]:
    """And the columns of the records that the first or the second alone has."""
    records = [query.of_partition(tables.RECORDS, ours.machine, ours.day) for query in (before, after)]
    sums = [query.rows(_SUMS.format(each))[0] for query, each in zip((before, after), records, strict=True)]
    a, b = (query.table(_ROWS.format(each)) for query, each in zip((before, after), records, strict=True))
    names = sorted({*_files(ours), *_files(theirs)})
    mass = [entry["mass_kg"] for entry in sums]
    difference: DayDifference = {
        "machine": ours.machine,
        "day": ours.day,
        "because": [key for key in _CAUSES if ours.content[key] != theirs.content[key]],
        "tables": [name.partition(".")[0] for name in names if _files(ours).get(name) != _files(theirs).get(name)],
        "seconds": [entry["seconds"] for entry in sums],
        "mass_kg": mass,
        "mass_change_pct": 100.0 * (mass[1] / mass[0] - 1.0) if mass[0] else None,
        "columns": _columns(a, b),
    }
    ours_alone = [name for name in a.column_names if name not in b.column_names]
    return difference, (ours_alone, [name for name in b.column_names if name not in a.column_names])


def _columns(first: Any, second: Any) -> dict[str, ColumnDifference]:
    """Of each column that differs: in how many seconds, the first of them, and the largest difference of numbers."""
    import pyarrow as pa
    import pyarrow.compute as pc

    count = min(first.num_rows, second.num_rows)
    ours, theirs = (table.slice(0, count) for table in (first, second))
    found = {}
    for name in ours.column_names:
        if name not in theirs.column_names:
            continue
        a, b = ours[name].combine_chunks(), theirs[name].combine_chunks()
        numbers = all(pa.types.is_integer(each.type) or pa.types.is_floating(each.type) for each in (a, b))
        if not numbers and a.type != b.type:
            # Of another kind in another release: as people read it.
            a, b = (each.cast(pa.string()) for each in (a, b))
        same = pc.or_kleene(pc.equal(a, b), pc.and_(pc.is_null(a), pc.is_null(b)))
        differs = pc.invert(pc.fill_null(same, False))
        seconds = pc.sum(differs).as_py() or 0
        if not seconds:
            continue
        entry: ColumnDifference = {"seconds": seconds, "first_number": pc.filter(ours["number"], differs)[0].as_py()}
        if numbers:
            entry["largest"] = pc.max(pc.abs(pc.subtract(b, a))).as_py()
        found[name] = entry
    return found

"""Recorded seconds from wherever they are: a daemon's store, or a table that `process` wrote."""

from __future__ import annotations

import csv
import dataclasses
import json
import logging
import types
import typing
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from yieldmon import bounded, file_kinds
from yieldmon.arguments import require_path
from yieldmon.bus.log_files.sqlite_log import SUFFIX as LOG_SUFFIX
from yieldmon.bus.log_files.sqlite_log import is_log
from yieldmon.documents.tickets import ListedTicket
from yieldmon.errors import InputError, brief
from yieldmon.estimation.parameter_origin import ParameterOrigin
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files import parameter_file
from yieldmon.service.storage import ledger
from yieldmon.service.storage.ledger import LoadRecord
from yieldmon.service.storage.load_ends import between_loads
from yieldmon.service.storage.rows import SecondRow
from yieldmon.service.storage.store import Store
from yieldmon.service.storage.store_errors import StoreDamagedError, StoreError
from yieldmon.service.tickets.action_log import ActionLog
from yieldmon.units import counted

_log = logging.getLogger(__name__)

STORE_SUFFIXES = (".sqlite", ".sqlite3", ".db")
SUFFIXES = (*STORE_SUFFIXES, ".csv", ".jsonl", ".parquet")

_HINTS = typing.get_type_hints(SecondRow)
_OPTIONAL = {name for name, hint in _HINTS.items() if isinstance(hint, types.UnionType)}
_KINDS = {
    name: next(kind for kind in (float, int, str) if kind in (hint, *typing.get_args(hint))) for name, hint in _HINTS.items()
}


#: Bounds of all numbers, and of those that a place, a time or a share of something is made of.
_LIMITS: dict[str, tuple[float, float]] = {
    **{name: (-1e15, 1e15) for name, kind in _KINDS.items() if kind is not str},
    "time_s": (-1e9, 2e11), "duration_s": (1e-6, 1e6), "mass_kg": (0.0, 1e9), "latitude_deg": (-90.0, 90.0),
    "longitude_deg": (-180.0, 180.0), "ground_speed_m_s": (0.0, 1e3), "course_deg": (-360.0, 720.0), "quality": (0, 255),
    "moisture_pct": (0.0, 100.0),
}  # fmt: skip


def is_store(path: str | Path) -> bool:
    """Whether a name is a store's."""
    return Path(path).suffix.lower() in STORE_SUFFIXES


def is_store_not_log(path: str | Path) -> bool:
    """`is_store` where bus logs stand beside stores: python-can names a log in a database .db as well, and a file of that name
    that is no database is a damaged log, or none.
    """
    return is_store(path) and (Path(path).suffix.lower() != LOG_SUFFIX or (not is_log(path) and not _is_no_database(path)))


def _is_no_database(path: str | Path) -> bool:
    """Whether a file is there that does not begin as SQLite's do."""
    if not Path(path).is_file():
        return False
    with Path(path).open("rb") as file:
        return file.read(len(file_kinds.SQLITE)) != file_kinds.SQLITE


def read_seconds(path: Path | str) -> list[SecondRow]:
    """The seconds in a store or in a table of `process`, in order.

    Parameters
    ----------
    path : path
        .sqlite, .sqlite3 or .db; .csv, .jsonl or .parquet.

    Returns
    -------
    list of SecondRow

    Raises
    ------
    InputError
        For a file that is missing, of another kind, or has a column or value that does not belong.

    Examples
    --------
    >>> api.read_seconds("/no/such.csv")
    Traceback (most recent call last):
        ...
    yieldmon.errors.InputError: /no/such.csv: no such file; expected a store, or a table that `yieldmon process` wrote
    """
    require_path(path)
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(str(path), f"unknown kind of record {suffix!r}", f"a name that ends in one of {', '.join(SUFFIXES)}")
    if not path.is_file():
        raise InputError(str(path), bounded.why_no_file(path), "a store, or a table that `yieldmon process` wrote")
    damaged: list[int] = []
    if suffix in STORE_SUFFIXES:
        with opened(path) as store:
            rows = store.seconds(on_damage=damaged.append)
        if damaged:
            numbers = ", ".join(map(str, damaged[:5])) + (" ..." if len(damaged) > 5 else "")
            _log.warning("%s: %s damaged and left out (number %s)", path, counted(len(damaged), "second"), numbers)
        for row in rows:
            _check(row, f"{path}: second {row.number}")
        return rows
    # A CSV's header is its first line; Parquet has rows alone.
    first, said = {".csv": (2, "line"), ".jsonl": (1, "line")}.get(suffix, (1, "row"))
    return [_row(values, f"{path}: {said} {number}") for number, values in enumerate(_tables(path, suffix), first)]


def read_loads(path: Path | str) -> list[LoadRecord]:
    """The loads of a store, as measured, recomputed and weighed.

    Parameters
    ----------
    path : path
        .sqlite, .sqlite3 or .db.

    Returns
    -------
    list of LoadRecord
        number, field, crop, started_s, ended_s (Unix time), area_m2, and masses in kg: mass_kg as measured, posted_mass_kg as
        recomputed, ticket_mass_kg as weighed, corrected_mass_kg the best of these.

    Raises
    ------
    InputError
        For a file that is not a store.

    Examples
    --------
    >>> sum(load.corrected_mass_kg for load in api.read_loads("/no/such.sqlite"))
    Traceback (most recent call last):
        ...
    yieldmon.errors.InputError: /no/such.sqlite: no such file; expected a daemon's store
    """
    require_path(path)
    if Path(path).suffix.lower() in SUFFIXES and not is_store(path):
        raise InputError(str(path), "is a table of seconds, which has no loads", "a daemon's store")
    with opened(Path(path)) as store:
        return corrected_loads(store)


def corrected_loads(store: Store) -> list[LoadRecord]:
    """All loads of a store that is open, with all their masses."""
    return [LoadRecord(**row) for row in store.corrected_loads()]


@contextmanager
def opened(path: Path) -> Iterator[Store]:
    """A store to read: as it is, and it stays so. Raises InputError, also for what fails while it is open."""
    try:
        with Store.reading(path) as store:
            yield store
    except StoreError as error:
        sound = "a sound store: a daemon puts it right when it starts"
        expected = sound if isinstance(error, StoreDamagedError) else "a daemon's store"
        raise InputError(str(path), str(error).removeprefix(f"{path}: "), expected) from error


def ticket_table(store: Store) -> list[ListedTicket]:
    """All tickets of a store, as the daemon that wrote it last would list them."""
    state = store.state() or {}
    waiting, of_crop = state.get("unfinished_tickets", ()), state.get("unfinished_tickets_of_crop", {})
    log = ActionLog(store.tickets(), store.actions(), 0.0, waiting, of_crop)
    return log.ticket_table(state.get("doubted_loads", ()))


def changed_at(store: Store) -> int:
    """Version of the parameters with which calibration began anew after the last change of the machine's parts; 0 for none."""
    undone = ledger.undone_versions(store.actions())
    begun = (v.version for v in store.parameter_versions() if v.origin == ParameterOrigin.HARDWARE and v.version not in undone)
    return max(begun, default=0)


def parameter_sets(store: Store) -> dict[int, ParameterSet]:
    """The parameters that a store has, by version, the oldest first."""
    return {
        known.version: parameter_file.from_document(known.document, f"{store.path}: version {known.version}")
        for known in store.parameter_versions()
    }


def seconds_between_loads(path: Path, rows: Iterable[SecondRow]) -> frozenset[int]:
    """Numbers of those of a store's seconds that belong to no load. Raises InputError."""
    with opened(path) as store:
        return between_loads(rows, store.loads())


def last_parameters(path: Path) -> ParameterSet:
    """The parameters that a store's daemon used last. Raises InputError, also where it holds none."""
    with opened(path) as store:
        versions = store.parameter_versions()
    if not versions:
        raise InputError(str(path), "holds no parameters", "the store of a daemon that has run")
    return parameter_file.from_document(versions[-1].document, str(path))


def _tables(path: Path, suffix: str) -> Iterable[Mapping[str, Any]]:
    try:
        if suffix == ".parquet":
            import pyarrow
            import pyarrow.parquet

            try:
                rows: list[Mapping[str, Any]] = pyarrow.parquet.read_table(path).to_pylist()
            except (pyarrow.ArrowException, OSError) as error:
                raise InputError(str(path), brief(error), "a Parquet file") from error
            return rows
        with path.open(encoding="utf-8", newline="") as stream:
            lines = bounded.lines(stream, str(path), "a table that `yieldmon process` wrote")
            return list(csv.DictReader(lines)) if suffix == ".csv" else [json.loads(line) for line in lines]
    except UnicodeDecodeError as error:
        raise InputError(str(path), f"byte {error.start} is not UTF-8", "a table that `yieldmon process` wrote") from error
    except (json.JSONDecodeError, csv.Error, RecursionError) as error:
        raise InputError(str(path), str(error), "a table that `yieldmon process` wrote") from error


def _row(values: Mapping[str, Any], where: str) -> SecondRow:
    if not isinstance(values, Mapping):
        raise InputError(where, "is not a record", "one JSON object a line")
    fields = {}
    for field in dataclasses.fields(SecondRow):
        if field.name not in values:
            if field.default is None:
                # A column that came later than the table.
                continue
            raise InputError(where, f"has no column '{field.name}'", "a table that `yieldmon process` wrote")
        fields[field.name] = _value(field.name, values[field.name], where)
    row = SecondRow(**fields)
    _check(row, where)
    return row


def _check(row: SecondRow, where: str) -> None:
    """Raises InputError for a number that no second has: what is made of it would fail further on, or mean nothing."""
    for name, (low, high) in _LIMITS.items():
        value = getattr(row, name)
        if value is not None and not low <= value <= high:
            raise InputError(f"{where}: {name}", f"is {value!r}", f"{low:g} to {high:g}")


def _value(name: str, value: Any, where: str) -> Any:
    if name in _OPTIONAL and value in (None, ""):
        return None
    try:
        if value is None:
            raise ValueError
        return _KINDS[name](value)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{where}: {name}", f"is {value!r}", f"a value of kind {_KINDS[name].__name__}") from None

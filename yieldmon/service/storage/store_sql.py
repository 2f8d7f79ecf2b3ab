"""How batches are put into the store's tables, each row with its checksum."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import astuple, fields, replace
from functools import partial
from typing import Any

from yieldmon.engine.mass.budget import MassBudget
from yieldmon.service.storage import schema
from yieldmon.service.storage.batch import Batch, Load
from yieldmon.service.storage.checksums import UNCHECKED, row_checksum
from yieldmon.service.storage.identity import KEY
from yieldmon.service.storage.rows import SecondRow
from yieldmon.service.storage.store_errors import breaks_schema

COLUMNS: Mapping[str, tuple[str, ...]] = {**schema.COLUMNS, "second": tuple(f.name for f in fields(SecondRow))}


def _put(table: str, verb: str = "INSERT") -> str:
    columns = COLUMNS[table]
    return f"{verb} INTO {table} ({', '.join(columns)}, checksum) VALUES ({', '.join('?' * len(columns))}, ?)"


_OF_LOADS = ("load", "load_area", "load_std_dev", "load_budget")
_INSERT_SECOND, _INSERT_SWEEP, _INSERT_FAULT = (_put(table) for table in ("second", "sweep", "fault"))
(
    _UPSERT_LOAD,
    _UPSERT_AREA,
    _UPSERT_STD_DEV,
    _UPSERT_BUDGET,
    _UPSERT_PARAMETERS,
    _UPSERT_COUNTER,
    _UPSERT_STATE,
    _UPSERT_MARK,
    _UPSERT_ACTION,
    _UPSERT_STEP,
) = (_put(table, "INSERT OR REPLACE") for table in (*_OF_LOADS, "parameter_set", "counter", "state", "mark", "action", "step"))
# A batch that is written again, to a store made anew, does not enter a ticket twice.
_INSERT_TICKET = (
    f"INSERT INTO ticket ({', '.join(COLUMNS['ticket'])}, checksum) SELECT ?1, ?2, ?3, ?4, ?5, ?6, ?7 WHERE NOT EXISTS "
    "(SELECT 1 FROM ticket WHERE time_s = ?1 AND first_load = ?2 AND last_load = ?3 AND weighed_mass_kg = ?4 AND note = ?6)"
)

#: What of a batch is put row by row, and how a row is named where it is left out.
_LABELS: Mapping[str, str] = {
    "seconds": "second {0.number}",
    "loads": "load {0.number}",
    "sweeps": "a sweep that ended as {0.outcome}",
    "parameter_versions": "parameter version {0.version}",
    "faults": "fault {0.code}",
    "tickets": "ticket for load {0.first_load}",
    "actions": "action {0.number} ({0.kind})",
    "steps": "step to version {0.version}",
}


def write(database: sqlite3.Connection, batch: Batch, identity: int) -> None:
    """Put all of a batch into its tables. identity: of the store, which the state carries."""
    _write_rows(database, batch)
    _write_state(database, batch, identity)


def write_in_part(database: sqlite3.Connection, batch: Batch, identity: int) -> list[str]:
    """As `write`, row by row; those that break the schema are left out, and for such a state the one before it stands. Returns
    what was left out, and why."""
    left_out = []

    def tried(what: str, put: Callable[[], None]) -> None:
        try:
            put()
        except (sqlite3.Error, TypeError, ValueError, OverflowError) as error:
            if not breaks_schema(error):
                raise
            left_out.append(f"{what}: {error}")

    empty = Batch(batch.number, batch.time_s, {})
    for name, label in _LABELS.items():
        for row in getattr(batch, name):
            alone: dict[str, Any] = {name: (row,)}
            tried(label.format(row), partial(_write_rows, database, replace(empty, **alone)))
    for name, value in batch.counters.items():
        tried(f"counter {name}", partial(_write_rows, database, replace(empty, counters={name: value})))
    before = database.execute("SELECT document FROM state ORDER BY batch DESC LIMIT 1").fetchone()
    if before is not None:
        # Under the new number, so that commits are counted on.
        _write_state(database, replace(batch, state=json.loads(before[0])), identity)
    tried("the monitor's state", partial(_write_state, database, batch, identity))
    return left_out


def _write_rows(database: sqlite3.Connection, batch: Batch) -> None:
    executemany = database.executemany
    executemany(_INSERT_SECOND, (_summed("second", astuple(row)) for row in batch.seconds))
    executemany(_UPSERT_LOAD, (_summed("load", _of_load(load)) for load in batch.loads))
    # A load that is in the batch twice counts as it is in its last row.
    loads = {load.number: load for load in batch.loads}.values()
    for table, upsert, values in (
        ("load_area", _UPSERT_AREA, [(load.number, load.area_m2) for load in loads]),
        ("load_std_dev", _UPSERT_STD_DEV, [(load.number, load.std_dev_kg) for load in loads]),
        ("load_budget", _UPSERT_BUDGET, [(load.number, *_of_budget(load.budget)) for load in loads]),
    ):
        # What is not known any more has no row either.
        executemany(f"DELETE FROM {table} WHERE number = ?", ((number,) for number, *value in values if None in value))
        executemany(upsert, (_summed(table, row) for row in values if None not in row))
    executemany(_INSERT_SWEEP, (_summed("sweep", (s.time_s, s.outcome, s.reason, _json(s.document))) for s in batch.sweeps))
    executemany(
        _UPSERT_PARAMETERS,
        (_summed("parameter_set", (p.version, p.time_s, p.origin, _json(p.document))) for p in batch.parameter_versions),
    )
    executemany(_INSERT_FAULT, (_summed("fault", astuple(fault)) for fault in batch.faults))
    executemany(_INSERT_TICKET, (_summed("ticket", astuple(ticket)) for ticket in batch.tickets))
    executemany(
        _UPSERT_ACTION, (_summed("action", (a.number, a.time_s, a.kind, a.who, _json(a.document))) for a in batch.actions)
    )
    executemany(_UPSERT_STEP, (_summed("step", (s.version, s.time_s, _json(s.document))) for s in batch.steps))
    executemany(_UPSERT_COUNTER, (_summed("counter", item) for item in batch.counters.items()))


def _of_load(load: Load) -> tuple[Any, ...]:
    return tuple(getattr(load, name) for name in COLUMNS["load"])


def _of_budget(budget: MassBudget | None) -> tuple[float | None, ...]:
    return (None,) if budget is None else astuple(budget)


def _write_state(database: sqlite3.Connection, batch: Batch, identity: int) -> None:
    row = (batch.number % 2, batch.number, batch.time_s, _json({**batch.state, KEY: identity}))
    database.execute(_UPSERT_STATE, _summed("state", row))


def write_mark(database: sqlite3.Connection, name: str, value: int) -> None:
    """Put a mark."""
    database.execute(_UPSERT_MARK, _summed("mark", (name, value)))


def second_is_sound(row: Sequence[Any], checksum: Any, unchecked_to: int) -> bool:
    """Whether a row of `second` is as it was written; rows from number 1 up to `unchecked_to` may have no checksum. In a zeroed
    sector SQLite sees rows of number 0 that have every column's default."""
    if checksum == UNCHECKED:
        return isinstance(row[0], int) and 1 <= row[0] <= unchecked_to
    return any(row_checksum("second", *(row[place] for place in places)) == checksum for places in schema.SECOND_CHECKED)


def statements(script: str) -> Iterator[str]:
    """The statements of a script one by one: executescript() would commit the transaction around them."""
    statement = ""
    for line in script.splitlines(keepends=True):
        statement += line
        if sqlite3.complete_statement(statement):
            yield statement
            statement = ""


def _json(document: Mapping[str, Any]) -> str:
    return json.dumps(document, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _summed(table: str, row: Sequence[Any]) -> tuple[Any, ...]:
    return (*row, row_checksum(table, *row))

"""What a store holds, read back: rows against their checksums, documents, and the loads as corrected."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Self

from yieldmon.documents.loads import ListedLoad
from yieldmon.engine.mass.budget import MassBudget
from yieldmon.service.storage import schema
from yieldmon.service.storage.batch import Action, FaultEvent, Load, ParameterVersion, Step, SweepRecord, Ticket
from yieldmon.service.storage.checksums import row_checksum
from yieldmon.service.storage.identity import KEY
from yieldmon.service.storage.ledger import ledger
from yieldmon.service.storage.rows import SecondRow
from yieldmon.service.storage.store_errors import StoreDamagedError, failures_of
from yieldmon.service.storage.store_sql import COLUMNS, second_is_sound

#: Schema version that brought the loads' areas.
_AREAS_FROM = 7
_LOAD_STD_DEVS_FROM = 13
_LOAD_BUDGETS_FROM = 14


class StoredRows:
    """An open database and what is in it.

    Raises StoreError from every method when the file or the medium fails, StoreDamagedError for what is not as it was written.
    """

    path: Path
    _database: sqlite3.Connection
    _unchecked_to: int | None
    """Seconds up to this number may lack a checksum; None: the store is of a version without any."""

    def close(self) -> None:
        """Close the file. What was committed is safe with or without it."""
        self._database.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _version(self) -> int:
        return int(self._pragma("user_version"))

    def _mark(self, name: str) -> int:
        found = [value for mark, value in self._checked("mark") if mark == name]
        if not found:
            raise StoreDamagedError(f"{self.path}: has no mark {name!r}")
        return int(found[0])

    def _pragma(self, name: str) -> Any:
        return self._database.execute(f"PRAGMA {name}").fetchone()[0]

    def last_batch(self) -> int:
        """Number of the last batch committed, 0 in a new store."""
        with failures_of(self.path):
            row = self._database.execute("SELECT max(batch) FROM state").fetchone()
        return int(row[0] or 0)

    def state(self) -> dict[str, Any] | None:
        """The monitor's state of the last batch, None in a new store."""
        if self._unchecked_to is None:
            with failures_of(self.path):
                rows = self._database.execute("SELECT batch, document FROM state").fetchall()
        else:
            rows = [(batch, document) for _, batch, _, document in self._checked("state")]
        document = self._document(max(rows)[1]) if rows else None
        return {name: value for name, value in document.items() if name != KEY} if isinstance(document, dict) else document

    def _document(self, text: Any) -> Any:
        try:
            return json.loads(text)
        except (ValueError, TypeError, RecursionError) as error:
            raise StoreDamagedError(f"{self.path}: a document is not JSON: {error}") from error

    def seconds(self, first_number: int = 0, on_damage: Callable[[int], None] | None = None) -> list[SecondRow]:
        """One-second records from `first_number` on, in order.

        on_damage: called with the number of each row that is not as it was written, which is then left out; without it such a
        row raises StoreDamagedError.
        """
        if first_number <= 1:
            # From end to end: a search is led astray by a damaged row, and what it passes over would be missed unsaid.
            return self._seconds("ORDER BY number", (), on_damage)
        return self._seconds("WHERE number >= ? ORDER BY number", (first_number,), on_damage)

    def seconds_of_load(self, load_number: int, on_damage: Callable[[int], None] | None = None) -> list[SecondRow]:
        """The records with a load's number, in order; load numbers never fall, so few others are looked at. on_damage: as in
        `seconds`."""
        with failures_of(self.path):
            ends = "SELECT coalesce(min(number), 0), coalesce(max(number), -1) FROM second"
            low, high = self._database.execute(ends).fetchone()
            nearest = "SELECT number, load_number FROM second WHERE number >= ? ORDER BY number LIMIT 1"
            while low < high:
                middle = (low + high) // 2
                here = self._database.execute(nearest, (middle,)).fetchone()
                low, high = (here[0] + 1, high) if here[1] < load_number else (low, middle)
            beyond = "SELECT number FROM second WHERE number >= ? AND load_number != ? ORDER BY number LIMIT 1"
            end = self._database.execute(beyond, (low, load_number)).fetchone()
        values = (low, 2**62 if end is None else end[0])
        return self._seconds("WHERE number >= ? AND number < ? ORDER BY number", values, on_damage)

    def seconds_of_sweeps(self) -> list[SecondRow]:
        """The records that a sweep may use, in order. Raises StoreDamagedError for one that is not as it was written."""
        return self._seconds("WHERE usable_for_calibration = 1 ORDER BY number")

    def oldest_second(self) -> int:
        """Number of the oldest one-second record; 0 where there is none."""
        with failures_of(self.path):
            return int(self._database.execute("SELECT coalesce(min(number), 0) FROM second").fetchone()[0])

    def last_second(self) -> SecondRow | None:
        """The newest one-second record."""
        rows = self._seconds("ORDER BY number DESC LIMIT 1")
        return rows[0] if rows else None

    def _seconds(
        self, source: str, values: tuple[Any, ...] = (), on_damage: Callable[[int], None] | None = None
    ) -> list[SecondRow]:
        columns = schema.second_columns(self._version())
        if self._unchecked_to is None:
            return [SecondRow(*row) for row in self._rows_of(columns, f"second {source}", values)]
        rows = []
        with failures_of(self.path):
            for *found, checksum in self._database.execute(f"SELECT {columns}, checksum FROM second {source}", values):
                if second_is_sound(found, checksum, self._unchecked_to):
                    rows.append(SecondRow(*found))
                elif on_damage is None:
                    raise StoreDamagedError(f"{self.path}: second {found[0]} is damaged")
                else:
                    on_damage(found[0])
        return rows

    def _checked(self, table: str, source: str = "", values: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
        """Rows of a table without their checksums, which are held against them."""
        columns = COLUMNS[table]
        order = source or f"ORDER BY {schema.KEYS[table]}"
        with failures_of(self.path):
            if self._database_is_older():
                return self._database.execute(f"SELECT {', '.join(columns)} FROM {table} {order}", values).fetchall()
            rows = self._database.execute(f"SELECT {', '.join(columns)}, checksum FROM {table} {order}", values).fetchall()
        for *found, checksum in rows:
            if row_checksum(table, *found) != checksum:
                raise StoreDamagedError(f"{self.path}: {table} {str(found[0])[:40]!r} is damaged")
        return [tuple(row[:-1]) for row in rows]

    def _database_is_older(self) -> bool:
        return self._version() < schema.CHECKED_FROM

    def loads(self) -> list[Load]:
        """All loads as measured, in order."""
        if self._version() < 2:
            columns = ", ".join(COLUMNS["load"][:-1])
            return self._of_kind(Load, ((*row, None) for row in self._rows_of(columns, "load ORDER BY number")))
        areas = dict(self._checked("load_area")) if self._version() >= _AREAS_FROM else {}
        deviations = dict(self._checked("load_std_dev")) if self._version() >= _LOAD_STD_DEVS_FROM else {}
        stated = self._checked("load_budget") if self._version() >= _LOAD_BUDGETS_FROM else []
        budgets = {number: MassBudget(*causes) for number, *causes in stated}
        return self._of_kind(
            Load, ((*row, *(known.get(row[0]) for known in (areas, deviations, budgets))) for row in self._checked("load"))
        )

    def corrected_loads(self) -> list[ListedLoad]:
        """All loads as measured, as measured again, as weighed, and the best of these."""
        standing = ledger(self.tickets(), self.actions())
        return standing.rows(self.loads())

    def tickets(self) -> list[Ticket]:
        """All tickets in the order they were entered."""
        return [] if self._version() < 2 else self._of_kind(Ticket, self._checked("ticket"))

    def actions(self) -> list[Action]:
        """What was entered, updated and taken back, in order."""
        return self._with_documents(Action, "action")

    def steps(self) -> list[Step]:
        """The steps between updates of the parameters, in order."""
        return self._with_documents(Step, "step")

    def _with_documents(self, row_type: type, table: str) -> list[Any]:
        if self._version() < schema.ACTIONS_FROM:
            return []
        return self._of_kind(row_type, ((*rest, self._document(text)) for *rest, text in self._checked(table)))

    def faults(self, limit: int = 100) -> list[FaultEvent]:
        """The newest `limit` fault events, oldest first."""
        rows = self._checked("fault", "ORDER BY id DESC LIMIT ?", (limit,))
        return [FaultEvent(time_s, code, bool(active), detail) for time_s, code, active, detail in reversed(rows)]

    def sweeps(self, limit: int = 100) -> list[SweepRecord]:
        """The newest `limit` sweeps, oldest first."""
        rows = self._checked("sweep", "ORDER BY id DESC LIMIT ?", (limit,))
        return self._of_kind(SweepRecord, ((*rest, self._document(document)) for *rest, document in reversed(rows)))

    def parameter_versions(self) -> list[ParameterVersion]:
        """All parameter versions, in order."""
        rows = self._checked("parameter_set")
        return self._of_kind(ParameterVersion, ((*rest, self._document(document)) for *rest, document in rows))

    def counters(self) -> dict[str, int]:
        """Counters by name."""
        return dict(self._checked("counter"))

    @staticmethod
    def _of_kind(row_type: type, rows: Iterable[Sequence[Any]]) -> list[Any]:
        return [row_type(*row) for row in rows]

    def _rows_of(self, columns: str, source: str, values: Iterable[Any] = ()) -> list[tuple[Any, ...]]:
        with failures_of(self.path):
            return self._database.execute(f"SELECT {columns} FROM {source}", tuple(values)).fetchall()

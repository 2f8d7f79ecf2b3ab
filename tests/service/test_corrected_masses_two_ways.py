"""Corrected masses by the store's view, for whoever reads it with SQL, and by the ledger: the same whatever was entered, undone
and measured again."""

from __future__ import annotations

import contextlib
import sqlite3
import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from yieldmon.service.storage import ledger
from yieldmon.service.storage.batch import Action, Batch, Load, Ticket
from yieldmon.service.storage.store import Store

LOADS = tuple(Load(n, "f", "corn", 10.0 * n, 10.0 * n + 9.0, 100.0 * n, 80.0 * n if n % 2 else None) for n in range(1, 5))
NUMBERS = st.integers(1, 4)
VERSIONS = st.integers(1, 5)
STEPS = st.lists(
    st.one_of(
        st.tuples(st.just(ledger.TICKET), NUMBERS, st.integers(0, 2), st.sampled_from([0.8, 1.1, 1.2])),
        st.tuples(st.just(ledger.TICKET_UNDO), NUMBERS),
        st.tuples(
            st.just(ledger.REMEASURED), st.lists(NUMBERS, max_size=2), st.integers(0, 5),
            st.dictionaries(NUMBERS, st.sampled_from([0.9, 1.05, 1.3]), min_size=1, max_size=3),
        ),
        st.tuples(st.just(ledger.PARAMETERS_UNDO), VERSIONS, st.one_of(st.none(), st.lists(VERSIONS, max_size=3))),
        st.tuples(st.just(ledger.TOTALS_RESET)),
    ),
    max_size=14,
)  # fmt: skip


def entered(steps: list) -> tuple[list[Ticket], list[Action]]:  # type: ignore[type-arg]
    tickets: list[Ticket] = []
    actions: list[Action] = []
    for time_s, (kind, *rest) in enumerate(steps, 100):
        document: dict[str, object] = {}
        if kind == ledger.TICKET:
            first, more, factor = rest
            last = min(first + more, len(LOADS))
            measured_kg = sum(load.mass_kg for load in LOADS[first - 1 : last])
            tickets.append(Ticket(float(time_s), first, last, factor * measured_kg, measured_kg))
            document = {"ticket": len(tickets), "reference": True}
        elif kind == ledger.TICKET_UNDO:
            document = {"ticket": rest[0]}
        elif kind == ledger.REMEASURED:
            document = {"tickets": rest[0], "version": rest[1], "factors": {str(n): f for n, f in rest[2].items()}}
        elif kind == ledger.PARAMETERS_UNDO:
            document = {"version": rest[0], **({} if rest[1] is None else {"versions": [rest[0], *rest[1]]})}
        actions.append(Action(len(actions) + 1, float(time_s), kind, "", document))
    return tickets, actions


@settings(max_examples=150)
@given(STEPS)
def test_the_view_says_what_the_ledger_says(steps: list) -> None:  # type: ignore[type-arg]
    tickets, actions = entered(steps)
    stands = ledger.ledger(tickets, actions)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "s.sqlite"
        with Store(path) as store:
            store.commit([Batch(1, 1.0, {}, loads=LOADS, tickets=tuple(tickets), actions=tuple(actions))])
            assert store.corrected_loads() == stands.rows(LOADS)
        with contextlib.closing(sqlite3.connect(path)) as database:
            columns = "number, corrected_mass_kg, corrected_dry_mass_kg, ticket_id"
            found = database.execute(f"SELECT {columns} FROM load_corrected ORDER BY number").fetchall()
    for load, row, (number, mass_kg, dry_kg, ticket) in zip(LOADS, stands.rows(LOADS), found, strict=True):
        assert (number, ticket) == (load.number, row["ticket_id"])
        assert mass_kg == pytest.approx(row["corrected_mass_kg"], rel=1e-12)
        assert dry_kg == (None if load.dry_mass_kg is None else pytest.approx(row["corrected_dry_mass_kg"], rel=1e-12))

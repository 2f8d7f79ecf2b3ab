"""Whatever a second brings is read back as it was, in one commit or many, and by a store that is opened anew."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.service.test_store import batch, second
from yieldmon.engine.mass.budget import MassBudget
from yieldmon.service.storage.batch import Action, FaultEvent, Load, ParameterVersion, Step, SweepRecord, Ticket
from yieldmon.service.storage.rows import SecondRow
from yieldmon.service.storage.store import Store

NUMBERS = st.floats(-1e12, 1e12)
SMALL = st.integers(0, 50)
#: All but surrogates, which are no text.
TEXT = st.text(st.characters(exclude_categories=("Cs",)), max_size=6)
DOCUMENTS = st.dictionaries(TEXT, NUMBERS | TEXT | st.booleans() | st.none() | st.lists(NUMBERS, max_size=2), max_size=3)
OPTIONAL = st.none() | NUMBERS
LOADS = st.builds(
    Load, number=SMALL, field=TEXT, crop=TEXT, started_s=OPTIONAL, ended_s=OPTIONAL, mass_kg=NUMBERS, dry_mass_kg=OPTIONAL,
    area_m2=OPTIONAL, std_dev_kg=OPTIONAL, budget=st.none() | st.builds(MassBudget, NUMBERS, NUMBERS, NUMBERS, NUMBERS, NUMBERS),
)  # fmt: skip
EVENTS = {
    "sweeps": st.builds(SweepRecord, NUMBERS, TEXT, TEXT, DOCUMENTS),
    "faults": st.builds(FaultEvent, NUMBERS, TEXT, st.booleans(), TEXT),
}
NUMBERED = {
    "parameter_versions": st.builds(ParameterVersion, SMALL, NUMBERS, TEXT, DOCUMENTS),
    "actions": st.builds(Action, SMALL, NUMBERS, TEXT, TEXT, DOCUMENTS),
    "steps": st.builds(Step, SMALL, NUMBERS, DOCUMENTS),
}
COUNTERS = st.dictionaries(TEXT, st.integers(-(2**62), 2**62), max_size=3)


def some(rows: st.SearchStrategy) -> st.SearchStrategy[list]:
    return st.lists(rows, max_size=3)


CONTENTS = st.fixed_dictionaries({name: some(rows) for name, rows in {**EVENTS, **NUMBERED, "loads": LOADS}.items()})


@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(first=CONTENTS, then=CONTENTS, counters=COUNTERS, state=DOCUMENTS, apart=st.booleans())
def test_rows_of_every_kind_come_back(tmp_path: Path, first: dict, then: dict, counters: dict, state: dict, apart: bool) -> None:
    """Of what has a number the last one with it counts; what has none is kept in order."""
    path = tmp_path / "s"
    for left in tmp_path.iterdir():
        left.unlink()
    batches = [batch(1, **{name: tuple(rows) for name, rows in first.items()})]
    batches.append(batch(2, **{name: tuple(rows) for name, rows in then.items()}, counters=counters, state=state))
    with Store(path) as store:
        for part in [[one] for one in batches] if apart else [batches]:
            store.commit(part)
    with Store(path) as store:
        assert (store.faults(), store.sweeps()) == ([*first["faults"], *then["faults"]], [*first["sweeps"], *then["sweeps"]])
        for name, key in (("parameter_versions", "version"), ("actions", "number"), ("steps", "version")):
            newest = {getattr(row, key): row for row in [*first[name], *then[name]]}
            assert getattr(store, name)() == [newest[number] for number in sorted(newest)], name
        # Also of what is not known any more.
        loads = {load.number: load for load in [*first["loads"], *then["loads"]]}
        assert store.loads() == [loads[number] for number in sorted(loads)]
        assert (store.counters(), store.state(), store.last_batch()) == (counters, state, 2)


@pytest.mark.parametrize(
    "then",
    [{"area_m2": None}, {"std_dev_kg": None}, {"area_m2": 12.0, "std_dev_kg": None}, {"budget": None}],
)
def test_a_load_that_is_in_a_batch_twice_is_kept_as_in_its_last_row(tmp_path: Path, then: dict[str, float | None]) -> None:
    first = Load(7, "field", "corn", 1.7e9, None, 100.0, None, area_m2=10.0, std_dev_kg=2.0, budget=MassBudget(4.0))
    last = replace(first, **then)
    with Store(tmp_path / "s") as store:
        store.commit([batch(1, loads=(first, last))])
        assert store.loads() == [last]


VALUES = {float: NUMBERS, int: st.integers(0, 2**31), str: TEXT}
NEEDED = {field.name for field in fields(SecondRow)} - {field.name for field in fields(SecondRow) if "None" in str(field.type)}


@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_every_column_of_a_second_comes_back(tmp_path: Path, data: st.DataObject) -> None:
    path, plain = tmp_path / "s", second(1)
    for left in tmp_path.iterdir():
        left.unlink()
    changes = {}
    for field in fields(SecondRow):
        if field.name == "number":
            continue
        kind = next(kind for kind in (float, int, str) if kind.__name__ in str(field.type))
        values = VALUES[kind] if field.name in NEEDED else st.none() | VALUES[kind]
        changes[field.name] = data.draw(values, label=field.name)
    row = replace(plain, **changes)
    with Store(path) as store:
        store.commit([batch(1, seconds=(row,))])
    with Store(path) as store:
        assert store.seconds() == [row]
        assert store.last_second() == row
        assert store.oldest_second() == 1


@pytest.mark.parametrize(
    ("first", "last", "weighed_kg", "measured_kg", "note"),
    [(1, 1, 1e-3, 1e-3, ""), (0, 63, 1e6, 1e6, "ä € 雨"), (7, 8, 9.5, 10.25, "x" * 80)],
)
def test_tickets_come_back_once(tmp_path: Path, first: int, last: int, weighed_kg: float, measured_kg: float, note: str) -> None:
    ticket = Ticket(1.7e9, first, last, weighed_kg, measured_kg, note)
    others = [replace(ticket, **{name: value}) for name, value in (("time_s", 1.7e9 + 1), ("note", "other"), ("last_load", 64))]
    with Store(tmp_path / "s") as store:
        store.commit([batch(1, tickets=(ticket, *others))])
        store.commit([batch(2, tickets=(ticket,))])
        assert store.tickets() == [ticket, *others]
    assert ticket.factor == weighed_kg / measured_kg

"""Loads and totals after corrections, against a plain list of masses by load, for any order of what can happen."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isnan, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from yieldmon.engine.mass.load_summary import LoadClosed, LoadSummary
from yieldmon.engine.mass.loads import Loads
from yieldmon.engine.mass.missed_mass import NO_LOAD, MissedMass
from yieldmon.engine.settings import EngineSettings

MARKET_PCT = 15.5


@dataclass
class Sum:
    """kg, dry_kg, unknown_moisture_kg, unknown_area_kg"""

    parts: list[float] = field(default_factory=lambda: [0.0] * 4)

    def add(self, *parts: float) -> None:
        self.parts = [max(known + more, 0.0) for known, more in zip(self.parts, parts, strict=True)]


@dataclass
class Book:
    loads: dict[int, Sum] = field(default_factory=lambda: {1: Sum()})
    number: int = 1
    first: int = 1
    is_open: bool = True
    total: Sum = field(default_factory=Sum)

    def new(self) -> None:
        self.number += 1
        self.loads[self.number] = Sum()
        self.is_open = True

    def reset(self) -> None:
        self.new()
        self.first, self.total = self.number, Sum()

    def count(self, kg: float, moisture_pct: float, area_m2: float) -> None:
        dry = 0.0 if isnan(moisture_pct) else kg * min(1.0, (100.0 - moisture_pct) / (100.0 - MARKET_PCT))
        parts = kg, dry, kg if isnan(moisture_pct) else 0.0, kg if isnan(area_m2) else 0.0
        self.total.add(*parts)
        if self.is_open:
            self.loads[self.number].add(*parts)

    def correct(self, number: int, parts: tuple[float, ...]) -> bool:
        """Whether a closed load is corrected."""
        here = self.is_open and number == self.number
        kg = max(parts[0], -self.loads[number].parts[0]) if here else parts[0]
        if number == NO_LOAD or number >= self.first:
            self.total.add(kg, *parts[1:3], 0.0)
        if number in self.loads:
            self.loads[number].add(kg, *parts[1:])
        return number in self.loads and not here


MISSED = st.tuples(*[st.sampled_from([0.0, 3.0, -3.0, -40.0, 25.0])] * 4)
STEPS = st.lists(
    st.one_of(
        st.tuples(st.sampled_from(["start", "stop", "reset"])),
        st.tuples(
            st.just("count"), st.sampled_from([5.0, 20.0]), st.sampled_from([14.0, 20.0, nan]), st.sampled_from([4.0, nan])
        ),
        st.tuples(st.just("correct"), st.integers(0, 5), MISSED),
    ),
    max_size=14,
)


def same(found: LoadSummary, known: Sum) -> None:
    assert [found.measured_kg, found.dry_kg, found.unknown_moisture_kg, found.unknown_area_kg] == pytest.approx(known.parts)


@given(STEPS)
def test_any_order_of_masses_and_corrections(steps: list[tuple]) -> None:
    loads, book = Loads(EngineSettings()), Book()
    loads.begin(0.0)
    for step, *values in steps:
        if step == "count":
            kg, moisture_pct, area_m2 = values
            loads.totals = loads.totals.with_mass(kg, loads.dry_kg(kg, moisture_pct), area_m2=area_m2)
            book.count(*values)
        elif step == "correct":
            number, parts = values
            if number > book.number:
                continue
            events = loads.correct({number: MissedMass(*parts)})
            closed = book.correct(number, parts)
            assert [event.load.number for event in events if isinstance(event, LoadClosed)] == [number] * closed
            assert len(events) == closed
        else:
            getattr(loads, step)(1.0)
            if step == "stop":
                book.is_open = False
            else:
                getattr(book, {"start": "new", "reset": "reset"}[step])()
        totals = loads.totals
        masses = [totals.total_kg, totals.total_dry_kg, totals.total_unknown_moisture_kg]
        assert masses == pytest.approx(book.total.parts[:3])
        assert [load.number for load in loads.all] == list(book.loads)
        for load in loads.all:
            same(load, book.loads[load.number])

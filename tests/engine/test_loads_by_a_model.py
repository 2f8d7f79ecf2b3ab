"""Loads against a plain list of what each was given, for any order of what can happen to them."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isnan, nan

import pytest
from engine_bench import MACHINE
from hypothesis import given
from hypothesis import strategies as st

from yieldmon.engine.flow import Flow
from yieldmon.engine.mass.budget import FlowBudget
from yieldmon.engine.mass.load_summary import LoadClosed, LoadOpened, LoadSummary
from yieldmon.engine.mass.loads import Loads
from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.measurement import Window
from yieldmon.engine.settings import EngineSettings
from yieldmon.frames import EstimateQuality

SETTINGS = EngineSettings()
LEAST = SETTINGS.windows.min_coverage
MARKET_PCT = 15.5


def window(coverage: float, *, contested: bool) -> Window:
    """A second of which so much was measured; two nodes sent samples for a contested one."""
    return Window(
        start_s=0.0, end_s=1.0, mean_mv=0.0, std_dev_mv=0.0, harmonics_mv=(), pulse_mv=0.0, trend=0.0, patterns=0, weight_s=1.0,
        covered_s=coverage, speed_rad_s=MACHINE.nominal_elevator_speed_rad_s, plate_angle_rad=1.0, plate_min_rad=1.0,
        plate_max_rad=1.0, frames=1, samples=4, last_frame_s=1.0, span_mv=0.0, held_s=0.0, saturated_share=0.0,
        sensor_fault_frames=0, lost_frames=0, surplus_frames=200 if contested else 0, repeated_frames=0,
    )  # fmt: skip


@dataclass
class Model:
    """One load as it ought to be."""

    number: int
    start_s: float
    end_s: float = nan
    kg: float = 0.0
    dry_kg: float = 0.0
    unknown_kg: float = 0.0
    area_m2: float = 0.0
    unknown_area_kg: float = 0.0
    contested_kg: float = 0.0
    complete: bool = True


@dataclass
class Book:
    """All loads as they ought to be, and the totals."""

    loads: list[Model] = field(default_factory=lambda: [Model(1, nan)])
    open: bool = True
    kg: float = 0.0
    contested_kg: float = 0.0

    @property
    def last(self) -> Model:
        return self.loads[-1]

    def close(self, now_s: float) -> None:
        if self.open:
            self.last.end_s = now_s
        self.open = False

    def new(self, now_s: float) -> None:
        self.loads.append(Model(self.last.number + 1, now_s))
        self.open = True

    def count(self, kg_s: float, coverage: float, moisture_pct: float, area_m2: float, *, contested: bool) -> None:
        load = self.last
        kg = 0.0 if isnan(kg_s) else kg_s * (1.0 if coverage >= LEAST else coverage)
        if self.open and (isnan(kg_s) or contested or coverage < LEAST):
            load.complete = False
        if contested and not isnan(kg_s):
            self.contested_kg += kg
            load.contested_kg += kg if self.open else 0.0
            kg = 0.0
        self.kg += kg
        if not self.open:
            return
        load.kg += kg
        if isnan(moisture_pct):
            load.unknown_kg += kg
        else:
            load.dry_kg += kg * min(1.0, (100.0 - moisture_pct) / (100.0 - MARKET_PCT))
        if isnan(area_m2):
            load.unknown_area_kg += kg
        else:
            load.area_m2 += area_m2


STEPS = st.lists(
    st.one_of(
        st.tuples(st.sampled_from(["begin", "start", "stop", "reset", "doubt"])),
        st.tuples(
            st.just("count"), st.sampled_from([0.0, 5.0, 20.0, nan]), st.sampled_from([1.0, LEAST, LEAST - 0.01, 0.05]),
            st.sampled_from([14.0, 20.0, nan]), st.sampled_from([0.0, 40.0, nan]), st.booleans(),
        ),
    ),
    max_size=14,
)  # fmt: skip


def same(found: LoadSummary, model: Model) -> None:
    expected = (model.number, model.kg, model.dry_kg, model.unknown_kg, model.area_m2, model.unknown_area_kg)
    given = (
        found.number, found.measured_kg, found.dry_kg, found.unknown_moisture_kg, found.area_m2, found.unknown_area_kg
    )  # fmt: skip
    assert given == pytest.approx(expected)
    assert (found.start_s, found.end_s) == pytest.approx((model.start_s, model.end_s), nan_ok=True)


@given(STEPS)
def test_any_order_of_loads_masses_and_resets(steps: list[tuple]) -> None:
    loads, book = Loads(SETTINGS), Book()
    assert isnan(loads.open.start_s)
    assert [type(event) for event in loads.begin(99.0)] == [LoadOpened]
    book.last.start_s = 99.0
    for now_s, (step, *values) in enumerate(steps, 100):
        before = book.open
        if step == "begin":
            assert loads.begin(float(now_s)) == ()
        elif step in {"start", "reset"}:
            events = getattr(loads, step)(float(now_s))
            book.close(float(now_s))
            if step == "reset":
                book.kg = book.contested_kg = 0.0
            book.new(float(now_s))
            assert [type(event) for event in events] == [*[LoadClosed] * before, LoadOpened]
            assert loads.totals.first_load == book.last.number if step == "reset" else loads.totals.first_load
        elif step == "stop":
            events = loads.stop(float(now_s))
            book.close(float(now_s))
            assert [type(event) for event in events] == [LoadClosed] * before
        elif step == "doubt":
            loads.doubt()
            book.last.complete = book.last.complete and not book.open
        else:
            kg_s, coverage, moisture_pct, area_m2, contested = values
            quality = EstimateQuality.NOT_AVAILABLE if isnan(kg_s) else EstimateQuality.OK
            flow = Flow(kg_s, 1.0, quality, 1.0, 1.0, budget=FlowBudget())
            mass_kg = loads.count(window(coverage, contested=contested), flow, moisture_pct, area_m2)
            total_before = book.kg
            book.count(kg_s, coverage, moisture_pct, area_m2, contested=contested)
            assert mass_kg == pytest.approx(book.kg - total_before)
        assert loads.totals.total_kg == pytest.approx(book.kg)
        assert loads.totals.total_contested_kg == pytest.approx(book.contested_kg)
        assert loads.totals.load_contested_kg == pytest.approx(book.last.contested_kg)
        assert (loads.totals.load_open, loads.totals.load_number) == (book.open, book.last.number)
        closed = [load for load in book.loads if not isnan(load.end_s)]
        assert len(loads.all) == len(closed) + book.open
        for found, model in zip(loads.all, [*closed, *[book.last] * book.open], strict=True):
            same(found, model)
            assert found.complete is model.complete
        assert (loads.open is not None) is book.open


@pytest.mark.parametrize(
    ("totals", "opened", "complete"),
    [
        (Totals(load_number=4, load_kg=5.0, total_kg=9.0), False, False),
        (Totals(load_number=4, total_kg=9.0), True, True),
        (Totals(load_number=4, load_kg=5.0, total_kg=9.0).stop_load(), False, True),
    ],
    ids=["under way", "empty", "ended"],
)
def test_a_load_that_is_gone_on_with_is_opened_when_it_is_empty_and_whole_when_nothing_passed(
    totals: Totals, opened: bool, complete: bool
) -> None:
    loads = Loads(SETTINGS)
    loads.restore(totals)
    events = loads.begin(50.0)
    assert [event.load.number for event in events] == [4] * opened
    if totals.load_open:
        assert (loads.open.complete, loads.open.start_s) == (complete, 50.0)
    else:
        assert (loads.open, loads.all) == (None, ())

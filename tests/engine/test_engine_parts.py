"""Gates, totals, faults, clock, reference masses and kept state, each by itself."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from engine_bench import monitor
from hypothesis import given
from hypothesis import strategies as st

from yieldmon import frames as bus
from yieldmon.engine.clock import BusClock
from yieldmon.engine.faults import FAULTS, FaultCode
from yieldmon.engine.health import FaultBook
from yieldmon.engine.mass.gates import GateInputs, HarvestGate
from yieldmon.engine.mass.totals import Totals, dry_mass
from yieldmon.engine.results import frames_in
from yieldmon.engine.sampling.zero import ZeroState
from yieldmon.engine.self_calibration.tank_scale import TankScale
from yieldmon.engine.settings import ClockSettings, GateSettings, ReferenceMassSettings, TotalsSettings
from yieldmon.engine.state import EngineState
from yieldmon.resources import shipped

NAN = float("nan")
NUMBERS = {
    "SensorMissing": (520192, 9), "SensorStuck": (520192, 2), "SensorSaturated": (520192, 0),
    "ZeroDrifted": (520193, 13), "SpeedMissing": (520194, 9), "SpeedOutOfRange": (520194, 1),
    "PlateNotFollowing": (520195, 7), "PlateFeedbackStale": (520195, 9), "SweepAborted": (520196, 31),
    "CalibrationOld": (520197, 13), "FlowOutsideCalibration": (520198, 31), "NotIdentifiable": (520199, 31),
    "ModelDisagrees": (520200, 31), "StoreFailing": (520201, 12), "FramesLost": (520202, 19),
    "ClockJumped": (520203, 2), "BusError": (520204, 19), "OutputConflict": (520205, 19),
    "ScaleFault": (520206, 2), "NetworkFault": (520207, 19), "ZeroMissing": (520193, 31),
    "WaveformContradicts": (520208, 31), "MassNearEnd": (520209, 0), "ScaleDisagrees": (520210, 31),
}  # fmt: skip

GATE = [
    # force N, pulses, empty, loaded, speed in range, idle s -> opens a closed gate, keeps an open one
    (5.0, True, False, False, True, 0.0, True, True),
    (1.2, True, False, False, True, 0.0, True, True),
    (1.2, False, False, True, True, 0.0, True, True),
    (1.2, False, False, False, True, 0.0, False, True),
    (1.2, False, True, False, True, 0.0, False, False),
    (0.7, True, False, True, True, 0.0, False, True),
    (0.3, True, False, True, True, 0.0, False, False),
    (50.0, False, False, False, True, 0.0, True, True),
    (50.0, False, True, False, True, 0.0, False, False),
    (50.0, True, False, True, False, 0.0, False, False),
    (5.0, True, False, True, True, 19.0, True, True),
    (5.0, True, False, True, True, 21.0, False, False),
    (50.0, True, False, True, True, 21.0, True, True),
    (NAN, False, False, False, True, 0.0, False, False),
    # At a limit: forces have to be above it, and the time is up.
    (10.0, False, False, False, True, 0.0, False, True),
    (1.0, True, False, False, True, 0.0, False, True),
    (0.5, True, False, True, True, 0.0, False, False),
    (10.0, True, False, True, True, 20.0, False, False),
]


@pytest.mark.parametrize(("force", "pulses", "empty", "loaded", "in_range", "idle", "opens", "keeps"), GATE)
def test_gate(
    force: float, pulses: bool, empty: bool, loaded: bool, in_range: bool, idle: float, opens: bool, keeps: bool
) -> None:
    inputs = GateInputs(force, pulses, empty, loaded, in_range, idle)
    assert HarvestGate(GateSettings()).see(inputs) is opens
    opened = HarvestGate(GateSettings(off_windows=1))
    opened.see(GateInputs(60.0, True, False, True, True))
    assert opened.see(inputs) is keeps


def test_gate_closes_only_after_several_windows_without_grain() -> None:
    gate = HarvestGate(GateSettings(off_windows=3))
    grain, none = GateInputs(60.0, True, False, True, True), GateInputs(0.0, False, False, False, True)
    assert [gate.see(i) for i in (grain, none, none, grain, none, none, none, none)] == [True] * 6 + [False] * 2


MASSES = st.lists(st.tuples(st.floats(0.0, 100.0), st.none() | st.floats(0.0, 100.0), st.sampled_from("....ns")), max_size=60)


@given(MASSES)
def test_totals_never_run_back_and_loads_add_up(masses: list[tuple[float, float | None, str]]) -> None:
    totals, loads = Totals(), [0.0]
    unattributed = 0.0
    for wet, dry, event in masses:
        if event == "n":
            totals = totals.start_load()
            loads.append(0.0)
        elif event == "s":
            totals = totals.stop_load()
        after = totals.with_mass(wet, dry)
        assert after.total_kg >= totals.total_kg
        if totals.load_open:
            loads[-1] += wet
        else:
            unattributed += wet
        totals = after
        assert totals.load_kg == pytest.approx(loads[-1])
    assert totals.total_kg == pytest.approx(sum(loads) + unattributed)
    assert totals.load_number == len(loads)


@pytest.mark.parametrize("mass", [-1.0, NAN, math.inf])
def test_totals_refuse_what_is_no_mass(mass: float) -> None:
    with pytest.raises(ValueError, match="mass to add"):
        Totals().with_mass(mass, None)


@pytest.mark.parametrize(
    ("moisture", "credit", "expected"),
    [
        (15.5, False, 100.0),
        (20.0, False, 94.674556),
        (10.0, False, 100.0),
        (10.0, True, 106.508876),
        (NAN, False, None),
        (0.0, False, None),
        (0.15, True, None),
        (3.0, True, 114.792899),
        (60.0, False, 47.337278),
        (61.0, False, None),
        (99.0, False, None),
    ],
)
def test_dry_mass(moisture: float, credit: bool, expected: float | None) -> None:
    found = dry_mass(100.0, moisture, TotalsSettings(moisture_reference_pct=15.5, credit_below_reference=credit))
    assert found is None if expected is None else found == pytest.approx(expected, abs=1e-6)


def test_the_table_of_faults_is_the_bus_s() -> None:
    assert set(FAULTS) == set(FaultCode)
    text = Path(shipped("dbc/yieldmon.dbc")).read_text()
    for definition in FAULTS.values():
        assert f" SG_ {definition.code.value} " in text
        assert 520192 <= definition.spn <= 524287
        assert 0 <= definition.fmi <= 31
        for sentence in (definition.cause, definition.effect, definition.remedy):
            assert sentence.endswith(".")
    pairs = [(d.spn, d.fmi) for d in FAULTS.values()]
    assert len(set(pairs)) == len(pairs)


def test_faults_have_the_numbers_that_displays_know() -> None:
    """Suspect parameter numbers and failure modes went out with version 0.1; a new fault gets new ones."""
    found = {definition.code.value: (definition.spn, definition.fmi) for definition in FAULTS.values()}
    assert found == NUMBERS


@pytest.mark.parametrize("code", FAULTS)
def test_fault_hysteresis(code: FaultCode) -> None:
    definition, book = FAULTS[code], FaultBook()
    events = []
    for second in range(definition.set_after):
        assert not book.is_active(code)
        events.append(book.observe(code, float(second), "why", present=True))
    assert book.is_active(code)
    assert (book.detail(code), book.since(code), book.occurrences(code)) == ("why", definition.set_after - 1.0, 1)
    for second in range(definition.clear_after):
        assert book.is_active(code)
        events.append(book.observe(code, 100.0 + second, present=False))
    assert book.active == ()
    assert [(event.code, event.active) for event in events if event is not None] == [(code, True), (code, False)]


def test_a_detail_that_holds_no_more_is_not_said_any_longer() -> None:
    book, code = FaultBook(), FaultCode.SPEED_MISSING
    for second in range(4):
        book.observe(code, float(second), "396 rpm, but grain strikes the plate", present=True)
    book.observe(code, 4.0, "", present=True)
    assert book.is_active(code)
    assert book.detail(code) == ""


def test_what_changed_with_a_window_is_handed_back_withdrawn_first() -> None:
    book = FaultBook()
    note, other, third = FaultCode.SWEEP_ABORTED, FaultCode.SENSOR_MISSING, FaultCode.CALIBRATION_OLD
    assert [event.code for event in book.observe_all({note: "a", other: "b"}, 1.0)] == [other, note]
    assert book.observe_all({note: "a", other: "b"}, 2.0) == ()
    assert [(event.code, event.active) for event in book.observe_all({other: "b", third: ""}, 3.0)] == [
        (note, False),
        (third, True),
    ]


@pytest.mark.parametrize("code", FAULTS)
def test_what_the_service_reports_is_shown_on_the_bus(code: FaultCode) -> None:
    target = monitor()
    target.tick(100.0)
    target.report_fault(code, True, "seen by the service")
    out = [frame for second in range(1, 6) for frame in frames_in(target.tick(100.0 + second))]
    status = [f.signals[code.value] for f in out if f.message == bus.YIELD_MONITOR_STATUS]
    assert status[-1] == 1
    target.report_fault(code, False)
    for second in range(40, 60):
        target.tick(100.0 + second)
    assert target.faults.is_active(code) == (
        code in (FaultCode.SENSOR_MISSING, FaultCode.SPEED_MISSING, FaultCode.PLATE_FEEDBACK_STALE)
    )


TIMES = [
    # bus times -> engine times, jumps
    ([5.0, 6.0, 6.5], [5.0, 6.0, 6.5], 0),
    ([5.0, 4.95, 5.1], [5.0, 4.95, 5.1], 0),
    ([5.0, 1.0, 2.0], [5.0, 5.0, 6.0], 1),
    ([5.0, 5000.0, 5001.0], [5.0, 5.0, 6.0], 1),
    ([5.0, 64.0], [5.0, 64.0], 0),
    ([5.0, NAN, math.inf, 1e300, 6.0], [5.0, None, None, None, 6.0], 0),
    ([5.0, 9000.0, 6.0], [5.0, 5.0, 5.0], 2),
]


@pytest.mark.parametrize(("given_s", "engine", "jumps"), TIMES)
def test_clock(given_s: list[float], engine: list[float | None], jumps: int) -> None:
    clock = BusClock(ClockSettings())
    assert [clock.engine_time(t) for t in given_s] == engine
    assert clock.jumps == jumps


SCALE = [
    # (time, stable reading), windows of 10 kg/s from 0 s to 100 s -> (reference, measured, complete)
    ([(10.0, 1000.0), (60.0, 1500.0)], set(), [(500.0, 500.0, True)]),
    ([(10.0, 1000.0), (30.0, 1200.0)], set(), []),
    ([(10.0, 1000.0), (60.0, 1500.0)], {33}, [(500.0, 490.0, False)]),
    ([(10.0, 1000.0), (40.0, 200.0), (90.0, 700.0)], set(), [(500.0, 500.0, True)]),
    ([(10.5, 1000.0), (60.25, 1497.5)], set(), [(497.5, 497.5, True)]),
    # Emptied on the move between the first two readings, in which it then gains again.
    ([(10.0, 1000.0), (40.0, 1100.0), (90.0, 1600.0)], set(), [(500.0, 500.0, True)]),
    # 30 % off is a calibration.
    ([(10.0, 1000.0), (90.0, 1560.0)], set(), [(560.0, 800.0, True)]),
    # What went by unmeasured held no grain.
    ([(2.0, 1000.0), (3.0, 1010.0), (10.0, 1080.0), (90.0, 1880.0)], {2}, [(870.0, 870.0, True)]),
]


@pytest.mark.parametrize(("readings", "missing", "expected"), SCALE)
def test_tank_scale(readings: list[tuple[float, float]], missing: set[int], expected: list[tuple[float, float, bool]]) -> None:
    scale, total = TankScale(ReferenceMassSettings(min_increment_kg=300.0)), 0.0
    pending = list(readings)
    for second in range(100):
        if pending and pending[0][0] <= second + 1.0:
            scale.reading(*pending.pop(0))
        mass = 0.0 if second in missing else 10.0
        scale.window(float(second), second + 1.0, total, mass, measured=second not in missing)
        total += mass
    found = [(a.reference_kg, pytest.approx(a.measured_kg), a.complete) for a in scale.masses]
    assert found == expected
    # An increment is the difference of two readings.
    assert all(a.std_dev_kg == pytest.approx(2.0**0.5 * ReferenceMassSettings().scale_std_dev_kg) for a in scale.masses)


NEXT_MASS = {
    "gained enough": ([1100.0, 1299.0, 1300.0, 1400.0], 3),
    "too little": ([1100.0, 1200.0], 0),
    "from the lowest since, the tank being emptied": ([1100.0, 50.0, 349.0, 350.0], 4),
    "readings that are not known": ([math.nan, 1300.0], 2),
    "nothing ahead": ([], 0),
}


@pytest.mark.parametrize(("masses_kg", "expected"), NEXT_MASS.values(), ids=NEXT_MASS)
def test_the_next_mass_that_may_be_weighed(masses_kg: list[float], expected: int) -> None:
    scale = TankScale(ReferenceMassSettings(min_increment_kg=300.0))
    scale.reading(0.5, 1000.0)
    scale.window(0.0, 1.0, 0.0, 0.0, measured=True)
    assert scale.next_mass(masses_kg) == expected


def test_seconds_in_which_a_zero_was_taken_held_no_grain() -> None:
    def weighed(empty_since_s: float) -> list[bool]:
        scale = TankScale(ReferenceMassSettings(min_increment_kg=300.0))
        for second in range(100):
            if second in (4, 60):
                scale.reading(second + 0.5, 0.0 if second == 4 else 500.0)
            scale.window(float(second), second + 1.0, 10.0 * max(0, second - 10), 10.0 * (second >= 10), measured=second >= 8)
            if second == 7:
                scale.empty_since(empty_since_s)
        return [reference.complete for reference in scale.masses]

    assert weighed(3.0) == [True]
    assert weighed(6.0) == [False]


ZERO = ZeroState(151.0, 150.0, 41.9, 3.0, (0.1, 2.0, 0.3, 0.4))
STATES = [EngineState(), EngineState(Totals(12.5, 11.0, 0.5, 3.0, 2.0, 0.0, 7, False), ZERO, 99, 4, 7.5, 60.0, 3)]


@pytest.mark.parametrize("state", STATES)
def test_state_goes_through_json(state: EngineState) -> None:
    assert EngineState.from_dict(json.loads(json.dumps(state.as_dict()))) == state


@pytest.mark.parametrize(
    "spoil",
    [
        lambda d: d.pop("totals"),
        lambda d: d.update(extra=1),
        lambda d: d["totals"].update(wrong=1),
        lambda d: d.update(zero={"zero_mv": 1}),
    ],
)
def test_spoilt_state_is_refused(spoil) -> None:
    data = STATES[1].as_dict()
    spoil(data)
    with pytest.raises(ValueError, match="engine state"):
        EngineState.from_dict(data)


@pytest.mark.parametrize(("at_s", "measured_kg"), [(10.0, 100.0), (10.25, 102.5), (10.5, 105.0), (11.0, 110.0)])
def test_a_reading_within_a_window_weighs_that_part_of_it(at_s: float, measured_kg: float) -> None:
    """One that comes before its window closes waits for it."""
    scale = TankScale(ReferenceMassSettings(min_increment_kg=50.0))
    scale.reading(0.0, 1000.0)
    for second in range(12):
        if second == 9:
            scale.reading(at_s, 1100.0)
        found = scale.window(float(second), second + 1.0, 10.0 * second, 10.0, measured=True)
        assert (found is not None) is (second == (9 if at_s == 10.0 else 10))
    (reference,) = scale.masses
    assert (reference.start_s, reference.end_s, reference.reference_kg) == (0.0, at_s, 100.0)
    assert reference.measured_kg == pytest.approx(measured_kg)

"""What outlives a restart comes back as it was, whatever it is, and a document that lacks a key is refused."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from yieldmon.engine.mass.budget import MassBudget
from yieldmon.engine.mass.since_empty import LoadSinceEmpty
from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.sampling.zero import ZeroState
from yieldmon.engine.self_calibration.calibrator_state import CalibratorState, GrainState, PriorState
from yieldmon.engine.self_calibration.scale_alarm import ScaleAlarmState, ScaleCheck
from yieldmon.engine.state import EngineState, TicketState, ZeroUndo
from yieldmon.engine.sweeps.disagreement import DisagreementState, SweepPattern
from yieldmon.service.assembly import build_monitor
from yieldmon.service.config import configuration

NUMBERS = st.floats(-1e12, 1e12)
MASSES = st.floats(0.0, 1e9)
COUNTS = st.integers(0, 2**40)
NAMES = st.text(max_size=8)
SOME = st.lists(NUMBERS, max_size=3).map(tuple)
#: An input beyond is none.
ANGLES_DEG = st.lists(st.floats(0.0, 180.0), max_size=3).map(tuple)
BUDGETS = st.builds(MassBudget, noise_kg2=MASSES, parameters_kg=MASSES, zero_kg=MASSES, moisture_kg=MASSES)
ZEROS = st.builds(
    ZeroState, zero_mv=NUMBERS, first_zero_mv=NUMBERS, speed_rad_s=NUMBERS, window_pulse_mv=NUMBERS, vibration_mv=SOME
)
MASS_FIELDS = (
    "total_dry_kg", "total_unknown_moisture_kg", "load_dry_kg", "load_unknown_moisture_kg", "total_contested_kg",
    "load_contested_kg", "load_area_m2", "load_unknown_area_kg", "market_moisture_pct",
)  # fmt: skip
TOTALS = st.builds(
    Totals, **dict.fromkeys(MASS_FIELDS, MASSES), total_kg=MASSES, load_kg=MASSES, load_number=COUNTS,
    load_open=st.booleans(), first_load=COUNTS, total_budget=BUDGETS, load_budget=BUDGETS,
)  # fmt: skip


@st.composite
def patterns(draw: st.DrawFn) -> SweepPattern:
    angles = draw(ANGLES_DEG)
    of_each = st.lists(NUMBERS, min_size=len(angles), max_size=len(angles)).map(tuple)
    return SweepPattern(
        draw(NUMBERS), angles, draw(of_each), draw(of_each), draw(NUMBERS), draw(NUMBERS), draw(st.none() | NUMBERS)
    )


@st.composite
def calibrators(draw: st.DrawFn) -> CalibratorState:
    rates = draw(st.lists(NUMBERS, max_size=3))
    columns = draw(st.integers(0, 4))
    row = st.lists(NUMBERS, min_size=columns, max_size=columns).map(tuple)
    names = draw(st.lists(NAMES, max_size=2, unique=True))
    square = tuple(tuple(draw(NUMBERS) for _ in names) for _ in names)
    prior = PriorState(draw(COUNTS), tuple((name, draw(NUMBERS)) for name in names), tuple(names), square)
    both = (prior, prior) if draw(st.booleans()) else (None, None)
    grain = GrainState(draw(NAMES), tuple(draw(st.lists(NAMES, max_size=2))), draw(NAMES), *both)
    return CalibratorState(
        waited_s=draw(MASSES), harvested_kg=draw(MASSES), moisture_pct=draw(st.none() | NUMBERS),
        drifting=tuple(f"p{number}" for number in range(len(rates))), rates=tuple(rates),
        covariance=tuple(draw(row) for _ in rates), at_s=draw(st.none() | NUMBERS),
        weighed=tuple(draw(st.lists(NAMES, max_size=3))), doubted=draw(NAMES), grains=(grain,) if draw(st.booleans()) else (),
    )  # fmt: skip


CHECKS = st.builds(ScaleCheck, name=NAMES, start_s=NUMBERS, weighed_kg=MASSES, measured_kg=MASSES, std_dev_kg=MASSES)
TICKETS = st.builds(
    TicketState, load_number=COUNTS, weighed_kg=MASSES, std_dev_kg=MASSES, waits=st.booleans(), crop=st.none() | NAMES
)
STATES = st.builds(
    EngineState, totals=TOTALS, zero=st.none() | ZEROS, windows=COUNTS, sweep_id=COUNTS, sweep_due_in_s=NUMBERS,
    calibration_age_s=st.none() | NUMBERS, parameter_version=COUNTS,
    disagreement=st.builds(DisagreementState, patterns=st.lists(patterns(), max_size=2).map(tuple), present=st.booleans()),
    calibrator=st.none() | calibrators(),
    scale_alarm=st.builds(ScaleAlarmState, contradiction=st.none() | CHECKS, since_s=NUMBERS, since=NAMES, agreed=NAMES),
    zero_undo=st.none() | st.builds(
        ZeroUndo, before=ZEROS, suspect=st.booleans(), by_scale=st.lists(st.tuples(COUNTS, NUMBERS), max_size=2).map(tuple)
    ),
    tickets=st.lists(TICKETS, max_size=2).map(tuple),
    since_empty=st.lists(st.builds(LoadSinceEmpty, number=COUNTS, kg_per_n=MASSES, zero_kg=MASSES), max_size=2).map(tuple),
)  # fmt: skip


@settings(max_examples=40)
@given(STATES)
def test_a_state_comes_back_through_json_as_it_was(state: EngineState) -> None:
    assert EngineState.from_dict(json.loads(json.dumps(state.as_dict(), allow_nan=False))) == state


@pytest.mark.parametrize("part", ["total_budget", "load_budget"])
def test_a_budget_that_is_not_known_stays_so(part: str) -> None:
    state = EngineState(totals=Totals(total_kg=5.0, load_kg=5.0, **{part: MassBudget.unknown()}))
    back = EngineState.from_dict(json.loads(json.dumps(state.as_dict(), allow_nan=False))).totals
    assert {name: math.isnan(getattr(back, name).std_dev_kg) for name in ("total_budget", "load_budget")} == {
        name: name == part for name in ("total_budget", "load_budget")
    }


LATER = {"disagreement", "calibrator", "scale_alarm", "zero_undo", "tickets", "moisture", "closed", "at_stop", "since_empty"}


@pytest.mark.parametrize("key", sorted(EngineState().as_dict()))
def test_a_key_that_is_missing_is_refused_unless_it_came_later(key: str) -> None:
    document = {name: value for name, value in EngineState().as_dict().items() if name != key}
    if key in LATER:
        assert EngineState.from_dict(document) == EngineState()
    else:
        with pytest.raises(ValueError, match="engine state"):
            EngineState.from_dict(document)


def test_an_unknown_key_is_refused() -> None:
    with pytest.raises(ValueError, match=r"engine state has keys .*'surprise'"):
        EngineState.from_dict({**EngineState().as_dict(), "surprise": 1})


@pytest.mark.parametrize(
    "changes",
    [
        {"rates": [1.0, 2.0]}, {"rates": []}, {"drifting": ["a", "b"]}, {"covariance": []}, {"covariance": [[1.0], [2.0]]},
    ],
)  # fmt: skip
def test_rates_that_do_not_fit_their_parameters_are_refused(changes: dict[str, object]) -> None:
    document = EngineState(calibrator=CalibratorState(1.0, 2.0, None, ("a",), (1.0,), ((1.0, 2.0),))).as_dict()
    document["calibrator"] |= changes
    with pytest.raises(ValueError, match="do not fit the parameters"):
        EngineState.from_dict(document)


@pytest.mark.parametrize("column", ["plate_angle_deg", "log_force", "sd"])
def test_a_sweep_pattern_has_columns_of_one_length(column: str) -> None:
    pattern = SweepPattern(5.0, (40.0, 50.0), (3.0, 3.1), (0.01, 0.01), 10.0, 42.0, None)
    document = EngineState(disagreement=DisagreementState((pattern,))).as_dict()
    document["disagreement"]["patterns"][0][column] = [1.0]
    with pytest.raises(ValueError, match="a sweep's pattern has"):
        EngineState.from_dict(document)


def test_rows_of_a_covariance_are_of_one_length() -> None:
    document = EngineState(calibrator=CalibratorState(1.0, 2.0, None, ("a", "b"), (1.0, 2.0), ((1.0,), (2.0,)))).as_dict()
    assert EngineState.from_dict(document).calibrator is not None
    document["calibrator"]["covariance"] = [[1.0], [2.0, 3.0]]
    with pytest.raises(ValueError, match="do not fit the parameters"):
        EngineState.from_dict(document)


@settings(max_examples=25)
@given(STATES, st.booleans())
def test_a_monitor_goes_on_from_what_it_was_given(state: EngineState, same_parameters: bool) -> None:
    """What another part knows (the calibrator's document, tickets, the moisture of the market) is not looked at here."""
    loaded = configuration.build({}, Path("c.yaml"), {})
    monitor = build_monitor(loaded.engine, loaded.machine, loaded.parameters, None)
    fresh = monitor.snapshot()
    version = loaded.parameters.version if same_parameters else loaded.parameters.version + 1
    monitor.restore(replace(state, parameter_version=version))
    found = monitor.snapshot()
    for name in ("windows", "sweep_id", "calibration_age_s", "zero"):
        assert getattr(found, name) == getattr(state, name)
    assert replace(found.totals, market_moisture_pct=0.0) == replace(state.totals, market_moisture_pct=0.0)
    assert found.scale_alarm == (state.scale_alarm if same_parameters else fresh.scale_alarm)
    kept = state.zero_undo
    assert (found.zero_undo is None) == (kept is None)
    if found.zero_undo is not None and kept is not None:
        assert (found.zero_undo.before, found.zero_undo.suspect) == (kept.before, kept.suspect)

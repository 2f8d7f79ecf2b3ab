"""What is stated of a flow grows with the grain harvested since the parameters were learnt, also before a first update."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.engine.test_closed_loop_calibrator import MACHINE, MODEL, PRIOR, SPEED, TRUE, records, ticket
from yieldmon.engine.calibrator_settings import CalibratorSettings
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.self_calibration.closed_loop_calibrator import ClosedLoopCalibrator
from yieldmon.engine.state import EngineState
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.self_calibration.drift_rates import DriftRates
from yieldmon.physics.model import Conditions

SEED, FLOW_KG_S = 6107, 10.0
RATES = DriftRates(per_root_kilotonne={"friction": 0.04, "density": 0.02, "restitution": 0.01}, per_root_hour={})
SETTINGS = CalibratorSettings(drift=RATES, steady_per_kilotonne={})


def second(total_t: float) -> WindowRecord:
    """A window at home after so much grain."""
    home = min(records(FLOW_KG_S), key=lambda record: abs(record.plate_angle_rad - MACHINE.home_plate_angle_rad))
    return replace(home, time_s=100.0 * total_t, total_kg=1000.0 * total_t, plate_angle_rad=MACHINE.home_plate_angle_rad)


def scatter(kilotonnes: float) -> float:
    """Of the force over machines whose parameters have walked, by draws."""
    rng = np.random.default_rng(SEED)
    there = Conditions(MACHINE.home_plate_angle_rad, SPEED, mass_flow_kg_s=FLOW_KG_S)
    drawn = {name: value * (1.0 + rate * kilotonnes**0.5 * rng.standard_normal(4000)) for name, value, rate in (
        ("density", 1100.0, 0.02), ("friction", 0.2, 0.04))}  # fmt: skip
    gain = 1.0 + 0.01 * kilotonnes**0.5 * rng.standard_normal(4000)
    values = {**PRIOR.values, **drawn, "restitution": 1.6 * gain - 1.0}
    force = np.real(MODEL.force(there, values))
    return float(np.std(force) / np.mean(force))


@pytest.fixture
def begun() -> tuple[ClosedLoopCalibrator, OpenLoop]:
    calibrator, estimator = ClosedLoopCalibrator(MODEL, SETTINGS), OpenLoop(MODEL, PRIOR)
    assert calibrator.drift_std_dev(second(0.0), estimator) == 0.0
    return calibrator, estimator


def test_it_grows_with_the_grain_before_a_first_update(begun: tuple[ClosedLoopCalibrator, OpenLoop]) -> None:
    calibrator, estimator = begun
    assert calibrator.drift_std_dev(second(19.0), estimator) == 0.0
    found = [calibrator.drift_std_dev(second(total_t), estimator) for total_t in (20.0, 400.0, 1600.0)]
    assert found == sorted(found)
    assert found[1:] == [pytest.approx(scatter(0.4), rel=0.04), pytest.approx(scatter(1.6), rel=0.04)]
    assert calibrator.drift_std_dev(second(1600.0), estimator) == found[-1]


def test_an_update_ends_it(begun: tuple[ClosedLoopCalibrator, OpenLoop]) -> None:
    calibrator, estimator = begun
    assert calibrator.drift_std_dev(second(400.0), estimator) > 0.0
    weighed = calibrator.weigh(second(400.0), (ticket(estimator, FLOW_KG_S, 39_000.0, 39_900.0),), estimator).estimator
    assert weighed is not None
    assert calibrator.drift_std_dev(second(401.0), weighed) == 0.0
    assert calibrator.drift_std_dev(second(800.0), weighed) == pytest.approx(scatter(0.4), rel=0.1)


def test_parameters_from_outside_end_it(begun: tuple[ClosedLoopCalibrator, OpenLoop]) -> None:
    """They are of a calibration that was made of the machine as it is now."""
    calibrator, estimator = begun
    assert calibrator.drift_std_dev(second(400.0), estimator) > 0.0
    other = OpenLoop(MODEL, replace(PRIOR, values=TRUE, version=2))
    assert calibrator.drift_std_dev(second(400.0), other) == 0.0
    assert calibrator.drift_std_dev(second(800.0), other) == pytest.approx(scatter(0.4), rel=0.1)


def test_a_restart_goes_on_with_it(begun: tuple[ClosedLoopCalibrator, OpenLoop]) -> None:
    calibrator, estimator = begun
    before = calibrator.drift_std_dev(second(400.0), estimator)
    state = calibrator.snapshot(second(400.0).time_s, 400_000.0)
    assert state is not None
    again, known = ClosedLoopCalibrator(MODEL, SETTINGS), OpenLoop(MODEL, replace(PRIOR))
    again.restore(state, known.parameters, 400_000.0)
    assert again.drift_std_dev(second(400.0), known) == pytest.approx(before, rel=1e-6)


def test_seconds_without_grain_keep_it(begun: tuple[ClosedLoopCalibrator, OpenLoop]) -> None:
    calibrator, estimator = begun
    idle = replace(second(400.0), mass_flow_kg_s=0.0)
    assert calibrator.drift_std_dev(idle, estimator) == 0.0
    before = calibrator.drift_std_dev(second(400.0), estimator)
    assert calibrator.drift_std_dev(idle, estimator) == before > 0.0


LIKELY = {"friction": 0.15, "density": 0.04, "restitution": 0.02}
STEADY = CalibratorSettings(drift=DriftRates(per_root_kilotonne={}, per_root_hour={}), steady_per_kilotonne=LIKELY)


def steady_scatter(kilotonnes: float) -> float:
    """Of the force over machines that drift steadily, at half to four and a half times the likely rates, each octave alike."""
    rng = np.random.default_rng(SEED)
    there = Conditions(MACHINE.home_plate_angle_rad, SPEED, mass_flow_kg_s=FLOW_KG_S)
    sizes = np.exp(rng.uniform(np.log(0.5), np.log(4.5), 20_000))
    drift = {name: likely * sizes * rng.standard_normal(sizes.size) * kilotonnes for name, likely in LIKELY.items()}
    drawn = {"density": 1100.0 * (1.0 + drift["density"]), "friction": 0.2 * (1.0 + drift["friction"])}
    force = np.real(MODEL.force(there, {**PRIOR.values, **drawn, "restitution": 1.6 * (1.0 + drift["restitution"]) - 1.0}))
    return float(np.std(force) / np.mean(force))


def test_rates_of_unknown_size_count_by_the_sizes_that_they_may_have() -> None:
    settings = replace(STEADY, steady_drift_memory_kt=np.inf)
    calibrator, estimator = ClosedLoopCalibrator(MODEL, settings), OpenLoop(MODEL, PRIOR)
    assert calibrator.drift_std_dev(second(0.0), estimator) == 0.0
    assert calibrator.drift_std_dev(second(400.0), estimator) == pytest.approx(steady_scatter(0.4), rel=0.05)


def test_a_sweep_does_not_end_what_it_does_not_see_and_a_restart_keeps_it() -> None:
    calibrator, estimator = ClosedLoopCalibrator(MODEL, STEADY), OpenLoop(MODEL, PRIOR)
    weighed = calibrator.weigh(second(0.0), (ticket(estimator, FLOW_KG_S, 0.0, 900.0),), estimator).estimator
    assert weighed is not None
    assert calibrator.drift_std_dev(second(1.0), weighed) == 0.0
    before = calibrator.drift_std_dev(second(400.0), weighed)
    swept_s, swept_kg = second(400.0).time_s, second(400.0).total_kg
    windows = [replace(record, time_s=record.time_s + swept_s, total_kg=swept_kg) for record in records(FLOW_KG_S)]
    swept = calibrator.update(windows, weighed).estimator
    assert swept is not None
    # What the parameters are known by holds the likely rates already.
    left = calibrator.drift_std_dev(second(401.0), swept)
    assert 0.5 * before < left < before
    state = calibrator.snapshot(second(401.0).time_s + 60.0, second(401.0).total_kg)
    assert state is not None
    again, known = ClosedLoopCalibrator(MODEL, STEADY), OpenLoop(MODEL, replace(swept.parameters))
    again.restore(state, known.parameters, second(401.0).total_kg)
    assert again.drift_std_dev(second(401.0), known) == pytest.approx(left, rel=1e-6)
    # A weighed mass sees the scale.
    last = again.weigh(second(402.0), (ticket(known, FLOW_KG_S, 40_000.0, 40_900.0),), known).estimator
    assert last is not None
    assert again.drift_std_dev(second(402.0), last) < 0.2 * left


def undone(*, restart: bool) -> tuple[float, float]:
    """Deviation at 500 t after an update at 400 t was taken back to one at 100 t, and as if it had never come."""
    found = []
    for taken_back in (True, False):
        calibrator, estimator = ClosedLoopCalibrator(MODEL, SETTINGS), OpenLoop(MODEL, PRIOR)
        assert calibrator.drift_std_dev(second(0.0), estimator) == 0.0
        first = calibrator.weigh(second(100.0), (ticket(estimator, FLOW_KG_S, 9_000.0, 9_900.0),), estimator).estimator
        assert first is not None
        calibrator.drift_std_dev(second(101.0), first)
        known = OpenLoop(MODEL, replace(first.parameters))
        if taken_back:
            wrong = ticket(first, 1.1 * FLOW_KG_S, 39_000.0, 39_900.0)
            later = calibrator.weigh(second(400.0), (wrong,), first).estimator
            assert later is not None
            calibrator.drift_std_dev(second(450.0), later)
            if restart:
                state = EngineState(calibrator=calibrator.snapshot(second(450.0).time_s, 450_000.0))
                kept = EngineState.from_dict(json.loads(json.dumps(state.as_dict()))).calibrator
                assert kept is not None
                calibrator = ClosedLoopCalibrator(MODEL, SETTINGS)
                calibrator.restore(kept, later.parameters, 450_000.0)
            known = OpenLoop(MODEL, replace(first.parameters, version=later.parameters.version + 1))
            calibrator.use(known)
        found.append(calibrator.drift_std_dev(second(500.0), known if taken_back else first))
    return found[0], found[1]


@pytest.mark.parametrize("restart", [False, True], ids=["", "after a restart"])
def test_after_an_undo_drift_counts_from_the_update_before(restart: bool) -> None:
    after_undo, never = undone(restart=restart)
    assert never == pytest.approx(scatter(0.4), rel=0.1)
    assert after_undo == pytest.approx(never, rel=1e-6)


def test_the_total_reset_meanwhile_changes_nothing() -> None:
    calibrator, estimator = ClosedLoopCalibrator(MODEL, SETTINGS), OpenLoop(MODEL, PRIOR)
    calibrator.drift_std_dev(second(0.0), estimator)
    updated = calibrator.weigh(second(300.0), (ticket(estimator, FLOW_KG_S, 29_000.0, 29_900.0),), estimator).estimator
    assert updated is not None
    calibrator.totals_reset(300_000.0)
    back = OpenLoop(MODEL, replace(PRIOR, version=3))
    calibrator.use(back)
    at = replace(second(300.0), total_kg=100_000.0)
    assert calibrator.drift_std_dev(at, back) == pytest.approx(scatter(0.4), rel=0.1)


def test_parameters_from_outside_are_as_old_as_their_grain(begun: tuple[ClosedLoopCalibrator, OpenLoop]) -> None:
    """A file from before 300 t that the store has seen since."""
    calibrator, _ = begun
    other = OpenLoop(MODEL, replace(PRIOR, values=TRUE, version=2))
    calibrator.use(other, 300_000.0)
    assert calibrator.drift_std_dev(second(400.0), other) == pytest.approx(scatter(0.3), rel=0.1)
    assert calibrator.drift_std_dev(second(700.0), other) == pytest.approx(scatter(0.6), rel=0.1)


@pytest.mark.parametrize(
    ("kilotonnes", "factor", "alarms"), [(0.0, 1.1, True), (0.0, 1.0, False), (0.6, 1.1, False), (0.6, 1.5, True)]
)
def test_the_scale_alarm_allows_for_all_that_drift_may_have_added(kilotonnes: float, factor: float, alarms: bool) -> None:
    """10 % off is an alarm right after a ticket, and not after grain over which the rates may have made as much."""
    calibrator, estimator = ClosedLoopCalibrator(MODEL, STEADY), OpenLoop(MODEL, PRIOR)
    calibrator.drift_std_dev(second(0.0), estimator)
    known = calibrator.weigh(second(1.0), (ticket(estimator, FLOW_KG_S, 0.0, 90.0),), estimator).estimator
    assert known is not None
    at_s = 1e5 * kilotonnes + 1000.0
    later = replace(second(1000.0 * kilotonnes + 2.0), time_s=at_s + 1000.0)
    calibrator.drift_std_dev(later, known)
    right = ticket(known, FLOW_KG_S, at_s, at_s + 900.0)
    checks = calibrator.weigh(later, (replace(right, reference_kg=factor * right.reference_kg),), known).checks
    assert len(checks) == 1
    assert (checks[0].p_value < 0.001) is alarms

"""The frames of a window: what the signals can carry, counters that begin anew, and what is not available."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from math import isfinite
from typing import Any

import pytest
from engine_bench import PARAMETERS, Bench, feed, monitor, only

from yieldmon import frames as bus
from yieldmon.engine.health import FaultBook
from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.publishing import Published, Publisher
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.settings import EngineSettings
from yieldmon.engine.sweeps.sweep_machine import SweepMachine
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.frames import NOT_AVAILABLE, EstimateQuality, Value
from yieldmon.signal_ranges import signal_ranges

Q = EstimateQuality
NAN = float("nan")
RANGES = signal_ranges()


@cache
def measured() -> tuple[WindowRecord, SweepMachine]:
    target = monitor()
    feed(target, Bench(flow=lambda t: 10.0 if t > 1005.0 else 0.0).frames(12))
    return target.records[-1], target.sweep


def published(
    message: str, age_s: float | None = 120.0, parameters: ParameterSet = PARAMETERS, **changes: Any
) -> dict[str, Value]:
    record, sweep = measured()
    frames = Publisher().frames(replace(record, **changes), Published(sweep, parameters, age_s, FaultBook()))
    (found,) = (frame.signals for frame in frames if frame.message == message)
    return dict(found)


@pytest.mark.parametrize(
    ("message", "signal", "attribute"),
    [(bus.MASS_FLOW, "WindowCounter", "window"), (bus.ACCUMULATED_MASS, "LoadNumber", "load_number")],
)
def test_counters_begin_anew_after_their_largest_value(message: str, signal: str, attribute: str) -> None:
    most = int(RANGES[message][signal][1])
    counts = [0, 1, most - 1, most, most + 1, most + 2, 2 * most + 2]
    found = [published(message, **{attribute: count})[signal] for count in counts]
    assert found == [0, 1, most - 1, most, 0, 1, 0]


@pytest.mark.parametrize(
    ("changes", "available", "quality"),
    [
        ({}, True, Q.OK),
        ({"mass_flow_kg_s": NAN}, False, Q.NOT_AVAILABLE),
        ({"mass_flow_kg_s": NAN, "quality": Q.NOT_HARVESTING}, False, Q.NOT_HARVESTING),
    ],
)
def test_flow_is_available_where_it_was_measured(changes: dict[str, Any], available: bool, quality: Q) -> None:
    found = published(bus.MASS_FLOW, **{"quality": Q.OK, **changes})
    record, _ = measured()
    flow = (record.mass_flow_kg_s, record.std_dev_kg_s) if available else (NOT_AVAILABLE, NOT_AVAILABLE)
    assert (found["MassFlowRate"], found["MassFlowStdDev"], found["EstimateQuality"]) == (*flow, int(quality))


@pytest.mark.parametrize(("kept_until_s", "known"), [(1009.26, True), (1009.2, False)], ids=["0.24 of it", "0.18 of it"])
def test_a_second_of_too_few_samples_has_no_flow_in_frame_and_record(kept_until_s: float, known: bool) -> None:
    """What was measured of it counts in the load; its record said 28.7 +- 13 kg/s, its frame nothing."""
    target, least = monitor(), EngineSettings().windows.min_coverage
    frames = Bench(flow=lambda t: 10.0 if t > 1005.0 else 0.0).frames(12)
    out = feed(target, [f for f in frames if f.message != bus.IMPACT_SENSOR_SAMPLES or not kept_until_s < f.time_s < 1010.12])
    (record,) = [one for one in target.records if one.time_s == pytest.approx(1010.1)]
    assert (least <= record.coverage < 0.3) if known else (0.1 < record.coverage < least)
    assert record.mass_kg == pytest.approx(10.0 if known else 10.0 * record.coverage, rel=0.1)
    assert record.quality == (Q.DEGRADED if known else Q.NOT_AVAILABLE)
    assert isfinite(record.mass_flow_kg_s) == isfinite(record.std_dev_kg_s) == known
    (sent,) = [f for f in only(out, bus.MASS_FLOW) if f.time_s == record.time_s]
    assert (sent.signals["MassFlowRate"] != NOT_AVAILABLE) == known
    assert sent.signals["EstimateQuality"] == int(record.quality)


@pytest.mark.parametrize(("signal", "attribute"), [("MassFlowRate", "mass_flow_kg_s"), ("MassFlowStdDev", "std_dev_kg_s")])
def test_what_a_signal_cannot_carry_is_not_available(signal: str, attribute: str) -> None:
    low, high = RANGES[bus.MASS_FLOW][signal]
    for value, carried in ((low, True), (high, True), (low - 1e-6, False), (high + 1e-6, False)):
        assert published(bus.MASS_FLOW, **{attribute: value})[signal] == (value if carried else NOT_AVAILABLE)


@pytest.mark.parametrize(("age_s", "minutes"), [(0.0, 0), (59.9, 0), (60.0, 1), (119.9, 1), (7200.0, 120), (None, NOT_AVAILABLE)])
def test_the_age_of_the_calibration_in_whole_minutes(age_s: float | None, minutes: Value) -> None:
    assert published(bus.SELF_CALIBRATION_STATUS, age_s)["CalibrationAge"] == minutes


def test_an_age_that_its_signal_cannot_carry_is_not_available() -> None:
    most = RANGES[bus.SELF_CALIBRATION_STATUS]["CalibrationAge"][1]
    assert published(bus.SELF_CALIBRATION_STATUS, 60.0 * most + 59.0)["CalibrationAge"] == most
    assert published(bus.SELF_CALIBRATION_STATUS, 60.0 * most + 60.0)["CalibrationAge"] == NOT_AVAILABLE


@pytest.mark.parametrize(
    ("values", "gain"), [({"restitution": 0.6}, 1.6), ({"restitution": 0.0}, 1.0), ({"k1": 1.25, "k2": 0.5}, 1.75)]
)
def test_friction_and_gain_of_the_impact(values: dict[str, float], gain: float) -> None:
    known = {"friction": 0.25, "density": 800.0, "shape_ratio": 2.0, **values}
    found = published(bus.SELF_CALIBRATION_STATUS, parameters=ParameterSet(known))
    assert (found["Friction"], found["ImpactGain"]) == (0.25, pytest.approx(gain))


def test_masses_near_the_largest_that_their_signals_carry() -> None:
    publisher = Publisher()
    most_load, most_total = (RANGES[bus.ACCUMULATED_MASS][name][1] for name in ("LoadMass", "TotalMass"))

    class Counted:
        load_kg = total_kg = 0.0

    totals: Totals = Counted()  # type: ignore[assignment]
    assert publisher.mass_near_end(totals, 0.5) is None
    totals.load_kg = 0.5 * most_load
    assert publisher.mass_near_end(totals, 0.5) == f"LoadMass {0.5 * most_load:.0f} kg of at most {most_load:.0f} kg: load start"
    totals.load_kg -= 1.0
    assert publisher.mass_near_end(totals, 0.5) is None
    totals.total_kg = totals.load_kg = most_total
    reported = publisher.mass_near_end(totals, 0.5)
    assert reported is not None
    assert reported.endswith(f"; TotalMass {most_total:.0f} kg of at most {most_total:.0f} kg: totals archive")

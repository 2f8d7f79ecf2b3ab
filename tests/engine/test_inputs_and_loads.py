"""Inputs are taken each by its own name, whatever its message brings beside it; masses join the load that they are of."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import pytest
from engine_bench import MACHINE, Bench, ForceProportional, Kept

from yieldmon import frames as bus
from yieldmon.engine.inputs import Inputs
from yieldmon.engine.loads import Loads
from yieldmon.engine.runs import run_of
from yieldmon.engine.settings import EngineSettings, InputSettings, TotalsSettings
from yieldmon.engine.since_zero import MissedMass
from yieldmon.engine.sources import DEFAULT_SOURCES
from yieldmon.frames import Frame
from yieldmon.physics.machine import RPM


def test_only_the_tanks_mass_is_the_tanks() -> None:
    inputs = Inputs(InputSettings())
    for second in range(20):
        inputs.take(bus.TANK_SCALE, float(second), {"TankMass": 4000.0 + 10.0 * second, "TankScaleStatus": 0})
        inputs.take(bus.GRAIN_CONDITION, second + 0.5, {"Moisture": 15.0, "GrainTemperature": 20.0, "TestWeight": 720.0})
    assert inputs.tank.disputed_s == -inf
    for second in range(20, 26):
        inputs.take(bus.TANK_SCALE, float(second), {"TankMass": 4000.0 if second % 2 else 15.0, "TankScaleStatus": 0})
    assert inputs.tank.disputed_s == 25.0


@pytest.mark.parametrize("step_s", [0.0, 7200.0, -7200.0], ids=["no step", "forward", "back"])
def test_a_message_with_samples_brings_what_else_is_in_it(step_s: float) -> None:
    """A sensor node that sends the speed beside its samples, with the clock set in the middle of a run."""
    sources = replace(
        DEFAULT_SOURCES,
        inputs=tuple(
            replace(source, message=bus.IMPACT_SENSOR_SAMPLES, signal="Speed") if source.quantity == "elevator_speed" else source
            for source in DEFAULT_SOURCES.inputs
        ),
    )
    heard = []
    for frame in Bench(flow=lambda t: 10.0 if t > 1004.0 else 0.0).frames(16):
        if frame.message != bus.ELEVATOR_SPEED:
            signals = {**frame.signals, "Speed": 400.0} if frame.message == bus.IMPACT_SENSOR_SAMPLES else frame.signals
            heard.append(Frame(frame.time_s + (step_s if frame.time_s > 1010.0 else 0.0), frame.message, signals))
    one_by_one, whole = (Kept(EngineSettings(), MACHINE, ForceProportional(), sources=sources) for _ in range(2))
    for frame in heard:
        one_by_one.feed(frame)
    whole.feed_run(run_of(heard, sources))
    assert len(whole.records) >= 14
    assert [record.elevator_speed_rad_s / RPM for record in whole.records] == pytest.approx([400.0] * len(whole.records))
    assert repr(whole.results) == repr(one_by_one.results)


@pytest.mark.parametrize(("given", "expected"), [(None, 13.5), (15.5, 15.5)])
def test_dry_mass_is_counted_at_the_market_moisture_that_was_set(given: float | None, expected: float) -> None:
    loads = Loads(replace(EngineSettings(), totals=TotalsSettings(moisture_reference_pct=given)))
    loads.set_market_moisture(13.5)
    assert loads.totals.market_moisture_pct == expected


def test_missed_mass_joins_its_own_load_and_no_other() -> None:
    def missed(kg: float) -> MissedMass:
        return MissedMass().plus(kg, None, area_known=True)

    loads = Loads(EngineSettings())
    loads.begin(0.0)
    assert loads.correct({1: missed(100.0)}) == ()
    loads.start(10.0)
    loads.correct({2: missed(50.0)})
    loads.start(20.0)
    corrected = [event.load for event in loads.correct({1: missed(5.0), 2: missed(-60.0), 3: missed(7.0)})]
    assert [(load.number, load.measured_kg, load.unknown_moisture_kg) for load in corrected] == [(1, 105.0, 105.0), (2, 0.0, 0.0)]
    assert [(load.number, load.measured_kg) for load in loads.all] == [(1, 105.0), (2, 0.0), (3, 7.0)]
    assert (loads.totals.total_kg, loads.totals.total_unknown_moisture_kg) == (102.0, 102.0)

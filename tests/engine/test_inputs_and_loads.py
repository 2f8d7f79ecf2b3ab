"""Inputs are taken each by its own name, whatever its message brings beside it; masses join the load that they are of."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest
from engine_bench import MACHINE, Bench, ForceProportional, Kept

from studies.waveform.frame_runs import run_of
from yieldmon import frames as bus
from yieldmon.engine.inputs import Inputs
from yieldmon.engine.mass.loads import Loads
from yieldmon.engine.mass.missed_mass import MissedMass
from yieldmon.engine.mass.silences import Missing, Silences
from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.settings import EngineSettings, InputSettings, TotalsSettings
from yieldmon.engine.sources import DEFAULT_SOURCES, QUANTITIES
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


MISSING = {
    "available": None,
    "silent": Missing.of(sampled=False, speed=nan, in_range=False, zeroed=False),
    "waking": Missing.of(sampled=False, speed=30.0, in_range=True, zeroed=False),
    "unzeroed": Missing.of(sampled=True, speed=30.0, in_range=True, zeroed=False),
    "spin-up": Missing.of(sampled=True, speed=15.0, in_range=False, zeroed=False),
    "standing": Missing.of(sampled=True, speed=0.0, in_range=False, zeroed=False),
    "at rest": None,
}


@pytest.mark.parametrize(
    ("seconds", "whole"),
    [
        ("", True),
        ("available", True),
        (["silent"] * 60 + ["available"], True),
        (["silent"] * 61, False),
        (["silent"] * 5 + ["waking"] * 3 + ["available"] * 2, True),
        (["silent"] * 5 + ["waking"] * 4, False),
        (["silent", "waking", "silent", "silent", "silent"], False),
        (["waking"], False),
        (["available", "silent"], False),
        (["silent", "available", "silent"], False),
        (["silent", "available", "waking"], False),
        (["unzeroed"] * 3 + ["waking", "available"], True),
        (["unzeroed"] * 5, False),
        (["spin-up"] * 6 + ["unzeroed"] * 3 + ["waking", "available"], True),
        (["spin-up"] * 7, False),
        (["standing"] * 100 + ["spin-up"] * 6 + ["unzeroed"] * 5, False),
        (["standing"] * 100 + ["unzeroed"] * 3 + ["waking", "available"], True),
        (["silent"] * 5 + ["unzeroed"] * 3 + ["waking", "available"], True),
        (["unzeroed"] * 3 + ["available", "waking"], False),
        (["available", "unzeroed"], False),
        # The ignition is off, also until the load ends.
        (["available", "at rest", *["silent"] * 3600], True),
        (["available", "at rest", *["silent"] * 3600, "at rest", "available"], True),
        (["available", "at rest", "waking", *["silent"] * 61, "waking", "waking", "at rest"], True),
        (["at rest", *["silent"] * 3600, "available"], False),
        (["at rest", *["silent"] * 60, "available", "available"], True),
        (["at rest", *["silent"] * 5, *["waking"] * 4], False),
        (["at rest", "available", "silent"], False),
        (["at rest", *["silent"] * 5, "available", "silent"], False),
    ],
    ids=lambda seconds: str(seconds)[:80],
)
def test_a_load_may_lack_its_sensors_while_no_grain_comes(seconds: list[str] | str, whole: bool) -> None:
    silences, taken = Silences(), [seconds] if seconds == "available" else seconds
    found = [silences.lacks_nothing(1.0, MISSING[second], stands=second == "at rest") for second in taken]
    assert all(found) is whole


@pytest.mark.parametrize("is_open", [True, False])
def test_totals_that_are_reset_begin_from_nothing_in_a_load_of_their_own(is_open: bool) -> None:
    loads = Loads(EngineSettings())
    loads.set_market_moisture(13.5)
    loads.begin(0.0)
    loads.start(10.0)
    loads.correct({2: MissedMass().plus(50.0, None, area_known=True)})
    if not is_open:
        loads.stop(15.0)
    assert (loads.totals.total_kg, loads.totals.load_number) == (50.0, 2)
    loads.reset(20.0)
    assert loads.totals == Totals(load_number=3, first_load=3, market_moisture_pct=13.5)


PLAUSIBLE = [
    ("elevator_speed", (0.0, 400.0), (-1.0, nan)),
    ("plate_angle", (0.0, 70.0, 90.0), (-1.0, 400.0, nan)),
    ("moisture", (0.0, 15.0, 99.9), (-0.1, 100.0, nan)),
    ("grain_temperature", (-50.0, 20.0, 100.0), (-50.1, 100.1, nan)),
    ("test_weight", (0.1, 720.0), (0.0, -1.0, nan)),
    ("thousand_kernel_weight", (1.0, 2000.0), (0.9, 2000.1, nan)),
    ("course", (0.0, 360.0), (-0.1, 360.1, nan)),
    ("ground_speed", (0.0, 6.0), (-0.1, nan)),
    ("latitude", (-90.0, 0.0, 90.0), (-90.1, 90.1, 180.0, nan)),
    ("longitude", (-180.0, 0.0, 180.0), (-180.1, 180.1, nan)),
    ("header_down", (0.0, 1.0), (2.0, 0.5, nan)),
    ("actuator_state", (0.0, 1.0, 2.0, 3.0), (4.0, 0.5, nan)),
]


@pytest.mark.parametrize(("quantity", "usable", "unusable"), PLAUSIBLE, ids=[row[0] for row in PLAUSIBLE])
def test_what_cannot_be_true_is_not_used(quantity: str, usable: tuple[float, ...], unusable: tuple[float, ...]) -> None:
    found = QUANTITIES[quantity].usable
    assert [bool(found(value)) for value in (*usable, *unusable)] == [True] * len(usable) + [False] * len(unusable)
    assert found(np.array([*usable, *unusable])).tolist() == [True] * len(usable) + [False] * len(unusable)

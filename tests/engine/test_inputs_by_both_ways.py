"""Inputs frame by frame and over a run: ages at their limits, readings of a scale that is not stable, halves of a position."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, nan, nextafter

import pytest

from studies.waveform.frame_runs import run_of
from yieldmon import frames as bus
from yieldmon.engine.inputs import Inputs, InputSnapshot
from yieldmon.engine.settings import InputSettings
from yieldmon.engine.sources import QUANTITIES
from yieldmon.frames import Frame, Value

SETTINGS = InputSettings()
STABLE, UNSTABLE, FAULT = 0, 1, 2


def seen(frames: list[Frame], at_s: float) -> InputSnapshot:
    """What is held at an instant after these frames; the same frame by frame and over a run."""
    one_by_one = Inputs(SETTINGS)
    for frame in frames:
        one_by_one.take(frame.message, frame.time_s, frame.signals)
    found = one_by_one.snapshot(at_s)
    together = Inputs(SETTINGS)
    run = together.follow(run_of(frames), 0.0)
    (over,) = run.snapshots([at_s])
    assert repr(over) == repr(found)
    run.finish()
    assert repr(together.snapshot(at_s)) == repr(found)
    return found


@pytest.mark.parametrize("name", [name for name, quantity in QUANTITIES.items() if quantity.usable(1.0)])
def test_a_value_is_fresh_up_to_its_timeout(name: str) -> None:
    timeout_s = getattr(SETTINGS, QUANTITIES[name].timeout)
    inputs = Inputs(SETTINGS)
    inputs.held[name].set(0.0, 1.0)
    for at_s, fresh in ((timeout_s, True), (nextafter(timeout_s, inf), False)):
        (together,) = inputs.follow(run_of([]), 0.0).snapshots([at_s])
        for found in (inputs.snapshot(at_s), together):
            assert (found.fresh[name] == 1.0) is fresh


def tank(*readings: tuple[float, float, int]) -> list[Frame]:
    """Frames of (time s, kg, status)."""
    return [Frame(at, bus.TANK_SCALE, {"TankMass": kg, "TankScaleStatus": status}) for at, kg, status in readings]


@pytest.mark.parametrize(
    ("readings", "expected"),
    [
        ([(1.0, 100.0, STABLE)], (1.0, 100.0)),
        ([(1.0, 100.0, STABLE), (2.0, 200.0, UNSTABLE)], (1.0, 100.0)),
        ([(1.0, 100.0, UNSTABLE), (2.0, 200.0, STABLE)], (2.0, 200.0)),
        ([(1.0, 100.0, FAULT)], (-inf, nan)),
        ([(1.0, 100.0, STABLE), (2.0, nan, STABLE)], (1.0, 100.0)),
    ],
    ids=["stable", "no longer stable", "stable again", "with a fault", "no number"],
)
def test_a_tank_is_weighed_by_readings_that_are_stable_themselves(
    readings: list[tuple[float, float, int]], expected: tuple[float, float]
) -> None:
    found = seen(tank(*readings), 3.0)
    assert (found.tank_time_s, found.tank_kg) == pytest.approx(expected, nan_ok=True)


def position(at_s: float, **degrees: Value) -> Frame:
    return Frame(at_s, bus.VEHICLE_POSITION, degrees)


@pytest.mark.parametrize(
    ("second", "expected"),
    [({"Latitude": 47.5, "Longitude": 8.5}, (47.5, 8.5)), ({"Latitude": 47.5, "Longitude": 200.0}, (47.0, 8.0)),
     ({"Latitude": 95.0, "Longitude": 8.5}, (47.0, 8.0)), ({"Latitude": 0.0, "Longitude": 0.0}, (47.0, 8.0)),
     ({"Latitude": 0.0, "Longitude": 8.5}, (0.0, 8.5)), ({"Latitude": 47.5, "Longitude": bus.NOT_AVAILABLE}, (47.0, 8.0))],
    ids=["both", "no longitude", "no latitude", "neither", "on the equator", "longitude not available"],
)  # fmt: skip
def test_halves_of_a_position_and_places_without_a_fix_are_not_used(
    second: Mapping[str, Value], expected: tuple[float, float]
) -> None:
    found = seen([position(1.0, Latitude=47.0, Longitude=8.0), position(1.5, **second)], 2.0)
    assert (found.fresh["latitude"], found.fresh["longitude"]) == expected

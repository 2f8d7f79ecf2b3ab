"""What a monitor without a zero says that it waits for."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from yieldmon.engine.faults import FaultCode
from yieldmon.engine.health import FaultEvent
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.results import WindowResult
from yieldmon.engine.settings import EngineSettings
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.files import machine_file, parameter_file
from yieldmon.frames import Frame
from yieldmon.physics.model import ForwardModel


def waiting(
    rpm: float | None = 400.0, angle_deg: float | None = 70.0, sensor: bool = True, pulse_mv: float = 0.0, seconds: float = 3.3
) -> str:
    """The sentence after some seconds of these frames."""
    machine, parameters = machine_file.load(), parameter_file.load()
    monitor = Monitor(EngineSettings(), machine, OpenLoop(ForwardModel(machine, parameters.effects), parameters))
    period_s = machine.pattern_length_m / machine.paddle_speed_m_s(400.0 * 0.10471975511965977)
    for k in range(int(250 * seconds)):
        at = 100.0 + 0.004 * k
        if sensor:
            samples = {f"Sample{i}": 500.0 + (pulse_mv if (at / period_s) % 1.0 < 0.3 else 0.0) for i in range(4)}
            monitor.feed(Frame(at, "ImpactSensorSamples", {**samples, "SampleCounter": k % 256, "SensorStatus": 0}))
        if rpm is not None and k % 25 == 0:
            monitor.feed(Frame(at, "ElevatorSpeed", {"ElevatorSpeed": rpm}))
        if angle_deg is not None and k % 12 == 0:
            monitor.feed(Frame(at, "PlateActuatorFeedback", {"PlateAngle": angle_deg, "ActuatorState": 0}))
        monitor.tick(at)
    return monitor.zero_waits_for


@pytest.mark.parametrize(
    ("how", "expected"),
    [
        ({"rpm": None}, "the elevator's speed, which no frame reports"),
        (
            {"rpm": 42.0},
            "the elevator to run at 250 to 599 rpm: it turns at 42 rpm; if 42 is in rad/s, that is 401 rpm: mapping `unit`",
        ),
        (
            {"rpm": 6.6},
            "the elevator to run at 250 to 599 rpm: it turns at 7 rpm; "
            "if 6.6 is in turns a second, that is 396 rpm: mapping `unit`",
        ),
        ({"rpm": 150.0}, "the elevator to run at 250 to 599 rpm: it turns at 150 rpm"),
        ({"rpm": 0.0}, "the elevator to run at 250 to 599 rpm: it turns at 0 rpm"),
        ({"sensor": False}, "whole seconds of samples from the impact sensor: the last has 0 %"),
        ({"angle_deg": 50.0}, "the plate to rest at home, 70 deg: it is at 50.0 deg"),
        ({"angle_deg": None}, "the plate to rest at home, 70 deg: no frame reports its angle"),
        ({"seconds": 2.3}, "the elevator running empty: 2 of 3 s"),
        ({"seconds": 8.0}, ""),
    ],
    ids=["no speed", "rad/s", "Hz", "slow", "stands", "no sensor", "plate away", "no feedback", "under way", "taken"],
)
def test_the_zero_says_what_it_waits_for(how: dict[str, float | None], expected: str) -> None:
    assert waiting(**how) == expected  # type: ignore[arg-type]


def test_grain_on_the_paddles_is_named() -> None:
    reported = waiting(pulse_mv=400.0, seconds=6.0)
    assert reported.startswith("an elevator that runs empty: in the last 3 s the paddle pulses had an amplitude of ")
    assert "stop taking in crop" in reported


def shown(
    seconds: int, *, sends: Callable[[int], bool] = lambda k: True, angle_deg: float = 70.0, cutting: bool = False
) -> tuple[Monitor, str]:
    """A monitor after so long with an empty elevator, and its last ZeroMissing. sends: whether sample frame k comes."""
    machine, parameters = machine_file.load(), parameter_file.load()
    monitor = Monitor(EngineSettings(), machine, OpenLoop(ForwardModel(machine, parameters.effects), parameters))
    told = ""
    for k in range(250 * seconds):
        at = 100.0 + 0.004 * k
        found = []
        if sends(k):
            samples = dict.fromkeys((f"Sample{i}" for i in range(4)), 500.0 + k % 2)
            found += monitor.feed(Frame(at, "ImpactSensorSamples", {**samples, "SampleCounter": k % 256, "SensorStatus": 0}))
        if k % 25 == 0:
            found += monitor.feed(Frame(at, "ElevatorSpeed", {"ElevatorSpeed": 400.0}))
            found += monitor.feed(Frame(at, "HarvestState", {"HeaderDown": int(cutting), "WorkState": int(cutting)}))
        if k % 12 == 0:
            found += monitor.feed(Frame(at, "PlateActuatorFeedback", {"PlateAngle": angle_deg, "ActuatorState": 0}))
        for result in found:
            if isinstance(result, WindowResult):
                events = [event for event in result.events if isinstance(event, FaultEvent)]
                told = next((event.detail for event in events if event.code == FaultCode.ZERO_MISSING), told)
    return monitor, told


def test_a_sensor_that_loses_frames_all_the_time_has_a_zero() -> None:
    """One frame of thirty lost, as on a loaded bus: no second is whole, and without a zero nothing is ever measured."""
    monitor, _ = shown(6, sends=lambda k: k % 30 != 7)
    assert monitor.zero_waits_for == ""


@pytest.mark.parametrize(
    ("how", "expected"),
    [
        ({"sends": lambda k: k % 3 != 1}, "whole seconds of samples from the impact sensor: the last has 67 %"),
        ({"angle_deg": 63.0}, "the plate to rest at home, 70 deg: it is at 63.0 deg"),
        ({"cutting": True}, "the machine is cutting"),
    ],
    ids=["many lost", "plate away", "cutting from the start"],
)
def test_no_zero_for_a_minute_is_a_fault_whatever_it_waits_for(how: dict[str, object], expected: str) -> None:
    """All the same the elevator runs and nothing is measured."""
    _, told = shown(64, **how)  # type: ignore[arg-type]
    assert expected in told

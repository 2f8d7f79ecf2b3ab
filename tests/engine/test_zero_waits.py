"""What a monitor without a zero says that it waits for."""

from __future__ import annotations

import pytest

from yieldmon.engine.monitor import Monitor
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
        ({"sensor": False}, "all samples of a second from the impact sensor"),
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
    assert reported.startswith("an elevator that runs empty: the paddles throw pulses of ")
    assert "stop taking in crop" in reported

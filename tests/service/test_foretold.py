"""What `check-config --log` says of a recording is what the daemon would show on it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import can
import pytest

from tests.service import bench
from yieldmon.bus.codec import Codec
from yieldmon.cli.main import main
from yieldmon.frames import ELEVATOR_SPEED, IMPACT_SENSOR_SAMPLES, Frame

SECONDS = 20


def recorded(folder: Path, changed: Callable[[Frame], Frame | None] = lambda frame: frame) -> Path:
    codec, path = Codec(), folder / "drive.log"
    with can.Logger(str(path)) as log:
        for frame in bench.traffic(bench.START_S, SECONDS, bench.EMPTY_MV):
            kept = changed(frame)
            if kept is not None:
                log.on_message_received(codec.encode(kept))
    return path


def with_status(frame: Frame) -> Frame:
    return frame._replace(signals={**frame.signals, "SensorStatus": 1}) if frame.message == IMPACT_SENSOR_SAMPLES else frame


def counting_samples(frame: Frame) -> Frame:
    """As a sensor whose counter counts samples, four in a frame."""
    if frame.message != IMPACT_SENSOR_SAMPLES:
        return frame
    return frame._replace(signals={**frame.signals, "SampleCounter": round(1000.0 * frame.time_s) % 256})


def seldom_speed(frame: Frame) -> Frame | None:
    return None if frame.message == ELEVATOR_SPEED and frame.time_s % 4.0 > 0.05 else frame


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        (lambda frame: frame, []),
        (with_status, ["the daemon shows SensorSaturated in 19 of 19 s: 100 % of the samples"]),
        (counting_samples, ["the daemon shows FramesLost in 19 of 19 s: ", "or the mapping's counter is wrong"]),
        (
            seldom_speed,
            [
                "elevator_speed comes up to 4 s apart, and a value holds for inputs.speed_timeout_s: where it is sent only when",
                "the daemon shows SpeedMissing in 1",
            ],
        ),
    ],
)
def test_faults_of_a_recording_are_told(
    changed: Callable[[Frame], Frame | None], told: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = recorded(tmp_path, changed)
    assert main(["check-config", "--log", str(log)]) == 0
    notes = [line for line in capsys.readouterr().out.splitlines() if line.startswith("note: ")]
    assert bool(notes) == bool(told)
    assert all(any(text in note for note in notes) for text in told)


def test_a_damaged_place_of_a_recording_is_said_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The recording is read twice."""
    log = recorded(tmp_path)
    with log.open("a") as stream:
        stream.write("(1790000000.0) can")
    assert main(["check-config", "--log", str(log)]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert [(line.startswith(f"yieldmon: {log}:"), line.endswith("is not a candump line")) for line in lines] == [(True, True)]

"""A load that begins before the sensors' nodes are awake: whole where no grain can have passed unseen."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.service.bench import encoded, running, traffic
from yieldmon import frames

EMPTY_MV = 0.0
#: The elevator's speed that its node reports while no sample comes, rpm; whether the load that begins meanwhile is whole.
BEGINS = {"the elevator stands": (0.0, True), "the elevator runs unseen": (400.0, False)}


@pytest.mark.parametrize("begin", BEGINS)
def test_seconds_without_samples_cost_a_load_nothing_while_the_elevator_stands(tmp_path: Path, begin: str) -> None:
    speed_rpm, whole = BEGINS[begin]
    with running(tmp_path) as bench:
        bench.play(15, EMPTY_MV)
        bench.played()
        for seconds in (3.0, 10.0):
            for frame in traffic(bench.now_s, seconds, EMPTY_MV):
                signals = {"ElevatorSpeed": speed_rpm} if frame.message == frames.ELEVATOR_SPEED else frame.signals
                if frame.message != frames.IMPACT_SENSOR_SAMPLES:
                    bench.peer.send(encoded(frame._replace(signals=signals)))
            bench.now_s += seconds
            bench.played()
            if seconds == 3.0:
                bench.daemon.command({"command": "load-start"})
        bench.play(6, EMPTY_MV)
        bench.played()
        assert bench.daemon.monitor.loads[-1].complete is whole

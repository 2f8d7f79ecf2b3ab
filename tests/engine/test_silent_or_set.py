"""A step of the bus's time: a clock that was set loses nothing, a bus that was silent does, and its load is no reference."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from engine_bench import Bench, feed, monitor

from studies.waveform.frame_runs import run_of

BENCH = Bench(flow=lambda t: 14.0 if t >= 1020.0 else 0.0)
FRAMES = BENCH.frames(200)


@pytest.mark.parametrize("as_run", [False, True], ids=["frame by frame", "as a run"])
@pytest.mark.parametrize(
    ("missing", "shift_s", "complete"),
    [
        (lambda t: False, lambda t: 0.0, True),
        (lambda t: False, lambda t: 1.7e9 if t > 1100.0 else 0.0, True),
        (lambda t: False, lambda t: -900.0 if t > 1100.0 else 0.0, True),
        (lambda t: 1100.0 < t < 1171.0, lambda t: 0.0, False),
        (lambda t: 1100.0 < t < 1171.0, lambda t: 1.7e9 if t > 1100.0 else 0.0, False),
        (lambda t: 1100.0 < t < 1130.0, lambda t: 0.0, False),
    ],
    ids=["neither", "set to the date", "set back", "silent for 71 s", "silent, then set", "silent for 30 s"],
)
def test_what_a_step_of_time_leaves_of_a_load(
    missing: Callable[[float], bool], shift_s: Callable[[float], float], complete: bool, as_run: bool
) -> None:
    target = monitor()
    frames = [frame._replace(time_s=frame.time_s + shift_s(frame.time_s)) for frame in FRAMES if not missing(frame.time_s)]
    feed(target, run_of(frames) if as_run else frames)
    (load,) = target.loads
    assert load.complete is complete
    assert load.measured_kg > 1000.0

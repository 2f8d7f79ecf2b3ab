"""Cost of a sample frame, of a closed window, and of a second of samples through the block path (`tools/bench`)."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "engine"))

from engine_bench import MACHINE, Bench, monitor

from studies.waveform.frame_runs import run_of
from yieldmon.engine.sampling.windows import WindowBuilder
from yieldmon.engine.settings import WindowSettings
from yieldmon.physics.machine import RPM

BENCH = Bench(flow=lambda t: 10.0 if t > 1005 else 0.0, scatter=0.07)


@pytest.mark.benchmark(group="30 s of frames (8,400 frames)")
def test_feed(benchmark):
    frames = BENCH.frames(30)

    def run():
        target = monitor()
        for frame in frames:
            target.feed(frame)
        return target

    assert benchmark(run).totals.total_kg > 200.0


@pytest.mark.benchmark(group="30 s of frames (8,400 frames)")
def test_feed_run(benchmark):
    whole = run_of(BENCH.frames(30))

    def run():
        target = monitor()
        target.feed_run(whole)
        return target

    assert benchmark(run).totals.total_kg > 200.0


@pytest.mark.benchmark(group="close of a window (1,000 samples)")
def test_close(benchmark):
    samples = Bench(flow=lambda t: 10.0, start_s=0.0).sample_frames(1)
    rows = np.column_stack((samples["times_s"], samples["counters"], samples["statuses"], samples["millivolts"]))
    builder = WindowBuilder(WindowSettings(), MACHINE)
    second = iter(range(10**9))

    def close():
        start_s = float(next(second))
        shifted = rows.copy()
        shifted[:, 0] += start_s
        builder.samples.add_block(shifted)
        for tenth in range(10):
            builder.speed.add(start_s + 0.1 * tenth, 400.0 * RPM)
        return builder.close(start_s, start_s + 1.0)

    assert benchmark(close).samples == 1000

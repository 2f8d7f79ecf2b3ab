"""Impact samples in another unit than millivolts: frame by frame and in runs they measure what millivolts measure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from engine_bench import Bench, feed, monitor

from studies.waveform.frame_runs import run_of
from yieldmon import frames as bus
from yieldmon.engine.runs import in_millivolts
from yieldmon.engine.sources import DEFAULT_SOURCES
from yieldmon.frames import Frame

PLAIN = Bench(flow=lambda t: 10.0 if t > 1006.0 else 0.0).frames(12)


def in_another_unit(scale_mv: float, offset_mv: float) -> list[Frame]:
    def changed(frame: Frame) -> Frame:
        if frame.message != bus.IMPACT_SENSOR_SAMPLES:
            return frame
        values = {
            n: (v - offset_mv) / scale_mv if n.startswith("Sample") and n[6:].isdigit() else v for n, v in frame.signals.items()
        }
        return frame._replace(signals=values)

    return [changed(frame) for frame in PLAIN]


@pytest.mark.parametrize(("scale_mv", "offset_mv"), [(2.0, 0.0), (1.0, 1.0), (1.0, 64.0), (0.5, -32.0), (-2.0, 4.0)])
def test_the_same_is_measured(scale_mv: float, offset_mv: float) -> None:
    (sensor,) = DEFAULT_SOURCES.impact
    sources = replace(DEFAULT_SOURCES, impact=(replace(sensor, scale_mv=scale_mv, offset_mv=offset_mv),))
    plain, one_by_one, in_runs = monitor(), monitor(sources=sources), monitor(sources=sources)
    feed(plain, PLAIN)
    frames = in_another_unit(scale_mv, offset_mv)
    feed(one_by_one, frames)
    feed(in_runs, run_of(frames, sources))
    assert plain.records[-1].mass_flow_kg_s == pytest.approx(10.0, rel=0.1)
    for target in (one_by_one, in_runs):
        assert [r.force_n for r in target.records] == pytest.approx([r.force_n for r in plain.records], nan_ok=True)
        assert [r.coverage for r in target.records] == [r.coverage for r in plain.records]


@pytest.mark.parametrize(
    ("scale_mv", "offset_mv", "expected"),
    [(1.0, 0.0, [5.0, 6.0]), (2.0, 0.0, [10.0, 12.0]), (1.0, 1.0, [6.0, 7.0]), (0.0, 3.0, [3.0, 3.0]), (2.0, -1.0, [9.0, 11.0])],
)
def test_rows_in_millivolts(scale_mv: float, offset_mv: float, expected: list[float]) -> None:
    source = replace(DEFAULT_SOURCES.impact[0], signals=("A", "B"), scale_mv=scale_mv, offset_mv=offset_mv)
    rows = in_millivolts(source, np.array([[7.0, 0.0, 5.0, 6.0]]))
    assert rows.tolist() == [[7.0, 0.0, *expected]]

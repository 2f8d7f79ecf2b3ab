"""Least and largest sample of a window, and how long the last one was held, against a loop over the samples."""

from __future__ import annotations

from itertools import takewhile

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from yieldmon.engine.sampling.sample_frames import SampleFrames
from yieldmon.engine.sampling.window_spread import extremes

PER_FRAME = 4


def frames(windows: list[list[list[tuple[int, bool]]]]) -> SampleFrames:
    counts = [len(window) for window in windows]
    flat = [sample for window in windows for frame in window for sample in frame]
    usable = np.array([ok for _, ok in flat], dtype=bool).reshape(-1, PER_FRAME)
    values = np.array([value if ok else 0 for value, ok in flat], dtype=float).reshape(-1, PER_FRAME)
    none = np.zeros(len(counts), dtype=np.intp)
    return SampleFrames(
        np.concatenate(([0], np.cumsum(counts))).astype(np.intp), np.arange(sum(counts), dtype=float), values, usable,
        np.zeros(usable.shape, dtype=bool), np.zeros(sum(counts), dtype=bool), none, none, none, np.zeros(len(counts)),
    )  # fmt: skip


SAMPLE = st.tuples(st.integers(0, 2), st.sampled_from([True, True, True, False]))


@pytest.mark.parametrize("clean", [True, False], ids=["all usable", "some usable"])
@given(data=st.data())
def test_spans_and_held_samples(clean: bool, data: st.DataObject) -> None:
    frame = st.lists(SAMPLE, min_size=PER_FRAME, max_size=PER_FRAME)
    windows = data.draw(st.lists(st.lists(frame, max_size=3), min_size=1, max_size=4))
    if clean:
        windows = [[[(value, True) for value, _ in one] for one in window] for window in windows]
    span, held, count = extremes(frames(windows))
    for place, window in enumerate(windows):
        values = [value for one in window for value, ok in one if ok]
        assert count[place] == len(values)
        if values:
            assert span[place] == max(values) - min(values)
            assert held[place] == len(list(takewhile(values[-1].__eq__, reversed(values))))
        else:
            assert np.isnan(span[place])
            assert held[place] == 0

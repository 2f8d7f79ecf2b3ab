"""Frames of samples against a count of them one by one: what arrived, what was lost, what came twice, and which samples count."""

from __future__ import annotations

import math
import random
from dataclasses import replace

import numpy as np
import pytest

from yieldmon.engine.sampling.sample_frames import SampleBuffer
from yieldmon.engine.sources import SampleSource
from yieldmon.frames import SensorStatus

SOURCE = SampleSource("Samples", ("A", "B"), 0.002, counter="Counter")
INTERVAL_S, MODULUS = 0.004, 256
FULL_SCALE_MV, PLAUSIBLE = 2000.0, 1.5
A_SECOND = 250

Row = tuple[float, float, float, float, float]


def row(index: int, first_mv: float = 100.0, second_mv: float = 101.0, status: SensorStatus = SensorStatus.OK) -> Row:
    """The frame of this number, 1 and on, as a sensor sends it."""
    return (index * INTERVAL_S, float(index % MODULUS), float(status.value), first_mv, second_mv)


def buffer(source: SampleSource = SOURCE) -> SampleBuffer:
    return SampleBuffer(source, FULL_SCALE_MV, PLAUSIBLE)


def edges(windows: int) -> np.ndarray:
    return INTERVAL_S / 2 + np.arange(windows + 1.0)


class Train:
    """Seconds of frames, some of them lost, alone or for longer than the counter takes to come round, and some sent again."""

    def __init__(self, seed: int, windows: int) -> None:
        draw = random.Random(seed)
        self.rows: list[Row] = []
        self.kept: list[list[Row]] = [[] for _ in range(windows)]
        self.lost, self.repeated, self.contradicted = [0] * windows, [0] * windows, [0] * windows
        missing = skip = 0
        for index in range(1, windows * A_SECOND + 1):
            window = (index - 1) // A_SECOND
            if skip == 0 and index > 1 and draw.random() < 0.01:
                skip = draw.choice((1, 1, 2, 5, 255, 256, 300))
            if skip:
                skip, missing = skip - 1, missing + 1
                continue
            sent = row(index, draw.uniform(0.0, 500.0), draw.uniform(0.0, 500.0))
            self.rows.append(sent)
            self.kept[window].append(sent)
            self.lost[window] += missing
            missing = 0
            if draw.random() < 0.02:
                again = sent if draw.random() < 0.5 else (*sent[:4], sent[4] + 1.0)
                self.rows.append(again)
                self.repeated[window] += 1
                self.contradicted[window] += again is not sent


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("together", [1, 3, 12])
def test_frames_are_counted_as_one_by_one(seed: int, together: int) -> None:
    """However many windows are taken at once."""
    train = Train(seed, 12)
    target = buffer()
    for first in range(0, 12, together):
        low, high = first * A_SECOND * INTERVAL_S, (first + together) * A_SECOND * INTERVAL_S
        rows = [r for r in train.rows if low + 1e-9 < r[0] <= high + 1e-9]
        half = len(rows) // 2
        target.rows.extend(rows[:half])
        target.add_block(np.array(rows[half:]).reshape(-1, 5))
        found = target.take(edges(12)[first : first + together + 1])
        taken = slice(first, first + together)
        kept = [r for window in train.kept[taken] for r in window]
        assert found.times.tolist() == [r[0] for r in kept]
        assert found.samples.tolist() == [list(r[3:]) for r in kept]
        assert found.frames.tolist() == [len(window) for window in train.kept[taken]]
        assert found.sample_bounds.tolist() == [2 * bound for bound in found.bounds.tolist()]
        assert found.lost.tolist() == train.lost[taken]
        assert found.repeated.tolist() == train.repeated[taken]
        assert found.surplus.tolist() == train.contradicted[taken]
        assert found.clean


@pytest.mark.parametrize(
    ("frame", "samples", "usable", "over"),
    [
        (row(1, 1999.5, 2000.0), [1999.5, 2000.0], [True, True], [False, True]),
        (row(1, 3000.0, 3000.5), [3000.0, 0.0], [True, False], [True, False]),
        (row(1, -3000.0, -3000.5), [-3000.0, 0.0], [True, False], [False, False]),
        (row(1, math.nan, 5.0), [0.0, 5.0], [False, True], [False, False]),
        (row(1, status=SensorStatus.FAULT), [0.0, 0.0], [False, False], [False, False]),
        (row(1, status=SensorStatus.OVER_RANGE), [100.0, 101.0], [True, True], [True, True]),
    ],
)
def test_which_samples_count(frame: Row, samples: list[float], usable: list[bool], over: list[bool]) -> None:
    target = buffer()
    target.rows.append(frame)
    found = target.take(edges(1))
    assert found.samples.tolist() == [samples]
    assert found.usable.tolist() == [usable]
    assert found.over.tolist() == [over]
    assert found.fault.tolist() == [frame[2] == SensorStatus.FAULT.value]
    assert found.clean is all(usable)


@pytest.mark.parametrize(("more", "surplus"), [(29, 0), (30, 0), (31, 1), (250, 220)])
def test_more_frames_than_their_interval_allows_are_of_a_second_sender(more: int, surplus: int) -> None:
    """A tenth and five frames may be bunched; without a counter nothing else would tell."""
    target = buffer(replace(SOURCE, counter=None))
    step_s = 1.0 / (A_SECOND + more)
    target.rows.extend((INTERVAL_S + k * step_s, math.nan, 0.0, float(k), 0.0) for k in range(A_SECOND + more))
    found = target.take(edges(1))
    assert (found.surplus.tolist(), found.lost.tolist(), found.repeated.tolist()) == ([surplus], [0], [0])


@pytest.mark.parametrize(("gap_s", "lost"), [(0.004, 0), (0.0189, 0), (0.0191, 4), (0.4, 99)])
def test_without_a_counter_a_gap_shows_lost_frames(gap_s: float, lost: int) -> None:
    """Frames that come up to 15 ms late are no gap."""
    target = buffer(replace(SOURCE, counter=None))
    target.rows.extend((time_s, math.nan, 0.0, 1.0, 2.0) for time_s in (0.1, 0.104, 0.104 + gap_s))
    assert target.take(edges(1)).lost.tolist() == [lost]


def test_windows_without_frames() -> None:
    target = buffer()
    target.rows.extend(row(index) for index in range(1, A_SECOND + 1))
    assert target.take(edges(1)).frames.tolist() == [A_SECOND]
    silent = target.take(edges(3)[1:])
    assert silent.frames.tolist() == [0, 0]
    assert silent.last_frame_s.tolist() == [1.0, 1.0]
    assert (silent.lost.tolist(), silent.samples.shape) == ([0, 0], (0, 2))


def test_texts_in_the_place_of_numbers_are_not_usable() -> None:
    target = buffer()
    target.rows.append((0.1, 3, 0, "ERROR", 4.0))
    found = target.take(edges(1))
    assert (found.samples.tolist(), found.usable.tolist()) == ([[0.0, 4.0]], [[False, True]])


@pytest.mark.parametrize("together", [1, 3, 12])
@pytest.mark.parametrize(("stated", "turns_at"), [(15, 15), (15, 16), (16, 16)])
def test_a_counter_turns_where_its_range_ends_unless_it_counts_on(stated: int, turns_at: int, together: int) -> None:
    """Four bits of which the DBC names fifteen values; some senders use all sixteen."""
    target, draw = buffer(replace(SOURCE, counter_modulus=stated, counter_values=16)), random.Random(3)
    lost, counted = 0, 0
    for first in range(0, 12, together):
        for index in range(first * A_SECOND + 1, (first + together) * A_SECOND + 1):
            # Until the counter has come round once nobody can know where it turns.
            if index > turns_at and draw.random() < 0.01:
                lost += 1
            else:
                sent = row(index)
                target.rows.append((sent[0], float(index % turns_at), *sent[2:]))
        found = target.take(edges(12)[first : first + together + 1])
        counted += int(found.lost.sum())
        assert not found.repeated.any()
        assert not found.surplus.any()
    assert counted == lost > 0

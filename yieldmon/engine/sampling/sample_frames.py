"""Sample frames of one impact sensor: accepted frames, lost frames, and frames of a second sender."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yieldmon.engine.duplicate_senders import Crowding
from yieldmon.engine.sampling import segments
from yieldmon.engine.sampling.segments import Counts
from yieldmon.engine.sources import SampleSource
from yieldmon.frames import SensorStatus, number
from yieldmon.physics.numerics import Array

ROW_COLUMNS = 3
"""Columns of a sample row before the samples: engine time, counter, status."""

_BUNCHING_S = 0.015
"""Largest delay of a frame by other traffic on the bus."""
_CROWDED_SHARE, _CROWDED_FRAMES = 0.1, 5.0
"""Share and number of frames beyond those due that a gateway or a controller may bunch; more come from a second sender."""


@dataclass(frozen=True, slots=True)
class SampleFrames:
    """Accepted frames of w windows, flat. bounds (w + 1,): first frame of each window and the end of the last.

    times (n,); samples and usable (n, samples_per_frame), 0 where not usable; over (n, samples_per_frame): at the end of the
    range; fault (n,). Each of a window (w,): lost, by counter and time; surplus, that a second sender accounts for; repeated, the
    same counter twice (one is used); last_frame_s, engine time of the last frame until then.
    """

    bounds: Counts
    times: Array
    samples: Array
    usable: NDArray[np.bool_]
    over: NDArray[np.bool_]
    fault: NDArray[np.bool_]
    lost: Counts
    surplus: Counts
    repeated: Counts
    last_frame_s: Array

    @property
    def clean(self) -> bool:
        """Whether every sample is usable."""
        return bool(self.usable.all())

    @property
    def frames(self) -> Counts:
        """Frames of each window (w,)."""
        counts: Counts = np.diff(self.bounds)
        return counts

    @property
    def sample_bounds(self) -> Counts:
        """First sample of each window and the end of the last, (w + 1,)."""
        bounds: Counts = self.bounds * self.samples.shape[1]
        return bounds


class SampleBuffer:
    """Sample frames that belong to windows not closed yet."""

    def __init__(self, source: SampleSource, full_scale_mv: float, plausible_full_scales: float) -> None:
        """source: layout of the frames. full_scale_mv: end of the sensor's range. plausible_full_scales: a sample beyond so many
        of them is no voltage that the sensor can give."""
        self.rows: list[tuple[Any, ...]] = []
        """Rows that came one by one (engine time, counter, status, samples...); the caller appends."""
        self._blocks: list[Array] = []
        self._full_scale_mv = full_scale_mv
        self._limit_mv = plausible_full_scales * full_scale_mv
        self._modulus, self._counter_values = float(source.counter_modulus), float(source.counter_values)
        self._counted = source.counter is not None
        self._columns = ROW_COLUMNS + len(source.signals)
        self._interval_s = source.interval_s * len(source.signals)
        self._last_s = float("nan")
        self._last_counter = float("nan")
        self._resumes = list[int]()
        """Indices of waiting rows before which the recording paused: the counter's advance there means no lost frames."""
        self._crowding = Crowding(_CROWDED_SHARE, _CROWDED_FRAMES, self._interval_s)

    def add_block(self, rows: Array) -> None:
        """Append rows (n, 3 + samples_per_frame) that follow those already there."""
        if self.rows:
            self._blocks.append(_as_array(self.rows))
            self.rows = []
        if rows.shape[0]:
            self._blocks.append(rows)

    def resume(self) -> None:
        """The rows that follow were recorded after a pause."""
        self._resumes.append(len(self.rows) + sum(block.shape[0] for block in self._blocks))

    def take(self, edges: Array) -> SampleFrames:
        """The frames of the windows between edges (w + 1,), engine time, which are removed."""
        table = self._table()
        bounds = segments.bounds_at(table[:, 0], edges)
        last_frame_s = np.concatenate(([self._last_s], table[:, 0]))[bounds[1:]]
        steps = self._steps(table[:, 0], table[:, 1])
        if self._resumes:
            steps[[place for place in self._resumes if place < table.shape[0]]] = 1.0
            self._resumes = [0] if self._resumes[-1] == table.shape[0] else []
        if table.shape[0]:
            self._last_s, self._last_counter = float(table[-1, 0]), float(table[-1, 1])
        new = steps != 0.0
        net = np.rint(segments.reduce(np.add, steps - new, bounds, 0.0)).astype(np.intp)
        lost = np.maximum(net, 0)
        crowded = self._crowding.take(np.diff(bounds), edges, lost)
        surplus = np.maximum(np.maximum(-net, 0), np.maximum(_contradicted(table, new, bounds), crowded))
        repeated = segments.count(~new, bounds)
        if not new.all():
            table = table[new]
            bounds = np.concatenate(([0], np.cumsum(new)))[bounds]
        status = table[:, 2]
        fault = status == SensorStatus.FAULT.value
        samples = np.ascontiguousarray(table[:, ROW_COLUMNS:])
        over_range = status == SensorStatus.OVER_RANGE.value
        with np.errstate(invalid="ignore"):
            usable, over = np.abs(samples) <= self._limit_mv, samples >= self._full_scale_mv
        if fault.any():
            usable &= ~fault[:, None]
        over &= usable
        if over_range.any():
            over |= over_range[:, None]
        return SampleFrames(
            bounds=bounds,
            times=np.ascontiguousarray(table[:, 0]),
            samples=samples if usable.all() else np.where(usable, samples, 0.0),
            usable=usable,
            over=over,
            fault=fault,
            lost=lost,
            surplus=surplus,
            repeated=repeated,
            last_frame_s=last_frame_s,
        )

    def _table(self) -> Array:
        """All rows, which are removed."""
        blocks = self._blocks
        if self.rows:
            blocks = [*blocks, _as_array(self.rows)]
        self.rows = []
        self._blocks = []
        if not blocks:
            return np.empty((0, self._columns))
        return blocks[0] if len(blocks) == 1 else np.concatenate(blocks)

    def _steps(self, times: Array, counters: Array) -> Array:
        """Number of frames from the frame before to each frame, by counter, its wraps resolved by time; 0 is a repeat."""
        since = segments.steps(self._last_s, times)
        by_time = np.rint(since / self._interval_s)
        if not self._counted:
            # Without a counter only a gap indicates lost frames; frames that bunch up on a busy bus are no gap.
            gap_s = max(1.5 * self._interval_s, self._interval_s + _BUNCHING_S)
            with np.errstate(invalid="ignore"):
                return np.where(since > gap_s, np.maximum(by_time, 1.0), 1.0)
        with np.errstate(invalid="ignore"):
            difference = segments.steps(self._last_counter, counters)
            # numpy.mod gives the same and takes several times as long.
            modulus = self._modulus_of(counters)
            difference -= modulus * np.floor(difference / modulus)
        by_counter = difference + modulus * np.rint((by_time - difference) / modulus)
        steps = np.where(np.isfinite(by_counter), by_counter, np.maximum(by_time, 1.0))
        return np.where(np.isfinite(steps), steps, 1.0)

    def _modulus_of(self, counters: Array) -> float | Array:
        """Modulus of the counter at each frame (n,): a larger value shows that the assumed modulus is too small."""
        before = self._modulus
        if before >= self._counter_values or not (beyond := counters >= before).any():
            return before
        self._modulus = self._counter_values
        return np.where(np.arange(counters.size) < beyond.argmax(), before, self._modulus)


def _contradicted(table: Array, new: NDArray[np.bool_], bounds: Counts) -> Counts:
    """Frames of each window (w,) that repeat a counter with other samples."""
    if new.all():
        return np.zeros(bounds.size - 1, np.intp)
    samples = table[:, 1:]
    differs = np.zeros(table.shape[0], bool)
    differs[1:] = ~((samples[1:] == samples[:-1]) | (np.isnan(samples[1:]) & np.isnan(samples[:-1]))).all(axis=1)
    return segments.count(differs & ~new, bounds)


def _as_array(rows: Sequence[tuple[Any, ...]]) -> Array:
    try:
        return np.array(rows, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return np.array([[number(value) for value in row] for row in rows], dtype=np.float64)

"""From 1 kHz samples to one mean a second that does not alias the paddle passes and loses no sample.

A window's samples come from `sample_frames`, elevator speed and plate angle from `interpolation`, the samples' weights from
`window_weights`; `window_means` and `window_spread` evaluate them. All arithmetic runs once, at the close of the window or of
many windows in a row, on arrays in the order of arrival: neither how the frames came in nor how many windows are closed together
changes a bit of the result.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from yieldmon.engine.duplicate_senders import DuplicateSenderWatch, angle_limits, speed_limits
from yieldmon.engine.fast_dataclasses import maker_of
from yieldmon.engine.interpolation import InterpolatedSignal, Knots
from yieldmon.engine.sampling import segments
from yieldmon.engine.sampling.cut_off import cut_off
from yieldmon.engine.sampling.frozen import frozen
from yieldmon.engine.sampling.sample_frames import SampleBuffer, SampleFrames
from yieldmon.engine.sampling.window_means import Leftover, pulse_harmonics, weighted_means
from yieldmon.engine.sampling.window_spread import extremes, scatter
from yieldmon.engine.sampling.window_weights import ChainPhase, weights_of
from yieldmon.engine.settings import WindowSettings
from yieldmon.engine.sources import DEFAULT_SOURCES, SampleSource
from yieldmon.physics.machine import Machine
from yieldmon.physics.numerics import Array

_DISPUTED = {
    (False, False): "",
    (True, False): "elevator speed",
    (False, True): "plate angle",
    (True, True): "elevator speed and plate angle",
}

_MOST_LATE_S = 0.1
"""Between the earliest and the latest frame of a window; beyond, their times do not lie on a line."""
_LONGEST_EXACT_S = 0.0105
"""Frames further apart than this may leave a whole window with less than full coverage."""
_NO_RANGE = (float("inf"), float("-inf"))


@dataclass(frozen=True, slots=True)
class Trace:
    """The usable samples of a window in order: samples_mv and phase (n,), in turns of the paddle pattern from the first window's
    start along the chain; interval_s between samples."""

    samples_mv: Array
    phase: Array
    interval_s: float


@dataclass(frozen=True, slots=True)
class Window:
    """One closed window. Means are under the window's weights; nan where nothing was measured, but for speed and plate angle:
    these are then the means over the time from start_s to end_s.

    start_s, end_s: engine time. weight_s: the window's whole weight, s; covered_s: the part that has samples. mean_mv and
    std_dev_mv: of the sensor, zero-load voltage included; std_dev_mv is of the mean, from the scatter of whole paddle patterns
    (patterns of them, with pattern_means_mv). harmonics_mv: complex amplitudes of what repeats with the paddle pattern, their
    phase counted along the chain from the first window, so that windows can be averaged coherently; pulse_mv: amplitude of all of
    them together. trend: difference of the window's halves in standard errors. lost_frames by counter and time; surplus_frames:
    more than the time allows, or the same counter with other samples, as a second sender makes them, and elevator speeds and
    plate angles of a second sender (disputed: which of them); repeated_frames: same counter twice (one is used). last_frame_s:
    engine time of the last sample frame until now.
    saturated_share: samples at the range's end, or at a ceiling below it (`cut_off`); ceiling_mv: that, 0: none.
    span_mv: largest less smallest sample. held_s: how long the last sample had not moved at the end. frozen_s, frozen_mv: longest
    time at one value, 0 for none longer than grain's pulses, and that value. plate_min_rad .. plate_max_rad: over the whole
    support.
    """

    start_s: float
    end_s: float
    mean_mv: float
    std_dev_mv: float
    harmonics_mv: tuple[complex, ...]
    pulse_mv: float
    trend: float
    patterns: int
    weight_s: float
    covered_s: float
    speed_rad_s: float
    plate_angle_rad: float
    plate_min_rad: float
    plate_max_rad: float
    frames: int
    samples: int
    last_frame_s: float
    span_mv: float
    held_s: float
    saturated_share: float
    sensor_fault_frames: int
    lost_frames: int
    surplus_frames: int
    repeated_frames: int
    disputed: str = ""
    ceiling_mv: float = 0.0
    pattern_means_mv: tuple[float, ...] = ()
    frozen_s: float = 0.0
    frozen_mv: float = 0.0
    trace: Trace | None = field(default=None, compare=False, repr=False)

    @property
    def coverage(self) -> float:
        """Share of the window's weight that was measured, 0 .. 1."""
        share = self.covered_s / self.weight_s if self.weight_s > 0.0 else 0.0
        return share if share < 1.0 else 1.0

    @property
    def contested(self) -> bool:
        """Whether more than one node sent what it was measured with."""
        return self.surplus_frames > 0


_made = maker_of(Window)


def coherent_amplitudes(windows: Iterable[Window]) -> tuple[float, ...]:
    """Amplitude of each pattern harmonic's mean over windows, mV; what keeps no step with the paddles averages out."""
    columns = zip(*[window.harmonics_mv for window in windows], strict=False)
    return tuple([abs(sum(values) / len(values)) for values in columns])


class WindowBuilder:
    """Collects samples, speeds and plate angles and closes windows, one or several in a row.

    The caller adds to `samples`, `speed` (rad/s) and `angle` (rad) in engine time and closes at the end of a window, or of
    several, before it adds anything later. Everything is worked out with the same operations in the same order for a window
    closed by itself and for one among many. Raises ValueError for edges longer than half a window.
    """

    def __init__(
        self,
        settings: WindowSettings,
        machine: Machine,
        source: SampleSource = DEFAULT_SOURCES.impact[0],
        *,
        speed_rad_s: float | None = None,
        angle_rad: float = float("nan"),
        traces: bool = False,
        speed_interval_s: float = float("nan"),
        angle_interval_s: float = float("nan"),
    ) -> None:
        """source: layout of the sample frames. speed_rad_s, angle_rad: before the first that is measured; speed_rad_s None: the
        machine's nominal speed. speed_interval_s, angle_interval_s: at which their one sender sends them; nan: not known."""
        if 2.0 * settings.max_ramp_s > settings.window_s:
            raise ValueError(f"max_ramp_s is {settings.max_ramp_s}; expected at most half of window_s, {settings.window_s}")
        self.samples = SampleBuffer(source, machine.sensor.full_scale_mv, settings.plausible_full_scales)
        self.speed = InterpolatedSignal(
            machine.nominal_elevator_speed_rad_s if speed_rad_s is None else speed_rad_s,
            DuplicateSenderWatch(speed_limits(machine, speed_interval_s)),
        )
        self.angle = InterpolatedSignal(angle_rad, DuplicateSenderWatch(angle_limits(angle_interval_s)))
        self._traces = traces
        self._max_ramp_s = settings.max_ramp_s
        self._turns_per_rad = machine.sprocket_pitch_radius_m / machine.pattern_length_m
        self._chain = ChainPhase(self._turns_per_rad, 1.0 / settings.max_ramp_s)
        samples = len(source.signals)
        self._sample_interval_s = source.interval_s
        self._lags_s = np.arange(samples - 1, -1, -1, dtype=np.float64) * source.interval_s
        frame_interval_s = source.interval_s * samples
        # At low rates a whole window may hold a sample less or more than its weight has room for.
        self._slack_s = frame_interval_s if frame_interval_s > _LONGEST_EXACT_S else 0.0
        self._left = Leftover()
        self._earlier_angles = _NO_RANGE

    def forget_angle(self) -> None:
        """The last plate angle no longer holds: the angle is unknown until the next one."""
        self.angle.forget()
        self._earlier_angles = _NO_RANGE

    def close(self, start_s: float, end_s: float) -> Window:
        """Close the window from start_s to end_s."""
        return self.close_run((start_s, end_s))[0]

    def close_run(self, edges_s: Sequence[float]) -> list[Window]:
        """Close the windows between consecutive edges (w + 1,), engine time; each takes what arrived before its end."""
        edges = np.array(edges_s)
        frames = self.samples.take(edges)
        speeds, _, rival_speeds = self.speed.take(edges)
        angles, measured, rival_angles = self.angle.take(edges)
        plate_min, plate_max = self._plate_range(angles, measured, edges)
        chain = self._chain.take(speeds, edges)

        sizes, of_window = frames.frames, np.diff(frames.sample_bounds)
        times = (frames.times[:, None] - self._lags_s).ravel()
        phase = chain.phase.at(np.maximum(times, np.repeat(edges[:-1], of_window)))
        to_end = np.repeat(chain.passed, of_window) - phase
        middles = np.maximum(frames.times - 0.5 * self._lags_s[0], np.repeat(edges[:-1], sizes))
        moving = np.stack((speeds.at(middles), angles.at(middles)))
        weights = weights_of(frames, to_end)
        total, (mean, speed, angle), left_sums = weighted_means(frames, weights, moving, self._left.sums)
        empty = ~(total > 0.0)
        if empty.any():
            speed[empty], angle[empty] = speeds.means()[empty], angles.means()[empty]
        phase += np.repeat(chain.turns, of_window)
        harmonics, left_waves = pulse_harmonics(frames, weights, phase, mean, total, self._left.waves)
        self._left = Leftover(left_sums, left_waves)
        std_dev, trend, patterns, means_mv = scatter(frames, to_end, chain.passed)
        std_dev[empty], trend[empty], patterns[empty] = np.nan, np.nan, 0
        span, held, samples = extremes(frames)
        pulse = np.sqrt(np.cumsum(np.square(harmonics.real) + np.square(harmonics.imag), axis=1)[:, -1])
        plateau, ceiling = cut_off(frames)
        over = np.maximum(segments.count(frames.over.ravel(), frames.sample_bounds), plateau)
        saturated = over / np.maximum(of_window, 1)
        waves = [() if none else tuple(row) for none, row in zip(empty.tolist(), harmonics.tolist(), strict=True)]
        columns = (
            edges[:-1], edges[1:], mean, std_dev, waves, pulse, trend, patterns, chain.weight_s,
            self._covered_s(total, chain.weight_s), speed, angle, plate_min, plate_max, sizes, samples, frames.last_frame_s,
            span, held * self._sample_interval_s, saturated, segments.count(frames.fault, frames.bounds),
            frames.lost, frames.surplus + rival_speeds + rival_angles, frames.repeated,
            [_DISPUTED[speed > 0, angle > 0] for speed, angle in zip(rival_speeds.tolist(), rival_angles.tolist(), strict=True)],
            ceiling, means_mv, *frozen(frames, self._sample_interval_s),
        )  # fmt: skip
        lists = (column.tolist() if isinstance(column, np.ndarray) else column for column in columns)
        if not self._traces:
            return [_made(*row, None) for row in zip(*lists, strict=True)]
        turns_per_s = (speed * self._turns_per_rad).tolist()
        traces = [
            _trace(
                frames, phase.reshape(frames.samples.shape), slice(first, last), self._sample_interval_s, 0.0 if lost else rate
            )
            for first, last, rate, lost in zip(
                frames.bounds[:-1].tolist(), frames.bounds[1:].tolist(), turns_per_s, frames.lost.tolist(), strict=True
            )
        ]
        return [_made(*row) for row in zip(*lists, traces, strict=True)]

    def _covered_s(self, total: Array, weight_s: Array) -> Array:
        """The part of each window's weight that has samples, s."""
        covered: Array = total * self._sample_interval_s
        if self._slack_s > 0.0:
            covered = np.where(total > 0.0, np.minimum(covered + self._slack_s, np.maximum(covered, weight_s)), covered)
        return covered

    def _plate_range(self, angles: Knots, measured: NDArray[np.bool_], edges: Array) -> tuple[Array, Array]:
        """Smallest and largest plate angle over each window's support, which reaches into the window before it."""
        ramps = measured & (angles.times >= edges[1:, None] - self._max_ramp_s)
        before = np.concatenate(([self._earlier_angles[0]], np.where(ramps, angles.values, np.inf).min(axis=1)))
        above = np.concatenate(([self._earlier_angles[1]], np.where(ramps, angles.values, -np.inf).max(axis=1)))
        self._earlier_angles = float(before[-1]), float(above[-1])
        return np.minimum(before[:-1], angles.values.min(axis=1)), np.maximum(above[:-1], angles.values.max(axis=1))


def _trace(frames: SampleFrames, phase: Array, rows: slice, interval_s: float, turns_per_s: float) -> Trace | None:
    """The samples of some frames; None where one is not usable, for then they are not evenly spaced.

    turns_per_s: of the pattern. Frames are late by what bus and gateway make of it, samples are taken by the sensor's clock:
    the phase is that of times on a straight line over the frames. 0: as their times say, where frames are missing.
    """
    if not frames.usable[rows].all() or rows.start == rows.stop:
        return None
    shown = phase[rows]
    if turns_per_s > 0.0:
        late_s = _late_s(frames.times[rows])
        if late_s.max() - late_s.min() < _MOST_LATE_S:
            shown = shown - (turns_per_s * late_s)[:, None]
    return Trace(frames.samples[rows].ravel(), shown.ravel(), interval_s)


def _late_s(times_s: Array) -> Array:
    """How late each frame (n,) is after the straight line of least squares through all of them."""
    place, squares = _places(times_s.size)
    since_s = times_s - times_s[0]
    since_s -= since_s.sum() / since_s.size
    since_s -= place * ((place * since_s).sum() / squares)
    return np.asarray(since_s)


@lru_cache(maxsize=64)
def _places(frames: int) -> tuple[Array, float]:
    """Numbers of frames from their middle, and the sum of their squares (1 for a single frame)."""
    place: Array = np.arange(frames, dtype=np.float64) - 0.5 * (frames - 1)
    place.flags.writeable = False
    return place, max(float((place * place).sum()), 1.0)

"""From 1 kHz samples to one mean a second that does not alias the paddle passes and loses no sample.

Window k ends at the engine second t_k. Its far and near edges are ramps in chain phase p, one paddle pattern long:

    E_k(p) = clip(p - P_k + 1, 0, 1),      P_k the phase at t_k,      p = integral of chain speed dt / pattern length

and a sample's weight in window k is E_{k-1}(p) - E_k(p). The weights are causal (nothing after t_k is needed), add up to exactly
1 over the windows, and as a function of phase they are a box convolved with a box one pattern long, whose transform is zero at
every harmonic of the paddle pattern. So a steady pulse train gives a steady mean at any speed and with any spacing of the
paddles, and to first order while the speed changes. The result belongs to the time from t_{k-1} to t_k, both less half a
pattern.

All arithmetic runs once, at the close of the window or of many windows in a row, on arrays in the order of arrival: neither how
the frames came in nor how many windows are closed together changes a bit of the result. So sums run over one window's samples at
a time (`ufunc.reduceat`, or a running sum along a row), never over what is padded or stands beside.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yieldmon.engine.quick import maker_of
from yieldmon.engine.rivals import RivalWatch, angle_limits, speed_limits
from yieldmon.engine.settings import WindowSettings
from yieldmon.engine.sources import DEFAULT_SOURCES, SampleSource
from yieldmon.frames import SensorStatus
from yieldmon.physics.machine import Machine

Array = NDArray[np.float64]
Counts = NDArray[np.intp]

ROW_COLUMNS = 3
"""Columns of a sample row before the samples: engine time, counter, status."""

HARMONICS = 4
"""Harmonics of the paddle pattern that make up the pulse amplitude: with two paddles a pattern, two of the paddle passes."""

_DISPUTED = {
    (False, False): "",
    (True, False): "elevator speed",
    (False, True): "plate angle",
    (True, True): "elevator speed and plate angle",
}

_WHOLE_TURN = 2.0 * np.pi
_LONGEST_EXACT_S = 0.0105
"""Frames further apart than this may leave a whole window with less than full coverage."""
_BUNCHING_S = 0.015
"""How late a frame may be because of others on the bus."""

_CROWDED_SHARE, _CROWDED_FRAMES = 0.1, 5.0
"""So many frames more than their interval allows are bunched by a gateway or a controller; beyond, a second node sends."""


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
    (patterns of them). harmonics_mv: complex amplitudes of what repeats with the paddle pattern, their phase counted along the
    chain from the first window, so that windows can be averaged coherently; pulse_mv: amplitude of all of them together. trend:
    difference of the window's halves in standard errors. lost_frames by counter and time; surplus_frames: more than the time
    allows, or the same counter with other samples, as a second sender makes them, and elevator speeds and plate angles of a
    second sender (disputed: which of them); repeated_frames: same counter twice (one is used). last_frame_s: engine time of the
    last sample frame until now.
    span_mv: largest less smallest sample. held_s: how long the last sample had not moved at the end. plate_min_rad ..
    plate_max_rad: over the whole support.
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
    trace: Trace | None = field(default=None, compare=False, repr=False)

    @property
    def coverage(self) -> float:
        """Share of the window's weight that was measured, 0 .. 1."""
        return min(1.0, self.covered_s / self.weight_s) if self.weight_s > 0.0 else 0.0

    @property
    def contested(self) -> bool:
        """Whether more than one node sent what it was measured with."""
        return self.surplus_frames > 0


_made = maker_of(Window)


@dataclass(frozen=True, slots=True)
class _Frames:
    """Accepted frames of w windows, flat. bounds (w + 1,): first frame of each window and the end of the last.

    times (n,); samples and usable (n, samples_per_frame), 0 where not usable; over (n, samples_per_frame): at the end of the
    range; fault (n,). lost, surplus, repeated, last_frame_s: (w,).
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


@dataclass(frozen=True, slots=True)
class _Shares:
    """How usable samples are shared between their own window and the next.

    late: those of a window's last pattern, of which the next window takes kept, both (m,); all others are wholly their own
    window's. frame_weights, frame_kept (n,): sums over each frame.
    """

    late: Counts
    kept: Array
    frame_weights: Array
    frame_kept: Array


@dataclass(frozen=True, slots=True)
class _Knots:
    """A signal over w windows, straight between knots; arrays (w, k), each row from a window's start to its end and then held."""

    times: Array
    values: Array


def coherent_amplitudes(windows: Iterable[Window]) -> tuple[float, ...]:
    """Amplitude of each pattern harmonic's mean over windows, mV; what keeps no step with the paddles averages out."""
    columns = zip(*(window.harmonics_mv for window in windows), strict=False)
    return tuple(abs(sum(values) / len(values)) for values in columns)


def number(value: object) -> float:
    """A signal's value as a float; nan for anything that is no finite number."""
    if isinstance(value, (int, float)):
        try:
            result = float(value)
        except OverflowError:
            return float("nan")
        return result if result - result == 0.0 else float("nan")
    return float("nan")


def _as_array(rows: Sequence[tuple[Any, ...]]) -> Array:
    try:
        return np.array(rows, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return np.array([[number(value) for value in row] for row in rows], dtype=np.float64)


class _Signal:
    """Measured points of a signal that wait for their window, and the value carried into it."""

    def __init__(self, carried: float, rivals: RivalWatch) -> None:
        self.carried = carried
        self._rivals = rivals
        self._times: list[float] = []
        self._values: list[float] = []

    def add(self, time_s: float, value: float) -> None:
        self._times.append(time_s)
        self._values.append(value)

    def extend(self, times_s: Sequence[float], values: Sequence[float]) -> None:
        self._times.extend(times_s)
        self._values.extend(values)

    def forget(self) -> None:
        self.carried = float("nan")
        self._times.clear()
        self._values.clear()

    def take(self, edges: Array) -> tuple[_Knots, NDArray[np.bool_], Counts]:
        """The knots of the windows between edges, which of them were measured, and how many points of each window a second
        sender accounts for; the points are used up.

        Before the first point ever the first point's own value holds.
        """
        starts, ends = edges[:-1, None], edges[1:, None]
        times, values = np.array(self._times), np.array([self.carried, *self._values])
        bounds = _window_bounds(times, edges)
        surplus = self._rivals.take(times, values[1:], bounds, edges)
        counts = np.diff(bounds)
        columns = np.arange(int(counts.max()) + 2)
        measured = (columns >= 1) & (columns <= counts[:, None])
        # Column 0 is what was carried in, the last column and those between hold the window's last value.
        places = bounds[:-1, None] + np.minimum(columns, counts[:, None])
        table = values[places]
        unknown = np.isnan(table[:, 0])
        if unknown.any():
            table[unknown, 0] = table[unknown, 1]
        knots = np.broadcast_to(ends, measured.shape).copy()
        knots[:, :1] = starts
        if times.size:
            knots[measured] = times
        knots = np.maximum.accumulate(np.minimum(np.maximum(knots, starts), ends), axis=1)
        self.carried = float(table[-1, -1])
        self._times.clear()
        self._values.clear()
        return _Knots(knots, table), measured, surplus


class WindowBuilder:
    """Collects samples, speeds and plate angles and closes windows, one or several in a row.

    The caller feeds in engine time and closes at the end of a window, or of several, before it adds anything later. Everything
    is worked out with the same operations in the same order for a window closed by itself and for one among many.
    Raises ValueError for edges longer than half a window.
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
        self._traces = traces
        if 2.0 * settings.max_ramp_s > settings.window_s:
            raise ValueError(f"max_ramp_s is {settings.max_ramp_s}; expected at most half of window_s, {settings.window_s}")
        self._settings = settings
        self._full_scale_mv = machine.sensor.full_scale_mv
        self._patterns_per_rad = machine.sprocket_pitch_radius_m / machine.pattern_length_m
        self._min_rate = 1.0 / settings.max_ramp_s
        samples = len(source.signals)
        self._sample_interval_s = source.interval_s
        self._counter_modulus = float(source.counter_modulus)
        self._lags_s = np.arange(samples - 1, -1, -1, dtype=np.float64) * source.interval_s
        self._frame_interval_s = source.interval_s * samples
        self._counted = source.counter is not None
        # At low rates a whole window may hold a sample less or more than its weight has room for.
        self._slack_s = self._frame_interval_s if self._frame_interval_s > _LONGEST_EXACT_S else 0.0
        self.rows: list[tuple[Any, ...]] = []
        """Pending sample rows (engine time, counter, status, samples...); the caller appends."""
        self._blocks: list[Array] = []
        self._speed = _Signal(
            machine.nominal_elevator_speed_rad_s if speed_rad_s is None else speed_rad_s,
            RivalWatch(speed_limits(machine, speed_interval_s)),
        )
        self._angle = _Signal(angle_rad, RivalWatch(angle_limits(angle_interval_s)))
        self._earlier_angles = (float("inf"), float("-inf"))
        self._left = np.zeros(4)
        self._left_s = 0.0
        self._left_waves = np.zeros((2, HARMONICS), dtype=np.complex128)
        self._turns = 0.0
        self._last_frame_s = float("nan")
        self._last_counter = float("nan")
        self._late_frames = 0.0

    def add_block(self, rows: Array) -> None:
        """Append sample rows (n, 3 + samples_per_frame) that follow those already there."""
        if self.rows:
            self._blocks.append(_as_array(self.rows))
            self.rows = []
        if rows.shape[0]:
            self._blocks.append(rows)

    def add_speed(self, time_s: float, speed_rad_s: float) -> None:
        """A measured elevator speed; the speed runs straight from one to the next and holds after the last."""
        self._speed.add(time_s, speed_rad_s)

    def add_angle(self, time_s: float, angle_rad: float) -> None:
        """A measured plate angle, used like the speeds."""
        self._angle.add(time_s, angle_rad)

    def add_speeds(self, times_s: Sequence[float], speeds_rad_s: Sequence[float]) -> None:
        """Several speeds that follow those already there."""
        self._speed.extend(times_s, speeds_rad_s)

    def add_angles(self, times_s: Sequence[float], angles_rad: Sequence[float]) -> None:
        """Several plate angles that follow those already there."""
        self._angle.extend(times_s, angles_rad)

    def forget_angle(self) -> None:
        """The last plate angle no longer holds: the angle is unknown until the next one."""
        self._angle.forget()
        self._earlier_angles = (float("inf"), float("-inf"))

    def close(self, start_s: float, end_s: float) -> Window:
        """Close the window from start_s to end_s."""
        return self.close_run((start_s, end_s))[0]

    def close_run(self, edges_s: Sequence[float]) -> list[Window]:
        """Close the windows between consecutive edges (w + 1,), engine time; each takes what arrived before its end."""
        edges = np.array(edges_s)
        frames = self._take_frames(edges)
        speeds, _, rival_speeds = self._speed.take(edges)
        angles, measured, rival_angles = self._angle.take(edges)
        plate_min, plate_max = self._plate_range(angles, measured, edges)
        phases, weight_s = self._phases(speeds, edges)
        end_phases = phases[:, -1]
        turns = self._turns_at_starts(end_phases)

        sizes = np.diff(frames.bounds)
        in_first = frames.bounds * self._lags_s.size
        frame_starts = np.repeat(edges[:-1], sizes)
        times = np.maximum(frames.times[:, None] - self._lags_s, frame_starts[:, None])
        phase = np.interp(times, speeds.times.ravel(), phases.ravel())
        to_end = np.repeat(end_phases, sizes)[:, None] - phase
        shares = _shares(frames, to_end)
        middles = np.maximum(frames.times - 0.5 * self._lags_s[0], frame_starts)
        moving = np.stack(
            (
                np.interp(middles, speeds.times.ravel(), speeds.values.ravel()),
                np.interp(middles, angles.times.ravel(), angles.values.ravel()),
            )
        )
        total, mean, speed, angle = self._means(frames, shares, moving, in_first)
        empty = ~(total > 0.0)
        if empty.any():
            speed[empty], angle[empty] = _mean_over_time(speeds)[empty], _mean_over_time(angles)[empty]
        phase += np.repeat(turns, sizes)[:, None]
        harmonics = self._harmonics(frames, phase, shares, mean, total, in_first)
        std_dev, trend, patterns = _scatter(frames, to_end, end_phases, sizes)
        std_dev[empty], trend[empty], patterns[empty] = np.nan, np.nan, 0
        span, held, samples = _extremes(frames, in_first)
        pulse = np.sqrt(np.cumsum(np.square(harmonics.real) + np.square(harmonics.imag), axis=1)[:, -1])
        saturated = _counts(frames.over.ravel(), in_first) / np.maximum(np.diff(in_first), 1)
        waves = [() if none else tuple(row) for none, row in zip(empty.tolist(), harmonics.tolist(), strict=True)]
        columns = (
            edges[:-1], edges[1:], mean, std_dev, waves, pulse, trend, patterns, weight_s,
            self._covered_s(total, weight_s), speed, angle, plate_min, plate_max, sizes, samples, frames.last_frame_s,
            span, held * self._sample_interval_s, saturated,
            _counts(frames.fault, frames.bounds), frames.lost, frames.surplus + rival_speeds + rival_angles, frames.repeated,
            [_DISPUTED[speed > 0, angle > 0] for speed, angle in zip(rival_speeds.tolist(), rival_angles.tolist(), strict=True)],
        )  # fmt: skip
        lists = (column.tolist() if isinstance(column, np.ndarray) else column for column in columns)
        if not self._traces:
            return [_made(*row, None) for row in zip(*lists, strict=True)]
        traces = [
            _trace(frames, phase, slice(first, last), self._sample_interval_s)
            for first, last in zip(frames.bounds[:-1].tolist(), frames.bounds[1:].tolist(), strict=True)
        ]
        return [_made(*row) for row in zip(*lists, traces, strict=True)]

    def _covered_s(self, total: Array, weight_s: Array) -> Array:
        """The part of each window's weight that has samples, s."""
        covered: Array = total * self._sample_interval_s
        if self._slack_s > 0.0:
            covered = np.where(total > 0.0, np.minimum(covered + self._slack_s, np.maximum(covered, weight_s)), covered)
        return covered

    def _take_frames(self, edges: Array) -> _Frames:
        blocks = self._blocks
        if self.rows:
            blocks = [*blocks, _as_array(self.rows)]
        self.rows = []
        self._blocks = []
        if not blocks:
            table = np.empty((0, ROW_COLUMNS + self._lags_s.size))
        else:
            table = blocks[0] if len(blocks) == 1 else np.concatenate(blocks)
        bounds = _window_bounds(table[:, 0], edges)
        last = self._last_frame_s
        last_frame_s = np.concatenate(([last], table[:, 0]))[bounds[1:]]
        steps = self._frame_steps(table[:, 0], table[:, 1])
        if table.shape[0]:
            self._last_frame_s, self._last_counter = float(table[-1, 0]), float(table[-1, 1])
        new = steps != 0.0
        net = np.rint(_segments(np.add, steps - new, bounds, 0.0)).astype(np.intp)
        contested = self._contested(table, bounds, edges, new, np.maximum(net, 0))
        repeated = _counts(~new, bounds)
        if not new.all():
            table = table[new]
            bounds = np.concatenate(([0], np.cumsum(new)))[bounds]
        status = table[:, 2]
        fault = status == SensorStatus.FAULT.value
        samples = table[:, ROW_COLUMNS:]
        limit = self._settings.plausible_full_scales * self._full_scale_mv
        with np.errstate(invalid="ignore"):
            usable = (np.abs(samples) <= limit) & ~fault[:, None]
            over = (status == SensorStatus.OVER_RANGE.value)[:, None] | (usable & (samples >= self._full_scale_mv))
        return _Frames(
            bounds=bounds,
            times=np.ascontiguousarray(table[:, 0]),
            samples=np.ascontiguousarray(samples) if usable.all() else np.where(usable, samples, 0.0),
            usable=usable,
            over=over,
            fault=fault,
            lost=np.maximum(net, 0),
            surplus=np.maximum(np.maximum(-net, 0), contested),
            repeated=repeated,
            last_frame_s=last_frame_s,
        )

    def _contested(self, table: Array, bounds: Counts, edges: Array, new: NDArray[np.bool_], lost: Counts) -> Counts:
        """Frames of each window that a second sender accounts for (w,): a counter that comes again with other samples, and frames
        closer together than one sensor sends them, whatever their counters say; those that the window before lacks, though none
        was lost (w,), have come late."""
        contradicted = np.zeros(bounds.size - 1, np.intp)
        if not new.all():
            samples = table[:, 1:]
            differs = np.zeros(table.shape[0], bool)
            differs[1:] = ~((samples[1:] == samples[:-1]) | (np.isnan(samples[1:]) & np.isnan(samples[:-1]))).all(axis=1)
            contradicted = _counts(differs & ~new, bounds)
        due = np.diff(edges) / self._frame_interval_s
        late = np.concatenate(([self._late_frames], np.maximum(due - np.diff(bounds) - lost, 0.0)))
        self._late_frames = float(late[-1])
        possible = due * (1.0 + _CROWDED_SHARE) + _CROWDED_FRAMES + late[:-1]
        crowded = np.floor(np.maximum(np.diff(bounds) - possible, 0.0)).astype(np.intp)
        found: Counts = np.maximum(contradicted, crowded)
        return found

    def _frame_steps(self, times: Array, counters: Array) -> Array:
        """Frames from each frame to the one before by counter, the counter's turns known by time; 0 is a repeat."""
        modulus = self._counter_modulus
        by_time = np.rint(np.diff(times, prepend=self._last_frame_s) / self._frame_interval_s)
        if not self._counted:
            # Without a counter only a gap indicates lost frames; frames that bunch up on a busy bus are no gap.
            gap_s = max(1.5 * self._frame_interval_s, self._frame_interval_s + _BUNCHING_S)
            since = np.diff(times, prepend=self._last_frame_s)
            with np.errstate(invalid="ignore"):
                return np.where(since > gap_s, np.maximum(by_time, 1.0), 1.0)
        with np.errstate(invalid="ignore"):
            difference = np.mod(np.diff(counters, prepend=self._last_counter), modulus)
        by_counter = difference + modulus * np.rint((by_time - difference) / modulus)
        steps = np.where(np.isfinite(by_counter), by_counter, np.maximum(by_time, 1.0))
        return np.where(np.isfinite(steps), steps, 1.0)

    def _plate_range(self, angles: _Knots, measured: NDArray[np.bool_], edges: Array) -> tuple[Array, Array]:
        """Smallest and largest plate angle over each window's support, which reaches into the window before it."""
        ramps = measured & (angles.times >= edges[1:, None] - self._settings.max_ramp_s)
        before = np.concatenate(([self._earlier_angles[0]], np.where(ramps, angles.values, np.inf).min(axis=1)))
        above = np.concatenate(([self._earlier_angles[1]], np.where(ramps, angles.values, -np.inf).max(axis=1)))
        self._earlier_angles = float(before[-1]), float(above[-1])
        return np.minimum(before[:-1], angles.values.min(axis=1)), np.maximum(above[:-1], angles.values.max(axis=1))

    def _phases(self, speeds: _Knots, edges: Array) -> tuple[Array, Array]:
        """Chain phase at the knots, in patterns from each window's start, and the windows' whole weights, s."""
        rates = np.maximum(speeds.values * self._patterns_per_rad, self._min_rate)
        steps_s = np.diff(speeds.times, axis=1)
        phases = np.zeros_like(rates)
        np.cumsum(0.5 * (rates[:, 1:] + rates[:, :-1]) * steps_s, axis=1, out=phases[:, 1:])
        # What a window leaves to the next: the integral of its far edge, which rises straight between knots.
        edge = phases - phases[:, -1:] + 1.0
        low, high = edge[:, :-1], edge[:, 1:]
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = high * high / (high - low)
        parts = 0.5 * steps_s * np.where(high <= 0.0, 0.0, np.where(low >= 0.0, low + high, crossing))
        left = np.concatenate(([self._left_s], np.cumsum(parts, axis=1)[:, -1]))
        self._left_s = float(left[-1])
        return phases, left[:-1] + np.diff(edges) - left[1:]

    def _turns_at_starts(self, end_phases: Array) -> Array:
        turns = []
        for end_phase in end_phases.tolist():
            turns.append(self._turns)
            self._turns = (self._turns + end_phase) % 1.0
        return np.array(turns)

    def _means(self, frames: _Frames, shares: _Shares, moving: Array, in_first: Counts) -> tuple[Array, Array, Array, Array]:
        """Total weight and weighted means of sample, speed and angle; speed and angle are taken at the middle of a frame."""
        samples, late = frames.samples.ravel(), shares.late
        weighted, kept = samples.copy(), np.zeros(samples.size)
        weighted[late] *= 1.0 - shares.kept
        kept[late] = shares.kept * samples[late]
        own = [
            _segments(np.add, shares.frame_weights, frames.bounds, 0.0),
            _segments(np.add, weighted, in_first, 0.0),
            *(_segments(np.add, shares.frame_weights * signal, frames.bounds, 0.0) for signal in moving),
        ]
        left = np.stack(
            [
                _segments(np.add, shares.frame_kept, frames.bounds, 0.0),
                _segments(np.add, kept, in_first, 0.0),
                *(_segments(np.add, shares.frame_kept * signal, frames.bounds, 0.0) for signal in moving),
            ]
        )
        sums = np.stack(own) + np.concatenate((self._left[:, None], left[:, :-1]), axis=1)
        self._left = left[:, -1]
        total = sums[0]
        with np.errstate(divide="ignore", invalid="ignore"):
            mean, speed, angle = sums[1:] / total
        mean[~(total > 0.0)] = np.nan
        return total, mean, speed, angle

    def _harmonics(
        self, frames: _Frames, phase: Array, shares: _Shares, mean: Array, total: Array, in_first: Counts
    ) -> NDArray[np.complex128]:
        """Complex amplitudes (w, HARMONICS) at the first harmonics of the paddle pattern; phase: along the chain.

        The mean is taken off first, so that a window with samples missing does not turn its level into an amplitude. What an
        earlier window left has its sums with and without the sample kept, for the mean that is not known yet.
        """
        samples, late = frames.samples.ravel(), shares.late
        angle = _WHOLE_TURN * phase.ravel()
        turn = np.empty(angle.size, dtype=np.complex128)
        np.cos(angle, out=turn.real)
        np.negative(np.sin(angle, out=angle), out=turn.imag)
        deviation = (frames.samples - np.repeat(np.nan_to_num(mean), np.diff(frames.bounds))[:, None]).ravel()
        if not frames.clean:
            deviation *= frames.usable.ravel()
        deviation[late] *= 1.0 - shares.kept
        wave = np.empty(angle.size, dtype=np.complex128)
        np.multiply(deviation, turn.real, out=wave.real)
        np.multiply(deviation, turn.imag, out=wave.imag)
        late_bounds = np.searchsorted(late, in_first)
        late_turn = turn[late]
        late_plain = shares.kept * late_turn
        late_wave = samples[late] * late_plain
        own = np.empty((mean.size, HARMONICS), dtype=np.complex128)
        left = np.empty((mean.size, 2, HARMONICS), dtype=np.complex128)
        for harmonic in range(HARMONICS):
            if harmonic:
                wave *= turn
                late_plain, late_wave = late_plain * late_turn, late_wave * late_turn
            own[:, harmonic] = _segments(np.add, wave, in_first, 0.0)
            left[:, 0, harmonic] = _segments(np.add, late_wave, late_bounds, 0.0)
            left[:, 1, harmonic] = _segments(np.add, late_plain, late_bounds, 0.0)
        before = np.concatenate((self._left_waves[None], left[:-1]))
        self._left_waves = left[-1]
        found = own + (before[:, 0] - np.nan_to_num(mean)[:, None] * before[:, 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where((total > 0.0)[:, None], 2.0 * found / total[:, None], 0.0)


def _trace(frames: _Frames, phase: Array, rows: slice, interval_s: float) -> Trace | None:
    """The samples of some frames; None where one is not usable, for then they are not evenly spaced."""
    if not frames.usable[rows].all() or rows.start == rows.stop:
        return None
    return Trace(frames.samples[rows].ravel(), phase[rows].ravel(), interval_s)


def _window_bounds(times: Array, edges: Array) -> Counts:
    """First entry of each window and the end of the last, (w + 1,); a time that lies back belongs to the window it came in."""
    inner = np.searchsorted(np.maximum.accumulate(times), edges[1:-1], side="left") if edges.size > 2 else ()
    return np.array([0, *inner, times.size], dtype=np.intp)


def _segments(operation: np.ufunc, values: NDArray[Any], bounds: Counts, empty: float) -> NDArray[Any]:
    """The operation over each stretch of values between bounds (w + 1,), `empty` for a stretch without values."""
    some = bounds[1:] > bounds[:-1]
    if some.all():
        found: NDArray[Any] = operation.reduceat(values, bounds[:-1])
        return found
    found = np.full(some.size, empty, dtype=values.dtype)
    if some.any():
        found[some] = operation.reduceat(values, bounds[:-1][some])
    return found


def _counts(marked: NDArray[np.bool_], bounds: Counts) -> Counts:
    """How many are marked in each stretch between bounds (w + 1,)."""
    places = np.flatnonzero(marked)
    found: Counts = np.diff(np.searchsorted(places, bounds))
    return found


def _shares(frames: _Frames, to_end: Array) -> _Shares:
    """to_end: phase from each sample to its window's end."""
    late = np.flatnonzero(to_end.ravel() < 1.0)
    if not frames.clean:
        late = late[frames.usable.ravel()[late]]
    kept = np.minimum(1.0 - to_end.ravel()[late], 1.0)
    count, samples = frames.usable.shape
    frame_weights = np.full(count, float(samples)) if frames.clean else _rows_sum(frames.usable.astype(np.float64))
    frame_kept = np.zeros(count)
    if late.size:
        of_frame = late // samples
        rows = of_frame[np.concatenate(([True], of_frame[1:] != of_frame[:-1]))]
        table = np.zeros((rows.size, samples))
        table[np.searchsorted(rows, of_frame), late % samples] = kept
        frame_kept[rows] = _rows_sum(table)
        frame_weights[rows] = _rows_sum(frames.usable[rows] - table)
    return _Shares(late, kept, frame_weights, frame_kept)


def _rows_sum(table: Array) -> Array:
    """Sums of the rows of a table with few columns, from left to right."""
    total = table[:, 0]
    for column in range(1, table.shape[1]):
        total = total + table[:, column]
    return total


def _mean_over_time(knots: _Knots) -> Array:
    """Means (w,) of a signal over each window."""
    parts = 0.5 * (knots.values[:, 1:] + knots.values[:, :-1]) * np.diff(knots.times, axis=1)
    mean: Array = np.cumsum(parts, axis=1)[:, -1] / (knots.times[:, -1] - knots.times[:, 0])
    return mean


def _scatter(frames: _Frames, to_end: Array, end_phases: Array, sizes: Counts) -> tuple[Array, Array, Counts]:
    """Standard deviation of the mean from differences of neighbouring patterns, the trend, and the patterns used, each (w,).

    to_end: phase from each sample to its window's end. sizes: frames of each window.
    """
    counts = end_phases.astype(np.intp)
    most = max(1, int(counts.max()))
    inside = ((to_end >= 0.0) & (to_end < np.repeat(counts, sizes)[:, None])).ravel()
    if not frames.clean:
        inside &= frames.usable.ravel()
    cell = (np.floor(to_end).astype(np.intp) + np.repeat(np.arange(sizes.size) * most, sizes)[:, None]).ravel()
    values = frames.samples.ravel()
    if not inside.all():
        cell, values = cell[inside], values[inside]
    members = np.bincount(cell, minlength=sizes.size * most).reshape(-1, most)
    sums = np.bincount(cell, weights=values, minlength=sizes.size * most).reshape(-1, most)
    full = (members > 0) & (members >= 0.5 * members.max(axis=1, keepdims=True))
    used = np.count_nonzero(full, axis=1)
    std_dev, trend = np.full(sizes.size, np.nan), np.full(sizes.size, np.nan)
    enough = used >= 3
    if enough.any():
        means = sums[full] / members[full]
        stops = np.cumsum(used)[enough]
        patterns = used[enough]
        starts = stops - patterns
        half = patterns // 2
        squares = np.append(np.square(np.diff(means)), 0.0)
        variance = _between(squares, starts, stops - 1) / (2.0 * (patterns - 1))
        padded = np.append(means, 0.0)
        difference = (_between(padded, starts, starts + half) - _between(padded, stops - half, stops)) / half
        error = np.sqrt(2.0 * variance / half)
        with np.errstate(divide="ignore", invalid="ignore"):
            trend[enough] = np.where(error > 0.0, np.abs(difference) / error, 0.0)
        std_dev[enough] = np.sqrt(variance / patterns)
    return std_dev, trend, used


def _between(values: Array, starts: Counts, stops: Counts) -> Array:
    """Sums of values[start:stop], each of at least one value; values has one entry to spare at its end."""
    pairs = np.column_stack((starts, stops)).ravel()
    sums: Array = np.add.reduceat(values, pairs)[::2]
    return sums


def _extremes(frames: _Frames, in_first: Counts) -> tuple[Array, Counts, Counts]:
    """Largest less smallest sample (nan without any), samples at the end that equal the last one, and samples, each (w,)."""
    values = frames.samples.ravel()
    if not frames.clean:
        return _extremes_of_some(values, frames.usable.ravel(), in_first)
    samples: Counts = np.diff(in_first)
    high, low = _segments(np.maximum, values, in_first, -np.inf), _segments(np.minimum, values, in_first, np.inf)
    held = np.zeros_like(samples)
    for window, (first, last) in enumerate(zip(in_first[:-1].tolist(), in_first[1:].tolist(), strict=True)):
        if last - first > 1 and values[last - 2] != values[last - 1]:
            held[window] = 1
        elif last > first:
            moves = np.flatnonzero(values[first:last] != values[last - 1])
            held[window] = last - first - (int(moves[-1]) + 1 if moves.size else 0)
    with np.errstate(invalid="ignore"):
        return np.where(samples > 0, high - low, np.nan), held, samples


def _extremes_of_some(values: Array, usable: NDArray[np.bool_], in_first: Counts) -> tuple[Array, Counts, Counts]:
    """The same where only some samples are usable."""
    samples = _counts(usable, in_first)
    high = _segments(np.maximum, np.where(usable, values, -np.inf), in_first, -np.inf)
    low = _segments(np.minimum, np.where(usable, values, np.inf), in_first, np.inf)
    places = np.arange(values.size)
    last = _segments(np.maximum, np.where(usable, places, -1), in_first, -1)
    at_end = np.append(values, 0.0)[last]
    moves = usable & (values != np.repeat(at_end, np.diff(in_first)))
    moved = _segments(np.maximum, np.where(moves, places, -1), in_first, -1)
    ordinal = np.concatenate(([0], np.cumsum(usable)))
    since = np.where(moved >= 0, moved + 1, in_first[:-1])
    held = ordinal[in_first[1:]] - ordinal[since]
    with np.errstate(invalid="ignore"):
        return np.where(samples > 0, high - low, np.nan), held, samples

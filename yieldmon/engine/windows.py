"""From 1 kHz samples to one mean a second that does not alias the paddle passes and loses no sample.

Window k ends at the engine second t_k. Its far and near edges are ramps in chain phase p, one paddle pattern long:

    E_k(p) = clip(p - P_k + 1, 0, 1),      P_k the phase at t_k,      p = integral of chain speed dt / pattern length

and a sample's weight in window k is E_{k-1}(p) - E_k(p). The weights are causal (nothing after t_k is needed), add up to exactly
1 over the windows, and as a function of phase they are a box convolved with a box one pattern long, whose transform is zero at
every harmonic of the paddle pattern. So a steady pulse train gives a steady mean at any speed and with any spacing of the
paddles, and to first order while the speed changes. The result belongs to the time from t_{k-1} to t_k, both less half a
pattern.

All arithmetic runs once, at the close of the window, on arrays in the order of arrival: how the frames came in does not matter.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yieldmon.engine.settings import WindowSettings
from yieldmon.frames import SensorStatus
from yieldmon.physics.machine import Machine

Array = NDArray[np.float64]

ROW_COLUMNS = 3
"""Columns of a sample row before the samples: engine time, counter, status."""

HARMONICS = 4
"""Harmonics of the paddle pattern that make up the pulse amplitude: with two paddles a pattern, two of the paddle passes."""


@dataclass(frozen=True, slots=True)
class Window:
    """One closed window. Means are under the window's weights; nan where nothing was measured.

    start_s, end_s: engine time. weight_s: the window's whole weight, s; covered_s: the part that has samples. mean_mv and
    std_dev_mv: of the sensor, zero-load voltage included; std_dev_mv is of the mean, from the scatter of whole paddle patterns
    (patterns of them). harmonics_mv: complex amplitudes of what repeats with the paddle pattern, their phase counted along the
    chain from the first window, so that windows can be averaged coherently. trend: difference of the window's halves in
    standard errors. lost_frames by counter and time; surplus_frames: more than the time allows; repeated_frames: same counter
    twice (one is used). span_mv: largest less smallest sample. held_s: how long the last sample had not moved at the end.
    plate_min_rad .. plate_max_rad: over the whole support.
    """

    start_s: float
    end_s: float
    mean_mv: float
    std_dev_mv: float
    harmonics_mv: tuple[complex, ...]
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
    span_mv: float
    held_s: float
    saturated_share: float
    sensor_fault_frames: int
    lost_frames: int
    surplus_frames: int
    repeated_frames: int

    @property
    def coverage(self) -> float:
        """Share of the window's weight that was measured, 0 .. 1."""
        return min(1.0, self.covered_s / self.weight_s) if self.weight_s > 0.0 else 0.0

    @property
    def pulse_mv(self) -> float:
        """Amplitude of what repeats with the paddle pattern in this window, all harmonics together, mV."""
        return float(sum(abs(value) ** 2 for value in self.harmonics_mv) ** 0.5)


@dataclass(frozen=True, slots=True)
class _Samples:
    """Samples with what is known of each. weight: what it still has to give; phase: in patterns from the window's start."""

    phase: Array
    weight: Array
    value: Array
    speed: Array
    angle: Array


@dataclass(frozen=True, slots=True)
class _Rows:
    """Accepted frames of a window: times (n,), samples (n, samples_per_frame) with nan where unusable, and the counts."""

    times: Array
    samples: Array
    over_range: NDArray[np.bool_]
    fault_frames: int
    lost: int
    surplus: int
    repeated: int


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


def _no_samples() -> _Samples:
    none = np.empty(0)
    return _Samples(none, none, none, none, none)


class WindowBuilder:
    """Collects samples, speeds and plate angles and closes one window after another.

    The caller feeds in engine time and closes at each window's end before it adds anything later.
    """

    def __init__(self, settings: WindowSettings, machine: Machine) -> None:
        self._settings = settings
        self._full_scale_mv = machine.sensor.full_scale_mv
        self._patterns_per_rad = machine.sprocket_pitch_radius_m / machine.pattern_length_m
        self._min_rate = 1.0 / settings.max_ramp_s
        lags = np.arange(settings.samples_per_frame - 1, -1, -1, dtype=np.float64)
        self._lags_s = lags * settings.sample_interval_s
        self._frame_interval_s = settings.sample_interval_s * settings.samples_per_frame
        self._grid = np.arange(round(settings.window_s / settings.sample_interval_s), dtype=np.float64)
        self.rows: list[tuple[Any, ...]] = []
        """Pending sample rows (engine time, counter, status, samples...); the caller appends."""
        self._blocks: list[Array] = []
        self._speeds: list[tuple[float, float]] = []
        self._angles: list[tuple[float, float]] = []
        self._speed_rad_s = machine.nominal_elevator_speed_rad_s
        self._angle_rad = float("nan")
        self._earlier_angles: list[tuple[float, float]] = []
        self._tail = _no_samples()
        self._grid_tail = _no_samples()
        self._turns = 0.0
        self.last_frame_s = float("nan")
        """Engine time of the last sample frame of the windows closed so far."""
        self._last_counter = float("nan")

    def add_block(self, rows: Array) -> None:
        """Append sample rows (n, 3 + samples_per_frame) that follow those already there."""
        if self.rows:
            self._blocks.append(_as_array(self.rows))
            self.rows = []
        if rows.shape[0]:
            self._blocks.append(rows)

    def add_speed(self, time_s: float, speed_rad_s: float) -> None:
        """A measured elevator speed; the speed runs straight from one to the next and holds after the last."""
        self._speeds.append((time_s, speed_rad_s))

    def add_angle(self, time_s: float, angle_rad: float) -> None:
        """A measured plate angle, used like the speeds."""
        self._angles.append((time_s, angle_rad))

    def forget_angle(self) -> None:
        """The last plate angle no longer holds: the angle is unknown until the next one."""
        self._angle_rad = float("nan")
        self._angles.clear()
        self._earlier_angles = []

    def close(self, start_s: float, end_s: float) -> Window:
        """Close the window from start_s to end_s."""
        rows = self._take_rows()
        speed_times, speeds = _knots(self._speeds, self._speed_rad_s, start_s, end_s)
        self._speed_rad_s = float(speeds[-1])
        self._speeds.clear()
        rates = np.maximum(speeds * self._patterns_per_rad, self._min_rate)
        phases = np.concatenate(([0.0], np.cumsum(0.5 * (rates[1:] + rates[:-1]) * np.diff(speed_times))))
        end_phase = float(phases[-1])
        angle_times, angles, angle_range = self._plate(start_s, end_s)

        times = (rows.times[:, None] - self._lags_s).ravel()
        values = rows.samples.ravel()
        usable = np.isfinite(values)
        times, values = times[usable], values[usable]
        window_samples = _Samples(
            np.interp(times, speed_times, phases),
            np.ones_like(times),
            values,
            np.interp(times, speed_times, speeds),
            np.interp(times, angle_times, angles),
        )
        support, weights, self._tail = _share(self._tail, window_samples, end_phase)

        step_s = (end_s - start_s) / self._grid.size
        grid_times = start_s + (self._grid + 0.5) * step_s
        grid_phase = np.interp(grid_times, speed_times, phases)
        grid = _Samples(
            grid_phase,
            np.ones_like(grid_phase),
            grid_phase,
            np.interp(grid_times, speed_times, speeds),
            np.interp(grid_times, angle_times, angles),
        )
        grid_support, grid_weights, self._grid_tail = _share(self._grid_tail, grid, end_phase)
        grid_total = float(grid_weights.sum())

        total = float(weights.sum())
        if total > 0.0:
            mean = float((weights * support.value).sum()) / total
            speed = float((weights * support.speed).sum()) / total
            angle = float((weights * support.angle).sum()) / total
            harmonics = _harmonics(support, mean, weights / total, self._turns)
            std_dev, trend, patterns = self._scatter(support, end_phase)
        else:
            mean = std_dev = trend = float("nan")
            harmonics = ()
            patterns = 0
            speed = float((grid_weights * grid_support.speed).sum()) / grid_total
            angle = float((grid_weights * grid_support.angle).sum()) / grid_total
        self._turns = (self._turns + end_phase) % 1.0
        over = rows.over_range[:, None] | (rows.samples >= self._full_scale_mv)
        return Window(
            start_s=start_s,
            end_s=end_s,
            mean_mv=mean,
            std_dev_mv=std_dev,
            harmonics_mv=harmonics,
            trend=trend,
            patterns=patterns,
            weight_s=grid_total * step_s,
            covered_s=total * self._settings.sample_interval_s,
            speed_rad_s=speed,
            plate_angle_rad=angle,
            plate_min_rad=angle_range[0],
            plate_max_rad=angle_range[1],
            frames=int(rows.times.size),
            samples=int(values.size),
            span_mv=float(values.max() - values.min()) if values.size else float("nan"),
            held_s=_held(values) * self._settings.sample_interval_s,
            saturated_share=float(over.sum()) / over.size if over.size else 0.0,
            sensor_fault_frames=rows.fault_frames,
            lost_frames=rows.lost,
            surplus_frames=rows.surplus,
            repeated_frames=rows.repeated,
        )

    def _take_rows(self) -> _Rows:
        blocks = self._blocks
        if self.rows:
            blocks = [*blocks, _as_array(self.rows)]
        self.rows = []
        self._blocks = []
        if not blocks:
            none = np.empty(0)
            return _Rows(none, np.empty((0, self._lags_s.size)), np.empty(0, dtype=np.bool_), 0, 0, 0, 0)
        table = blocks[0] if len(blocks) == 1 else np.concatenate(blocks)
        times, counters, status = table[:, 0], table[:, 1], table[:, 2]
        steps = self._frame_steps(times, counters)
        self.last_frame_s, self._last_counter = float(times[-1]), float(counters[-1])
        new = steps != 0.0
        net = round(float(steps.sum()) - float(np.count_nonzero(new)))
        table = table[new]
        status = status[new]
        fault = status == SensorStatus.FAULT.value
        samples = table[:, ROW_COLUMNS:]
        limit = self._settings.plausible_full_scales * self._full_scale_mv
        with np.errstate(invalid="ignore"):
            unusable = fault[:, None] | ~(np.abs(samples) <= limit)
        return _Rows(
            times=table[:, 0],
            samples=np.where(unusable, np.nan, samples),
            over_range=status == SensorStatus.OVER_RANGE.value,
            fault_frames=int(np.count_nonzero(fault)),
            lost=max(0, net),
            surplus=max(0, -net),
            repeated=int(new.size - np.count_nonzero(new)),
        )

    def _frame_steps(self, times: Array, counters: Array) -> Array:
        """Frames from each frame to the one before by counter, the counter's turns told by time; 0 is a repeat."""
        modulus = float(self._settings.sample_counter_modulus)
        by_time = np.rint(np.diff(times, prepend=self.last_frame_s) / self._frame_interval_s)
        with np.errstate(invalid="ignore"):
            difference = np.mod(np.diff(counters, prepend=self._last_counter), modulus)
        by_counter = difference + modulus * np.rint((by_time - difference) / modulus)
        steps = np.where(np.isfinite(by_counter), by_counter, np.maximum(by_time, 1.0))
        return np.where(np.isfinite(steps), steps, 1.0)

    def _plate(self, start_s: float, end_s: float) -> tuple[Array, Array, tuple[float, float]]:
        first = self._angles[0][1] if self._angles else float("nan")
        carried = self._angle_rad if self._angle_rad == self._angle_rad else first
        times, angles = _knots(self._angles, carried, start_s, end_s)
        support = [angle for _, angle in self._earlier_angles] + [float(angle) for angle in angles]
        self._angle_rad = float(angles[-1])
        ramp_start_s = end_s - self._settings.max_ramp_s
        self._earlier_angles = [(t, a) for t, a in self._angles if t >= ramp_start_s]
        self._angles.clear()
        return times, angles, (min(support), max(support))

    def _scatter(self, support: _Samples, end_phase: float) -> tuple[float, float, int]:
        """Standard deviation of the mean from differences of neighbouring patterns, the trend, and the patterns used."""
        count = int(end_phase)
        index = np.floor(end_phase - support.phase).astype(np.intp)
        inside = (index >= 0) & (index < count)
        sizes = np.bincount(index[inside], minlength=count)
        sums = np.bincount(index[inside], weights=support.value[inside], minlength=count)
        full = sizes >= 0.5 * sizes.max() if sizes.size and sizes.max() > 0 else np.zeros(count, dtype=np.bool_)
        means = sums[full] / sizes[full]
        if means.size < 3:
            return float("nan"), float("nan"), int(means.size)
        variance = float(np.square(np.diff(means)).sum()) / (2.0 * (means.size - 1))
        half = means.size // 2
        difference = float(means[:half].mean() - means[-half:].mean())
        error = (2.0 * variance / half) ** 0.5
        trend = abs(difference) / error if error > 0.0 else 0.0
        return (variance / means.size) ** 0.5, trend, int(means.size)


def _knots(points: list[tuple[float, float]], carried: float, start_s: float, end_s: float) -> tuple[Array, Array]:
    """Times and values of a signal over a window: carried in at the start, straight between points, held to the end."""
    times = np.array([start_s, *(t for t, _ in points), end_s])
    values = np.array([carried, *(v for _, v in points), points[-1][1] if points else carried])
    return np.maximum.accumulate(np.clip(times, start_s, end_s)), values


def _share(tail: _Samples, new: _Samples, end_phase: float) -> tuple[_Samples, Array, _Samples]:
    """Everything with weight in the window, its weights, and what is left for the next window."""
    support = _Samples(
        np.concatenate((tail.phase, new.phase)),
        np.concatenate((tail.weight, new.weight)),
        np.concatenate((tail.value, new.value)),
        np.concatenate((tail.speed, new.speed)),
        np.concatenate((tail.angle, new.angle)),
    )
    kept = np.minimum(np.clip(support.phase - end_phase + 1.0, 0.0, 1.0), support.weight)
    left = kept > 0.0
    rest = _Samples(
        support.phase[left] - end_phase,
        kept[left],
        support.value[left],
        support.speed[left],
        support.angle[left],
    )
    return support, support.weight - kept, rest


def _held(values: Array) -> int:
    """Samples at the end that equal the last one."""
    if not values.size:
        return 0
    moves = np.flatnonzero(values != values[-1])
    return int(values.size - 1 - moves[-1]) if moves.size else int(values.size)


def _harmonics(support: _Samples, mean: float, shares: Array, turns: float) -> tuple[complex, ...]:
    """Complex amplitudes at the first harmonics of the paddle pattern; turns: chain phase at the window's start.

    The mean is taken off first, so that a window with samples missing does not turn its level into an amplitude.
    """
    turn = np.exp(-2j * np.pi * (support.phase + turns))
    wave = 2.0 * shares * (support.value - mean) * turn
    found = []
    for _ in range(HARMONICS):
        found.append(complex(wave.sum()))
        wave = wave * turn
    return tuple(found)

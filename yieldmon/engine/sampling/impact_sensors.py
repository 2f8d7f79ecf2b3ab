"""The impact sensors of one machine: sample frames in, one window a second out.

One sensor is one `SampleSource` and one `WindowBuilder`. Several sensors carry the plate together: their voltages add up, and
so do the variances of their means.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import hypot, nan, sqrt

import numpy as np

from yieldmon.engine.inputs import DEGREE, MOVING, RunInputs
from yieldmon.engine.runs import FrameRun, in_millivolts
from yieldmon.engine.sampling.windows import Window, WindowBuilder
from yieldmon.engine.settings import WindowSettings
from yieldmon.engine.sources import QUANTITIES, SampleSource, Sources
from yieldmon.frames import Value, number
from yieldmon.physics.machine import Machine
from yieldmon.physics.numerics import Array

_INTO_BUILDER = {"elevator_speed": 1.0, "plate_angle": DEGREE}


class ImpactSensors:
    """Forms the windows of all sensors together."""

    def __init__(self, settings: WindowSettings, machine: Machine, sources: Sources, *, traces: bool = False) -> None:
        """traces: windows keep their samples; only those of a single sensor do."""
        speed, angle = (_fixed(sources, name) for name in MOVING)
        at_start = float("nan") if angle is None else angle
        speed_interval_s, angle_interval_s = (sources.interval_s(name) for name in MOVING)
        self._sensors = [
            (
                source,
                WindowBuilder(
                    settings, machine, source, speed_rad_s=speed, angle_rad=at_start, traces=traces,
                    speed_interval_s=speed_interval_s, angle_interval_s=angle_interval_s,
                ),
            )
            for source in sources.impact
        ]  # fmt: skip
        self._of_message: dict[str, list[tuple[SampleSource, WindowBuilder]]] = {}
        for source, builder in self._sensors:
            self._of_message.setdefault(source.message, []).append((source, builder))
        self._angle_fixed = angle is not None

    def take(self, message: str, now_s: float, signals: Mapping[str, Value]) -> None:
        """One frame at engine time now_s, whatever it is."""
        for source, builder in self._of_message.get(message, ()):
            get = signals.get
            counter = get(source.counter) if source.counter is not None else None
            status = get(source.status) if source.status is not None else None
            if source.scale_mv == 1.0 and source.offset_mv == 0.0:
                builder.samples.rows.append((now_s, counter, status, *map(get, source.signals)))
            else:
                samples = np.array([[number(get(name)) for name in source.signals]])
                row = np.concatenate(([[np.nan, np.nan]], samples), axis=1)
                builder.samples.rows.append((now_s, counter, status, *in_millivolts(source, row)[0, 2:].tolist()))

    def take_row(self, sensor: int, now_s: float, row: Sequence[float]) -> None:
        """One row of a `SampleRun` of the sensor with this number."""
        self._sensors[sensor][1].samples.rows.append((now_s, *row))

    def add(self, quantity: str, now_s: float, value: float) -> None:
        """A measured elevator speed, rad/s, or plate angle, deg."""
        for _, builder in self._sensors:
            if quantity == "elevator_speed":
                builder.speed.add(now_s, value)
            else:
                builder.angle.add(now_s, value * DEGREE)

    def resume(self) -> None:
        """The recording continues after a pause."""
        for _, builder in self._sensors:
            builder.samples.resume()

    def forget_angle(self) -> None:
        """Discard the last plate angle, unless the plate is fixed."""
        if not self._angle_fixed:
            for _, builder in self._sensors:
                builder.forget_angle()

    def close_run(self, edges_s: Sequence[float]) -> list[Window]:
        """Close the windows between consecutive edges (w + 1,), engine time."""
        if len(self._sensors) == 1:
            return self._sensors[0][1].close_run(edges_s)
        of_each = [builder.close_run(edges_s) for _, builder in self._sensors]
        return [combined(windows) for windows in zip(*of_each, strict=True)]

    def feeding(self, run: FrameRun, offset_s: float, inputs: RunInputs) -> RunFeeding:
        """The run's samples, speeds and angles, to be passed on up to the end of one window after another."""
        parts: list[_Part] = []
        moving = [(name, inputs.track(name)) for name in MOVING]
        for (_, builder), samples in zip(self._sensors, run.samples, strict=True):
            times = run.times_s[samples.places] + offset_s
            parts.append((times, partial(_add_rows, builder, times, samples.rows)))
            for name, track in moving:
                add = (builder.speed if name == "elevator_speed" else builder.angle).extend
                values = track.values if name == "elevator_speed" else track.values * DEGREE
                parts.append((track.times_s, partial(_add_values, add, track.times_s.tolist(), values.tolist())))
        return RunFeeding(parts, inputs)


_Part = tuple[Array, Callable[[int, int], None]]


class RunFeeding:
    """Passes a run to the builders piece by piece."""

    def __init__(self, parts: list[_Part], inputs: RunInputs) -> None:
        self.inputs = inputs
        self._parts = parts
        self._done = [0] * len(parts)

    def up_to(self, end_s: float) -> None:
        """Pass on everything before end_s."""
        for index, (times, add) in enumerate(self._parts):
            last = int(np.searchsorted(times, end_s, side="left"))
            add(self._done[index], last)
            self._done[index] = last

    def rest(self) -> None:
        """Pass on the rest."""
        self.up_to(float("inf"))


def combined(windows: Sequence[Window]) -> Window:
    """One window of several sensors that carry the plate together: voltages add up; the worst sensor determines coverage."""
    first, hung = windows[0], max(windows, key=lambda w: w.frozen_s)
    harmonics: tuple[complex, ...] = tuple(sum(column) for column in zip(*(w.harmonics_mv for w in windows), strict=False))
    return replace(
        first,
        trace=None,
        mean_mv=sum(w.mean_mv for w in windows),
        std_dev_mv=hypot(*(w.std_dev_mv for w in windows)),
        harmonics_mv=harmonics,
        pulse_mv=sqrt(sum(abs(amplitude) ** 2 for amplitude in harmonics)),
        trend=max(w.trend for w in windows),
        patterns=min(w.patterns for w in windows),
        pattern_means_mv=_sums([w.pattern_means_mv for w in windows]),
        covered_s=min(w.covered_s for w in windows),
        frames=min(w.frames for w in windows),
        samples=min(w.samples for w in windows),
        last_frame_s=min(w.last_frame_s for w in windows),
        span_mv=min(w.span_mv for w in windows),
        held_s=max(w.held_s for w in windows),
        frozen_s=hung.frozen_s,
        frozen_mv=nan,
        saturated_share=max(w.saturated_share for w in windows),
        sensor_fault_frames=max(w.sensor_fault_frames for w in windows),
        lost_frames=sum(w.lost_frames for w in windows),
        surplus_frames=sum(w.surplus_frames for w in windows),
        repeated_frames=sum(w.repeated_frames for w in windows),
    )


def _sums(of_each: Sequence[tuple[float, ...]]) -> tuple[float, ...]:
    """Pattern by pattern; empty where one has lost some."""
    return tuple(map(sum, zip(*of_each, strict=True))) if len({len(means) for means in of_each}) == 1 else ()


def _fixed(sources: Sources, name: str) -> float | None:
    if name not in sources.fixed:
        return None
    return sources.fixed[name] * QUANTITIES[name].factor * _INTO_BUILDER[name]


def _add_rows(builder: WindowBuilder, times: Array, rows: Array, first: int, last: int) -> None:
    builder.samples.add_block(np.vstack((times[first:last], rows[first:last].T)).T)


def _add_values(
    add: Callable[[Sequence[float], Sequence[float]], None], times: list[float], values: list[float], first: int, last: int
) -> None:
    add(times[first:last], values[first:last])

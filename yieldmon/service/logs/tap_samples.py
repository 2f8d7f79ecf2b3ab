"""Samples of an impact sensor out of a log, as they are: for taps on the plate, where no elevator turns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yieldmon.bus.codec import Codec, FrameError
from yieldmon.bus.log_files.candump import channel_name
from yieldmon.bus.log_files.log_notes import LogNotes
from yieldmon.bus.log_files.logs import read_log
from yieldmon.engine.settings import EngineSettings
from yieldmon.engine.sources import SampleSource
from yieldmon.errors import InputError
from yieldmon.frames import Frame, SensorStatus, number
from yieldmon.physics.numerics import Array
from yieldmon.service.logs.channels import OneChannel
from yieldmon.service.logs.log_copies import refuse_copies
from yieldmon.service.traffic.input_frames import InputFrames
from yieldmon.signals.mapping import SignalMap

_GAP = 1.5
"""Frame intervals from one frame to the next beyond which one is missing."""


@dataclass(frozen=True)
class TapSamples:
    """What `read` finds. stretches: samples without a gap, mV. source: where they come from. notes: for people, on samples that
    are left out and on what a log does not tell."""

    stretches: list[Array]
    source: SampleSource
    notes: list[str]


@dataclass
class _Recorded:
    """Frames of a log. times_s: of the sensor's frames. samples: of each, mV; None: not usable. speeds: time, s, and rpm."""

    times_s: list[float] = field(default_factory=list)
    samples: list[list[float] | None] = field(default_factory=list)
    speeds: list[tuple[float, float]] = field(default_factory=list)


def read(
    paths: Sequence[str | Path], signals: SignalMap, channels: Sequence[str] = (), settings: EngineSettings | None = None
) -> TapSamples:
    """Samples of the mapping's one impact sensor while the elevator rests.

    channels: whose frames are taken; empty: all, where the samples do not come on two at the same times. settings: up to which
    speed an elevator rests, and how long a speed holds, before its frame as well as after it; None: the defaults. An elevator
    whose speed is not known rests.

    Raises InputError for a log that cannot be read, for one without samples of a resting elevator, and where several sensors
    carry the plate.
    """
    if len(signals.sources.impact) != 1:
        count = len(signals.sources.impact)
        raise InputError("signals", f"{count} impact sensors carry the plate", "one, whose answer a tap shows")
    refuse_copies([str(path) for path in paths])
    source = signals.sources.impact[0]
    rests = settings or EngineSettings()
    found = TapSamples([], source, [])
    for path in paths:
        recorded = _recorded(path, source, signals, channels)
        if not any(recorded.samples):
            hint = "`signals` in the configuration; `yieldmon signals LOG` lists what there is"
            raise InputError(str(path), "holds no sample of the impact sensor", hint)
        turning = _turning(recorded, rests.gate.min_turning_rpm, rests.inputs.speed_timeout_s)
        interval_s = source.interval_s * len(source.signals)
        if turning.all():
            fastest_rpm = max(rpm for _, rpm in recorded.speeds)
            raise InputError(str(path), f"the elevator turns, at up to {fastest_rpm:.0f} rpm", "taps while the elevator rests")
        if turning.any():
            turning_s = interval_s * float(turning.sum())
            found.notes.append(f"{path}: {turning_s:.1f} s with a turning elevator are left out")
        if not recorded.speeds:
            found.notes.append(f"{path}: holds no elevator speed; the taps count as given while the elevator rested")
        found.stretches.extend(_stretches(recorded, turning, interval_s))
    return found


def _recorded(path: str | Path, source: SampleSource, signals: SignalMap, channels: Sequence[str]) -> _Recorded:
    bus, found = InputFrames(Codec(), signals), _Recorded()
    speeds = [speed for speed in signals.sources.inputs if speed.quantity == "elevator_speed"]
    one_channel = None if channels else OneChannel(signals.sources)
    for message in read_log(path, LogNotes()):
        channel = channel_name(message)
        if channels and channel not in channels:
            continue
        try:
            frames = bus.frames(message)
        except FrameError:
            continue
        for frame in frames:
            for speed in speeds:
                rpm = speed.scale * number(frame.signals.get(speed.signal)) + speed.offset
                if frame.message == speed.message and isfinite(rpm):
                    found.speeds.append((frame.time_s, rpm))
            if frame.message != source.message:
                continue
            if one_channel is not None:
                one_channel.take_frame(str(path), frame.message, channel, frame.time_s)
            found.times_s.append(frame.time_s)
            found.samples.append(_samples(frame, source))
    return found


def _turning(recorded: _Recorded, rests_rpm: float, holds_s: float) -> NDArray[np.bool_]:
    """Of each frame of samples, (n,), whether a speed beyond `rests_rpm` is known within `holds_s` of it."""
    times_s, turning = np.array(recorded.times_s), np.sort([time_s for time_s, rpm in recorded.speeds if rpm > rests_rpm])
    first, last = np.searchsorted(turning, times_s - holds_s), np.searchsorted(turning, times_s + holds_s, side="right")
    return np.asarray(first < last)


def _stretches(recorded: _Recorded, turning: NDArray[np.bool_], interval_s: float) -> list[Array]:
    stretches: list[list[float]] = []
    last_s = float("-inf")
    for time_s, samples, turns in zip(recorded.times_s, recorded.samples, turning.tolist(), strict=True):
        if not stretches or turns or samples is None or not abs(time_s - last_s) < _GAP * interval_s:
            stretches.append([])
        last_s = time_s
        stretches[-1] += [] if turns else samples or []
    return [np.array(stretch) for stretch in stretches if stretch]


def _samples(frame: Frame, source: SampleSource) -> list[float] | None:
    """mV; None where one is not available, or the sensor says that it has a fault."""
    if source.status is not None and frame.signals.get(source.status) == SensorStatus.FAULT:
        return None
    values = [number(frame.signals.get(name)) for name in source.signals]
    if not np.all(np.isfinite(values)):
        return None
    return [source.scale_mv * value + source.offset_mv for value in values]

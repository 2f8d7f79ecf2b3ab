"""Samples of an impact sensor out of a log, as they are: for taps on the plate, where no elevator turns."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from yieldmon.bus.codec import Codec, FrameError
from yieldmon.bus.log_files.candump import channel_name
from yieldmon.bus.log_files.log_notes import LogNotes
from yieldmon.bus.log_files.logs import read_log
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


def read(paths: Sequence[str | Path], signals: SignalMap, channels: Sequence[str] = ()) -> tuple[list[Array], SampleSource]:
    """Stretches of samples without a gap, mV, and their source: the one impact sensor of the mapping. channels: whose frames are
    taken; empty: all, where the samples do not come on two at the same times.

    Raises InputError for a log that cannot be read, for one without samples, and where several sensors carry the plate.
    """
    if len(signals.sources.impact) != 1:
        count = len(signals.sources.impact)
        raise InputError("signals", f"{count} impact sensors carry the plate", "one, whose answer a tap shows")
    refuse_copies([str(path) for path in paths])
    source = signals.sources.impact[0]
    stretches: list[Array] = []
    for path in paths:
        found = _stretches(path, source, signals, channels)
        if not found:
            hint = "`signals` in the configuration; `yieldmon signals LOG` lists what there is"
            raise InputError(str(path), "holds no sample of the impact sensor", hint)
        stretches += found
    return stretches, source


def _stretches(path: str | Path, source: SampleSource, signals: SignalMap, channels: Sequence[str]) -> list[Array]:
    bus, interval_s = InputFrames(Codec(), signals), source.interval_s * len(source.signals)
    stretches: list[list[float]] = []
    last_s = float("-inf")
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
            if frame.message != source.message:
                continue
            if one_channel is not None:
                one_channel.take_frame(str(path), frame.message, channel, frame.time_s)
            samples = _samples(frame, source)
            if not stretches or samples is None or not abs(frame.time_s - last_s) < _GAP * interval_s:
                stretches.append([])
            last_s = frame.time_s
            stretches[-1] += samples or []
    return [np.array(stretch) for stretch in stretches if stretch]


def _samples(frame: Frame, source: SampleSource) -> list[float] | None:
    """mV; None where one is not available, or the sensor says that it has a fault."""
    if source.status is not None and frame.signals.get(source.status) == SensorStatus.FAULT:
        return None
    values = [number(frame.signals.get(name)) for name in source.signals]
    if not np.all(np.isfinite(values)):
        return None
    return [source.scale_mv * value + source.offset_mv for value in values]

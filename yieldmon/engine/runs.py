"""Runs of input frames as arrays, a column a signal: how logs reach the engine in bulk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from yieldmon.engine.sources import SampleSource
from yieldmon.frames import Frame
from yieldmon.physics.numerics import Array


@dataclass(frozen=True, slots=True)
class SignalRun:
    """The frames of one message in a run. places (n,): where each stands among all frames of the run, rising. times_s (n,): bus
    time. signals: name -> values (n,), nan for what is not available."""

    message: str
    places: NDArray[np.intp]
    times_s: Array
    signals: dict[str, Array]

    def frames(self) -> list[tuple[int, Frame]]:
        """Place and frame, one by one."""
        columns = {name: values.tolist() for name, values in self.signals.items()}
        return [
            (place, Frame(time_s, self.message, {name: column[row] for name, column in columns.items()}))
            for row, (place, time_s) in enumerate(zip(self.places.tolist(), self.times_s.tolist(), strict=True))
        ]


@dataclass(frozen=True, slots=True)
class SampleRun:
    """The frames of one impact sensor in a run. places (m,): among all frames. rows (m, 2 + samples a frame): counter, status and
    millivolts, nan for what is not available."""

    places: NDArray[np.intp]
    rows: Array


@dataclass(frozen=True, slots=True)
class FrameRun:
    """Consecutive frames, in the order in which they arrived.

    times_s (n,): bus time of all of them. samples: a run for each impact sensor, in the order of `Sources.impact`. others: the
    other messages' frames, each message once.
    """

    times_s: Array
    samples: Sequence[SampleRun]
    others: Sequence[SignalRun] = field(default=())


def sample_columns(source: SampleSource) -> tuple[str | None, ...]:
    """Signals of a sample row's columns: counter, status, samples; None where the source has none."""
    return (source.counter, source.status, *source.signals)


def in_millivolts(source: SampleSource, rows: Array) -> Array:
    """Sample rows (m, 2 + samples a frame) in the signal's unit as rows in millivolts."""
    if source.scale_mv != 1.0:
        rows[:, 2:] *= source.scale_mv
    if source.offset_mv != 0.0:
        rows[:, 2:] += source.offset_mv
    return rows

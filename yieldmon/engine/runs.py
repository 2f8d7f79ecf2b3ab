"""Runs of input frames as arrays, a column a signal: how logs reach the engine in bulk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from yieldmon.engine.windows import number
from yieldmon.frames import IMPACT_SENSOR_SAMPLES, SAMPLES_PER_FRAME, Frame

Array = NDArray[np.float64]

_SAMPLES = tuple(f"Sample{k}" for k in range(SAMPLES_PER_FRAME))


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
class FrameRun:
    """Consecutive frames, in the order in which they arrived.

    times_s (n,): bus time of all of them. samples (m, 2 + samples a frame): counter, status and millivolts of the
    ImpactSensorSamples among them, nan for what is not available, at sample_places (m,). others: the other messages' frames,
    each message once.
    """

    times_s: Array
    sample_places: NDArray[np.intp]
    samples: Array
    others: Sequence[SignalRun] = field(default=())

    @property
    def sample_times_s(self) -> Array:
        """Bus times (m,) of the ImpactSensorSamples frames."""
        return self.times_s[self.sample_places]


def run_of(frames: Sequence[Frame]) -> FrameRun:
    """The same frames as a run."""
    places: dict[str, list[int]] = {}
    for place, frame in enumerate(frames):
        places.setdefault(frame.message, []).append(place)
    at = np.array(places.pop(IMPACT_SENSOR_SAMPLES, []), dtype=np.intp)
    names = ("SampleCounter", "SensorStatus", *_SAMPLES)
    samples = [[number(frames[place].signals.get(name)) for name in names] for place in at]
    times = np.array([frame.time_s for frame in frames], dtype=np.float64)
    others = []
    for message, rows in places.items():
        signals = dict.fromkeys(name for place in rows for name in frames[place].signals)
        columns = {name: np.array([number(frames[place].signals.get(name)) for place in rows]) for name in signals}
        others.append(SignalRun(message, np.array(rows, dtype=np.intp), times[rows], columns))
    return FrameRun(times, at, np.array(samples, dtype=np.float64).reshape(-1, len(names)), others)

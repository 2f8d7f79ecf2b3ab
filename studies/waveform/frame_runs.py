"""Frames of a simulated bus as the run of columns that the engine takes in bulk."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from yieldmon.engine.runs import FrameRun, SampleRun, SignalRun, in_millivolts, sample_columns
from yieldmon.engine.sources import DEFAULT_SOURCES, Sources
from yieldmon.frames import Frame, number


def run_of(frames: Sequence[Frame], sources: Sources = DEFAULT_SOURCES) -> FrameRun:
    """The same frames as a run."""
    places: dict[str, list[int]] = {}
    for place, frame in enumerate(frames):
        places.setdefault(frame.message, []).append(place)
    times = np.array([frame.time_s for frame in frames], dtype=np.float64)
    samples = []
    for source in sources.impact:
        at = np.array(places.get(source.message, []), dtype=np.intp)
        names = sample_columns(source)
        rows = [[number(frames[place].signals.get(name)) if name else np.nan for name in names] for place in at]
        table = np.array(rows, dtype=np.float64).reshape(-1, len(names))
        samples.append(SampleRun(at, in_millivolts(source, table)))
    listened = {source.message for source in sources.inputs}
    taken = {source.message for source in sources.impact}
    others = []
    for message, rows_of in places.items():
        if message in taken and message not in listened:
            continue
        signals = dict.fromkeys(name for place in rows_of for name in frames[place].signals)
        columns = {name: np.array([number(frames[place].signals.get(name)) for place in rows_of]) for name in signals}
        others.append(SignalRun(message, np.array(rows_of, dtype=np.intp), times[rows_of], columns))
    return FrameRun(times, samples, others)

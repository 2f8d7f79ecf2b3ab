"""What windows' samples hold beside their mean, looked at after the windows' frames are made.

It takes longer than all the rest. It corrects the flows of the windows after it, so that a window's own frames need not wait.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from yieldmon.engine.flow import Flow
from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.quick import maker_of
from yieldmon.engine.records import Second, record_of
from yieldmon.engine.results import Result, WindowResult
from yieldmon.engine.waveform.waveform import Waveform
from yieldmon.engine.waveform.waveform_reading import WaveformReading

_result = maker_of(WindowResult)


@dataclass(slots=True)
class _Samples:
    """Of one window. flow: by mean force. seen: None until they are looked at."""

    second: Second
    flow: Flow
    estimator: FlowEstimator
    seen: WaveformReading | None = None


class LaterSamples:
    """The windows that have not been completed yet, in order."""

    def __init__(self, waveform: Waveform) -> None:
        self._waveform = waveform
        self._samples: deque[_Samples] = deque()

    def add(self, second: Second, flow: Flow, estimator: FlowEstimator) -> None:
        """A further window; flow: by mean force, with this estimator."""
        self._samples.append(_Samples(second, flow, estimator))

    def look(self) -> None:
        """Look at all that wait: a further window is to be concluded."""
        for samples in self._samples:
            self._look(samples)

    def complete(self, result: WindowResult) -> WindowResult:
        """The result of the first window that waits, with what its samples hold."""
        samples = self._samples.popleft()
        seen = self._look(samples)
        completed: WindowResult = _result(record_of(samples.second._replace(waveform=seen)), result.frames, result.events, seen)
        return completed

    def completed(self, results: Sequence[Result]) -> list[Result]:
        """The last results handed out, their windows completed; windows before them are looked at, and no more."""
        windows = sum(isinstance(result, WindowResult) for result in results)
        while len(self._samples) > windows:
            self._look(self._samples.popleft())
        if not self._samples:
            return list(results)
        return [self.complete(result) if isinstance(result, WindowResult) else result for result in results]

    def _look(self, samples: _Samples) -> WaveformReading:
        if samples.seen is None:
            samples.seen = self._waveform.see(samples.second.reading, samples.flow, samples.estimator)
        return samples.seen

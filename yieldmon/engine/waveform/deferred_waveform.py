"""The waveform of windows, evaluated after the windows' frames were made.

It takes longer than everything else. It corrects only the flows of later windows, so a window's own frames need not wait for it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from yieldmon.engine.fast_dataclasses import maker_of
from yieldmon.engine.flow import Flow
from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.records import Second, record_of
from yieldmon.engine.results import Result, WindowResult
from yieldmon.engine.waveform.waveform import Waveform
from yieldmon.engine.waveform.waveform_reading import WaveformReading

_result = maker_of(WindowResult)


@dataclass(slots=True)
class _Pending:
    """A window whose waveform is still to be evaluated. flow: by mean force. waveform: None until it is evaluated."""

    second: Second
    flow: Flow
    estimator: FlowEstimator
    waveform: WaveformReading | None = None


class DeferredWaveform:
    """The windows whose results lack the waveform, in order."""

    def __init__(self, waveform: Waveform) -> None:
        self._waveform = waveform
        self._pending: deque[_Pending] = deque()

    def add(self, second: Second, flow: Flow, estimator: FlowEstimator) -> None:
        """Add a window. flow: by mean force, with this estimator."""
        self._pending.append(_Pending(second, flow, estimator))

    def evaluate(self) -> None:
        """Evaluate all pending windows, before a further window is concluded."""
        for pending in self._pending:
            self._evaluated(pending)

    def complete(self, result: WindowResult) -> WindowResult:
        """The result of the first pending window, with its waveform."""
        pending = self._pending.popleft()
        waveform = self._evaluated(pending)
        record = record_of(pending.second._replace(waveform=waveform))
        completed: WindowResult = _result(record, result.frames, result.events, waveform)
        return completed

    def completed(self, results: Sequence[Result]) -> list[Result]:
        """The results last returned, their windows completed; earlier pending windows are evaluated and dropped."""
        windows = sum(isinstance(result, WindowResult) for result in results)
        while len(self._pending) > windows:
            self._evaluated(self._pending.popleft())
        if not self._pending:
            return list(results)
        return [self.complete(result) if isinstance(result, WindowResult) else result for result in results]

    def _evaluated(self, pending: _Pending) -> WaveformReading:
        if pending.waveform is None:
            pending.waveform = self._waveform.see(pending.second.reading, pending.flow, pending.estimator)
        return pending.waveform

"""The difference between the flows by pulse shape and by mean force over the last windows, and whether they contradict."""

from __future__ import annotations

from collections import deque
from math import isfinite
from statistics import median

from yieldmon.engine.flow_estimator import FlowEstimator
from yieldmon.engine.settings import WaveformSettings
from yieldmon.estimation.waveform.channel_combination import Combined
from yieldmon.estimation.waveform.pattern_fold import PatternWave
from yieldmon.estimation.waveform.pulse_fit import PulseEstimate
from yieldmon.estimation.waveform.pulse_model import PulseModel
from yieldmon.estimation.waveform.pulse_shape import deviations_from

NO_FIT = 1000.0
"""Misfit used for pulses to which no fit converges."""
_LOOKED_FROM = 1.0
"""Difference of the two flows, in standard deviations, above which a second fit is made at the mean force's flow."""
_LOOK_EVERY = 10
"""Windows from one such fit to the next; it costs as much as two fits."""
_ITERATIONS = 10


class ShapeDifference:
    """Differences between shape and mean force, in standard deviations, and misfits, window by window."""

    def __init__(self, settings: WaveformSettings) -> None:
        self._settings = settings
        self._seen: deque[tuple[float, float]] = deque(maxlen=settings.contradiction_windows)
        self._last: tuple[float, FlowEstimator] | None = None
        self._ratio = 1.0
        """Ratio of the difference by the pulses to that by the two flows, at least 1."""
        self._look_in = 0
        self.contradicts = False

    def add(self, z: float, misfit: float, now_s: float, estimator: FlowEstimator) -> str:
        """Add a window; returns the contradiction in words, "" for none."""
        if isfinite(z):
            self._seen.append((z, min(misfit, NO_FIT)))
            self._last = now_s, estimator
        against = self._contradiction()
        self.contradicts = bool(against)
        return against

    def farther(
        self, together: Combined, pulses: PulseModel, wave: PatternWave, shape: PulseEstimate, volume_flow_m3_s: float
    ) -> float:
        """The signed difference in standard deviations: of the two flows, or, where that is more, of the pulses from the pulses
        at the mean force's flow. volume_flow_m3_s: by the mean force."""
        if not abs(together.z) > _LOOKED_FROM:
            return together.z
        if self._look_in <= 0:
            off = deviations_from(pulses, wave, shape, volume_flow_m3_s, together.mean_volume_sd, iterations=_ITERATIONS)
            self._ratio = max(1.0, off / abs(together.z)) if isfinite(off) else 1.0
            self._look_in = _LOOK_EVERY
        self._look_in -= 1
        return self._ratio * together.z

    def deviations(self, now_s: float, estimator: FlowEstimator, holds_s: float) -> float:
        """Absolute median over the last windows; 0 without a window by this estimator in the last holds_s seconds."""
        if self._last is None or self._last[1] is not estimator or now_s - self._last[0] > holds_s:
            return 0.0
        return abs(median(z for z, _ in self._seen))

    def _contradiction(self) -> str:
        if len(self._seen) < self._settings.contradiction_windows:
            return ""
        z, misfit = (median(column) for column in zip(*self._seen, strict=True))
        if abs(z) > self._settings.contradiction_z:
            return f"pulse shape and mean force differ by {abs(z):.1f} standard deviations"
        if misfit > self._settings.largest_misfit:
            return f"pulses are not of the model's shape (misfit {misfit:.0f}); is sensor.response_s of the machine right?"
        return ""

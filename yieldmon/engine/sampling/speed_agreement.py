"""Whether the pulses on the plate come at the rate of the reported elevator speed.

Grain strikes the plate at the rate of the paddles. The amplitude at that rate is formed along the phase that is integrated from
the reported speed; where this speed is wrong by a tenth, pulses and phase part within a second, and the amplitude vanishes
while the mean and the range of the samples stay. Uneven feed lowers the amplitude less, and pulses that merge lower the range
with it. Multiples of the rate do not count: one of them may be a multiple of the true rate.
"""

from __future__ import annotations

from collections import deque
from statistics import median

from yieldmon.engine.sampling.windows import Window

_KEPT, _LEAST = 30, 10
"""Newest windows that agree, with which a window is compared, and how many there must be."""
_SEEN = 0.3
"""Least amplitude, relative to the mean, of a sensor that shows the pulses."""
_LOST = 0.3
"""Share of its usual value below which an amplitude relative to mean or range is lost: a speed wrong by a tenth leaves less."""
_STAYS = 0.8
"""Share of its usual value above which the range relative to the mean has stayed: a wrong speed hardly changes it."""


class SpeedAgreement:
    """Compares the pulses of each window with grain with those of the windows before."""

    def __init__(self, paddles: int) -> None:
        """paddles: in a turn of the paddle pattern."""
        self._paddles = paddles
        self._over_mean: deque[float] = deque(maxlen=_KEPT)
        self._over_range: deque[float] = deque(maxlen=_KEPT)

    def contradicted(self, window: Window, grain_mv: float) -> bool:
        """Whether the window's pulses contradict its speed.

        Parameters
        ----------
        window : Window
            With grain, whole, with samples of one sensor.
        grain_mv : float
            Its mean less the zero, mV, above 0.

        Returns
        -------
        bool
            Never before ten windows with clear pulses.
        """
        if not window.span_mv > 0.0:
            return False
        amplitude_mv = self._amplitude_mv(window)
        over_mean, over_range = amplitude_mv / grain_mv, amplitude_mv / window.span_mv
        if len(self._over_mean) >= _LEAST:
            usual_over_mean, usual_over_range = median(self._over_mean), median(self._over_range)
            # A single wrong sample changes the range alone; something on the plate, or a plate without grain, the mean.
            pulsed = window.span_mv * usual_over_range > _STAYS * grain_mv * usual_over_mean
            lost = over_mean < _LOST * usual_over_mean and over_range < _LOST * usual_over_range
            if usual_over_mean > _SEEN and pulsed and lost:
                return True
        self._over_mean.append(over_mean)
        self._over_range.append(over_range)
        return False

    def _amplitude_mv(self, window: Window) -> float:
        """At the rate of the paddles; of all known multiples of the pattern's rate where it has more paddles than these."""
        waves = window.harmonics_mv
        return abs(waves[self._paddles - 1]) if self._paddles <= len(waves) else window.pulse_mv

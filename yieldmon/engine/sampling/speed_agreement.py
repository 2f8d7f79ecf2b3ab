"""Whether the pulses on the plate come at the rate of the reported elevator speed.

Grain strikes the plate at the rate of the paddles. The amplitude at that rate is formed along the phase that is integrated from
the reported speed; where this speed is wrong by a tenth, pulses and phase part within a second, and the amplitude vanishes
while the mean and the range of the samples stay. Uneven feed lowers the amplitude less, and pulses that merge lower the range
with it. Multiples of the rate do not count: one of them may be a multiple of the true rate.

A speed that is wrong from the beginning, or a chain that slips, never shows the amplitude; then pulses of a large range have next
to none at the reported rate. Where it is wrong by less, the phase of the pattern's slowest wave advances by as much from each
second to the next.
"""

from __future__ import annotations

from cmath import phase
from collections import deque
from math import pi
from statistics import median

from yieldmon.engine.sampling.windows import Window
from yieldmon.physics.machine import Machine

_KEPT, _LEAST = 30, 10
"""Newest windows that agree, with which a window is compared, and how many there must be."""
_SEEN = 0.3
"""Least amplitude, relative to the mean, of a sensor that shows the pulses."""
_LOST = 0.3
"""Share of its usual value below which an amplitude relative to mean or range is lost: a speed wrong by a tenth leaves less."""
_STAYS = 0.8
"""Share of its usual value above which the range relative to the mean has stayed: a wrong speed hardly changes it."""
_NEVER_OF_MEAN, _NEVER_OF_RANGE, _CLEAR = 0.3, 0.12, 2.0
"""Amplitude relative to mean and to range below which there are no pulses at the reported rate, where the range is that large
relative to the mean."""
_IN_A_ROW = 10
"""Seconds in a row that show a speed which is wrong from the beginning."""
_ALIGNED = 0.9
"""Least length of the mean of their phases' turns, each of length 1: 0 for chance, 1 for a steady advance."""
_WRONG = 0.05
"""Least relative error of the speed by the phase: the geometry in a machine file may be off by some percent."""
_MOST_TURNS = 0.45
"""Most of a turn between two seconds from which its sign is known."""


class SpeedAgreement:
    """Compares the pulses of each window with grain with those of the windows before."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._paddles = len(machine.paddle_spacings_m)
        self._over_mean: deque[float] = deque(maxlen=_KEPT)
        self._over_range: deque[float] = deque(maxlen=_KEPT)
        self.doubted = False
        """Whether the last windows' pulses come at another rate than that of the reported speed since they were first seen."""
        self._never = 0
        """Seconds in a row without pulses at the reported rate."""
        self._turns: deque[complex] = deque(maxlen=_IN_A_ROW)
        """Advances of the phase from one second to the next."""
        self._last: Window | None = None

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
        advances = self._advances(window)
        self.doubted = self._never_shown(window, grain_mv) or advances
        if self.doubted:
            return False
        amplitude_mv = self._amplitude_mv(window)
        over_mean, over_range = amplitude_mv / grain_mv, amplitude_mv / window.span_mv
        # Their largest, before the medians: this is done every second.
        if len(self._over_mean) >= _LEAST and over_mean < _LOST * max(self._over_mean):
            usual_over_mean, usual_over_range = median(self._over_mean), median(self._over_range)
            # A single wrong sample changes the range alone; something on the plate, or a plate without grain, the mean.
            pulsed = window.span_mv * usual_over_range > _STAYS * grain_mv * usual_over_mean
            lost = over_mean < _LOST * usual_over_mean and over_range < _LOST * usual_over_range
            if usual_over_mean > _SEEN and pulsed and lost:
                return True
        self._over_mean.append(over_mean)
        self._over_range.append(over_range)
        return False

    def _never_shown(self, window: Window, grain_mv: float) -> bool:
        """Whether the last windows have clear pulses, but none at the reported rate."""
        amplitude_mv = self._amplitude_mv(window)
        clear = window.span_mv > _CLEAR * grain_mv
        never = clear and amplitude_mv < _NEVER_OF_MEAN * grain_mv and amplitude_mv < _NEVER_OF_RANGE * window.span_mv
        self._never = self._never + 1 if never else 0
        return self._never >= _IN_A_ROW

    def _advances(self, window: Window) -> bool:
        """Whether the pattern's phase has advanced steadily over the last windows, as it does by a wrong speed."""
        last, self._last = self._last, window
        seconds, speed_m_s = window.end_s - window.start_s, float(self._machine.paddle_speed_m_s(window.speed_rad_s))
        patterns = speed_m_s * seconds / self._machine.pattern_length_m
        if last is None or last.end_s != window.start_s or not (last.harmonics_mv and window.harmonics_mv):
            self._turns.clear()
            return False
        turn = window.harmonics_mv[0] * last.harmonics_mv[0].conjugate()
        self._turns.append(turn / abs(turn) if turn else 0j)
        mean = sum(self._turns) / _IN_A_ROW
        return abs(mean) > _ALIGNED and _WRONG * patterns < abs(phase(mean)) / (2.0 * pi) and _WRONG * patterns < _MOST_TURNS

    def _amplitude_mv(self, window: Window) -> float:
        """At the rate of the paddles; of all known multiples of the pattern's rate where it has more paddles than these."""
        waves = window.harmonics_mv
        return abs(waves[self._paddles - 1]) if self._paddles <= len(waves) else window.pulse_mv

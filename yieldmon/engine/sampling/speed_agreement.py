"""Whether the pulses on the plate come at the rate of the reported elevator speed.

Grain strikes the plate at the rate of the paddles. The amplitude at that rate is formed along the phase that is integrated from
the reported speed; where this speed is wrong by a tenth, pulses and phase part within a second, and the amplitude vanishes
while the mean and the range of the samples stay. Uneven feed lowers the amplitude less, and pulses that merge lower the range
with it. Multiples of the rate do not count: one of them may be a multiple of the true rate.

A speed that is wrong from the beginning, or a chain that slips, never shows the amplitude; then pulses of a large range have next
to none at the reported rate. Where it is wrong by less, the phase of the pattern's slowest wave advances by as much from each
second to the next (`phase_advance.py`); a change of that advance is seen from 1.5 % of the speed on.
"""

from __future__ import annotations

from collections import deque
from statistics import median

from yieldmon.engine.sampling.phase_advance import PhaseAdvance
from yieldmon.engine.sampling.windows import Window
from yieldmon.physics.machine import RPM, Machine

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


class SpeedAgreement:
    """Compares the pulses of each window with grain with those of the windows before."""

    def __init__(self, machine: Machine) -> None:
        self._paddles = len(machine.paddle_spacings_m)
        self._over_mean: deque[float] = deque(maxlen=_KEPT)
        self._over_range: deque[float] = deque(maxlen=_KEPT)
        self._never = 0
        """Seconds in a row without pulses at the reported rate."""
        self._advance = PhaseAdvance(machine)
        self.doubt = ""
        """What the last windows with grain showed of the reported speed, for the operator; "" for nothing."""

    @property
    def change(self) -> float:
        """Relative change of the error of the reported speed since grain was first seen; 0 for none."""
        return self._advance.change

    def contradicted(self, window: Window, grain_mv: float, *, pulses: bool = True) -> bool:
        """Whether the window's pulses contradict its speed.

        Parameters
        ----------
        window : Window
            With grain, whole, with samples of one sensor.
        grain_mv : float
            Its mean less the zero, mV, above 0.
        pulses : bool
            Whether what keeps step with the paddles is more than vibration.

        Returns
        -------
        bool
            Never before ten windows with clear pulses.
        """
        if not window.span_mv > 0.0:
            return False
        self._advance.see(window, pulses=pulses)
        wrong = self._never_shown(window, grain_mv) or self._advance.wrong
        self.doubt = self._doubt(window, wrong=wrong)
        if wrong:
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

    def _doubt(self, window: Window, *, wrong: bool) -> str:
        rpm = window.speed_rad_s / RPM
        if change := self.change:
            sign = "faster" if change > 0.0 else "slower"
            return (
                f"at {rpm:.0f} rpm the pulses of the grain come {100.0 * abs(change):.1f} % {sign} than they did at first: check "
                "chain or belt slip and the speed sensor"
            )
        if not wrong:
            return ""
        return f"the pulses of the grain do not come at the rate of {rpm:.0f} rpm: check the speed's scale and chain slip"

    def _amplitude_mv(self, window: Window) -> float:
        """At the rate of the paddles; of all known multiples of the pattern's rate where it has more paddles than these."""
        waves = window.harmonics_mv
        return abs(waves[self._paddles - 1]) if self._paddles <= len(waves) else window.pulse_mv

"""A step of the signal that the grain's pulses do not share: the zero has moved while grain flows.

Mean and amplitude of the pulses grow together with the flow: at one load and speed their ratio stays within 1 % from second to
second. A zero that steps moves the mean alone. Seconds are compared only where amplitude, speed and shape of the pulses are about
the same: their ratio to the mean depends on load, speed and grain, and the shape with it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from statistics import median
from typing import NamedTuple

from yieldmon.engine.sampling.windows import Window

_NEWEST, _KEPT, _LEAST = 5, 60, 10
"""Newest seconds, whose median is compared; seconds before them that are kept, and how many of those there must be."""
_LIKE_AMPLITUDE, _LIKE_SPEED, _LIKE_SHAPE = 0.25, 0.03, 0.04
"""Largest relative difference of amplitude, speed and shape of seconds that are compared."""
_SHARE = 0.06
"""Step relative to the mean below which a change of the pulses' shape may be the cause."""
_NEAR = _SHARE / (1.0 + 2.0 * _LIKE_AMPLITUDE)
"""Relative difference of ratios that makes no such step, whatever the amplitudes of the seconds compared."""
_SCATTERS = 6.0
"""Step in scatters of the seconds compared below which it may be chance."""
_ENDS = 0.5
"""Share of these limits below which a step that was found is gone."""
_SEEN = 0.5
"""Least amplitude, relative to the mean, of pulses that show the flow."""


class _Second(NamedTuple):
    """shape: amplitude at twice the rate of the paddles over that at their rate. ratio: mean over amplitude."""

    amplitude_mv: float
    speed_rad_s: float
    shape: float
    ratio: float


class ZeroStep:
    """Looks for a step over the seconds with grain since the plate was last seen empty."""

    def __init__(self, paddles: int, least_mv: float) -> None:
        """paddles: in a turn of the paddle pattern. least_mv: smaller steps are not looked for."""
        self._paddles = paddles
        self._least_mv = least_mv
        self._before: deque[_Second] = deque(maxlen=_KEPT)
        self._newest: deque[_Second] = deque(maxlen=_NEWEST)
        self._ratios: deque[float] = deque(maxlen=_KEPT)
        """Of the seconds before."""
        self.step_mv = 0.0
        """The step as last found, mV; 0 for none."""

    def forget(self) -> None:
        """The plate was seen empty, or there is another zero."""
        self._before.clear()
        self._ratios.clear()
        self._newest.clear()
        self.step_mv = 0.0

    def see(self, window: Window, grain_mv: float) -> None:
        """A whole window with grain and the plate at home.

        Parameters
        ----------
        window : Window
        grain_mv : float
            Its mean less the zero, mV, above 0.
        """
        waves = window.harmonics_mv
        if 2 * self._paddles > len(waves):
            return
        amplitude_mv, second_mv = abs(waves[self._paddles - 1]), abs(waves[2 * self._paddles - 1])
        if not amplitude_mv > 0.0:
            return
        if len(self._newest) == _NEWEST and self.step_mv == 0.0:
            # Seconds after a step are not what a further one is compared with.
            self._before.append(self._newest[0])
            self._ratios.append(self._newest[0].ratio)
        self._newest.append(_Second(amplitude_mv, window.speed_rad_s, second_mv / amplitude_mv, grain_mv / amplitude_mv))
        if len(self._newest) == _NEWEST and len(self._before) >= _LEAST and (self.step_mv != 0.0 or self._differ):
            found_mv = self._found_mv()
            if found_mv is not None:
                self.step_mv = found_mv

    @property
    def _differ(self) -> bool:
        """Whether the newest seconds' ratios are so far from those before that there can be a step; cheap, for every second."""
        low, high = min(self._ratios), max(self._ratios)
        newest = [second.ratio for second in self._newest]
        return max(newest) - low > _NEAR * low or high - min(newest) > _NEAR * high

    def _found_mv(self) -> float | None:
        """The step by the newest seconds, 0 for none; None where they differ from each other or from all seconds before."""
        newest = self._newest
        middle = (
            median([second.amplitude_mv for second in newest]),
            median([second.speed_rad_s for second in newest]),
            median([second.shape for second in newest]),
        )
        if len(_alike(newest, *middle)) < _NEWEST or len(like := _alike(self._before, *middle)) < _LEAST:
            return None
        amplitude_mv = middle[0]
        usual = median(like)
        step_mv = median([(second.ratio - usual) * second.amplitude_mv for second in newest])
        scatter_mv = amplitude_mv * _deviation(like, usual)
        least_mv = max(self._least_mv, _SHARE * usual * amplitude_mv, _SCATTERS * scatter_mv)
        if self.step_mv != 0.0:
            least_mv *= _ENDS
        return step_mv if abs(step_mv) > least_mv and usual < 1.0 / _SEEN else 0.0


def _alike(seconds: Iterable[_Second], amplitude_mv: float, speed_rad_s: float, shape: float) -> list[float]:
    """Ratios of the seconds that can be compared with one of this amplitude, speed and shape."""
    by_amplitude, by_speed, by_shape = _LIKE_AMPLITUDE * amplitude_mv, _LIKE_SPEED * speed_rad_s, _LIKE_SHAPE * shape
    return [
        ratio
        for amplitude, speed, of_second, ratio in seconds
        if abs(of_second - shape) <= by_shape
        and abs(amplitude - amplitude_mv) <= by_amplitude
        and abs(speed - speed_rad_s) <= by_speed
    ]


def _deviation(values: Iterable[float], middle: float) -> float:
    """Median absolute deviation."""
    return median([abs(value - middle) for value in values])

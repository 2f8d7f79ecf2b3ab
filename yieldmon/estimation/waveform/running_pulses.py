"""Running mean pulses, separately for each range of force, plate angle and speed.

The samples minus a mean pulse are noise only if that mean is of similar pulses, since their width depends on load, plate angle
and speed.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from functools import lru_cache
from math import floor, log

import numpy as np

from yieldmon.physics.numerics import AnyArray, Array

from .pattern_fold import FoldedPattern

_BINS = 512
_KEEP = 0.95
"""Factor on the weight of earlier windows for each further window of the same kind."""
_LEAST_SAMPLES = 2.0
_FORGOTTEN_AFTER = 60
"""Number of windows without one of a kind after which its mean is dropped, since pulses change with the grain."""
_LOG_FORCE, _ANGLE_RAD, _LOG_SPEED = 0.1, float(np.deg2rad(2.0)), 0.03
"""Widths of the classes of pulses: ln force, plate angle, ln speed."""
_MOST_LATE = 0.05
"""Largest delay of a window's pulses from their mean, in turns; a paddle's pulse is half a turn or less."""
_PLACES = 129
"""Number of delays that are tried within that range; a parabola through the best one and its neighbours is used."""
_BETWEEN_BINS = 2.0 / 3.0
"""Mean variance of a linear interpolation between two bins, relative to a bin's variance."""


@dataclass(slots=True)
class _Sums:
    values: Array
    weights: Array
    squares: Array
    window: int


class RunningPulses:
    """Exponentially weighted mean pulses over the phase of the paddle pattern, by mean force, plate angle and speed."""

    def __init__(self) -> None:
        self._kinds: OrderedDict[tuple[int, int, int], _Sums] = OrderedDict()
        self._windows = 0

    def take(
        self, samples_n: Array, phase: Array, *, mean_force_n: float, plate_angle_rad: float, elevator_speed_rad_s: float
    ) -> tuple[FoldedPattern, float] | None:
        """The mean of earlier windows of the same kind; the window is then added to it.

        Parameters
        ----------
        samples_n, phase : ndarray (n,)
            As in `pattern_fold.fold_all`, with the phase relative to the pulses.
        mean_force_n : float
            Above 0.
        plate_angle_rad, elevator_speed_rad_s : float
            Of the window, rad and rad/s.

        Returns
        -------
        tuple or None
            The mean pattern, and its variance by chance relative to that of a sample; None if there were too few such windows.
        """
        kind = _kind(mean_force_n, plate_angle_rad, elevator_speed_rad_s)
        self._windows += 1
        self._forget()
        sums = self._kinds.pop(kind, None) or _Sums(np.zeros(_BINS), np.zeros(_BINS), np.zeros(_BINS), 0)
        found = None
        if sums.weights.min() >= _LEAST_SAMPLES:
            mean = sums.values / sums.weights
            own = _BETWEEN_BINS * float((sums.squares / (sums.weights * sums.weights)).sum()) / _BINS
            found = FoldedPattern(mean, np.zeros(_BINS), sums.weights, float("inf")), own
        place = ((phase - np.floor(phase)) * _BINS).astype(np.intp) % _BINS
        counts = np.bincount(place, minlength=_BINS)
        self._kinds[kind] = _Sums(
            _KEEP * sums.values + np.bincount(place, weights=samples_n, minlength=_BINS),
            _KEEP * sums.weights + counts,
            _KEEP**2 * sums.squares + counts,
            self._windows,
        )
        return found

    def late_turns(
        self, amplitudes_n: AnyArray, *, mean_force_n: float, plate_angle_rad: float, elevator_speed_rad_s: float
    ) -> float:
        """Delay of a window's pulses from the mean of earlier windows of the same kind.

        The time shift in a fit of the pulse model is correlated with other parameters, and its error is milliseconds at small
        loads.

        Parameters
        ----------
        amplitudes_n : ndarray (k,)
            Harmonics 1 .. k of the window, as in `pattern_fold.PatternWave`, with the phase as in `take`.
        mean_force_n, plate_angle_rad, elevator_speed_rad_s : float
            As in `take`.

        Returns
        -------
        float
            Turns of the pattern with the largest correlation; 0 if there is no mean yet, or no maximum within range.

        Source: least squares of a shift under white noise is the largest correlation (Knapp and Carter, IEEE Trans. Acoust. 24
        (1976) 320).
        """
        sums = self._kinds.get(_kind(mean_force_n, plate_angle_rad, elevator_speed_rad_s))
        if sums is None or sums.weights.min() < _LEAST_SAMPLES:
            return 0.0
        count = amplitudes_n.size
        waves = np.fft.rfft(sums.values / sums.weights)[1 : count + 1]
        in_phase, across = _shifts(count)
        product = amplitudes_n * waves.conj()
        alike = in_phase @ product.real - across @ product.imag
        best = int(alike.argmax())
        if not 0 < best < _PLACES - 1:
            return 0.0
        before, here, after = alike[best - 1 : best + 2]
        between = 0.5 * (before - after) / (before - 2.0 * here + after)
        return float((best + between) * 2.0 * _MOST_LATE / (_PLACES - 1) - _MOST_LATE)

    def _forget(self) -> None:
        """Drop kinds without a recent window, which come first."""
        while self._kinds and self._windows - next(iter(self._kinds.values())).window > _FORGOTTEN_AFTER:
            self._kinds.popitem(last=False)


def _kind(mean_force_n: float, plate_angle_rad: float, elevator_speed_rad_s: float) -> tuple[int, int, int]:
    """Class of a window; pulses of the same class are averaged."""
    return (
        floor(log(mean_force_n) / _LOG_FORCE),
        round(plate_angle_rad / _ANGLE_RAD),
        round(log(elevator_speed_rad_s) / _LOG_SPEED),
    )


@lru_cache(maxsize=4)
def _shifts(harmonics: int) -> tuple[Array, Array]:
    """Cosines and sines (places, harmonics) that advance pulses by each of the delays that are tried. The mean over a bin counts
    at its middle."""
    late = np.linspace(-_MOST_LATE, _MOST_LATE, _PLACES) + 0.5 / _BINS
    turned = 2.0 * np.pi * np.outer(late, np.arange(1, harmonics + 1))
    factors: tuple[Array, Array] = np.cos(turned), np.sin(turned)
    for factor in factors:
        factor.flags.writeable = False
    return factors

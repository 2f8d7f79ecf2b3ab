"""Mean pulses of the last windows, each kind of load by itself.

What is left of the samples once the mean pulse has been taken off is noise only where that mean is of pulses like them: their
width goes with the load, the plate and the speed.
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
"""What of a running mean a further window of its kind leaves."""
_LEAST_SAMPLES = 2.0
_FORGOTTEN_AFTER = 60
"""Windows since the last one of a kind after which its mean no longer stands for it: pulses change with the grain."""
_LOG_FORCE, _ANGLE_RAD, _LOG_SPEED = 0.1, float(np.deg2rad(2.0)), 0.03
"""Steps by which pulses are distinguished."""
_MOST_LATE = 0.05
"""Of a turn, how far a window's pulses may lie from the mean of their kind; a paddle's pulse is half a turn or less."""
_PLACES = 129
"""Looked at within that on either side, of which the best and its neighbours make a parabola."""
_BETWEEN_BINS = 2.0 / 3.0
"""Of a bin's variance, what the straight line between two bins has in the mean."""


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
        """The mean of earlier windows like this one, which then joins them.

        Parameters
        ----------
        samples_n, phase : ndarray (n,)
            As in `pattern_fold.fold_all`, the phase counted from the pulses themselves.
        mean_force_n : float
            Above 0.
        plate_angle_rad, elevator_speed_rad_s : float
            Of the window, rad and rad/s.

        Returns
        -------
        tuple or None
            The mean pattern, and by what share of a sample's variance its own chance adds to that of a difference; None where
            too few such windows have been.
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
        """How much later a window's pulses come than the mean of earlier windows like it.

        A fit of the pulse model has a time of its own, but one that other parameters of the fit can stand for; on thin loads it
        errs by milliseconds.

        Parameters
        ----------
        amplitudes_n : ndarray (k,)
            Harmonics 1 .. k of the window, as in `pattern_fold.PatternWave`, by the phase that `take` is given.
        mean_force_n, plate_angle_rad, elevator_speed_rad_s : float
            As in `take`.

        Returns
        -------
        float
            Turns of the pattern, where the two correlate most; 0 where there is no such mean yet, or none within reach.

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
        """Drop the kinds that have not been met for long, which come first."""
        while self._kinds and self._windows - next(iter(self._kinds.values())).window > _FORGOTTEN_AFTER:
            self._kinds.popitem(last=False)


def _kind(mean_force_n: float, plate_angle_rad: float, elevator_speed_rad_s: float) -> tuple[int, int, int]:
    """What windows have alike whose pulses are averaged."""
    return (
        floor(log(mean_force_n) / _LOG_FORCE),
        round(plate_angle_rad / _ANGLE_RAD),
        round(log(elevator_speed_rad_s) / _LOG_SPEED),
    )


@lru_cache(maxsize=4)
def _shifts(harmonics: int) -> tuple[Array, Array]:
    """Cosines and sines (places, harmonics) that bring pulses forward by each of the places within reach; a mean over a bin is
    that at its middle."""
    late = np.linspace(-_MOST_LATE, _MOST_LATE, _PLACES) + 0.5 / _BINS
    turned = 2.0 * np.pi * np.outer(late, np.arange(1, harmonics + 1))
    factors: tuple[Array, Array] = np.cos(turned), np.sin(turned)
    for factor in factors:
        factor.flags.writeable = False
    return factors

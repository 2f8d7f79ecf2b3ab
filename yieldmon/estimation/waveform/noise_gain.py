"""Power gain of a sensor for white noise of force: cell, sampler and aliases."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from yieldmon.physics.numerics import Array

CONTACT_HZ = 2000.0
"""Frequency from which on an unknown share of a kernel's noise is lost by the duration of its contact (some 0.1 ms)."""
_ALIASES = 64


def power_gain(frequency_hz: Array, cell_response_s: float, sample_interval_s: float, *, averaged: bool = True) -> Array:
    """Ratio of the samples' spectral density to a white density of force, (k,): critically damped cell, sampler, aliases.

    Parameters
    ----------
    frequency_hz : ndarray (k,)
    cell_response_s : float
        Time constant; 0 for none.
    sample_interval_s : float
    averaged : bool
        As in `KernelNoiseSettings`.
    """
    return power_gain_and_aliases(frequency_hz, cell_response_s, sample_interval_s, averaged=averaged)[0]


def power_gain_and_aliases(
    frequency_hz: Array, cell_response_s: float, sample_interval_s: float, averaged: bool
) -> tuple[Array, Array]:
    """`power_gain`, and the part of it by aliases from above `CONTACT_HZ`, each (k,)."""
    frequency = np.ascontiguousarray(frequency_hz, dtype=np.float64)
    return _power_gain(frequency.tobytes(), cell_response_s, sample_interval_s, averaged)


@lru_cache(maxsize=64)
def _power_gain(frequencies: bytes, cell_response_s: float, sample_interval_s: float, averaged: bool) -> tuple[Array, Array]:
    """The same with frequencies as bytes, since they are the same each second and can be cached."""
    order = np.arange(-_ALIASES, _ALIASES + 1)[:, None]
    frequency = np.frombuffer(frequencies) + order / sample_interval_s
    shown = 1.0 / (1.0 + (2.0 * np.pi * frequency * cell_response_s) ** 2) ** 2
    if averaged:
        shown *= np.sinc(frequency * sample_interval_s) ** 2
    gain: Array = np.asarray(shown.sum(axis=0))
    beyond: Array = np.asarray(np.where(np.abs(frequency) > CONTACT_HZ, shown, 0.0).sum(axis=0))
    gain.flags.writeable = beyond.flags.writeable = False
    return gain, beyond

"""The error of a slow impact sensor: the standard deviation that aliased paddle pulses add to a second's mean force.

A steady train of pulses has harmonics at multiples of the paddle pattern's frequency f. Samples taken at the rate fs show the
k-th at |k f - m fs| for whole m; the window (1 s, with edges one paddle pattern long) passes those near 0. The zeros of its
transform are not relied on, because speed and sample times vary: its envelope, 1 / (pi f t) beyond 1 / t, is used instead.
"""

from __future__ import annotations

from math import hypot, pi

from yieldmon.engine.sources import SampleSource
from yieldmon.physics.machine import Machine

_AMPLITUDES = (0.31, 1.29, 0.41, 0.47, 0.24, 0.12, 0.10, 0.02)
"""Amplitude over mean force of the pattern's harmonics, two paddles a pattern: of the virtual combine at 400 rpm and 12 kg/s."""
_NEGLIGIBLE = 1e-4
_WINDOW_S = 1.0
ALIAS_FREE_HZ = 200.0
"""Sampling rate above which no relevant harmonic is aliased, at any speed at which grain is measured."""


def aliasing_share(source: SampleSource, machine: Machine, speed_rad_s: float) -> float:
    """Standard deviation from aliasing over the mean force; 0 where the samples are frequent enough.

    Parameters
    ----------
    source : SampleSource
        Sampling rate and the sensor's own filter.
    machine : Machine
        Whose paddles pass.
    speed_rad_s : float
        Of the elevator's upper sprocket, rad/s.

    Returns
    -------
    float
        Of the mean over a second.
    """
    pattern_hz = speed_rad_s * machine.sprocket_pitch_radius_m / machine.pattern_length_m
    if not pattern_hz > 0.0:
        return 0.0
    rate_hz = source.rate_hz
    total = 0.0
    for harmonic, amplitude in enumerate(_AMPLITUDES, 1):
        at_hz = harmonic * pattern_hz
        filtered = amplitude / hypot(1.0, 2.0 * pi * at_hz * source.time_constant_s)
        nearest = round(at_hz / rate_hz)
        seen = [abs(at_hz - fold * rate_hz) for fold in (nearest - 1, nearest, nearest + 1) if fold >= 1]
        passed = max((_passed(hz, _WINDOW_S) * _passed(hz, 1.0 / pattern_hz) for hz in seen), default=0.0)
        total += 0.5 * (filtered * passed) ** 2
    share = total**0.5
    return share if share > _NEGLIGIBLE else 0.0


def _passed(hz: float, length_s: float) -> float:
    """Envelope of a box's transform."""
    return 1.0 / max(1.0, pi * hz * length_s)

"""What a slow impact sensor costs: the standard deviation that sampling paddle pulses too rarely adds to a second's mean force.

A steady train of pulses has harmonics at multiples of the passing frequency f. Samples taken at the rate fs show the k-th at
|k f - m fs| for whole m; the window (1 s, with edges one paddle pattern long) lets pass what comes near 0 there. Its zeros are
not relied on: the envelope of its transform, 1 / (pi f t) beyond 1 / t, stands in for it, since speed and sample times waver.
"""

from __future__ import annotations

from math import exp, hypot, pi

from yieldmon.engine.sources import SampleSource
from yieldmon.physics.machine import Machine

_HARMONICS = 8
_PULSE_STD_DEV_PASSES = 0.155
"""Standard deviation of a pulse in time over the time between passes: of the virtual combine's pulses at 10 kg/s."""
_NEGLIGIBLE = 1e-4
ALIAS_FREE_HZ = 200.0
"""From this rate on no harmonic that matters is folded, at any speed at which grain is measured."""


def aliasing_share(source: SampleSource, machine: Machine, speed_rad_s: float, window_s: float = 1.0) -> float:
    """Standard deviation from aliasing over the mean force; 0 where the samples are frequent enough.

    Parameters
    ----------
    source
        Sampling interval and the sensor's own filter.
    speed_rad_s
        Of the elevator's upper sprocket.
    """
    chain_m_s = speed_rad_s * machine.sprocket_pitch_radius_m
    pass_hz = chain_m_s / machine.paddle_spacing_m
    if not pass_hz > 0.0:
        return 0.0
    edge_s = machine.pattern_length_m / chain_m_s
    rate_hz = source.rate_hz
    total = 0.0
    for harmonic in range(1, _HARMONICS + 1):
        at_hz = harmonic * pass_hz
        amplitude = 2.0 * exp(-2.0 * (pi * harmonic * _PULSE_STD_DEV_PASSES) ** 2)
        amplitude /= hypot(1.0, 2.0 * pi * at_hz * source.time_constant_s)
        nearest = round(at_hz / rate_hz)
        seen = [abs(at_hz - fold * rate_hz) for fold in (nearest - 1, nearest, nearest + 1) if fold >= 1]
        passed = max((_passed(hz, window_s) * _passed(hz, edge_s) for hz in seen), default=0.0)
        total += 0.5 * (amplitude * passed) ** 2
    share = total**0.5
    return share if share > _NEGLIGIBLE else 0.0


def _passed(hz: float, length_s: float) -> float:
    """Envelope of a box's transform."""
    return 1.0 / max(1.0, pi * hz * length_s)

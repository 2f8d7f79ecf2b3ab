"""Expected accuracy of kernel noise with a given sensor, before any measurement."""

from __future__ import annotations

import numpy as np

from .kernel_noise import KernelImpulse, KernelNoiseSettings, kernel_impulse
from .noise_gain import power_gain
from .spectral_density import Density, expected_averages, frequencies_hz, in_pulses


def expected_impulse(
    *,
    mean_force_n: float,
    impulse_n_s: float,
    quiet_n2_hz: float,
    cell_response_s: float,
    sample_interval_s: float,
    duration_s: float,
    settings: KernelNoiseSettings | None = None,
    segment: int = 256,
    crest: float = 1.0,
) -> KernelImpulse:
    """Expected result of `kernel_impulse` with a white background.

    Parameters
    ----------
    mean_force_n, impulse_n_s : float
        Mean force of the grain, and impulse of one kernel.
    quiet_n2_hz : float
        Two-sided density of the empty machine.
    cell_response_s, sample_interval_s, settings
        As in `kernel_impulse`.
    duration_s : float
        Duration of the measurement with grain, and with the empty machine, s.
    segment : int
        Samples in a spectrum.
    crest : float
        As in `in_pulses`.

    Returns
    -------
    KernelImpulse
        The given impulse with its expected standard deviations.
    """
    frequency = frequencies_hz(segment, sample_interval_s)
    averages = expected_averages(duration_s, sample_interval_s, segment=segment)
    ground = np.full(frequency.size, quiet_n2_hz)
    averaged = settings.averaged if settings is not None else True
    shown = ground + mean_force_n * impulse_n_s * power_gain(frequency, cell_response_s, sample_interval_s, averaged=averaged)
    return kernel_impulse(
        in_pulses(Density(frequency, shown, averages), crest),
        Density(frequency, ground, averages),
        mean_force_n,
        cell_response_s=cell_response_s,
        sample_interval_s=sample_interval_s,
        settings=settings,
    )

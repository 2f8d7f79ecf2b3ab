"""The arrival law of waves at known volume flows, and the noise of a wave of so many samples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from yieldmon.estimation.waveform.arrival_calibration import Terms, arrival_point, law_of
from yieldmon.estimation.waveform.arrival_law import TERMS, ArrivalLaw
from yieldmon.estimation.waveform.pattern_fold import PatternWave
from yieldmon.estimation.waveform.pulse_model import PulseModel
from yieldmon.physics.numerics import Array

SEVERAL_GRAINS = (tuple(range(TERMS)), (0, 1, 2, 3, 4, 8, 9), (0, 1, 2, 3, 4, 5, 8, 9))
"""Terms of stretch, tail and delay for a calibration over loads, plate angles, speeds and frictions."""


def calibrate_arrival(
    pulses: PulseModel | Sequence[PulseModel],
    waves: Sequence[PatternWave],
    volume_flows_m3_s: Sequence[float],
    *,
    terms: int | Terms = 2,
) -> ArrivalLaw:
    """The arrival law that waves at known volume flows follow.

    Parameters
    ----------
    pulses : PulseModel or sequence
        One, or one for each wave where their grain differs; see `arrival_point`.
    waves, volume_flows_m3_s : sequences
        More than terms.
    terms : int or tuple
        As `law_of`.

    Returns
    -------
    ArrivalLaw

    Raises
    ------
    ValueError
        For too few waves.
    """
    models = [pulses] * len(waves) if isinstance(pulses, PulseModel) else list(pulses)
    points = [arrival_point(*row) for row in zip(models, waves, volume_flows_m3_s, strict=True)]
    return law_of(points, terms=terms, indexed=models[0].settings.indexed)


def sample_noise_n(
    pulses: PulseModel, *, sample_sd_n: float, samples: float, shot_n2_s: float = 0.0, duration_s: float = 1.0
) -> Array:
    """noise_n of a wave averaged from `samples` samples of white noise, and of shot noise of a given density over duration_s."""
    variance = 0.5 * sample_sd_n**2 / samples + 0.5 * shot_n2_s / duration_s
    return np.full(pulses.settings.harmonics, np.sqrt(variance))

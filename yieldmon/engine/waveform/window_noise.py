"""The noise of windows with grain, once their pulses have been taken off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from yieldmon.estimation.waveform import noise_by_phase, pulse_times, spectral_density
from yieldmon.estimation.waveform.noise_by_phase import PhaseNoise
from yieldmon.estimation.waveform.pattern_fold import FoldedPattern
from yieldmon.estimation.waveform.pulse_residuals import residuals_of_pulses
from yieldmon.estimation.waveform.pulse_times import PulseTimes
from yieldmon.estimation.waveform.spectral_density import Density
from yieldmon.physics.machine import Machine
from yieldmon.physics.numerics import Array

SEGMENT = 256
"""Samples of which a spectrum is made."""


@dataclass(frozen=True, slots=True)
class LoadedWindow:
    """What is known of a window with grain; flow_kg_s: by the mean force, of the estimator in use."""

    force_n: float
    plate_angle_rad: float
    speed_rad_s: float
    moisture_pct: float
    flow_kg_s: float

    @property
    def impulse_per_kg(self) -> float:
        return self.force_n / self.flow_kg_s


@dataclass(frozen=True, slots=True)
class LoadedSamples:
    """Samples of a window with grain, and the pulses to take off them.

    Attributes
    ----------
    window : LoadedWindow
    force_n, phase : ndarray (n,)
        The samples, N, and their phase in turns of the paddle pattern, counted from the pulses themselves.
    mean : FoldedPattern
        Mean pulses of earlier windows like this one.
    own_variance : float
        What the chance of that mean adds to the variance of a difference, as a share of a sample's.
    by_phase : bool
        Whether noise by phase and pulses' times are wanted as well.
    """

    window: LoadedWindow
    force_n: Array
    phase: Array
    mean: FoldedPattern
    own_variance: float
    by_phase: bool


@dataclass(frozen=True, slots=True)
class WindowNoise:
    """Noise of a window with grain; by_phase, times: None where they were not wanted."""

    window: LoadedWindow
    density: Density
    by_phase: PhaseNoise | None
    times: PulseTimes | None


def noise_of(
    windows: Sequence[LoadedSamples], machine: Machine, sample_interval_s: float, band_hz: tuple[float, float]
) -> list[WindowNoise]:
    """The noise of each window; several at once cost half of what they do one by one.

    Parameters
    ----------
    windows : sequence of LoadedSamples
    machine : Machine
    sample_interval_s : float
        Of the sensor that all windows are of.
    band_hz : (float, float)
        In which noise by phase and pulses' times are looked at.
    """
    residuals = residuals_of_pulses(
        [samples.force_n for samples in windows],
        [samples.phase for samples in windows],
        [samples.mean for samples in windows],
        machine.paddle_spacings_m,
    )
    densities = spectral_density.densities([left_n for left_n, _ in residuals], sample_interval_s, segment=SEGMENT)
    found = []
    for samples, (left_n, late_turns), shown in zip(windows, residuals, densities, strict=True):
        by_phase = times = None
        if samples.by_phase:
            by_phase = _by_phase(samples, left_n, sample_interval_s, band_hz)
            times = _times(samples, late_turns, machine, band_hz)
        found.append(WindowNoise(samples.window, _density(samples, shown), by_phase, times))
    return found


def _density(samples: LoadedSamples, shown: Density) -> Density:
    mean_n = samples.mean.mean_n
    crest = mean_n.size * float(mean_n @ mean_n) / float(mean_n.sum()) ** 2
    own = Density(shown.frequency_hz, shown.density / (1.0 + samples.own_variance), shown.averages)
    return spectral_density.in_pulses(own, crest)


def _by_phase(samples: LoadedSamples, left_n: Array, sample_interval_s: float, band_hz: tuple[float, float]) -> PhaseNoise:
    return noise_by_phase.noise_by_phase(
        left_n / (1.0 + samples.own_variance) ** 0.5,
        samples.force_n,
        samples.phase,
        interval_s=sample_interval_s,
        low_hz=band_hz[0],
        high_hz=band_hz[1],
    )


def _times(samples: LoadedSamples, late_turns: Array, machine: Machine, band_hz: tuple[float, float]) -> PulseTimes:
    return pulse_times.pulse_times(
        late_turns,
        samples.mean.mean_n,
        pulses=len(machine.paddle_spacings_m),
        pattern_s=machine.pattern_length_m / machine.paddle_speed_m_s(samples.window.speed_rad_s),
        low_hz=band_hz[0],
        high_hz=band_hz[1],
    )

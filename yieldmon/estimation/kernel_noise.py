"""Mass flow from the noise of kernels.

Grain is discrete: kernels that strike one by one, each with an impulse J, make the force's spectral density F J (two-sided, F the
mean force), flat up to the duration of a contact (Campbell's theorem; Rice, Bell Syst. Tech. J. 23, 1944; Schottky's shot noise).
J over the impulse per kilogram F / flow is a kernel's mass. So flow = bias F m / J with the mass m of a kernel from a
thousand-kernel weight: an absolute scale, which no mean force holds. What the sensor passes on at these frequencies decides
whether there is anything to see.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from yieldmon.physics.numerics import Array

_ALIASES = 64
_CONTACT_HZ = 2000.0
"""From which on a kernel's contact, of some tenths of a millisecond, passes on an unknown share of its noise."""
CLEAR_OF_ALIASES = 0.4
"""Share of the sampling rate up to which what the sampler folds back is small beside what is there."""
_ITERATIONS = 6
_SHORTEST_CELL_S = 1e-5
"""A cell without lag counts as one of this time constant where the tilt of another one is compared with it."""
_TINY = 1e-9
_PUSHING = -0.4
"""Exponent of the frequency by which the noise of kernels falls at most, for a push lasts (studies/waveform, `kernels`)."""
_HANN_NEIGHBOURS = 1.0 + 2.0 * ((2.0 / 3.0) ** 2 + (1.0 / 6.0) ** 2)
"""Variance of a sum over frequencies over that of independent ones: correlation of a Hann spectrum with its next neighbours."""


class KernelVerdict(IntEnum):
    """Whether kernel noise gives a flow, else what stands in the way."""

    NOT_LOOKED_AT = 0
    USED = 1
    TOO_EARLY = 2
    NO_KERNEL_WEIGHT = 3
    NO_BAND = 4
    NO_NOISE = 5
    TOO_RANDOM = 6
    BACKGROUND = 7
    SLOW_CELL = 8
    UNEVEN = 9


@dataclass(frozen=True, slots=True)
class KernelNoiseSettings:
    """Band, what is not known of the background, and what calibrations found.

    Attributes
    ----------
    low_hz, high_hz : float
        Band: above the pulses, below the inverse of a contact's duration.
    quiet_error : float
        Relative standard deviation of the background's density between empty and harvesting; it does not average out.
    response_error : float
        Relative standard deviation of the cell's time constant.
    bias, bias_sd : float
        J over (kernel mass times impulse per kilogram), and its standard deviation between crops, loads and restitutions
        (studies/waveform, discrete-element forces).
    largest_sd : float
        Relative standard deviation of J above which the channel says nothing.
    averaged : bool
        Whether a sample is the mean over its interval; else it is the force at one instant, into which all aliases fold.
    """

    low_hz: float = 200.0
    high_hz: float = 800.0
    quiet_error: float = 0.1
    response_error: float = 0.05
    bias: float = 0.9
    bias_sd: float = 0.1
    largest_sd: float = 0.25
    averaged: bool = True


@dataclass(frozen=True, slots=True)
class Density:
    """Spectral density of a signal.

    Attributes
    ----------
    frequency_hz : ndarray (k,)
    density : ndarray (k,)
        Two-sided, N^2/Hz, so that the sum over positive and negative frequencies times their spacing is the mean square.
    averages : float
        Independent segments that were averaged, as far as sums over many frequencies go: neighbours that share their noise count
        as fewer segments.
    """

    frequency_hz: Array
    density: Array
    averages: float


@dataclass(frozen=True, slots=True)
class KernelImpulse:
    """Impulse of one kernel.

    Attributes
    ----------
    impulse_n_s : float
        nan where nothing can be said.
    random_sd, lasting_sd : float
        Relative standard deviations: of what averages out; and of background, cell, and a density that is not that of kernels
        over the whole band.
    verdict : KernelVerdict
    reason : str
        The verdict in words; empty where usable.
    """

    impulse_n_s: float
    random_sd: float
    lasting_sd: float
    verdict: KernelVerdict
    reason: str

    @property
    def usable(self) -> bool:
        """Whether the impulse is known well enough to give a flow."""
        return self.verdict is KernelVerdict.USED

    @property
    def relative_sd(self) -> float:
        """Both together."""
        return float(np.hypot(self.random_sd, self.lasting_sd))


@dataclass(frozen=True, slots=True)
class KernelFlow:
    """Mass flow from kernel noise; relative_sd holds the kernel's mass and the bias too."""

    mass_flow_kg_s: float
    relative_sd: float
    random_sd: float


def density(samples_n: Array, sample_interval_s: float, *, segment: int = 256) -> Density:
    """Averaged spectral density of a stretch of samples (Welch, Hann window, half overlapped).

    Parameters
    ----------
    samples_n : ndarray (n,)
        Evenly spaced, none missing.
    sample_interval_s : float
    segment : int
        Samples in a segment; n must hold at least one.

    Returns
    -------
    Density
        Frequencies above 0 and below Nyquist.

    Raises
    ------
    ValueError
        For fewer samples than one segment.
    """
    count = (len(samples_n) - segment) // (segment // 2) + 1
    if count < 1:
        raise ValueError(f"{len(samples_n)} samples, expected at least one segment of {segment}")
    window, power_of_window = _hann(segment)
    parts = np.asarray(samples_n, dtype=float)[_segments(count, segment)]
    parts -= (parts.sum(axis=1) / segment)[:, None]
    parts *= window
    waves = np.fft.rfft(parts)
    power = (waves.real**2 + waves.imag**2).sum(axis=0) * (sample_interval_s / (power_of_window * count))
    # Hann segments that overlap by half: 1 / (1 + 2 (1/6)^2) of their number are independent (Welch, 1967).
    independent = count if count == 1 else count / (1.0 + 2.0 * (1.0 - 1.0 / count) / 36.0)
    return Density(_frequencies(segment, sample_interval_s), power[1:-1], independent / _HANN_NEIGHBOURS)


@lru_cache(maxsize=8)
def _hann(segment: int) -> tuple[Array, float]:
    """The window, and the sum of its squares."""
    window = np.hanning(segment + 1)[:-1]
    window.flags.writeable = False
    return window, float((window**2).sum())


@lru_cache(maxsize=8)
def _segments(count: int, segment: int) -> NDArray[np.intp]:
    """Places (count, segment) of the samples of segments that overlap by half."""
    places = np.arange(count)[:, None] * (segment // 2) + np.arange(segment)
    places.flags.writeable = False
    return places


@lru_cache(maxsize=8)
def _frequencies(segment: int, sample_interval_s: float) -> Array:
    """Above 0 and below Nyquist."""
    frequency: Array = np.asarray(np.fft.rfftfreq(segment, sample_interval_s)[1:-1], dtype=np.float64)
    frequency.flags.writeable = False
    return frequency


def in_pulses(found: Density, crest: float) -> Density:
    """A density of shot noise that comes in pulses: kernels strike for part of the time, and fewer of them average out less.

    Parameters
    ----------
    crest : float
        Mean square of the pulses over the square of their mean.
    """
    return replace(found, averages=found.averages / crest)


def pooled(parts: list[Density]) -> Density:
    """Mean of densities on the same frequencies, weighted by their averages."""
    weights = np.array([p.averages for p in parts])
    mean = weights @ np.array([p.density for p in parts]) / weights.sum()
    return Density(parts[0].frequency_hz, mean, float(weights.sum()))


def power_gain(frequency_hz: Array, cell_response_s: float, sample_interval_s: float, *, averaged: bool = True) -> Array:
    """Share (k,) of a white density of force that samples show: critically damped cell, sampler, aliases.

    Parameters
    ----------
    frequency_hz : ndarray (k,)
    cell_response_s : float
        Time constant; 0 for none.
    sample_interval_s : float
    averaged : bool
        As of `KernelNoiseSettings`.
    """
    return _gains(frequency_hz, cell_response_s, sample_interval_s, averaged)[0]


def _gains(frequency_hz: Array, cell_response_s: float, sample_interval_s: float, averaged: bool) -> tuple[Array, Array]:
    """The same, and the part of it from beyond the frequency of a contact."""
    frequency = np.ascontiguousarray(frequency_hz, dtype=np.float64)
    return _power_gain(frequency.tobytes(), cell_response_s, sample_interval_s, averaged)


@lru_cache(maxsize=64)
def _power_gain(frequencies: bytes, cell_response_s: float, sample_interval_s: float, averaged: bool) -> tuple[Array, Array]:
    """The same for the bytes of frequencies: a sensor's are the same each second."""
    order = np.arange(-_ALIASES, _ALIASES + 1)[:, None]
    frequency = np.frombuffer(frequencies) + order / sample_interval_s
    shown = 1.0 / (1.0 + (2.0 * np.pi * frequency * cell_response_s) ** 2) ** 2
    if averaged:
        shown *= np.sinc(frequency * sample_interval_s) ** 2
    gain: Array = np.asarray(shown.sum(axis=0))
    beyond: Array = np.asarray(np.where(np.abs(frequency) > _CONTACT_HZ, shown, 0.0).sum(axis=0))
    gain.flags.writeable = beyond.flags.writeable = False
    return gain, beyond


def kernel_impulse(
    loaded: Density,
    quiet: Density,
    mean_force_n: float,
    *,
    cell_response_s: float,
    sample_interval_s: float,
    settings: KernelNoiseSettings | None = None,
    steady_share: float = 0.0,
    scatter: float = 0.0,
) -> KernelImpulse:
    """Impulse of one kernel from densities measured while harvesting and while empty.

    Parameters
    ----------
    loaded, quiet : Density
        On the same frequencies; `loaded` of what is left once the mean pulse has been taken off.
    mean_force_n : float
        Of the grain.
    cell_response_s, sample_interval_s : float
        As in `power_gain`.
    steady_share : float
        What of the noise beyond `quiet` stays between the pulses (`noise_by_phase.steady_noise`) and so is not the kernels'; half
        of it counts as a deviation.
    scatter : float
        Relative standard deviation of windows' noise beyond chance (`noise_scatter.excess_scatter`); it counts as a deviation.

    Returns
    -------
    KernelImpulse
        By weighted least squares over the band; usable is False, with the reason, where the band is empty, the force small, or
        the deviation above `settings.largest_sd`.
    """
    s = settings or KernelNoiseSettings()
    band = (loaded.frequency_hz >= s.low_hz) & (loaded.frequency_hz <= min(s.high_hz, CLEAR_OF_ALIASES / sample_interval_s))
    if not band.any():
        return _unusable(KernelVerdict.NO_BAND, f"no frequency of the samples lies in {s.low_hz:g} to {s.high_hz:g} Hz")
    if not mean_force_n > 0.0:
        return _unusable(KernelVerdict.NO_NOISE, "no force of grain")
    frequency = loaded.frequency_hz[band]
    shares, beyond = _gains(frequency, cell_response_s, sample_interval_s, s.averaged)
    gain = mean_force_n * shares
    folded = float(beyond.sum() / shares.sum())
    if not s.averaged and folded > s.largest_sd:
        return _unusable(KernelVerdict.NO_BAND, f"{100.0 * folded:.0f} % of the band is aliases from above {_CONTACT_HZ:g} Hz")
    ground = quiet.density[band]
    above = (1.0 - steady_share) * (loaded.density[band] - ground)
    impulse, weight, variance = _least_squares(above, ground, gain, (loaded.averages, quiet.averages), s.quiet_error)
    if impulse <= 0.0:
        return _unusable(KernelVerdict.NO_NOISE, "no noise above that of the empty machine")
    slope = float((weight * gain).sum()) * impulse
    random = float(np.sqrt((weight**2 * variance).sum())) / slope
    steady = 0.5 * steady_share / max(1.0 - steady_share, _TINY)
    background = float(np.hypot(s.quiet_error * float((weight * ground).sum()) / slope, steady))
    turned = (2.0 * np.pi * frequency * cell_response_s) ** 2
    cell = s.response_error * float((weight * gain * 4.0 * turned / (1.0 + turned)).sum() / (weight * gain).sum())
    if not s.averaged:
        # What of the aliases a contact keeps back is not known; a sampler that averages lets few of them in.
        cell = float(np.hypot(cell, float((weight * beyond).sum() / (weight * shares).sum())))
    cell_sd = s.response_error * 4.0 * turned / (1.0 + turned)
    per_half = _halves(above, gain, weight, variance, s.quiet_error * ground, cell_sd)
    middles_hz, lever = _as_another_cell_tilts(frequency, weight * gain, cell_response_s)
    uneven = max(_unevenness(per_half / impulse), lever * _beyond_kernels(per_half / impulse, middles_hz))
    uneven = float(np.hypot(uneven, scatter))
    lasting = float(np.hypot(np.hypot(background, cell), uneven))
    total = float(np.hypot(random, lasting))
    if total <= s.largest_sd:
        return KernelImpulse(impulse, random, lasting, KernelVerdict.USED, "")
    parts = {KernelVerdict.TOO_RANDOM: random, KernelVerdict.BACKGROUND: background, KernelVerdict.SLOW_CELL: cell}
    parts[KernelVerdict.UNEVEN] = uneven
    why = max(parts, key=parts.__getitem__)
    reason = f"deviation {100.0 * total:.0f} %, mostly {_CAUSES[why]}; the limit is {100.0 * s.largest_sd:.0f} %"
    return KernelImpulse(impulse, random, lasting, why, reason)


def _least_squares(
    above: Array, ground: Array, gain: Array, averages: tuple[float, float], quiet_error: float
) -> tuple[float, Array, Array]:
    """Impulse, N s, by repeatedly weighted least squares of above = impulse * gain, and weights and variances of the frequencies.

    above, ground: density beyond that of the empty machine, and that. averages: periodograms of the loaded and of the empty
    machine. quiet_error: relative deviation of ground.
    """
    impulse = max(float(np.median(above / gain)), 0.0)
    weight = variance = np.ones_like(gain)
    for _ in range(_ITERATIONS):
        expected = ground + impulse * gain
        variance = expected**2 / averages[0] + ground**2 / averages[1]
        # A background wrong by one share everywhere is taken as wrong in each place, which is what lines of vibration are.
        weight = gain / (variance + (quiet_error * ground) ** 2)
        impulse = max(float((weight * above).sum() / (weight * gain).sum()), 0.0)
    return impulse, weight, variance


_CAUSES = {
    KernelVerdict.TOO_RANDOM: "chance",
    KernelVerdict.BACKGROUND: "noise that is not the kernels': of the empty machine, or between the pulses",
    KernelVerdict.SLOW_CELL: "the cell's response, which is not known well enough",
    KernelVerdict.UNEVEN: (
        "noise that is not even over the band, or over time, as that of kernels is (is sensor.response_s right? a paddle bent?)"
    ),
}


def _halves(above: Array, gain: Array, weight: Array, variance: Array, ground_sd: Array, cell_sd: Array) -> Array:
    """Impulse by the lower and the upper half of a band, and its deviations by chance, background and cell (2, 4), all N s."""
    rows = []
    for half in (slice(None, gain.size // 2), slice(gain.size // 2, None)):
        w, slope = weight[half], float((weight[half] * gain[half]).sum())
        impulse = float((w * above[half]).sum()) / slope
        chance = float(np.sqrt((w**2 * variance[half]).sum())) / slope
        of_cell = impulse * float((w * gain[half] * cell_sd[half]).sum()) / slope
        rows.append((impulse, chance, float((w * ground_sd[half]).sum()) / slope, of_cell))
    return np.array(rows)


def _unevenness(per_half: Array) -> float:
    """Half of what two halves of a band differ by beyond their deviations; background and cell err in both alike."""
    apart = per_half[1] - per_half[0]
    expected = float((per_half[:, 1] ** 2).sum() + apart[2] ** 2 + apart[3] ** 2)
    return 0.5 * float(np.sqrt(max(0.0, float(apart[0]) ** 2 - expected)))


def _as_another_cell_tilts(frequency_hz: Array, weight: Array, cell_response_s: float) -> tuple[Array, float]:
    """Middles of the band's halves, Hz, and by what share of the impulse another time constant errs for what it tilts them.

    weight: of the frequencies in the impulse. The lever is the mean over the band of the change of ln(gain) over the difference
    of its means over the halves.
    """
    turned = (2.0 * np.pi * frequency_hz * max(cell_response_s, _SHORTEST_CELL_S)) ** 2
    change = turned / (1.0 + turned)
    half = frequency_hz.size // 2
    means = [
        (float((w * f).sum() / w.sum()), float((w * c).sum() / w.sum()))
        for f, c, w in zip(*((v[:half], v[half:]) for v in (frequency_hz, change, weight)), strict=True)
    ]
    (low_hz, low), (high_hz, high) = means
    return np.array([low_hz, high_hz]), float((weight * change).sum() / weight.sum()) / (high - low)


def _beyond_kernels(per_half: Array, middles_hz: Array) -> float:
    """By how much ln(impulse) differs between two halves of a band beyond what kernels and 1.5 deviations explain.

    Kernels that strike and leave differ by nothing, those that go on pushing as the frequency to the power of `_PUSHING`.
    """
    if not per_half[:, 0].min() > 0.0:
        return 0.0
    apart = per_half[1] - per_half[0]
    chance = float(np.sqrt((per_half[:, 1] ** 2).sum() + apart[2] ** 2 + apart[3] ** 2))
    tilt, pushing = (float(np.log(v[1] / v[0])) for v in (per_half[:, 0], middles_hz**_PUSHING))
    return max(0.0, max(tilt, pushing - tilt) - 1.5 * chance)


def _unusable(verdict: KernelVerdict, reason: str) -> KernelImpulse:
    return KernelImpulse(float("nan"), float("inf"), float("inf"), verdict, reason)


def kernel_flow(
    found: KernelImpulse,
    mean_force_n: float,
    kernel_mass_kg: float,
    *,
    kernel_mass_sd: float = 0.0,
    settings: KernelNoiseSettings | None = None,
) -> KernelFlow:
    """Mass flow = bias F m / J.

    Parameters
    ----------
    kernel_mass_kg : float
        Mean mass of a kernel, weighted by mass where kernels differ; a thousand-kernel weight / 1000.
    kernel_mass_sd : float
        Relative.
    """
    s = settings or KernelNoiseSettings()
    flow = s.bias * mean_force_n * kernel_mass_kg / found.impulse_n_s
    whole = float(np.sqrt(found.relative_sd**2 + (s.bias_sd / s.bias) ** 2 + kernel_mass_sd**2))
    return KernelFlow(flow, whole, found.random_sd)


def expected_sd(
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
    """What a sensor would reach: `kernel_impulse` on the densities that are to be expected, with a white background.

    crest: as of `in_pulses`.
    """
    frequency: Array = np.asarray(np.fft.rfftfreq(segment, sample_interval_s), dtype=np.float64)[1:-1]
    averages = duration_s / (segment * sample_interval_s) * 2.0 / (1.0 + 2.0 / 36.0) / _HANN_NEIGHBOURS
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


__all__ = [
    "Density",
    "KernelFlow",
    "KernelImpulse",
    "KernelNoiseSettings",
    "KernelVerdict",
    "density",
    "expected_sd",
    "in_pulses",
    "kernel_flow",
    "kernel_impulse",
    "pooled",
    "power_gain",
]

"""Mass flow from the noise of kernels.

Grain is discrete. Kernels that strike one by one, each with an impulse J, cause a force with the spectral density F J (two-sided,
F the mean force), flat up to the inverse of a contact's duration (Campbell's theorem; Rice, Bell Syst. Tech. J. 23, 1944;
Schottky's shot noise). A kernel's mass is J divided by the impulse per kilogram, F / flow. Therefore flow = bias F m / J, with
the mass m of a kernel from a thousand-kernel weight. This is an absolute scale, which the mean force does not give. The method
requires a sensor that transmits these frequencies.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from yieldmon.physics.numerics import Array, median

from .band_evenness import uneven_sd
from .noise_gain import CONTACT_HZ, power_gain_and_aliases
from .spectral_density import Density

CLEAR_OF_ALIASES = 0.4
"""Share of the sampling rate up to which aliases are small."""
_ITERATIONS = 6
_TINY = 1e-9


class KernelVerdict(IntEnum):
    """Whether kernel noise gives a flow, or the reason why not. CONTRADICTS: the flow contradicts that of the mean force and is
    not used."""

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
    CONTRADICTS = 10


@dataclass(frozen=True, slots=True)
class KernelNoiseSettings:
    """Band, uncertainties, and calibrated bias.

    Attributes
    ----------
    low_hz, high_hz : float
        Band: above the pulses, below the inverse of a contact's duration.
    quiet_error : float
        Relative standard deviation of the background's change between empty and harvesting; it does not average out.
    response_error : float
        Relative standard deviation of the cell's time constant.
    bias, bias_sd : float
        J / (kernel mass times impulse per kilogram), and its standard deviation between crops, loads and restitutions
        (studies/waveform, discrete-element forces).
    largest_sd : float
        Relative standard deviation of J above which the channel gives no flow.
    averaged : bool
        Whether a sample is the mean over its interval; if not, it is the force at one instant, which contains all aliases.
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
class KernelImpulse:
    """Impulse of one kernel.

    Attributes
    ----------
    impulse_n_s : float
        nan if it is not known.
    random_sd, lasting_sd : float
        Relative standard deviations by chance, which averages out; and by background, cell, and a density that differs from that
        of kernels, which do not.
    verdict : KernelVerdict
    reason : str
        The verdict in words; empty if usable.
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
        """Relative standard deviation by chance and lasting errors together."""
        return float(np.hypot(self.random_sd, self.lasting_sd))


@dataclass(frozen=True, slots=True)
class KernelFlow:
    """Mass flow from kernel noise; relative_sd includes the errors of the kernel's mass and the bias."""

    mass_flow_kg_s: float
    relative_sd: float


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
    misplaced: float = 0.0,
) -> KernelImpulse:
    """Impulse of one kernel from spectral densities measured while harvesting and while empty.

    Parameters
    ----------
    loaded, quiet : Density
        At the same frequencies; `loaded` of the samples minus the mean pulses.
    mean_force_n : float
        Mean force of the grain, N.
    cell_response_s, sample_interval_s : float
        As in `power_gain`.
    settings : KernelNoiseSettings, optional
        None: the defaults.
    steady_share : float
        Share of the noise beyond `quiet` that also exists between the pulses (`noise_by_phase.steady_noise`) and is not caused by
        kernels. It is subtracted, and half of it counts as a standard deviation.
    scatter : float
        Relative standard deviation of windows' noise beyond chance (`noise_scatter.excess_scatter`); it is added to the standard
        deviation.
    misplaced : float
        Share of the noise beyond `quiet` that displaced pulses may cause (`pulse_times.misplaced_share`). It is only added to the
        standard deviation, because measured displacements are already removed from the samples.

    Returns
    -------
    KernelImpulse
        By weighted least squares over the band. Not usable, with a reason, if the band is empty, there is no force of grain, or
        the standard deviation exceeds `settings.largest_sd`.
    """
    s = settings or KernelNoiseSettings()
    band = (loaded.frequency_hz >= s.low_hz) & (loaded.frequency_hz <= min(s.high_hz, CLEAR_OF_ALIASES / sample_interval_s))
    if not band.any():
        return _unusable(KernelVerdict.NO_BAND, f"no frequency of the samples lies in {s.low_hz:g} to {s.high_hz:g} Hz")
    if not mean_force_n > 0.0:
        return _unusable(KernelVerdict.NO_NOISE, "no force of grain")
    frequency = loaded.frequency_hz[band]
    shares, beyond = power_gain_and_aliases(frequency, cell_response_s, sample_interval_s, averaged=s.averaged)
    gain = mean_force_n * shares
    folded = float(beyond.sum() / shares.sum())
    if not s.averaged and folded > s.largest_sd:
        return _unusable(KernelVerdict.NO_BAND, f"{100.0 * folded:.0f} % of the band is aliases from above {CONTACT_HZ:g} Hz")
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
        # How much of the aliases a contact attenuates is not known. A sampler that averages has few of them.
        cell = float(np.hypot(cell, float((weight * beyond).sum() / (weight * shares).sum())))
    uneven = uneven_sd(
        above,
        gain,
        impulse_n_s=impulse,
        weight=weight,
        variance=variance,
        ground_sd=s.quiet_error * ground,
        cell_sd=s.response_error * 4.0 * turned / (1.0 + turned),
        frequency_hz=frequency,
        cell_response_s=cell_response_s,
    )
    uneven = float(np.hypot(np.hypot(uneven, scatter), misplaced))
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
    """Iteratively reweighted least squares of above = impulse * gain.

    Parameters
    ----------
    above, ground : ndarray (k,)
        Density beyond that of the empty machine, and density of the empty machine.
    gain : ndarray (k,)
    averages : (float, float)
        Averaged periodograms of the loaded and of the empty machine.
    quiet_error : float
        Relative standard deviation of ground.

    Returns
    -------
    impulse : float
        N s.
    weight, variance : ndarray (k,)
        Weight of the frequencies in the impulse, and variance of `above` by chance.
    """
    impulse = max(median(above / gain), 0.0)
    weight = variance = np.ones_like(gain)
    of_empty = ground**2 / averages[1]
    # The background's error is treated as independent between frequencies, as for lines of vibration.
    wrong = (quiet_error * ground) ** 2
    for _ in range(_ITERATIONS):
        variance = (ground + impulse * gain) ** 2 / averages[0] + of_empty
        weight = gain / (variance + wrong)
        impulse = max(float((weight * above).sum() / (weight * gain).sum()), 0.0)
    return impulse, weight, variance


_CAUSES = {
    KernelVerdict.TOO_RANDOM: "chance",
    KernelVerdict.BACKGROUND: "noise that is not the kernels': of the empty machine, or between the pulses",
    KernelVerdict.SLOW_CELL: "the cell's response, which is not known well enough",
    KernelVerdict.UNEVEN: (
        "noise that is not even over the band, or over time, as that of kernels is, or pulses out of place (is sensor.response_s "
        "right? a paddle bent? does the chain jerk?)"
    ),
}


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
    found : KernelImpulse
        A usable impulse.
    mean_force_n : float
        Mean force of the grain, N.
    kernel_mass_kg : float
        Mean mass of a kernel, weighted by mass where kernels differ, kg; a thousand-kernel weight / 1000.
    kernel_mass_sd : float
        Its relative standard deviation.
    settings : KernelNoiseSettings, optional
        None: the defaults.

    Returns
    -------
    KernelFlow
    """
    s = settings or KernelNoiseSettings()
    flow = s.bias * mean_force_n * kernel_mass_kg / found.impulse_n_s
    whole = float(np.sqrt(found.relative_sd**2 + (s.bias_sd / s.bias) ** 2 + kernel_mass_sd**2))
    return KernelFlow(flow, whole)

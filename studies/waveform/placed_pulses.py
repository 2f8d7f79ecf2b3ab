"""Discrete-element pulses in a train whose chain is not even: samples of a plate's cell, and what was struck.

Places of paddles follow from a chain of `PADDLES` that goes round, told off by what `Chain` names; nothing here knows the pulse
model or how the daemon looks at pulses' times. Each pulse is one of the heaps at 10 kHz, drawn anew, so that no two neighbours
share their kernels but by chance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from studies.waveform.kernels import INTERVAL_S, Heaps

Array = NDArray[np.float64]
PADDLES = 36
EMPTY_S = 20.0
SAMPLE_S = 1e-3
NOISE_MV = 3.0
ZERO_MV = 500.0
_BEFORE_S = 0.01
_PITCH_M, _TEETH, _RADIUS_M = 0.0414, 8, 0.0541


@dataclass(frozen=True)
class Chain:
    """What is wrong with a chain and its drive.

    Attributes
    ----------
    worn_mm : float
        Standard deviation of the paddles' places along the chain, each for good.
    late_mm, late_paddles, late_share : float, int, float
        So many paddles of the chain, evenly spread, are that late, and throw that share of a load.
    missing : int
        Paddles of the chain that are not there; their grain stays below.
    slack_mm, slack_s : float
        Standard deviation and correlation time of the whole chain's place, a Gaussian process of the first order.
    ripple, ripple_hz : float
        Relative amplitude of the chain's speed, and its frequency.
    polygon : bool
        Chain links go over `_TEETH` teeth as chords, paddles at half a pitch of them in turn.
    told_rpm : float
        Standard deviation of each reported speed; 0: the mean speed is told.
    told_share : float
        Reported speeds over true ones.
    load_scatter : float
        Relative standard deviation of a pulse's size.
    """

    worn_mm: float = 0.0
    late_mm: float = 0.0
    late_paddles: int = 0
    late_share: float = 1.0
    missing: int = 0
    slack_mm: float = 0.0
    slack_s: float = 0.2
    ripple: float = 0.0
    ripple_hz: float = 6.7
    polygon: bool = False
    told_rpm: float = 0.0
    told_share: float = 1.0
    load_scatter: float = 0.07


@dataclass(frozen=True)
class Train:
    """samples_mv (n,) at `SAMPLE_S`; strikes_per_s: pulses with grain, each counted by its size."""

    samples_mv: Array
    strikes_per_s: float


def _of_the_process(times_s: Array, sd: float, correlation_s: float, rng: np.random.Generator) -> Array:
    value, found, before = sd * rng.standard_normal(), [], float(times_s[0])
    for now in times_s:
        keeps = np.exp(-(now - before) / correlation_s)
        value = keeps * value + sd * np.sqrt(1.0 - keeps**2) * rng.standard_normal()
        found.append(value)
        before = float(now)
    return np.array(found)


def _polygon_m(places_m: Array) -> Array:
    """How far a chain over chords is from one over a circle at those of its places; once a pitch."""
    half = np.pi / _TEETH
    turned = half * (2.0 * ((places_m / _PITCH_M) % 1.0) - 1.0)
    return np.asarray(_RADIUS_M * (np.sin(turned) - turned * np.sin(half) / half))


def strikes(chain: Chain, *, spacing_m: float, speed_m_s: float, end_s: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Times, s, at which paddles pass the place where a heap's own time begins, and sizes of their pulses."""
    count = int((end_s - EMPTY_S) * speed_m_s / spacing_m)
    number = np.arange(count)
    paddle = number % PADDLES
    even_s = np.asarray(EMPTY_S + number * spacing_m / speed_m_s, dtype=np.float64)
    away_m: Array = (1e-3 * chain.worn_mm * rng.standard_normal(PADDLES))[paddle]
    size = np.ones(count)
    if chain.late_paddles:
        those = paddle % (PADDLES // chain.late_paddles) == 5
        away_m = away_m + np.where(those, 1e-3 * chain.late_mm, 0.0)
        size = np.where(those, chain.late_share * size, size)
    if chain.slack_mm:
        away_m = away_m + _of_the_process(even_s, 1e-3 * chain.slack_mm, chain.slack_s, rng)
    if chain.ripple:
        turned = 2.0 * np.pi * chain.ripple_hz
        away_m = away_m + chain.ripple * speed_m_s / turned * np.cos(turned * even_s + rng.uniform(0.0, 2.0 * np.pi))
    if chain.polygon:
        away_m = away_m + _polygon_m(np.asarray(number * 4.5 * _PITCH_M + 0.25 * _PITCH_M))
    if chain.missing:
        size = np.where(paddle % (PADDLES // chain.missing) == 7, 0.0, size)
    return even_s + away_m / speed_m_s, size


def train(
    pulses: Heaps, chain: Chain, *, spacing_m: float, speed_m_s: float, cell_s: float, gain_n_per_mv: float, end_s: float,
    seed: int,
) -> Train:  # fmt: skip
    """Samples of a cell behind heaps that strike as the chain brings them.

    Parameters
    ----------
    pulses : Heaps
        Of one group.
    cell_s : float
        Both time constants of the cell, s; 0 for none.
    """
    # Chains of one seed carry the same heaps, so that rows differ by the chain alone.
    rng, of_chain = np.random.default_rng([seed, 0]), np.random.default_rng([seed, 1])
    when, size = strikes(chain, spacing_m=spacing_m, speed_m_s=speed_m_s, end_s=end_s, rng=of_chain)
    size = np.maximum(size * (1.0 + chain.load_scatter * rng.standard_normal(when.size)), 0.0)
    which = rng.integers(len(pulses.force_n), size=when.size)
    bins = pulses.force_n.shape[1]
    force = np.zeros(round(end_s / INTERVAL_S) + 2 * bins)

    place = (when - _BEFORE_S) / INTERVAL_S
    first = np.floor(place).astype(int)
    for start, share, amount, row in zip(first, place - first, size, which, strict=True):
        if amount > 0.0 and start + bins + 1 < force.size:
            pulse = amount * pulses.force_n[row]
            force[start : start + bins] += (1.0 - share) * pulse
            force[start + 1 : start + bins + 1] += share * pulse
    if cell_s > 0.0:
        keeps = np.exp(-INTERVAL_S / cell_s)
        for _ in range(2):
            force = lfilter([1.0 - keeps], [1.0, -keeps], force)
    step = round(SAMPLE_S / INTERVAL_S)
    count = round(end_s / SAMPLE_S)
    felt = force[: count * step].reshape(count, step).mean(axis=1)
    samples = ZERO_MV + felt / gain_n_per_mv + NOISE_MV * rng.standard_normal(count)
    return Train(np.maximum(samples, 0.0), float(size.sum()) / (end_s - EMPTY_S))

"""Volume flow of grain from the shape of the paddles' pulses.

The mean force determines the flow only together with density and impact gain: (flow, density, 1 + e) -> (a, a, 1/a) does not
change any sample. But the depth of a heap, and with it the arrival times of its grain, depend on flow / density alone. This
module fits the forward model's pulses (`yieldmon.physics.pulse`) to the harmonics of the paddle pattern and determines that
ratio, the volume flow, with its covariance. The size of the pulses is a free parameter.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from yieldmon.physics.numerics import AnyArray, Array

from .pattern_fold import PatternWave
from .pulse_fit import PulseEstimate, WaveBatch, fitted, no_estimate, rise
from .pulse_model import FLOW, GAIN, SHAPE_COUNT, SHIFT, PulseModel

_SCAN = np.geomspace(0.06, 0.9, 16)
"""Fills (ratio of load to a full paddle) that are tried as a start."""
_SHIFTS = 256
_SIDE_BY_SIDE = 128
"""Number of windows fitted at once: large enough for efficient array operations, small enough for the cache."""
_INDEX_REACH_S = 0.015


def estimate(
    pulses: PulseModel, wave: PatternWave, *, start: Array | None = None, centre: Array | None = None, iterations: int = 15
) -> PulseEstimate:
    """Fit the pulses to one wave.

    Parameters
    ----------
    pulses : PulseModel
    wave : PatternWave
        With `harmonics` amplitudes.
    start : ndarray (n,), optional
        Start; default: the best of all fills and shifts.
    centre : ndarray (n,), optional
        Means of the priors; default: the settings' own, at the start's flow, shift and gain.
    iterations : int
        Largest number of steps.

    Returns
    -------
    PulseEstimate
        `converged` is False if the iteration did not converge; the values are then those of the last step.
    """
    theta = look_for_start(pulses, wave) if start is None else np.array(start, dtype=float)
    mean = _own_centres(pulses, theta[None]) if centre is None else np.asarray(centre, dtype=float)[None]
    shown = WaveBatch.of([wave])
    if not np.all(np.isfinite(theta[pulses.prior_sd(wave.patterns) > 0.0])):
        return no_estimate(pulses, theta)
    return fitted(pulses, shown, theta[None], mean, iterations)[0]


def estimate_near(
    pulses: PulseModel, waves: Sequence[PatternWave], volume_flows_m3_s: Sequence[float], *, iterations: int = 15
) -> list[PulseEstimate]:
    """Fit the pulses to many waves at once, each starting at an approximately known volume flow.

    Shift and gain start at the best correlation over the whole pattern. A result does not depend on the other waves.

    Parameters
    ----------
    pulses : PulseModel
    waves : sequence of PatternWave
    volume_flows_m3_s : sequence
        One for each wave, e.g. from the mean force.
    iterations : int
        Steps at most.

    Returns
    -------
    list of PulseEstimate
        nan if the flow exceeds the capacity of the paddles.
    """
    found: list[PulseEstimate] = []
    for first in range(0, len(waves), _SIDE_BY_SIDE):
        part = slice(first, first + _SIDE_BY_SIDE)
        shown, flows = WaveBatch.of(waves[part]), np.asarray(volume_flows_m3_s[part], dtype=float)
        theta = np.tile(pulses.start(1.0), (flows.size, 1))
        theta[:, FLOW] = np.log(flows)
        thrown = pulses.thrown(theta[:, :SHAPE_COUNT], shown.speeds_rad_s, shown.angles_rad)
        theta[:, SHIFT], theta[:, GAIN] = _aligned(pulses, shown, pulses.waves_behind_cell(thrown[0], theta, shown.speeds_rad_s))
        begun = pulses.behind_cell(thrown, theta, shown.speeds_rad_s)
        found += fitted(pulses, shown, theta, _own_centres(pulses, theta), iterations, begun)
    return found


def deviations_from(
    pulses: PulseModel,
    wave: PatternWave,
    found: PulseEstimate,
    volume_flow_m3_s: float,
    relative_sd: float,
    *,
    iterations: int = 15,
) -> float:
    """Deviation of pulses from those of an otherwise known volume flow, by a second fit at that flow.

    The difference of two flows in standard deviations would assume a linear model, which is not justified if the fitted flow is
    far away because of a heap of another shape.

    Parameters
    ----------
    pulses : PulseModel
    wave : PatternWave
    found : PulseEstimate
        The fit without that flow.
    volume_flow_m3_s, relative_sd : float
        The other flow, and the standard deviation of its logarithm.
    iterations : int
        Steps at most.

    Returns
    -------
    float
        Root of the increase of the sum of squares, in standard deviations; nan if no pulses of that flow fit.

    Source: Wilks, Ann. Math. Statist. 9 (1938), on the ratio of likelihoods.
    """
    shown, theta = WaveBatch.of([wave]), pulses.start(volume_flow_m3_s)[None]
    thrown = pulses.thrown(theta[:, :SHAPE_COUNT], shown.speeds_rad_s, shown.angles_rad)
    theta[:, SHIFT], theta[:, GAIN] = _aligned(pulses, shown, pulses.waves_behind_cell(thrown[0], theta, shown.speeds_rad_s))
    free = np.array([found.values[name] for name in pulses.names])
    mean = _own_centres(pulses, theta)
    if not np.all(np.isfinite(theta[0, [SHIFT, GAIN]])):
        return float("nan")
    held = fitted(pulses, shown, theta, mean, iterations, flow_sd=relative_sd)[0]
    # Without an index, the prior of the shift is centred on its start and carries no information.
    if not pulses.settings.indexed:
        mean[:, SHIFT] = free[SHIFT]
    rest = rise(pulses, shown, free, np.array([held.values[name] for name in pulses.names]), mean[0], relative_sd)
    return float(np.sqrt(rest / max(1.0, found.misfit)))


def _aligned(pulses: PulseModel, shown: WaveBatch, waves: AnyArray) -> tuple[Array, Array]:
    """Shift (s) and ln gain, (m,), with which waves (m, k) fit best; nan if none fits."""
    envelope = np.abs(shown.amplitudes_n)
    lasting = pulses.lasting_variance(envelope) + 1e-6 * envelope.max(axis=1, keepdims=True) ** 2
    weight = 1.0 / (shown.random + lasting)
    products = np.zeros((len(waves), _SHIFTS), dtype=complex)
    products[:, 1 : 1 + waves.shape[1]] = weight * np.conj(waves) * shown.amplitudes_n
    fits = np.fft.ifft(products).real * _SHIFTS
    best = np.argmax(fits, axis=1)
    period_s = 2.0 * np.pi / pulses.frequencies_rad_s(shown.speeds_rad_s)[:, 0]
    shift_s = best * period_s / _SHIFTS
    if pulses.settings.indexed:
        shift_s = np.where(best > _SHIFTS // 2, shift_s - period_s, shift_s)
    size = fits[np.arange(len(waves)), best] / (weight * np.abs(waves) ** 2).sum(axis=1)
    known = size > 0.0
    return np.where(known, shift_s, np.nan), np.log(np.where(known, size, np.nan))


def _own_centres(pulses: PulseModel, theta: Array) -> Array:
    """Means of the priors (m, n), with flow, shift and gain of the start."""
    mean = np.tile(pulses.start(1.0), (len(theta), 1))
    mean[:, [FLOW, GAIN]] = theta[:, [FLOW, GAIN]]
    mean[:, SHIFT] = 0.0 if pulses.settings.indexed else theta[:, SHIFT]
    return mean


def look_for_start(pulses: PulseModel, wave: PatternWave) -> Array:
    """Parameters of the best fit over all fills and shifts of the pattern."""
    speed, angle = wave.elevator_speed_rad_s, wave.plate_angle_rad
    p, machine = pulses.parameters, pulses.machine
    flows = _SCAN * pulses.full_paddle_kg / p["density"] * machine.paddle_speed_m_s(speed) / machine.paddle_spacing_m
    batch = np.repeat(pulses.start(1.0)[None, :SHAPE_COUNT], flows.size, axis=0)
    batch[:, 0] = np.log(flows)
    waves = pulses.joined(pulses.shapes(batch, speed, angle), pulses.start(1.0)[None], np.array([speed]))[0].sum(axis=1)
    known = np.all(np.isfinite(waves), axis=1)
    waves = np.where(known[:, None], waves, 0.0)
    envelope = np.abs(wave.amplitudes_n)
    weight = 1.0 / (wave.noise_n**2 + pulses.lasting_variance(envelope) + 1e-6 * envelope.max() ** 2)
    shift = np.arange(_SHIFTS) * (2.0 * np.pi / pulses.fundamental_rad_s(speed) / _SHIFTS)
    omega = pulses.fundamental_rad_s(speed) * np.arange(1.0, wave.amplitudes_n.size + 1.0)
    product = (weight * np.conj(waves) * wave.amplitudes_n) @ np.exp(1j * np.outer(omega, shift))
    size = (weight * np.abs(waves) ** 2).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        gain = np.where(known[:, None] & (product.real > 0.0), product.real / size[:, None], np.nan)
        fitted = np.where(np.isfinite(gain), gain * product.real, -np.inf)
    if pulses.settings.indexed:
        period = 2.0 * np.pi / pulses.fundamental_rad_s(speed)
        shift = np.where(shift > 0.5 * period, shift - period, shift)
        fitted = np.where(np.abs(shift) < _INDEX_REACH_S, fitted, -np.inf)
    row, column = np.unravel_index(int(np.argmax(fitted)), fitted.shape)
    size_there = float(gain[row, column])
    found = float(np.log(size_there)) if size_there > 0.0 else float("nan")
    return pulses.start(float(flows[row]), shift_s=float(shift[column]), log_gain=found)

"""Fit of pulse parameters to the waves of several windows at once.

Sources: Gauss-Newton with Gaussian priors; for the model error Kennedy and O'Hagan, J. R. Statist. Soc. B 63
(2001).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from yieldmon.physics.numerics import AnyArray, Array

from .pattern_fold import PatternWave
from .pulse_model import FLOW, SHIFT, Linear, PulseModel

_LARGEST_STEP = 0.4
_SETTLED = 1e-3
"""Squared length of a step, in posterior standard deviations, below which it is the last one, without a new evaluation."""
_WEIGHED_ANEW = 3
"""Number of steps with new weights; after these the weights stay the same, so that the fit converges."""
_PARTS = (1.0, 0.5, 0.25, 0.1)
"""Fractions of a step that are tried until the fit improves."""


@dataclass(frozen=True)
class PulseEstimate:
    """Parameters of a window's pulses.

    Attributes
    ----------
    volume_flow_m3_s : float
        Mass flow over bulk density on the paddle.
    relative_sd, random_sd : float
        Standard deviation of its logarithm: total, and the part that averages out over windows.
    values : dict
        All parameters by name.
    names, covariance :
        Order and posterior covariance (n, n).
    misfit : float
        Mean square of the residuals in standard deviations that include the model error; about 1 if the model is correct.
    relative_residual : float
        Root of the summed squares of the residual harmonics over that of the harmonics.
    converged : bool
    outside : str
        Why the volume flow must not be used: the load, plate angle or speed is outside the calibration of the arrival law. Empty
        if it is inside.
    """

    volume_flow_m3_s: float
    relative_sd: float
    random_sd: float
    values: dict[str, float]
    names: tuple[str, ...]
    covariance: Array
    misfit: float
    relative_residual: float
    converged: bool
    outside: str = ""

    def standard_deviation(self, name: str) -> float:
        """Posterior standard deviation of a parameter."""
        i = self.names.index(name)
        return float(np.sqrt(self.covariance[i, i]))


@dataclass(frozen=True, slots=True)
class WaveBatch:
    """Waves of m windows: amplitudes and their variances by what averages out, (m, k), and conditions, (m,)."""

    amplitudes_n: AnyArray
    random: Array
    patterns: Array
    speeds_rad_s: Array
    angles_rad: Array

    @classmethod
    def of(cls, waves: Sequence[PatternWave]) -> WaveBatch:
        return cls(
            np.array([wave.amplitudes_n for wave in waves]),
            np.array([wave.noise_n for wave in waves]) ** 2,
            np.array([wave.patterns for wave in waves]),
            np.array([wave.elevator_speed_rad_s for wave in waves]),
            np.array([wave.plate_angle_rad for wave in waves]),
        )

    def at(self, rows: AnyArray) -> WaveBatch:
        """The waves of some rows."""
        return WaveBatch(
            self.amplitudes_n[rows], self.random[rows], self.patterns[rows], self.speeds_rad_s[rows], self.angles_rad[rows]
        )


class _Priors:
    """Priors of the parameters of m windows.

    Attributes
    ----------
    free : ndarray of bool (n,)
        The f parameters that are fitted.
    own : ndarray of bool (f,)
        Which of them are the paddles' scatter.
    sd : ndarray (m, n)
        Standard deviations.
    precision : ndarray (m, f, f)
        Inverse covariances.
    flow_sd : float or None
        As given.
    """

    def __init__(self, pulses: PulseModel, patterns: Array, flow_sd: float | None = None) -> None:
        """flow_sd: standard deviation of ln volume flow; None: that of the settings."""
        own, self.flow_sd = pulses.own_scatter, flow_sd
        self.sd = np.tile(pulses.prior_sd(1.0), (len(patterns), 1))
        if flow_sd is not None:
            self.sd[:, FLOW] = flow_sd
        self.sd[:, own] = (pulses.settings.scatter / np.sqrt(np.maximum(patterns, 1.0)))[:, None]
        self.free: AnyArray = self.sd[0] > 0.0
        self.own: AnyArray = own[self.free]
        whole = pulses.prior_precision(1.0)
        if flow_sd is not None:
            whole[FLOW, FLOW] = flow_sd**-2.0
        one = whole[np.ix_(self.free, self.free)]
        self.precision = np.tile(one, (len(patterns), 1, 1))
        places = np.flatnonzero(self.own)
        self.precision[:, places, places] = self.sd[:, self.free][:, places] ** -2.0


def fitted(
    pulses: PulseModel, shown: WaveBatch, theta: Array, mean: Array, iterations: int, begun: Linear | None = None,
    *, flow_sd: float | None = None,
) -> list[PulseEstimate]:  # fmt: skip
    """Gauss-Newton fit of m windows.

    Parameters
    ----------
    pulses : PulseModel
    shown : WaveBatch
        The measured waves.
    theta : ndarray (m, n)
        Start; overwritten.
    mean : ndarray (m, n)
        Means of the priors.
    iterations : int
    begun : Linear, optional
        The model at theta.
    flow_sd : float, optional
        Prior standard deviation of ln volume flow; default: that of the settings.
    """
    priors = _Priors(pulses, shown.patterns, flow_sd)
    free = priors.free
    theta[:, ~free] = mean[:, ~free]
    at = pulses.linearised(theta, shown.speeds_rad_s, shown.angles_rad) if begun is None else begun
    limits = np.minimum(_LARGEST_STEP, 3.0 * np.where(free, priors.sd, 1.0))
    limits[:, SHIFT] = np.pi / (8.0 * pulses.frequencies_rad_s(shown.speeds_rad_s)[:, 0])
    converged = np.zeros(len(theta), dtype=bool)
    variance = np.full(shown.random.shape, np.nan)
    going = np.flatnonzero(np.all(np.isfinite(theta[:, free]), axis=1))
    for turn in range(iterations):
        known = np.all(np.isfinite(at.waves[going]), axis=1)
        lost, rows = going[~known], going[known]
        if lost.size:
            theta[lost, FLOW] -= 0.1
            at.put(lost, pulses.linearised(theta[lost], shown.speeds_rad_s[lost], shown.angles_rad[lost]))
        if rows.size:
            anew = rows if turn < _WEIGHED_ANEW else rows[np.isnan(variance[rows, 0])]
            variance[anew] = shown.random[anew] + pulses.lasting_variance(at.envelope[anew])
            step, best, settled = _step(shown, at, theta, mean, priors, variance, rows)
            done, rest = rows[settled], rows[~settled]
            theta[done] += step[settled]
            converged[done] = True
            if rest.size:
                whole = np.clip(step[~settled], -limits[rest], limits[rest])
                theta[rest] = _shortened(pulses, shown, at, theta[rest], mean, priors, variance, rest, whole, best[~settled])
            going = np.sort(np.concatenate((lost, rest)))
        if not going.size:
            break
    return _results(pulses, shown, theta, at, converged, priors)


def _step(
    shown: WaveBatch, at: Linear, theta: Array, mean: Array, priors: _Priors, variance: Array, rows: AnyArray
) -> tuple[Array, Array, AnyArray]:
    """Full step (r, n), present cost (r,), and whether the step is short enough to be the last (r,), for each of the rows."""
    free, prior = priors.free, priors.precision[rows]
    white, residual = _whitened(at.jacobian[rows][..., free], shown.amplitudes_n[rows] - at.waves[rows], variance[rows])
    across = white.swapaxes(1, 2)
    normal = across @ white + prior
    # Without a response of the cell, ln of its time constant is -inf; it is not a free parameter then.
    away = theta[rows][:, free] - mean[rows][:, free]
    pull = _times(prior, away)
    short: Array = np.asarray(np.linalg.solve(normal, (_times(across, residual) - pull)[..., None])[..., 0], dtype=np.float64)
    step = np.zeros((rows.size, theta.shape[1]))
    step[:, free] = short
    best = (residual * residual).sum(axis=1) + (away * pull).sum(axis=1)
    return step, best, (short * _times(normal, short)).sum(axis=1) < _SETTLED


def _shortened(
    pulses: PulseModel, shown: WaveBatch, at: Linear, theta: Array, mean: Array, priors: _Priors, variance: Array, rows: AnyArray,
    whole: Array, best: Array,
) -> Array:  # fmt: skip
    """theta (r, n) of the rows after the largest fraction of the full step that improves the fit; `at` is updated."""
    tried, left = theta.copy(), np.arange(rows.size)
    for part in _PARTS:
        those = rows[left]
        tried[left] = theta[left] + part * whole[left]
        there = pulses.linearised(tried[left], shown.speeds_rad_s[those], shown.angles_rad[those])
        at.put(those, there)
        away = tried[left][:, priors.free] - mean[those][:, priors.free]
        off = (np.abs(shown.amplitudes_n[those] - there.waves) ** 2 / variance[those]).sum(axis=1)
        left = left[~(off + (away * _times(priors.precision[those], away)).sum(axis=1) < best[left])]
        if not left.size:
            break
    return tried


def _times(matrices: Array, vectors: Array) -> Array:
    """Products (m, a) of matrices (m, a, b) and vectors (m, b)."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def _whitened(jacobian: AnyArray, off_n: AnyArray, variance: Array) -> tuple[Array, Array]:
    """Derivatives (m, 2 k, n) and residuals (m, 2 k) in units of standard deviations; real parts first."""
    weight = 1.0 / np.sqrt(variance)
    residual, slopes = off_n * weight, jacobian * weight[..., None]
    return np.concatenate((slopes.real, slopes.imag), axis=1), np.concatenate((residual.real, residual.imag), axis=1)


def _covariances(white: Array, random: Array, variance: Array, priors: _Priors) -> tuple[Array, Array]:
    """Posterior covariances (m, n, n), zero for fixed parameters, and the part of them that averages out over windows.

    white: whitened derivatives with respect to the free parameters, (m, 2 k, f).
    """
    across = white.swapaxes(1, 2)
    small = np.linalg.inv(across @ white + priors.precision)
    share = random / variance
    both = np.concatenate((share, share), axis=1)
    noise = across @ (both[..., None] * white)
    # The paddles' scatter is independent between windows, like noise.
    places = np.flatnonzero(priors.own)
    noise[:, places, places] += priors.precision[:, places, places]
    count, n = priors.sd.shape
    full, averaging = (np.zeros((count, n, n)) for _ in range(2))
    inside = np.ix_(np.arange(count), np.flatnonzero(priors.free), np.flatnonzero(priors.free))
    full[inside], averaging[inside] = small, small @ noise @ small
    return full, averaging


def no_estimate(pulses: PulseModel, theta: Array) -> PulseEstimate:
    nan, n = float("nan"), theta.size
    values = dict(zip(pulses.names, theta.tolist(), strict=True))
    return PulseEstimate(
        volume_flow_m3_s=nan,
        relative_sd=nan,
        random_sd=nan,
        values=values,
        names=pulses.names,
        covariance=np.full((n, n), nan),
        misfit=nan,
        relative_residual=nan,
        converged=False,
    )


def _results(
    pulses: PulseModel, shown: WaveBatch, theta: Array, at: Linear, converged: AnyArray, priors: _Priors
) -> list[PulseEstimate]:
    known = np.all(np.isfinite(at.waves), axis=1) & np.all(np.isfinite(theta[:, priors.free]), axis=1)
    if not known.any():
        return [no_estimate(pulses, row) for row in theta]
    if not known.all():
        # Rows that are not finite must not reach the matrix inversions.
        rows = np.flatnonzero(known)
        of_rows = _Priors(pulses, shown.patterns[rows], priors.flow_sd)
        kept = _results(pulses, shown.at(rows), theta[rows], at.at(rows), converged[rows], of_rows)
        fits = iter(kept)
        return [next(fits) if good else no_estimate(pulses, row) for good, row in zip(known.tolist(), theta, strict=True)]
    variance = shown.random + pulses.lasting_variance(at.envelope)
    off_n = shown.amplitudes_n - at.waves
    white, residual = _whitened(at.jacobian[..., priors.free], off_n, variance)
    covariance, averaging = _covariances(white, shown.random, variance, priors)
    misfit = np.mean(residual**2, axis=1)
    sd = np.sqrt(covariance[:, FLOW, FLOW] * np.maximum(1.0, misfit))
    size = np.sqrt((np.abs(shown.amplitudes_n) ** 2).sum(axis=1))
    with np.errstate(divide="ignore", invalid="ignore"):
        left = np.where(size > 0.0, np.sqrt((np.abs(off_n) ** 2).sum(axis=1)) / size, np.nan)
    flows = np.exp(theta[:, FLOW])
    fills = pulses.fill(flows[:, None], shown.speeds_rad_s[:, None]).mean(axis=1)
    law = pulses.settings.arrival
    columns = (
        flows,
        sd,
        np.sqrt(averaging[:, FLOW, FLOW]),
        misfit,
        left,
        converged,
        fills,
        shown.angles_rad,
        shown.speeds_rad_s,
    )
    return [
        PulseEstimate(
            volume_flow_m3_s=flow,
            relative_sd=relative_sd,
            random_sd=random_sd,
            values=dict(zip(pulses.names, values, strict=True)),
            names=pulses.names,
            covariance=posterior,
            misfit=off,
            relative_residual=rest,
            converged=good,
            outside=law.outside(fill, angle, speed),
        )
        for values, posterior, (flow, relative_sd, random_sd, off, rest, good, fill, angle, speed) in zip(
            theta.tolist(), covariance, zip(*(column.tolist() for column in columns), strict=True), strict=True
        )
    ]


def rise(pulses: PulseModel, shown: WaveBatch, free: Array, held: Array, mean: Array, flow_sd: float) -> float:
    """Increase of one window's least sum of squares (residuals and priors) by a prior of the flow.

    Parameters
    ----------
    pulses : PulseModel
    shown : WaveBatch
        The wave of this window alone.
    free, held : ndarray (n,)
        Parameters with the least sum, without the prior of the flow and with it.
    mean : ndarray (n,)
        Means of the priors.
    flow_sd : float
        Prior standard deviation of ln volume flow.

    Returns
    -------
    float
        0 or more; nan if the model gives no wave.
    """
    both = np.stack((free, held))
    one = np.repeat(0, 2)
    at = pulses.linearised(both, shown.speeds_rad_s[one], shown.angles_rad[one])
    # The same variance for both: that at the fit without the prior of the flow.
    variance = shown.random + pulses.lasting_variance(at.envelope[:1])
    priors = _Priors(pulses, shown.patterns, flow_sd)
    away = both[:, priors.free] - mean[priors.free]
    away[0, priors.free[:FLOW].sum()] = 0.0
    sums = (np.abs(shown.amplitudes_n - at.waves) ** 2 / variance).sum(axis=1)
    sums += (away * _times(np.repeat(priors.precision, 2, axis=0), away)).sum(axis=1)
    return float(np.fmax(sums[1] - sums[0], 0.0)) if np.all(np.isfinite(sums)) else float("nan")


def information(
    pulses: PulseModel, theta: Array, *, elevator_speed_rad_s: float, plate_angle_rad: float, noise_n: Array, patterns: float
) -> tuple[Array, Array]:
    """Expected posterior covariance of a window before it is measured, and the part that averages out, both (n, n).

    Parameters
    ----------
    pulses : PulseModel
    theta : ndarray (n,)
        Parameters in the order of `pulses.names`.
    elevator_speed_rad_s, plate_angle_rad : float
        Of the window, rad/s and rad.
    noise_n : ndarray (k,)
    patterns : float
        As in `PatternWave`.
    """
    at = pulses.linearised(theta[None], np.array([elevator_speed_rad_s]), np.array([plate_angle_rad]))
    priors, random = _Priors(pulses, np.array([patterns])), noise_n[None] ** 2
    variance = random + pulses.lasting_variance(at.envelope)
    white, _ = _whitened(at.jacobian[..., priors.free], at.waves, variance)
    full, averaging = _covariances(white, random, variance, priors)
    return full[0], averaging[0]

"""Density, impact gain and the curve of force over load from weighed loads, by Bayesian model averaging.

The average is over three unknowns:

- The curve of force over flow. The model's curve is that of one geometry; other sensors are described by the weights of the
  effect `load_pattern`. Their prior is zero (the model's own curve), near proportionality (a plate that takes the momentum of all
  grain), or of one of two sizes about the model's curve (`force_curves`).
- Scatter of the loads beyond that of scale and windows, for example because the machine drifts between them.
- Wrong tickets (`ticket_slips`).

Each combination is weighted by its posterior probability.

Sources: Hoeting, Madigan, Raftery and Volinsky, "Bayesian model averaging: a tutorial", Statistical Science 14 (1999); Kennedy
and O'Hagan, J. R. Stat. Soc. B 63 (2001), for the model's error as a quantity with a prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from yieldmon.estimation.load_pattern import NAMES, with_weights
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.recent import Recent
from yieldmon.physics.numerics import Array

from .density_and_gain import DENSITY, moved
from .force_curves import ForceCurve, curves
from .load_fit import LoadProblem
from .ticket_slips import Slip, slips

_SCATTERS = ((0.0, 0.9), (0.01, 0.08), (0.03, 0.02))
"""(relative scatter of a load's mass beyond the stated one, prior probability)."""
_REST = 0.004
"""Relative error of a load's mass that the pattern's weights leave if the curve is not the model's."""
_ALL_OFF = 2.0
"""Ratio of weighed to measured mass; if all loads exceed it, the error is a common factor and not a tare."""
_ITERATIONS = 25
_SETTLED = 1e-4
_MOST_STEP = 1.0
_GAIN_STEP, _GAIN_STEPS = 0.1, 25
_RECENT = 64
"""Steps whose errors and slopes are kept."""


class LawProblem(LoadProblem):
    """Weighed loads in the model with `load_pattern`. A step is (ln density, ln gain, weights of the pattern)."""

    @cached_property
    def curves(self) -> tuple[ForceCurve, ...]:
        """Priors of the curve of force over load."""
        return curves(self)

    @cached_property
    def at_step(self) -> Recent[tuple[Array, Array]]:
        """Cache of ln(measured / weighed mass) and its slopes, by the step's bytes."""
        return Recent(_RECENT)


@dataclass(frozen=True)
class LawAverage:
    """Posterior of the loads, averaged over curves, scatters and wrong tickets.

    Attributes
    ----------
    step : ndarray (5,)
        ln density, ln gain and the pattern's weights relative to the start.
    covariance : ndarray (h + 5, h + 5)
        Of the held parameters and `step`.
    error : ndarray (n,)
        ln(measured / weighed mass) at `step`.
    by_step, by_held : ndarray (n, 5), (n, h)
        Derivatives of `error` with respect to the step and the held parameters.
    law : float
        Probability that the force does not follow the model's curve.
    scatter : float
        Relative standard deviation of the loads beyond the stated one, rms over the combinations.
    scatters : float
        Probability that the loads scatter by more than stated.
    strain : float
        Distance of `step` from the start in standard deviations of the widest prior.
    wrong : float
        Probability that a ticket is wrong.
    slips : tuple of (Slip, float)
        Possible slips of the active loads, each with its probability.
    along : tuple of float
        Expected size of the common error of each slip (`Slip.along`), in its standard deviations.
    """

    step: Array
    covariance: Array
    error: Array
    by_step: Array
    by_held: Array
    law: float
    scatter: float
    scatters: float
    strain: float
    wrong: float
    slips: tuple[tuple[Slip, float], ...]
    along: tuple[float, ...]


@dataclass(frozen=True)
class _Tickets:
    """Hypotheses about the tickets of n loads.

    Attributes
    ----------
    slips : tuple of Slip (s,)
        The first one is that all tickets are right.
    ln_priors : ndarray (s,)
    shifts : ndarray (s, n)
        `Slip.shift` of each.
    covariances : ndarray (g, n, n)
        The distinct covariances among the slips.
    of_covariance : ndarray of int (s,)
        Index of each slip's covariance.
    """

    slips: tuple[Slip, ...]
    ln_priors: Array
    shifts: Array
    covariances: Array
    of_covariance: NDArray[np.intp]


@dataclass(frozen=True)
class _Mixture:
    """Posterior over all combinations, in the model linearised about a step.

    Attributes
    ----------
    step, covariance : ndarray (5,), (5, 5)
        Mean and covariance of the step.
    gain : ndarray (5, n)
        Derivative of the mean step with respect to ln(weighed / measured mass) of each load.
    law, scatter, scatters : float
        As in `LawAverage`.
    of_slip : ndarray (s,)
        Probability of each slip of `_Tickets`.
    along : ndarray (s,)
        Expected size of each slip's common error, in its standard deviations.
    """

    step: Array
    covariance: Array
    gain: Array
    law: float
    scatter: float
    scatters: float
    of_slip: Array
    along: Array


def placed(start: ParameterSet, step: Array) -> ParameterSet:
    """The set with density, gain and the pattern's weights changed by a step, (5,)."""
    there = moved(start, float(step[0]), float(step[1]))
    return replace(
        there, values=dict(there.values) | {n: start.values[n] + float(s) for n, s in zip(NAMES, step[2:], strict=True)}
    )


def average(problem: LawProblem, active: NDArray[np.bool_], near: Array | None = None) -> LawAverage | None:
    """Average over curves, scatters and wrong tickets, given the active loads.

    Parameters
    ----------
    problem : LawProblem
        See `law_problem`.
    active : ndarray of bool (n,)
        Loads to use.
    near : ndarray (5,), optional
        First step of the search.

    Returns
    -------
    LawAverage or None
        None if no flow explains the forces.
    """
    step = _begin(problem) if near is None else near
    if step is None:
        return None
    error, slope = _slopes(problem, step)
    if not np.all(np.isfinite(error)):
        return None
    names = [load.name for load, ok in zip(problem.loads, active, strict=True) if ok]
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = np.min((problem.weighed / problem.mass(problem.given))[active])
    wrong = slips(problem.weighed[active], names, all_off=bool(factor > _ALL_OFF))
    tickets = _tickets(wrong, int(active.sum()))
    for _ in range(_ITERATIONS):
        wanted = _mixture(problem, active, step, error, slope, tickets).step
        change = np.clip(wanted - step, -_MOST_STEP, _MOST_STEP)
        for _ in range(8):
            after, after_slope = _slopes(problem, step + change)
            if np.all(np.isfinite(after)) and np.all(np.isfinite(after_slope)):
                break
            change = 0.5 * change
        else:
            break
        step, error, slope = step + change, after, after_slope
        if float(np.max(np.abs(change))) < _SETTLED:
            break
    found = _mixture(problem, active, step, error, slope, tickets)
    held = problem.held_slopes(placed(problem.start, step))
    whole = _with_held(problem, active, held, found)
    strain = float(np.sqrt(step @ np.linalg.solve(problem.curves[-1].covariance, step)))
    each = tuple(zip(wrong, found.of_slip[1:].tolist(), strict=True))
    right = float(found.of_slip[0])
    along = tuple(found.along[1:].tolist())
    return LawAverage(
        step=step,
        covariance=whole,
        error=error,
        by_step=slope,
        by_held=held,
        law=found.law,
        scatter=found.scatter,
        scatters=found.scatters,
        strain=strain,
        wrong=1.0 - right,
        slips=each,
        along=along,
    )


def _begin(problem: LawProblem) -> Array | None:
    """A step at which every force has a flow; None if none is found."""
    for k in range(_GAIN_STEPS):
        step = np.zeros(2 + len(NAMES))
        step[1] = _GAIN_STEP * k
        if np.all(np.isfinite(problem.mass(placed(problem.start, step)))):
            return step
    return None


def _slopes(problem: LawProblem, step: Array) -> tuple[Array, Array]:
    return problem.at_step.of(step.tobytes(), lambda: _slopes_at(problem, step))


def _slopes_at(problem: LawProblem, step: Array) -> tuple[Array, Array]:
    known = placed(problem.start, step)
    flow, by_flow = problem.flow(known)
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.log(problem.windows.total_kg(flow) / problem.weighed)
        size = 1e-4
        beside = [placed(problem.start, step + size * d).values for d in np.eye(step.size)]
        return error, problem.slopes(beside, flow, by_flow, (size,) * step.size)


def _tickets(wrong: Sequence[Slip], count: int) -> _Tickets:
    right = Slip((), np.zeros(count), np.zeros(count), 1.0 - sum(slip.prior for slip in wrong), "")
    every = (right, *wrong)
    # Most slips have the covariance of right tickets, so each distinct one is built and compared only once.
    keys = [(slip.variance.tobytes(), slip.along.tobytes()) for slip in every]
    first = dict(zip(reversed(keys), reversed(every), strict=True))
    place = {key: index for index, key in enumerate(first)}
    made = np.array([slip.covariance for slip in first.values()])
    covariances, of_made = np.unique(made, axis=0, return_inverse=True)
    of_covariance = of_made.ravel()[[place[key] for key in keys]]
    shifts = np.array([slip.shift for slip in every])
    return _Tickets(every, np.log([slip.prior for slip in every]), shifts, covariances, of_covariance)


def _mixture(
    problem: LawProblem,
    active: NDArray[np.bool_],
    step: Array,
    error: Array,
    slope: Array,
    tickets: _Tickets,
) -> _Mixture:
    """Posterior over all combinations in the model linearised about `step`."""
    h, target = slope[active], slope[active] @ step - error[active]
    shifted = target - tickets.shifts
    errors = problem.errors
    noise = np.diag(errors.apart[active] ** 2) + errors.shared[active] @ errors.shared[active].T
    parts = [_under(curve, h, shifted, noise, tickets) for curve in problem.curves]
    logs, steps, after, gains, along = (np.concatenate(part) for part in zip(*parts, strict=True))
    of_covariance = tickets.of_covariance
    combinations = [(curve, scatter) for curve in problem.curves for scatter, _ in _SCATTERS]
    scatters = np.array([_whole_scatter(curve, scatter) for curve, scatter in combinations])
    weight = np.exp(logs - logs.max())
    weight /= weight.sum()
    of_combination, of_slip = weight.sum(axis=1), weight.sum(axis=0)
    mean = np.einsum("cs,csi->i", weight, steps)
    apart = steps - mean
    of_group = np.stack([np.bincount(of_covariance, row, minlength=len(tickets.covariances)) for row in weight])
    covariance = np.einsum("cg,cgij->ij", of_group, after) + np.einsum("cs,csi,csj->ij", weight, apart, apart)
    return _Mixture(
        step=mean,
        covariance=covariance,
        gain=np.einsum("cg,cgij->ij", of_group, gains),
        law=float(sum(w for w, (curve, _) in zip(of_combination, combinations, strict=True) if curve.another)),
        scatter=float(np.sqrt(of_combination @ scatters**2)),
        scatters=float(sum(w for w, (_, scatter) in zip(of_combination, combinations, strict=True) if scatter > 0.0)),
        of_slip=of_slip,
        along=np.sum(weight * along, axis=0) / np.maximum(of_slip, 1e-300),
    )


def _whole_scatter(curve: ForceCurve, scatter: float) -> float:
    """Relative scatter of a load's mass beyond the stated one, including what the pattern's weights leave of another curve."""
    return float(np.hypot(scatter, _REST if curve.another else 0.0))


def _under(
    curve: ForceCurve, h: Array, shifted: Array, own: Array, tickets: _Tickets
) -> tuple[Array, Array, Array, Array, Array]:
    """Posterior of the step for one curve, each of c scatters and each of s slips, in the model shifted = h @ step + error.

    Parameters
    ----------
    curve : ForceCurve
    h : ndarray (n, 5)
        Derivatives of ln(measured / weighed mass) with respect to the step.
    shifted : ndarray (s, n)
        ln(weighed / measured mass) at the start, corrected by each slip.
    own : ndarray (n, n)
        Covariance of the loads' errors.
    tickets : _Tickets

    Returns
    -------
    ndarray (c, s)
        ln of prior times likelihood.
    ndarray (c, s, 5)
        Mean of the step.
    ndarray (c, g, 5, 5)
        Its covariance, by the tickets' covariance.
    ndarray (c, g, 5, n)
        Its derivative with respect to `shifted`, by the tickets' covariance.
    ndarray (c, s)
        Expected size of the slip's common error, in its standard deviations.
    """
    scatters = [_whole_scatter(curve, scatter) for scatter, _ in _SCATTERS]
    priors = np.array([np.log(curve.likely * probable) for _, probable in _SCATTERS])
    noise = np.stack([own + scatter**2 * np.eye(len(own)) for scatter in scatters])
    by_prior = curve.covariance @ h.T
    spread = (h @ by_prior + noise)[:, None] + tickets.covariances
    inverse, (_, log_det) = np.linalg.inv(spread), np.linalg.slogdet(spread)
    gain = by_prior @ inverse
    away = shifted - h @ curve.mean
    of_slip = tickets.of_covariance
    weighted = np.einsum("csij,sj->csi", inverse[:, of_slip], away)
    steps = curve.mean + np.einsum("csij,sj->csi", gain[:, of_slip], away)
    misfit = np.sum(away * weighted, axis=-1)
    logs = priors[:, None] + tickets.ln_priors - 0.5 * (misfit + log_det[:, of_slip])
    along = np.zeros(logs.shape)
    for place, slip in enumerate(tickets.slips):
        if slip.along.size:
            along[:, place] = [float(slip.along @ row) for row in weighted[:, place]]
    return logs, steps, curve.covariance - gain @ by_prior.T, gain, along


def _with_held(problem: LoadProblem, active: NDArray[np.bool_], held: Array, found: _Mixture) -> Array:
    """Covariance of (held..., step): errors of the held parameters change the step by the gain of each combination (Schmidt).

    found.covariance already contains the error of another combine's monitor.
    """
    count = held.shape[1]
    out = np.zeros((count + found.step.size,) * 2)
    known = problem.prior[:count, :count]
    follows = -found.gain @ held[active]
    out[:count, :count] = known
    out[count:, :count] = (follows - found.gain @ problem.ticket_slopes()[active]) @ known
    out[:count, count:] = out[count:, :count].T
    out[count:, count:] = found.covariance + follows @ known @ follows.T
    return out


def law_problem(problem: LoadProblem) -> LawProblem:
    """The same loads in the model with the effect `load_pattern`."""
    start = with_weights(problem.start)
    return LawProblem(problem.model, with_weights(problem.given), start, problem.loads, problem.settings, beside=NAMES)


def left_out(law: LawProblem, active: NDArray[np.bool_], near: Array) -> tuple[Array, Array]:
    """Each load predicted from the other active loads.

    Returns
    -------
    ndarray (n,)
        ln error; nan if there is no other active load.
    ndarray (n,)
        Its absolute value in standard deviations of the prediction.
    """
    errors, away = np.full((2, len(law.loads)), np.nan)
    for k in range(len(law.loads)):
        others = active & (np.arange(len(law.loads)) != k)
        if np.any(others):
            said = against_others(law, others, k, near)
            errors[k], away[k] = said.error, said.away
    return errors, away


@dataclass(frozen=True)
class Against:
    """A load compared with its prediction from the others.

    Attributes
    ----------
    error : float
        ln(predicted / weighed mass); nan if the others do not determine it.
    std_dev : float
        Standard deviation of `error`.
    away : float
        abs(error) / std_dev; 0 if the others do not determine it.
    """

    error: float
    std_dev: float
    away: float


def against_others(law: LawProblem, others: NDArray[np.bool_], k: int, near: Array | None = None) -> Against:
    """Load k compared with its prediction from other loads."""
    found = average(law, others, near)
    if found is None:
        return Against(float("nan"), 1.0, 0.0)
    row = np.concatenate((found.by_held[k] + law.ticket_slopes()[k], found.by_step[k]))
    errors = law.errors
    std_dev = float(np.sqrt(row @ found.covariance @ row + errors.apart[k] ** 2 + errors.moist[k] ** 2 + found.scatter**2))
    return Against(float(found.error[k]), std_dev, float(abs(found.error[k])) / std_dev)


def inliers(problem: LoadProblem, law: LawProblem) -> NDArray[np.bool_]:
    """Loads that the others do not contradict, whatever the curve. At least three loads, and more than half, are kept.

    Of several outliers the one is left out first without which the others agree best.
    """
    settings = problem.settings
    active = np.ones(len(problem.loads), dtype=bool)
    while active.sum() >= settings.outlier_least and 2 * (active.sum() - 1) > active.size:
        suspects = np.flatnonzero(active).tolist()
        try:
            found = problem.left_out(active, 2)
            worst = int(np.argmin(np.where(active, found.cost, np.inf)))
            if found.away[worst] < settings.outlier_sds:
                break
            others = active & (np.arange(active.size) != worst)
            if not problem.contradicts(problem.fit(others, 2), others, 2):
                suspects = [worst]
        except ValueError:  # The model's own curve has no flow for a force.
            pass
        said = {k: against_others(law, active & (np.arange(active.size) != k), k) for k in suspects}
        # The one least likely given the others, and not the farthest one, whose prediction may be uncertain.
        worst = max(said, key=lambda k: 0.5 * said[k].away ** 2 + np.log(said[k].std_dev))
        if said[worst].away < settings.outlier_sds:
            break
        active[worst] = False
    return active


def carrying(known: ParameterSet, law: LawProblem, covariance: Array) -> ParameterSet:
    """Extend the covariance of a set by the pattern's weights.

    Parameters
    ----------
    known : ParameterSet
        Values, and covariance of held parameters, density and gain.
    law : LoadProblem
    covariance : ndarray
        Covariance of (held..., ln density, ln gain, weights).

    Returns
    -------
    ParameterSet
    """
    count = len(law.held)
    names = known.covariance_names
    # d(known's names) / d(held..., ln density, ln gain): known from the values.
    to = np.zeros((len(names) + len(NAMES), covariance.shape[0]))
    for i, name in enumerate(names):
        if name in law.held:
            to[i, law.held.index(name)] = 1.0
        elif name == DENSITY:
            to[i, count] = known.values[name]
        else:
            to[i, count + 1] = 1.0 + known.values[name] if name == "restitution" else known.values[name]
    to[len(names) :, count + 2 :] = np.eye(len(NAMES))
    full = to @ covariance @ to.T
    full[: len(names), : len(names)] = known.covariance
    return replace(known, covariance_names=(*names, *NAMES), covariance=0.5 * (full + full.T))

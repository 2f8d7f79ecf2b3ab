"""Calibration by weighed loads.

Loads at one plate angle determine two quantities: the monitor's scale, and how it changes with the flow. Both are expressed by
density and impact gain (1 + restitution, or k1 and k2), which are fitted in their logarithms. All other parameters are held, but
their uncertainty counts in the covariance of the result (Schmidt's consider filter). A direction on which the loads have less
information than the prior is held as well.

Weighed masses take precedence over the given parameters: density and gain start with at least the standard deviations in
`LoadSettings`. Among four or more loads, one that the others contradict is named and left out; smaller deviations lose weight
(Huber).

Source: Schmidt, "Application of state-space methods to navigation problems" (1966). The fit itself: `load_fit`.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from yieldmon.estimation.closed_loop_settings import ClosedLoopSettings
from yieldmon.estimation.load_pattern import EFFECT
from yieldmon.estimation.parameters import CalibratedRange, ParameterSet
from yieldmon.estimation.self_calibration.closed_loop import fit_parameters
from yieldmon.estimation.self_calibration.closed_loop_inputs import Sweep, WeighedMass
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import Array, span

from .density_and_gain import DENSITY, gain_names, moved, widened
from .flow_curve_fit import fit_loads
from .load_fit import LoadFit, LoadProblem
from .load_inputs import LoadSettings, WeighedLoad
from .load_law import LawAverage, LawProblem, average, carrying, inliers, law_problem, left_out, placed
from .load_outcome import AnotherLaw, Contradiction, LoadCalibration, LoadResult, sentences
from .wrong_tickets import LEAST_LOADS, by_no_plate, known_slips, of_several, probabilities, without_wrong, wrong_ticket

_MODELS_OWN = 0.2
"""Largest probability of another curve with which the model's own is used."""
_MOST_STRAIN, _MOST_LEFT = 5.0, 0.3
"""Largest plausible joint deviation of density, gain and curve, in standard deviations, and largest plausible ln error of a
load."""
_CONTRADICTED = 2.0
"""rms deviation of loads left out, in standard deviations, beyond which neither another curve nor scatter explains it."""
_LOW, _HIGH = 0.025, 0.995
"""Quantiles of the weighed grain at the ends of the calibrated range; grain below the lower one is harvested at ends of
passes."""
_LEFT_OUT_WEIGHT = 0.632
_PRIOR_LOADS = 4.0
"""Weight of the stated standard deviations against the observed scatter, as a number of loads."""


def calibrate_loads(
    model: ForwardModel,
    prior: ParameterSet,
    loads: Sequence[WeighedLoad],
    *,
    sweeps: Sequence[Sweep] = (),
    settings: LoadSettings | None = None,
    sweep_settings: ClosedLoopSettings | None = None,
    in_prior: Container[str] = (),
) -> LoadCalibration:
    """Density and impact gain from weighed loads; with `sweeps` also the parameters that sweeps determine.

    Parameters
    ----------
    model : ForwardModel
        Of the machine that measured the loads, with the prior's effects.
    prior : ParameterSet
        Parameters with which the loads were measured, or the crop's shipped ones.
    loads : sequence of WeighedLoad
        One or more.
    sweeps : sequence of Sweep
        Sweeps in the same grain, fitted together with the loads that are not left out, as in `self_calibrate`.
    settings : LoadSettings, optional
    sweep_settings : ClosedLoopSettings, optional
        Default: flow as a process, model error 1 %.
    in_prior : container of str
        Names of loads that the prior was fitted to. How well it measures these is not counted as evidence for it.

    Returns
    -------
    LoadCalibration
        `refused` if loads left out of the fit are measured worse than before.

    Raises
    ------
    ValueError
        Without loads, or if a load's force exceeds that of a full paddle.
    """
    if not loads:
        raise ValueError("no weighed load to calibrate with")
    settings = LoadSettings() if settings is None else settings
    condensed = [load.condensed for load in loads]
    problem = LoadProblem(model, prior, widened(prior, settings), condensed, settings)
    law = law_problem(problem)
    every = np.ones(len(loads), dtype=bool)
    whole = average(law, every)
    active = every if of_several(whole) else inliers(problem, law)
    found = whole if np.all(active) else average(law, active)
    active, found = without_wrong(problem, law, active, found)
    if found is None or found.strain > _MOST_STRAIN:
        # Raises an error that names the masses if the model's own curve does not explain them either.
        problem.fit(active, 2)
    likely, perhaps = probabilities(int(active.sum()))
    no_plate = by_no_plate(problem, active)
    if found is not None and (found.wrong > likely or (no_plate and active.sum() < LEAST_LOADS)):
        return _with_wrong_ticket(problem, law, active, found, len(sweeps))
    if found is not None and np.max(np.abs(found.error[active])) > _MOST_LEFT:
        problem.fit(active, 2)
    if found is None or not _is_another(found, problem, active):
        if sweep_settings is None:
            sweep_settings = ClosedLoopSettings(flow="process", model_error=0.01)
        calibration = _calibration(problem, active, sweeps, sweep_settings, in_prior)
    else:
        calibration = _by_another_law(problem, law, active, found, in_prior)
    if not calibration.refused:
        given = problem.given.calibrated
        before = given if _bears_out(problem, active) else CalibratedRange()
        ranged = _with_range(problem, calibration.parameter_set, loads, active, before)
        calibration = replace(calibration, parameter_set=ranged, range_dropped=before != given)
    wrong = wrong_ticket(law, active, found) if found is not None and (no_plate or found.wrong > perhaps) else None
    calibration = replace(calibration, wrong_ticket=wrong, slips=known_slips(law, active))
    return replace(calibration, sentences=tuple(sentences(calibration, len(sweeps))))


def _with_range(
    problem: LoadProblem, known: ParameterSet, loads: Sequence[WeighedLoad], active: NDArray[np.bool_], before: CalibratedRange
) -> ParameterSet:
    """The set with its calibrated range widened to that of the weighed grain.

    before: the given set's range if the loads confirm the set, else an empty one: then the given range and model error belong to
    another machine. Seconds beyond `_LOW` and `_HIGH` are sweeps and ends of passes, on which a load's mass depends little.
    """
    every = LoadProblem(problem.model, known, known, loads, problem.settings)
    flow, windows = every.flow(known)[0], every.windows
    mass = np.where(active[windows.of_load], windows.duration_s * flow, 0.0)
    moisture = np.array([load.mean_moisture_pct for load, ok in zip(problem.loads, active, strict=True) if ok])

    def middle(value: Array, limits: tuple[float, float] | None) -> tuple[float, float]:
        order = np.argsort(value)
        share = np.cumsum(mass[order]) / mass.sum()
        low, high = (float(value[order][min(int(np.searchsorted(share, at)), value.size - 1)]) for at in (_LOW, _HIGH))
        return (low, high) if limits is None else (min(low, limits[0]), max(high, limits[1]))

    return replace(
        known,
        # Without a former range the covariance already contains the whole remaining error.
        model_error=known.model_error if before != CalibratedRange() else 0.0,
        calibrated=CalibratedRange(
            middle(flow, before.mass_flow_kg_s),
            middle(windows.plate_angle_rad, before.plate_angle_rad),
            middle(windows.elevator_speed_rad_s, before.elevator_speed_rad_s),
            before.moisture_pct if problem.model.needs_moisture or not np.all(np.isfinite(moisture)) else span(moisture),
        ),
    )


def _bears_out(problem: LoadProblem, active: NDArray[np.bool_]) -> bool:
    """Whether the given set measures the active loads within its uncertainty."""
    given = problem.given
    own = LoadProblem(problem.model, given, given, problem.loads, problem.settings)
    std_dev = np.hypot(np.hypot(own.spreads(given), own.errors.sd), given.own_error)
    error = np.log(own.mass(given) / own.weighed)
    return bool(np.all((np.abs(error) < problem.settings.outlier_sds * std_dev)[active]))


def _calibration(
    problem: LoadProblem,
    active: NDArray[np.bool_],
    sweeps: Sequence[Sweep],
    sweep_settings: ClosedLoopSettings,
    in_prior: Container[str],
) -> LoadCalibration:
    found = _fitted(problem, active)
    fit, directions, errors = found.fit, found.directions, found.left_out_error
    against = problem.contradicts(fit, active, max(directions, 1))
    shown = float(np.nan_to_num(_expected_rms(fit.error[active], errors[active]))) if against else 0.0
    posterior, next_sd, level_sd = _posterior(problem, active, found, shown)
    after = problem.weighed * np.exp(fit.error)
    together = _together(problem, fit, sweeps, active, sweep_settings) if sweeps else None
    if together is not None:
        posterior, after = together, problem.mass(together)
        errors = _left_out_together(problem, fit, sweeps, active, sweep_settings)
        next_sd, level_sd = problem.spread(posterior, active)
    judged = _judged(problem, errors, active, in_prior)
    error = np.log(after / problem.weighed)
    refused = judged.is_worse(error) and not _by_other_monitor(problem, active, directions)
    found_alone = replace(
        _outcome(problem, active, judged, posterior, after, refused=refused),
        scale_sd=level_sd,
        load_dependence=directions == 2 and not refused,
        next_load_sd=next_sd,
    )
    if together is not None:
        return replace(found_alone, sweeps_used=len(sweeps))
    return replace(found_alone, contradiction=_contradiction(problem, errors) if against or not active.all() else None)


def _by_other_monitor(problem: LoadProblem, active: NDArray[np.bool_], directions: int) -> bool:
    """Whether the errors of loads left out are explained by the error of another combine's monitor."""
    return bool(np.any(problem.errors.common) and _rms(problem.left_out(active, directions).away[active]) <= _CONTRADICTED)


@dataclass(frozen=True)
class _Judged:
    """Data for the decision whether a calibration is refused.

    Attributes
    ----------
    before : ndarray (n,)
        Masses of the loads with the given parameters, kg.
    errors : ndarray (n,)
        ln error of each load left out of the calibration.
    judges : ndarray of bool (n,)
        Loads that count in the decision.
    rms_before, rms_left_out : float
        rms of the ln errors of these loads, with the given parameters and left out.
    several : bool
        Whether more than one load is active.
    """

    before: Array
    errors: Array
    judges: NDArray[np.bool_]
    rms_before: float
    rms_left_out: float
    several: bool

    def is_worse(self, error: Array) -> bool:
        """Whether a further load is expected to be measured worse than before. error: ln error of each fitted load, (n,)."""
        return self.several and _expected_rms(error[self.judges], self.errors[self.judges]) > self.rms_before


def _judged(problem: LoadProblem, errors: Array, active: NDArray[np.bool_], in_prior: Container[str]) -> _Judged:
    """Compare the calibration with the given parameters on loads that the prior was not fitted to, or on all if there are
    none."""
    before = problem.mass(problem.given)
    unseen = active & np.array([load.name not in in_prior for load in problem.loads])
    judges = unseen if np.any(unseen) else active
    return _Judged(
        before, errors, judges, _rms(np.log(before / problem.weighed)[judges]), _rms(errors[judges]), bool(active.sum() > 1)
    )


def _outcome(
    problem: LoadProblem, active: NDArray[np.bool_], judged: _Judged, posterior: ParameterSet, after: Array, *, refused: bool
) -> LoadCalibration:
    """The calibration with the fields that every kind of fit has; the others keep neutral values.

    posterior: replaced by the given set if refused. after: masses of the loads with `posterior`, kg, (n,).
    """
    before = judged.before
    chosen, after = (problem.given, before) if refused else (posterior, after)
    moving = _moved_names(problem.given, chosen)
    return LoadCalibration(
        parameter_set=chosen,
        names=moving,
        held=tuple(n for n in chosen.values if n not in moving),
        loads=_results(problem, before, after, judged.errors, active),
        scale=float(after[active].sum() / before[active].sum()),
        scale_sd=float("nan"),
        load_dependence=False,
        next_load_sd=float("nan"),
        rms_before=judged.rms_before,
        rms_left_out=judged.rms_left_out,
        refused=refused,
        sweeps_used=0,
    )


def _results(
    problem: LoadProblem, before: Array, after: Array, errors: Array, active: NDArray[np.bool_]
) -> tuple[LoadResult, ...]:
    return tuple(
        LoadResult(load.name, load.weighed_kg, float(b), float(a), float(np.expm1(e)), not bool(ok))
        for load, b, a, e, ok in zip(problem.loads, before, after, errors, active, strict=True)
    )


def _moved_names(given: ParameterSet, chosen: ParameterSet) -> tuple[str, ...]:
    """Names of the parameters that changed; none if the calibration is refused."""
    return tuple(n for n, v in chosen.values.items() if given.values.get(n) != v)


def _is_another(found: LawAverage, problem: LoadProblem, active: NDArray[np.bool_]) -> bool:
    """Whether to fit the curve too: unless enough loads have shown that it is the model's."""
    return EFFECT in problem.given.effects or active.sum() < LEAST_LOADS or found.law > _MODELS_OWN


def _by_another_law(
    problem: LoadProblem, law: LawProblem, active: NDArray[np.bool_], found: LawAverage, in_prior: Container[str]
) -> LoadCalibration:
    """The calibration if the force may follow another curve over the flow than the model's."""
    errors, away = left_out(law, active, found.step)
    judged = _judged(problem, errors, active, in_prior)
    # A large error that another probable curve explains is no reason to refuse.
    refused = judged.is_worse(found.error) and _rms(away[judged.judges]) > _CONTRADICTED
    posterior = problem.given if refused else _as_law_set(law, active, found)
    information = problem.information(LoadFit(found.step[:2], found.error, found.by_step[:, :2]), active)
    mean = np.column_stack((found.by_held, found.by_step))[active].mean(axis=0)
    return replace(
        _outcome(problem, active, judged, posterior, problem.weighed * np.exp(found.error), refused=refused),
        scale_sd=float(np.sqrt(mean @ found.covariance @ mean)),
        load_dependence=bool(not refused and np.all(information >= problem.settings.least_information)),
        next_load_sd=_next_sd(problem, active, found),
        another_law=AnotherLaw(found.law, found.scatter, found.scatters),
    )


def _next_sd(problem: LoadProblem, active: NDArray[np.bool_], found: LawAverage) -> float:
    """Relative standard deviation of a further load like the active ones."""
    rows = np.column_stack((found.by_held, found.by_step))[active]
    spread = np.einsum("ki,ij,kj->k", rows, found.covariance, rows)
    errors = problem.errors
    return float(np.sqrt(np.mean(spread) + np.mean(errors.own[active] ** 2 + errors.moist[active] ** 2) + found.scatter**2))


def _with_wrong_ticket(
    problem: LoadProblem, law: LawProblem, active: NDArray[np.bool_], found: LawAverage, sweeps: int
) -> LoadCalibration:
    """The result if a ticket is wrong: refused, with the given parameters."""
    errors, _ = left_out(law, active, found.step)
    before = problem.mass(problem.given)
    error = np.log(before / problem.weighed)[active]
    mean = np.column_stack((found.by_held, found.by_step))[active].mean(axis=0)
    calibration = LoadCalibration(
        parameter_set=problem.given,
        names=(),
        held=tuple(problem.given.values),
        loads=_results(problem, before, before, errors, active),
        scale=1.0,
        scale_sd=float(np.sqrt(mean @ found.covariance @ mean)),
        load_dependence=False,
        next_load_sd=_next_sd(problem, active, found),
        rms_before=_rms(error),
        rms_left_out=_rms(errors[active]),
        refused=True,
        sweeps_used=0,
        wrong_ticket=wrong_ticket(law, active, found),
    )
    return replace(calibration, sentences=tuple(sentences(calibration, sweeps)))


def _as_law_set(law: LawProblem, active: NDArray[np.bool_], found: LawAverage) -> ParameterSet:
    """The set with the pattern's weights. The loads' scatter and moisture error are added to the gain's variance, since they are
    common to all seconds of a load."""
    count = len(law.held)
    covariance = found.covariance.copy()
    by_moisture = float(np.mean(law.errors.moist[active] ** 2))
    covariance[count + 1, count + 1] += (found.scatter**2 + by_moisture) / float(np.mean(found.by_step[:, 1])) ** 2
    return carrying(_as_set(law, placed(law.start, found.step), covariance[: count + 2, : count + 2]), law, covariance)


@dataclass(frozen=True)
class _Fitted:
    """A fit of loads by the model's own curve.

    Attributes
    ----------
    fit : LoadFit
    directions : int
        Number of directions along which the parameters changed.
    left_out_error : ndarray (n,)
        ln error of each load left out.
    full : LoadFit or None
        The fit along both directions, if the loads determine both but one is enough.
    """

    fit: LoadFit
    directions: int
    left_out_error: Array
    full: LoadFit | None = None


def _fitted(problem: LoadProblem, active: NDArray[np.bool_]) -> _Fitted:
    """Fit along as many directions as the active loads determine and need."""
    both = problem.fit(active, 2)
    directions = int(np.sum(problem.information(both, active) >= problem.settings.least_information))
    errors = problem.left_out(active, directions).error
    if directions == 2 and not problem.contradicts(one := problem.fit(active, 1), active, 1):
        simpler = problem.left_out(active, 1).error
        if _rms(simpler[active]) < _rms(errors[active]):
            return _Fitted(one, 1, simpler, both)
    return _Fitted(both if directions == 2 else problem.fit(active, directions), directions, errors)


def _together(
    problem: LoadProblem, near: LoadFit, sweeps: Sequence[Sweep], active: NDArray[np.bool_], settings: ClosedLoopSettings
) -> ParameterSet | None:
    """One fit of sweeps and loads that begins at the fit of the loads alone; None if it updates nothing."""
    masses = [
        WeighedMass(
            reference_kg=load.weighed_kg,
            std_dev_kg=float(sd) * load.weighed_kg,
            duration_s=load.duration_s,
            force_n=load.force_n,
            plate_angle_rad=load.plate_angle_rad,
            elevator_speed_rad_s=load.elevator_speed_rad_s,
            moisture_pct=load.moisture_pct,
            common_kg=load.common_kg,
        )
        for load, sd, ok in zip(problem.loads, problem.errors.sd, active, strict=True)
        if ok
    ]
    centre = moved(problem.start, *map(float, near.step))
    outcome = fit_parameters(problem.model, centre, sweeps, masses=masses, settings=settings)
    if not outcome.updated:
        return None
    return replace(outcome.parameter_set, version=problem.given.version + 1)


def _left_out_together(
    problem: LoadProblem, near: LoadFit, sweeps: Sequence[Sweep], active: NDArray[np.bool_], settings: ClosedLoopSettings
) -> Array:
    errors = np.full(len(problem.loads), np.nan)
    for k in range(len(problem.loads)):
        others = active & (np.arange(len(problem.loads)) != k)
        found = _together(problem, near, sweeps, others, settings) if np.any(others) else None
        if found is not None:
            errors[k] = np.log(problem.mass(found)[k] / problem.weighed[k])
    return errors


def _posterior(
    problem: LoadProblem, active: NDArray[np.bool_], found: _Fitted, shown: float
) -> tuple[ParameterSet, float, float]:
    """Parameters and uncertainty of a fit by the model's own curve.

    If the fit uses one direction although the loads determine two, the covariance is that of both, plus the distance to the full
    fit as an additional error.

    Parameters
    ----------
    problem : LoadProblem
    active : ndarray of bool (n,)
    found : _Fitted
    shown : float
        Least relative standard deviation of a further load to state: the rms of loads left out if they contradict the model's
        curve, else 0.

    Returns
    -------
    ParameterSet
    float
        Relative standard deviation of a further load.
    float
        Relative standard deviation of the active loads' mean.
    """
    fit, directions, full = found.fit, found.directions, found.full
    centre = moved(problem.start, *map(float, fit.step))
    h = np.column_stack((problem.held_slopes(centre), fit.by_step))
    rows = h[active]
    determined = directions if full is None else 2
    basis = np.zeros((h.shape[1], determined))
    basis[-2:] = problem.basis(fit.by_step, active.astype(float))[:, :determined]
    errors = problem.errors
    noise, shared, moist = errors.apart[active] ** 2, errors.shared[active], errors.moist[active]
    moving, counted = rows @ basis, active.astype(float)
    gain = basis @ moving.T @ np.linalg.inv(moving @ moving.T + np.diag(noise) + shared @ shared.T)
    tickets = rows.copy()
    tickets[:, : len(problem.held)] += problem.ticket_slopes()[active]
    left = np.eye(h.shape[1]) - gain @ tickets
    chi2 = float(fit.error @ errors.informed(fit.error[:, None], counted)[:, 0])
    dof = max(int(active.sum()) - directions, 0)
    inflation = (_PRIOR_LOADS + chi2) / (_PRIOR_LOADS + dof)
    held, by_noise = left @ problem.prior @ left.T, gain @ np.diag(noise) @ gain.T
    own = np.mean(errors.own[active] ** 2 + moist**2)
    each = [np.einsum("ki,ij,kj->k", rows, part, rows).mean() for part in (held, by_noise)]
    inflation = max(inflation, float((shown**2 - each[0]) / (each[1] + own)))
    covariance = held + inflation * by_noise + np.outer(gain @ moist, gain @ moist)
    if full is not None:
        covariance[-2:, -2:] += np.outer(full.step - fit.step, full.step - fit.step)
    spread = np.einsum("ki,ij,kj->k", rows, covariance, rows)
    next_sd = float(np.sqrt(np.mean(spread) + inflation * own))
    mean = rows.mean(axis=0)
    level_sd = float(np.sqrt(mean @ covariance @ mean))
    # For grain of any moisture among the loads, and not only of their mean.
    covariance[-1, -1] += np.mean(moist**2) / np.mean(fit.by_step[active, 1]) ** 2
    return _as_set(problem, centre, covariance), next_sd, level_sd


def _as_set(problem: LoadProblem, centre: ParameterSet, covariance: Array) -> ParameterSet:
    values, gain = centre.values, gain_names(centre)
    size = 1.0 + values["restitution"] if len(gain) == 1 else 1.0
    rows: list[Array] = list(np.eye(len(covariance))[: len(problem.held)])
    unit = np.eye(len(covariance))
    rows.append(unit[-2] * values[DENSITY])
    names: list[str] = [*problem.held, DENSITY]
    for name in gain:
        weight = size if name == "restitution" else values[name]
        if weight != 0.0:
            rows.append(unit[-1] * weight)
            names.append(name)
    # k1 and k2 change together here; a small independent variance keeps their covariance positive definite.
    own = np.zeros(len(names))
    if "k1" in names and "k2" in names:
        own[-2:] = [(1e-3 * values[n]) ** 2 for n in ("k1", "k2")]
    to = np.stack(rows)
    full = to @ covariance @ to.T + np.diag(own)
    full = 0.5 * (full + full.T)
    return replace(centre, covariance_names=tuple(names), covariance=full, version=problem.given.version + 1)


def _contradiction(problem: LoadProblem, errors: Array) -> Contradiction:
    """Leave-one-out errors of the model and of an alpha-beta curve over all loads, outliers included."""
    try:
        found = fit_loads(problem.loads, problem.model.machine.home_plate_angle_rad)
    except ValueError:
        return Contradiction(_rms(errors), float("nan"))
    return Contradiction(_rms(errors), _rms(np.array(found.left_out_error)))


def _expected_rms(fitted: Array, left_out: Array) -> float:
    """Expected rms error of a further load.

    Errors of fitted loads are too small; those of loads left out are too large, since a fit without one of few loads is poorer.
    Source: the 0.632 estimator, B. Efron, J. American Statistical Association 78 (1983) 316.
    """
    return float(np.hypot(np.sqrt(1.0 - _LEFT_OUT_WEIGHT) * _rms(fitted), np.sqrt(_LEFT_OUT_WEIGHT) * _rms(left_out)))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")

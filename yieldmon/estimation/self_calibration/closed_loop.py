"""Closed loop: joint estimation of flows and parameters from sweeps of the plate and a prior.

The scale (mass flow, density, impact gain) -> (a, a, 1/a) is exactly unobservable in a sweep. The estimate is therefore a maximum
a posteriori with the prior's full covariance, and what a sweep does not determine stays at the prior. The parameters are common
to all sweeps, and each sweep has a flow of its own. Weighed masses and a measured density are used as further measurements. The
posterior is Laplace's approximation.

Sources: thesis section 9.3 for the idea of the sweep; Gelman et al., "Bayesian Data Analysis" (normal approximation of the
posterior).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import NoneType

import numpy as np

from yieldmon.arguments import all_of_type, require_type
from yieldmon.estimation.admission import allowing_for
from yieldmon.estimation.closed_loop_settings import ClosedLoopSettings
from yieldmon.estimation.fitting.identifiability import (
    Direction,
    directions,
    flow_names,
    natural_scale,
    scale_tangent,
    share_flow,
)
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.grain import GRAIN, at_search_end
from yieldmon.physics.model import ForwardModel, refuse_impossible
from yieldmon.physics.numerics import Array

from .closed_loop_inputs import MeasuredDensity, Sweep, WeighedMass
from .closed_loop_outcome import NO_SCALE, FlowPosterior, Outcome, ParameterUpdate, ScaleReport
from .closed_loop_problem import ClosedLoopProblem, Solution
from .partial_update import determined_part
from .steady_drift import widened

_WIDENINGS = 4
_ALL = 1e-9
"""Least information of a weighed mass for an update; so small that any mass is used."""
_NARROWED = 0.995
_LARGEST_MODEL_ERROR, _HALVINGS = 0.5, 12
"""Largest relative model error tried if windows disagree with the model, and number of bisections of its range."""


def self_calibrate(
    model: ForwardModel,
    prior: ParameterSet,
    sweeps: Sequence[Sweep],
    *,
    masses: Sequence[WeighedMass] = (),
    density: MeasuredDensity | None = None,
    settings: ClosedLoopSettings | None = None,
    anchors: Sequence[WeighedMass] = (),
) -> Outcome:
    """Estimate the flows of sweeps and update the parameters.

    Parameters
    ----------
    model : ForwardModel
    prior : ParameterSet
        Parameters with a variance are updated.
    sweeps : sequence of Sweep
    masses : sequence of WeighedMass
        Weighed masses.
    density : MeasuredDensity, optional
        An independent measurement of the density.
    settings : ClosedLoopSettings, optional
    anchors : sequence of WeighedMass
        Former name of `masses`, until the next version.

    Returns
    -------
    Outcome
        `parameter_set` is the one to use from now on; `flows`, `parameters`, `scale` and `reason` give the result. The whole
        update is refused if the misfit is too large, or if sweeps alone would move a parameter to an end of the range of grain.
        Directions that the data hardly determine are not updated: see `ClosedLoopSettings.learned_information` and `kept_ratio`.
        The model error used is at least that of the prior.

    Raises
    ------
    ValueError
        If an argument is of another type, there is no measurement, the prior has no covariance, no flow can explain a sweep, an
        angle or a speed is outside its range (`Conditions`), or a weighed mass or the density is not usable.

    References
    ----------
    "Self-Calibrating Mass Flow Sensor" (Univ. of Illinois / Deere), section 9.3; Gelman et al., "Bayesian Data Analysis", on the
    normal approximation of the posterior.

    Examples
    --------
    >>> prior = api.load_parameters()
    >>> model = api.ForwardModel(api.Machine(), prior.effects)
    >>> angle, speed = np.radians(np.repeat([40.0, 60.0, 80.0], 4)), np.full(12, 400.0 * api.RPM)
    >>> force = model.force(api.Conditions(angle, speed, mass_flow_kg_s=12.0), prior.values)
    >>> found = api.self_calibrate(model, prior, [api.Sweep(np.arange(12.0), angle, speed, force, 0.01 * force)])
    >>> round(found.flows[0].mass_flow_kg_s, 1)
    12.0
    """
    require_type("model", model, ForwardModel, "a ForwardModel")
    require_type("prior", prior, ParameterSet, "a ParameterSet")
    sweeps = all_of_type("sweeps", sweeps, Sweep, "a list of Sweep, such as [sweep]")
    masses = all_of_type("masses", masses, WeighedMass, "a list of WeighedMass, such as [mass]")
    masses = (*masses, *all_of_type("anchors", anchors, WeighedMass, "a list of WeighedMass, such as [mass]"))
    require_type("density", density, (MeasuredDensity, NoneType), "a MeasuredDensity, or None")
    require_type("settings", settings, (ClosedLoopSettings, NoneType), "ClosedLoopSettings, or None")
    read = allowing_for(ClosedLoopSettings() if settings is None else settings, prior)
    found = fit_parameters(model, prior, sweeps, masses=masses, density=density, settings=read)
    if not masses and density is None and (ends := at_search_end(found.parameter_set.values, found.learned())):
        found = _not_determined(found, prior, ends)
    if found.consistent or not sweeps:
        return found
    # Paule and Mandel, J. Res. NBS 87 (1982) 377: the error that makes chi-square its degrees of freedom.
    low, high = read.model_error, max(read.model_error, _LARGEST_MODEL_ERROR)
    wrong = found
    for _ in range(_HALVINGS):
        error = 0.5 * (low + high)
        wrong = fit_parameters(model, prior, sweeps, masses=masses, density=density, settings=replace(read, model_error=error))
        low, high = (error, high) if wrong.chi2 > wrong.dof else (low, error)
    return replace(found, flows=tuple(map(_with_difference, found.flows, wrong.flows)))


def _not_determined(found: Outcome, prior: ParameterSet, ends: Sequence[str]) -> Outcome:
    """Refuse an update that ends at a limit of the search, since that value and the others then depend on the limit."""
    values = found.parameter_set.values
    at = " and ".join(f"{name} to {values[name]:.4g} {GRAIN[name].unit}".rstrip() + _range(name) for name in ends)
    return replace(
        found,
        parameter_set=prior,
        updated=False,
        reason=f"the windows would move {at}, to an end of its range, and so do not determine it; the parameters stay",
        parameters=tuple(replace(p, value=p.prior, sd=p.prior_sd, learned=False) for p in found.parameters),
        scale=replace(found.scale, posterior_sd=found.scale.prior_sd, shift=0.0),
    )


def _range(name: str) -> str:
    low, high = GRAIN[name].search
    return f" ({low:g} to {high:g})"


def _with_difference(flow: FlowPosterior, other: FlowPosterior) -> FlowPosterior:
    """A flow with the standard deviation of another estimate, widened by their difference, since either may be right."""
    difference = float(np.log(flow.mass_flow_kg_s / other.mass_flow_kg_s))
    return replace(flow, log_sd=float(np.hypot(other.log_sd, difference)))


def fit_parameters(
    model: ForwardModel,
    prior: ParameterSet,
    sweeps: Sequence[Sweep],
    *,
    masses: Sequence[WeighedMass] = (),
    density: MeasuredDensity | None = None,
    settings: ClosedLoopSettings,
) -> Outcome:
    """`self_calibrate` in one fit. The flows' standard deviations are too small if windows disagree with the model.

    Parameters
    ----------
    model, prior, sweeps, masses, density, settings
        As in `self_calibrate`.

    Returns
    -------
    Outcome

    Raises
    ------
    ValueError
        As `self_calibrate`.
    """
    for sweep in sweeps:
        refuse_impossible("sweep", sweep.plate_angle_rad, sweep.elevator_speed_rad_s)
    for mass in (*masses, *(() if density is None else (density,))):
        mass.require_usable()
    problem = ClosedLoopProblem(model, prior, sweeps, masses, density, settings)
    return _outcome(problem, problem.solve())


def update_from_tickets(
    model: ForwardModel,
    prior: ParameterSet,
    masses: Sequence[WeighedMass],
    density: MeasuredDensity | None = None,
    settings: ClosedLoopSettings | None = None,
) -> Outcome:
    """`self_calibrate` from weighed masses alone.

    If the weighed masses contradict the parameters, the parameters' standard deviations are doubled until both agree, up to 16
    times and at most to half of a parameter's physical range. A weighed mass is used however little information it adds, since
    unlike a sweep it has no systematic error that repeats.

    Parameters
    ----------
    model, prior, masses, density, settings
        As in `self_calibrate`.

    Returns
    -------
    Outcome
        `prior_widening` is the factor on the prior's covariance.

    Raises
    ------
    ValueError
        As `self_calibrate`.
    """
    widening = 1.0
    settings = replace(ClosedLoopSettings() if settings is None else settings, learned_information=_ALL, kept_ratio=1.0 - _ALL)
    outcome = fit_parameters(model, prior, (), masses=masses, density=density, settings=settings)
    for _ in range(_WIDENINGS):
        wide = replace(prior, covariance=widened(prior.covariance, prior.covariance_names, 4.0 * widening))
        if outcome.consistent or _beyond_physics(wide):
            break
        widening *= 4.0
        outcome = fit_parameters(model, wide, (), masses=masses, density=density, settings=settings)
    return replace(outcome, prior_widening=widening)


def _beyond_physics(wide: ParameterSet) -> bool:
    """Whether a standard deviation exceeds half of the range in which its parameter can lie."""
    ranges = {n: GRAIN[n].search for n in wide.covariance_names if n in GRAIN and not GRAIN[n].follows_response}
    return any(wide.standard_deviation(name) > 0.5 * (high - low) for name, (low, high) in ranges.items())


def _outcome(problem: ClosedLoopProblem, solution: Solution) -> Outcome:
    """The outcome of a solved problem."""
    from scipy.special import chdtrc  # slow to import: not needed by commands without a sweep

    settings = problem.settings
    theta, residual = solution.unknown[problem.layout.of_parameters], solution.residual
    chi2 = float(residual @ residual)
    known = problem.windows + len(problem.masses) + (problem.density is not None)
    dof = max(known - len(problem.sweeps), 1)
    p_value = float(chdtrc(dof, chi2))
    consistent = p_value >= settings.consistent_p
    information = _data_information(problem, solution.jacobian)
    mean, covariance = determined_part(problem.prior, theta, information, problem.lower, problem.upper, settings)
    updates = _parameter_updates(problem, mean, covariance, consistent)
    updated = any(p.learned for p in updates)
    parameter_set = _updated(problem, mean, covariance) if updated else problem.prior_set
    residuals = _sweep_residuals(problem, solution)
    scale = _scale(problem, solution)
    return Outcome(
        parameter_set=parameter_set,
        updated=updated,
        consistent=consistent,
        reason=_reason(
            problem, updated=updated, consistent=consistent, updates=updates, p_value=p_value, residuals=residuals, scale=scale
        ),
        region=_worst_angle(problem, residuals),
        flows=_flows(problem, solution),
        parameters=updates,
        scale=scale,
        chi2=chi2,
        dof=dof,
        p_value=p_value,
        residuals=residuals,
    )


def _parameter_updates(
    problem: ClosedLoopProblem, mean: Array, covariance: Array, consistent: bool
) -> tuple[ParameterUpdate, ...]:
    """Prior and posterior of each parameter; the posterior equals the prior if the data contradict the model."""
    prior, prior_sds = problem.prior.mean, problem.prior.standard_deviation
    sds = np.sqrt(np.diag(covariance))
    return tuple(
        ParameterUpdate(
            name,
            float(prior[i]),
            float(prior_sds[i]),
            float(mean[i] if consistent else prior[i]),
            float(sds[i] if consistent else prior_sds[i]),
            consistent and not (mean[i] == prior[i] and sds[i] == prior_sds[i]),
        )
        for i, name in enumerate(problem.names)
    )


def _updated(problem: ClosedLoopProblem, mean: Array, covariance: Array) -> ParameterSet:
    before = problem.prior_set
    return replace(
        before,
        values=dict(before.values) | {n: float(v) for n, v in zip(problem.names, mean, strict=True)},
        covariance_names=problem.names,
        covariance=covariance,
        version=before.version + 1,
    )


def _sweep_residuals(problem: ClosedLoopProblem, solution: Solution) -> tuple[Array, ...]:
    """Measured less predicted force of each sweep, N."""
    missed = problem.model_errors_n(solution.unknown)
    return tuple(
        np.asarray(missed[rows] - np.linalg.solve(whitener, solution.residual[rows]))
        for rows, whitener in zip(problem.sweep_rows, solution.whiteners, strict=True)
    )


def _data_information(problem: ClosedLoopProblem, jacobian: Array) -> Array:
    """Information of all data except the prior on the parameters, with the flows eliminated, (n, n)."""
    windows, width = problem.windows, problem.layout.parameters
    data = np.delete(jacobian, slice(windows, windows + width), axis=0)
    full = data.T @ data
    info = full[:width, :width]
    if problem.sweeps:
        cross, block = full[:width, width:], full[width:, width:]
        info = info - cross @ np.linalg.solve(block, cross.T)
    return 0.5 * (info + info.T)


def _scale(problem: ClosedLoopProblem, solution: Solution) -> ScaleReport:
    parameters = problem.layout.of_parameters
    theta, posterior = solution.unknown[parameters], solution.covariance[parameters, parameters]
    values = {n: float(v) for n, v in zip(problem.names, theta, strict=True)} | problem.fixed
    tangent = np.array([scale_tangent(n, values[n]) for n in problem.names])
    # ln a is the component of the change along the scale direction, in the metric of the prior.
    metric = problem.white.T @ problem.white
    size = float(tangent @ metric @ tangent)
    if size <= 0.0:
        return NO_SCALE
    row = tangent @ metric / size
    prior_sd = float(np.sqrt(row @ problem.prior.covariance @ row))
    posterior_sd = float(np.sqrt(row @ posterior @ row))
    shift = float(row @ (theta - problem.prior.mean))
    found = _null_directions(problem, solution.jacobian, values)
    breaks = bool(problem.masses) or problem.density is not None or not any(d.is_scale for d in found)
    return ScaleReport(prior_sd, posterior_sd, shift, breaks, found)


def _null_directions(problem: ClosedLoopProblem, jacobian: Array, values: Mapping[str, float]) -> tuple[Direction, ...]:
    """Directions of flows and parameters that the sweeps alone do not determine."""
    if not problem.sweeps:
        return ()
    count, of_windows = len(problem.sweeps), jacobian[: problem.windows]
    relative = of_windows[:, problem.layout.of_parameters] * np.array([natural_scale(n, values[n]) for n in problem.names])
    together = np.column_stack((of_windows[:, problem.layout.of_flows], relative))
    found = directions(together, flow_names(count, problem.names))
    return share_flow([d for d in found if not np.isfinite(d.relative_sd)], count, problem.names)


def _flows(problem: ClosedLoopProblem, solution: Solution) -> tuple[FlowPosterior, ...]:
    unknown, first = solution.unknown, problem.layout.of_flows.start
    out = []
    for i, rows in enumerate(problem.sweep_rows):
        level = float(unknown[first + i])
        gradient = np.zeros(unknown.size)
        gradient[first + i] = 1.0
        extra = 0.0
        if problem.settings.flow == "process":
            # The mean of the process, given the residuals. It is correlated with the level, so both are added.
            covariance = solution.flow_covariances[i]
            gain = solution.whiteners[i] @ (problem.elastic(unknown)[rows, None] * covariance)
            level -= float((gain.T @ solution.residual[rows]).mean())
            gradient -= gain.mean(axis=1) @ solution.jacobian[rows]
            extra = float((covariance - gain.T @ gain).mean())
        variance = float(gradient @ solution.covariance @ gradient) + max(extra, 0.0)
        out.append(FlowPosterior(float(np.exp(level)), float(np.sqrt(variance))))
    return tuple(out)


def _reason(
    problem: ClosedLoopProblem,
    *,
    updated: bool,
    consistent: bool,
    updates: Sequence[ParameterUpdate],
    p_value: float,
    residuals: Sequence[Array],
    scale: ScaleReport,
) -> str:
    if not consistent:
        return (
            f"the windows disagree with the model (p = {p_value:.1g}), most around {_worst_angle(problem, residuals)}; "
            "the parameters stay"
        )
    if not updated:
        return "the data add too little to what was known; the parameters stay"
    narrowed = ", ".join(f"{p.name} to {100.0 * p.ratio:.0f} %" for p in updates if p.learned and p.ratio < _NARROWED)
    if not narrowed:
        return "agrees with what was known, which it leaves about as certain"
    end = "" if scale.observable else "; the scale (flow, density, 1/impact gain) rests on the prior"
    return f"width narrowed: {narrowed}{end}"


def _worst_angle(problem: ClosedLoopProblem, residuals: Sequence[Array]) -> str:
    angle = np.degrees(np.concatenate([s.plate_angle_rad for s in problem.sweeps])) if problem.sweeps else np.zeros(0)
    if not angle.size:
        return "the weighed loads"
    error = np.concatenate(residuals) / np.concatenate([s.force_std_dev_n for s in problem.sweeps])
    sums = {a: abs(error[np.round(angle) == a].sum()) for a in np.unique(np.round(angle))}
    return f"{max(sums, key=lambda a: sums[a]):.0f} deg"

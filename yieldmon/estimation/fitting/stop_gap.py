"""A calibration for a model that does not fit: physically likely grain, and a smooth error without a named cause beside it.

Least squares alone turns the model's error into a friction of 0 or a density at the limit for grain. Such parameters fit the
table, but do not respond to moisture and wear as grain does. Here the grain has a prior, the error is the weights of the effect
`stop_gap`, and both are fitted together; the error's size is the likeliest one. It stands for causes that are not known yet,
within the calibrated angles and loads alone.

Source: Kennedy and O'Hagan, "Bayesian calibration of computer models", J. R. Stat. Soc. B 63 (2001); size by the marginal
likelihood in Laplace's approximation (MacKay, Neural Computation 4 (1992)).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from yieldmon.estimation.admission import STOP_GAP as EFFECT
from yieldmon.estimation.model_error import FLOOR, level
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.priors import Prior
from yieldmon.physics.effects import effect_parameter
from yieldmon.physics.effects.stop_gap import POWERS, weight_name
from yieldmon.physics.grain import GRAIN
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import span

from .calibration import calibrate
from .calibration_problem import CalibrationProblem
from .measurements import Measurements
from .scatter_law import LEAST_PURE_DOF

_WEIGHTS = tuple(f"{EFFECT}.{weight_name(i, j)}" for i, j in POWERS)
_BEYOND = (f"{EFFECT}.beyond_angle", f"{EFFECT}.beyond_load")
_SIZES = (0.005, 0.01, 0.02, 0.04, 0.08, 0.16, 0.32)
"""Relative standard deviations of the error that are tried."""
_SHARE_OF_STEP = 0.5
"""Of a change that matters (`GrainParameter.step`): standard deviation of grain about its typical value."""


@dataclass(frozen=True, slots=True)
class _Fit:
    parameters: ParameterSet
    log_evidence: float
    size: float


def with_stop_gap(model: ForwardModel, data: Measurements, found: ParameterSet, free: Sequence[str]) -> ParameterSet:
    """Grain and error together.

    Parameters
    ----------
    model : ForwardModel
        Of the calibration, without the effect.
    data : Measurements
        Its rows, with a sigma, or with enough repetitions to estimate their noise.
    found : ParameterSet
        What the calibration without the effect found; what is not free stays as it is there.
    free : sequence of str
        What it fitted.

    Returns
    -------
    ParameterSet
        With the effect `stop_gap`, the covariance of grain and weights together, and as `model_error` what is still missed.

    Raises
    ------
    ValueError
        Where the rows do not show their noise, lie at fewer than three loads, or a free parameter is in the reading's own unit.
    """
    if any(name in GRAIN and GRAIN[name].follows_response for name in free):
        raise ValueError(
            "a stop-gap needs a reading in N or kg m/s (of a `response`: --response-scale S) and the impact gain as 1 + e "
            "(--impact restitution): nothing is known of k1 and k2"
        )
    problem = CalibrationProblem(model, data, found.values, tuple(free), prior=None, bounds=None, robust=False)
    if not problem.given_sigma and problem.pure_dof < LEAST_PURE_DOF:
        raise ValueError(f"a stop-gap needs the rows' noise: a sigma column, or {LEAST_PURE_DOF} rows that repeat others")
    angle, speed, load, _ = data.columns()
    if data.conditions.paddle_mass_kg is None:
        load = load / model.machine.passes_per_s(speed)
    if np.unique(np.round(np.log(np.maximum(load, 1e-9)), 1)).size < 3:
        raise ValueError("a stop-gap needs three loads or more")
    # The model's floor of error is no error of the rows, but what the weights cannot follow is left to it.
    sd = np.hypot(problem.row_sd, FLOOR * level(data.momentum))
    rows = replace(data, sigma=sd)
    ends = np.degrees(span(angle)), span(load)
    names = ("lowest_angle_deg", "highest_angle_deg", "lowest_load_kg", "highest_load_kg")
    known = {f"{EFFECT}.{name}": float(value) for name, value in zip(names, np.concatenate(ends), strict=True)}
    corrected = model.with_effects((*model.effects, EFFECT))
    fits = [_fit(corrected, rows, found, tuple(free), size, known) for size in _SIZES]
    return max(fits, key=lambda fit: fit.log_evidence).parameters


def without_stop_gap(parameters: ParameterSet) -> ParameterSet:
    """The set as the named physics alone has it; its grain does not explain the calibration's table alone."""
    if EFFECT not in parameters.effects:
        return parameters
    kept = tuple(name for name in parameters.covariance_names if not name.startswith(f"{EFFECT}."))
    return replace(
        parameters,
        values={name: value for name, value in parameters.values.items() if not name.startswith(f"{EFFECT}.")},
        covariance_names=kept,
        covariance=parameters.covariance_of(kept),
    )


def sentence(parameters: ParameterSet) -> str:
    """The sentence for the user on a set with a stop-gap."""
    grain = [name for name in parameters.covariance_names if name in GRAIN]
    known = ", ".join(f"{name} {parameters.values[name]:.4g} +- {parameters.standard_deviation(name):.2g}" for name in grain)
    size = parameters.standard_deviation(_BEYOND[0])
    return (
        f"stop-gap: beside likely grain ({known}) a smooth error of the model of {100.0 * size:.2g} % over plate angle and load; "
        f"together they miss the rows by {100.0 * parameters.own_error:.2g} % beyond noise. It holds within the table's angles "
        "and loads, names no cause (yieldmon diagnose looks for one), and sweeps change nothing while it is there."
    )


def _fit(
    model: ForwardModel, data: Measurements, found: ParameterSet, free: tuple[str, ...], size: float, known: Mapping[str, float]
) -> _Fit:
    names = (*free, *_WEIGHTS)
    likely = {name: _likely(name) for name in free} | dict.fromkeys(_WEIGHTS, (0.0, size))
    prior = Prior.independent({n: likely[n][0] for n in names}, {n: likely[n][1] for n in names})
    start = dict(found.values) | {n: likely[n][0] for n in names} | dict.fromkeys(_BEYOND, 0.0) | dict(known)
    result = calibrate(model, data, start, names, prior=prior, starts=1, intervals=False, response_unit=found.response_unit)
    values = result.parameter_set.values
    sd = np.asarray(data.sigma)
    spread = prior.standard_deviation
    error = (result.predicted - data.momentum) / sd
    slopes = result.jacobian / sd[:, None] * spread
    information = slopes.T @ slopes + np.eye(len(names))
    inverse = np.linalg.inv(information)
    moved = (np.array([values[n] for n in names]) - prior.mean) / spread
    evidence = -0.5 * float(error @ error + moved @ moved) - 0.5 * float(np.linalg.slogdet(information)[1])
    covariance = np.zeros((len(names) + len(_BEYOND),) * 2)
    covariance[: len(names), : len(names)] = 0.5 * (inverse + inverse.T) * np.outer(spread, spread)
    covariance[len(names) :, len(names) :] = size**2 * np.eye(len(_BEYOND))
    relative = sd / level(result.predicted)
    leverage = np.einsum("ni,ij,nj->n", slopes, inverse, slopes)
    missed = float(np.mean(relative**2 * (error**2 - (1.0 - leverage))))
    parameters = replace(
        result.parameter_set,
        covariance_names=(*names, *_BEYOND),
        covariance=covariance,
        provenance=found.provenance,
        model_error=float(np.sqrt(FLOOR**2 + max(missed, 0.0))),
    )
    return _Fit(parameters, evidence, size)


def _likely(name: str) -> tuple[float, float]:
    """Mean and standard deviation of a parameter before any data."""
    if name in GRAIN:
        return GRAIN[name].typical, _SHARE_OF_STEP * GRAIN[name].step
    known = effect_parameter(name)
    return known.null, known.prior_sd

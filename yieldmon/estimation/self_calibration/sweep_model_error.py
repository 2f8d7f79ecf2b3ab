"""Error of the model's force at the home angle, estimated from its error at the angles of sweeps.

A sweep measures the model's error relative to that at home, since the error at home is absorbed by the flow. But an effect that
changes the force over the angle also changes it at home. Therefore the pattern of errors over the angle is compared with that of
each effect of the library, with a normal prior of its size (typical size as standard deviation), and with no missing effect. The
expected error at home is the average of what these effects change there, weighted by their probabilities. No effect is named, and
the flow at home is not corrected. Effects that change the scale more than the pattern (slip, wear, air drag) are excluded, since
a weighed mass measures those.

Away from home the error relative to home is measured, whatever its cause. If an effect is more likely missing than not, the flow
away from home is corrected by the expected error, and the remaining uncertainty is stated.

Source: Bayesian model averaging, Hoeting et al., Statistical Science 14 (1999) 382.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import frexp, ldexp

import numpy as np

from yieldmon.estimation.clusters import cluster
from yieldmon.estimation.force_deviation import SD_STEP
from yieldmon.estimation.parameters import CalibratedRange, ParameterSet
from yieldmon.physics.effects import Effect, registry
from yieldmon.physics.machine import RPM, SAME_ANGLE_RAD, Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import Array

from .angle_error import NO_ERROR, NODES_RAD, AngleError, node_shares
from .misfit import ReducedSweep
from .sweep_flow import force_n

_NONE = 0.5
"""Prior probability that no effect is missing."""
_TAKEN_OFF = 0.5
"""Probability of no missing effect below which the flow away from home is corrected."""
_LAW_ERROR = 0.1
"""Relative error of an effect's law in the library."""
_LEAST_PATTERN = 0.5
"""Ratio of an effect's rms change over the angle to its change at home below which it is excluded."""
_NOT_HIDDEN = ("angle_pattern", "load_pattern", "moisture_dependence")
"""Effects without a cause of their own, or whose cause is measured otherwise. The stop-gap is kept as an unexplained small
error."""
_MIDDLE = (400.0 * RPM, 10.0, 15.0)
"""Elevator speed, rad/s, flow, kg/s, and moisture, %, used where the calibrated range of the parameters is unknown."""
_BITS = 7
_NO_MOMENT = np.zeros((NODES_RAD.size, NODES_RAD.size))


@dataclass(frozen=True, slots=True)
class _Pattern:
    """Errors of the model at angles away from home.

    Attributes
    ----------
    plate_angle_rad : ndarray (n,)
    error : ndarray (n,)
        ln(model force / measured force) relative to home.
    covariance : ndarray (n, n)
        By noise and the parameters.
    """

    plate_angle_rad: Array
    error: Array
    covariance: Array


def unswept_error(model: ForwardModel, parameters: ParameterSet, plate_angle_rad: Sequence[float] | Array) -> AngleError:
    """Expected model error before the first sweep, with the same priors as `model_error`.

    Parameters
    ----------
    model : ForwardModel
        With the parameters' effects.
    parameters : ParameterSet
    plate_angle_rad : array_like
        Angles of the sweep. Effects that change the force too little over these angles are excluded.

    Returns
    -------
    AngleError
        In the middle of the calibrated range, with parameter values rounded within 0.8 %.
    """
    away = {angle for angle in map(float, plate_angle_rad) if abs(angle - model.machine.home_plate_angle_rad) > SAME_ANGLE_RAD}
    if not away:
        return NO_ERROR
    # Cached by rounded values: it takes 25 ms, and hardly changes over restarts, reloads, crops and weighed masses.
    values = tuple((name, _nearby(value)) for name, value in parameters.values.items())
    return _unswept_error(model.machine, model.nodes, values, parameters.calibrated, tuple(sorted(away)), *_missing(parameters))


def _nearby(value: float) -> float:
    """The value rounded to seven bits (within 0.8 %), which changes the expected error by about 1 % at most."""
    mantissa, exponent = frexp(value)
    return ldexp(round(2.0**_BITS * mantissa), exponent - _BITS)


@lru_cache(maxsize=16)
def _unswept_error(
    machine: Machine,
    nodes: int,
    values: tuple[tuple[str, float], ...],
    known: CalibratedRange,
    away_rad: tuple[float, ...],
    *missing: Effect,
) -> AngleError:
    """away_rad: angles of the sweep away from home; missing: effects that the parameters do not contain."""
    parameters = ParameterSet(dict(values), calibrated=known)
    model = ForwardModel(machine, parameters.effects, nodes=nodes)
    home_rad = model.machine.home_plate_angle_rad
    ranges = (known.elevator_speed_rad_s, known.mass_flow_kg_s, known.moisture_pct)
    at = [middle if ends is None else 0.5 * sum(ends) for ends, middle in zip(ranges, _MIDDLE, strict=True)]
    changes = _changes(model, parameters, np.array(away_rad), at)
    each = (1.0 - _NONE) / _count(parameters)
    moments = [np.outer(change.at_nodes, change.at_nodes) for change in changes]
    return AngleError.of(each / (_NONE + each * len(changes)) * sum(moments, start=_NO_MOMENT), home_rad)


def model_error(
    model: ForwardModel, parameters: ParameterSet, sweeps: Sequence[ReducedSweep], *, tolerance: float = 0.0
) -> AngleError:
    """The model's error, given sweeps.

    Parameters
    ----------
    model : ForwardModel
        With the parameters' effects.
    parameters : ParameterSet
        In use. A pattern within their covariance is not counted as an error of the model.
    sweeps : sequence of ReducedSweep
        Complete sweeps. Those without a moisture are skipped if the model needs one.
    tolerance : float
        Standard deviation of a tolerated relative error at each angle.

    Returns
    -------
    AngleError
        With the correlation between angles that each cause produces.
    """
    known = [s.measured_by(model, parameters) for s in sweeps if not model.needs_moisture or np.isfinite(s.moisture_pct)]
    pattern = _shared_pattern(model, parameters, known, tolerance)
    if pattern is None:
        return NO_ERROR
    at = [
        float(np.mean([getattr(s, name) for s in known])) for name in ("elevator_speed_rad_s", "mass_flow_kg_s", "moisture_pct")
    ]
    causes = [_cause(pattern, change) for change in _changes(model, parameters, pattern.plate_angle_rad, at)]
    weights = [np.log(_NONE) + _log_density(pattern.error, pattern.covariance)]
    weights += [np.log((1.0 - _NONE) / _count(parameters)) + cause.log_density for cause in causes]
    share = np.exp(np.array(weights) - max(weights))
    share /= share.sum()
    home_rad = model.machine.home_plate_angle_rad
    if share[0] < _TAKEN_OFF:
        return _taken_off(share, [_at_nodes(pattern, cause, home_rad) for cause in causes], home_rad)
    moment, unexplained = _NO_MOMENT, pattern.error
    for part, cause in zip(share[1:], causes, strict=True):
        moment = moment + part * cause.square * np.outer(cause.change.at_nodes, cause.change.at_nodes)
        unexplained = unexplained - part * cause.size * cause.change.pattern
    beyond = _interpolated(pattern, _beyond_noise(unexplained, pattern.covariance), home_rad)
    return AngleError.of(moment + (1.0 - share[0]) * np.outer(beyond, beyond), home_rad)


@dataclass(frozen=True, slots=True)
class _Nodes:
    """Error at the nodes given one cause, (nodes,), its covariance, and `away`, the part relative to home that sweeps measure."""

    error: Array
    covariance: Array
    away: Array


def _at_nodes(pattern: _Pattern, cause: _Cause, home_rad: float) -> _Nodes:
    at_nodes, size = cause.change.at_nodes, cause.size
    beyond = _beyond_noise(pattern.error - size * cause.change.pattern, pattern.covariance)
    noise = np.where(beyond == 0.0, 0.0, np.sqrt(np.diag(pattern.covariance)))
    seen = _interpolated(pattern, beyond, home_rad)
    against_home = size * (at_nodes - np.interp(home_rad, NODES_RAD, at_nodes))
    # 0 at home, also if it lies between two nodes, and beyond the visited angles.
    angles = np.append(pattern.plate_angle_rad, home_rad)
    within = np.abs(NODES_RAD - 0.5 * (angles.max() + angles.min())) < 0.5 * np.ptp(angles) + SAME_ANGLE_RAD
    away = np.where(within, against_home + seen, 0.0)
    first, _ = node_shares(home_rad)
    away[first : first + 2] -= np.interp(home_rad, NODES_RAD, away)
    unsure = np.abs(_LAW_ERROR * against_home) + _interpolated(pattern, noise, home_rad)
    covariance = (cause.square - size**2) * np.outer(at_nodes, at_nodes) + np.outer(unsure, unsure)
    return _Nodes(size * at_nodes + seen, covariance, away)


def _taken_off(share: Array, causes: Sequence[_Nodes], home_rad: float) -> AngleError:
    """The error after correction of the flow by the expected error away from home. share: probability of no cause, and of
    each."""
    away = np.sum([part * cause.away for part, cause in zip(share[1:], causes, strict=True)], axis=0)
    expected, moments = -share[0] * away, share[0] * np.outer(away, away)
    for part, cause in zip(share[1:], causes, strict=True):
        left = cause.error - away
        expected = expected + part * left
        moments = moments + part * (cause.covariance + np.outer(left, left))
    return AngleError.of(moments, home_rad, away, expected)


def _interpolated(pattern: _Pattern, values: Array, home_rad: float) -> Array:
    """Values at the pattern's angles, and 0 at home, interpolated at the nodes."""
    angles = np.append(pattern.plate_angle_rad, home_rad)
    order = np.argsort(angles)
    found: Array = np.interp(NODES_RAD, angles[order], np.append(values, 0.0)[order])
    return found


@dataclass(frozen=True, slots=True)
class _Change:
    """Change of ln(force) by an effect of typical size.

    Attributes
    ----------
    at_nodes : ndarray (nodes,)
    pattern : ndarray (n,)
        At the angles of the sweep, relative to home.
    one_sided : bool
        Whether the effect can have this sign only.
    """

    at_nodes: Array
    pattern: Array
    one_sided: bool


@dataclass(frozen=True, slots=True)
class _Cause:
    """Posterior of the size of a possibly missing effect.

    Attributes
    ----------
    change : _Change
    size, square : float
        Mean and mean square of the size, relative to the typical one.
    log_density : float
        ln of the likelihood of the sweeps with this effect, but for a constant.
    """

    change: _Change
    size: float
    square: float
    log_density: float


def _changes(model: ForwardModel, parameters: ParameterSet, away_rad: Array, at: Sequence[float]) -> list[_Change]:
    """Changes by the missing effects that change the force over the angle at least half as much as at home.

    away_rad: angles away from home. at: elevator speed, rad/s, flow, kg/s, and moisture, %.
    """
    count = away_rad.size
    angles = np.concatenate((away_rad, [model.machine.home_plate_angle_rad], NODES_RAD))
    without = np.log(force_n(model, parameters.values, angles, *at))
    found = []
    for effect in _missing(parameters):
        values = dict(parameters.values) | {f"{effect.name}.{p.name}": p.typical for p in effect.parameters}
        with_it = force_n(model.with_effects((*parameters.effects, effect.name)), values, angles, *at)
        with np.errstate(invalid="ignore", divide="ignore"):
            change = without - np.log(with_it)
        if not np.all(np.isfinite(change[: count + 1])):
            continue
        pattern, home = change[:count] - change[count], float(change[count])
        if _rms(pattern) < _LEAST_PATTERN * abs(home) or _rms(pattern) == 0.0:
            continue
        known = np.isfinite(change)
        order = np.argsort(angles[known])
        at_nodes = np.interp(NODES_RAD, angles[known][order], change[known][order])
        first = effect.parameters[0]
        found.append(_Change(at_nodes, pattern, first.null in (first.lower, first.upper)))
    return found


def _cause(seen: _Pattern, change: _Change) -> _Cause:
    from scipy.special import log_ndtr

    shape = change.pattern
    noise = seen.covariance + np.diag((_LAW_ERROR * shape) ** 2)
    information = float(shape @ np.linalg.solve(noise, shape)) + 1.0
    size = float(shape @ np.linalg.solve(noise, seen.error)) / information
    square = size**2 + 1.0 / information
    density = _log_density(seen.error, noise + np.outer(shape, shape))
    if not change.one_sided:
        return _Cause(change, size, square, density)
    # For an effect of one sign: the normal distribution truncated at 0.
    root = float(np.sqrt(information))
    log_share = float(log_ndtr(size * root))
    by = float(np.exp(-0.5 * (size * root) ** 2 - 0.5 * np.log(2.0 * np.pi) - log_share)) / root
    return _Cause(change, max(size + by, 0.0), max(square + size * by, 0.0), density + float(np.log(2.0)) + log_share)


def _missing(parameters: ParameterSet) -> list[Effect]:
    return [effect for name, effect in registry().items() if name not in (*parameters.effects, *_NOT_HIDDEN)]


def _count(parameters: ParameterSet) -> int:
    return len(_missing(parameters))


def _beyond_noise(values: Array, covariance: Array) -> Array:
    """Each value with its noise variance subtracted from its square."""
    return np.sign(values) * np.sqrt(np.maximum(values**2 - np.diag(covariance), 0.0))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _log_density(error: Array, covariance: Array) -> float:
    """ln of the density of a normal distribution about 0, but for a constant."""
    return float(-0.5 * (error @ np.linalg.solve(covariance, error) + np.linalg.slogdet(covariance)[1]))


def _shared_pattern(
    model: ForwardModel, parameters: ParameterSet, sweeps: Sequence[ReducedSweep], tolerance: float
) -> _Pattern | None:
    """The sweeps' mean pattern; None if they have no angle away from home."""
    parts = [part for sweep in sweeps if (part := _pattern(model, parameters, sweep)) is not None]
    if not parts:
        return None
    angle, error, sd, slopes = (np.concatenate([part[k] for part in parts]) for k in range(4))
    numbers = cluster(angle, SAME_ANGLE_RAD)
    weight = 1.0 / sd**2
    total = np.bincount(numbers, weight)

    def mean(column: Array) -> Array:
        found: Array = np.bincount(numbers, weight * column) / total
        return found

    rows = np.stack([mean(column) for column in slopes.T], axis=-1) if slopes.shape[1] else np.zeros((total.size, 0))
    covariance = np.diag(1.0 / total + tolerance**2) + rows @ parameters.covariance @ rows.T
    return _Pattern(mean(angle), mean(error), covariance)


def _pattern(model: ForwardModel, parameters: ParameterSet, sweep: ReducedSweep) -> tuple[Array, Array, Array, Array] | None:
    """Error of the model at one sweep's angles away from home; None if there are none.

    Returns
    -------
    ndarray (n,), ndarray (n,), ndarray (n,)
        Plate angle, rad; ln(model force / measured force) relative to home; its standard deviation.
    ndarray (n, p)
        Its derivatives with respect to the parameters of the covariance.
    """
    home_rad = model.machine.home_plate_angle_rad
    away = np.abs(sweep.plate_angle_rad - home_rad) > SAME_ANGLE_RAD
    angles = np.append(sweep.plate_angle_rad[away], home_rad)

    def log_force(values: dict[str, float]) -> Array:
        at = sweep.elevator_speed_rad_s, sweep.mass_flow_kg_s, sweep.moisture_pct
        with np.errstate(invalid="ignore", divide="ignore"):
            found: Array = np.log(force_n(model, values, angles, *at))
        return found

    values = dict(parameters.values)
    here = log_force(values)
    slopes = np.zeros((here.size, len(parameters.covariance_names)))
    for k, name in enumerate(parameters.covariance_names):
        step = SD_STEP * parameters.standard_deviation(name)
        if step > 0.0:
            with np.errstate(invalid="ignore"):
                slopes[:, k] = (log_force({**values, name: values[name] + step}) - here) / step
    # A sweep's flow at home is measured with the same parameters, so that the error at home is 0.
    error, sd = here[:-1] - sweep.log_force[away], sweep.sd[away]
    against_home = slopes[:-1] - slopes[-1]
    good = np.isfinite(error) & np.isfinite(sd) & (sd > 0.0) & np.all(np.isfinite(against_home), axis=1)
    if not np.any(good):
        return None
    return angles[:-1][good], error[good], sd[good], against_home[good]

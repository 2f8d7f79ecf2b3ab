"""Prior for a crop from the weighed loads of many machines, for a machine that has none yet: empirical Bayes.

Each machine's density and impact gain differ from the crop's shipped values by a vector of logarithms. The vector contains the
effects of its sensor, its plate's angle and its grain. The machines' vectors scatter about a mean vector of the crop. Both the
mean and the scatter are estimated, and the prior of the next machine includes the uncertainty of both, since that machine has not
weighed anything yet. A scatter estimated from few machines is itself uncertain: the prior's standard deviations are multiplied by
the ratio of Student's t to the normal quantile, so that two of them contain 95 %.

Loads do not determine the other parameters, such as friction, but the density and gain that fit the loads depend on them: with
more friction the same loads require a higher density. The covariance of the prior contains this correlation. A load is therefore
less uncertain than the uncertainty of friction alone would suggest, and density and gain follow when a sweep determines friction.

If another combine filled part of a machine's trucks, the error of that combine's monitor is common to these loads
(`other_monitor`) and does not average out over them. Each machine is given an independent error of this kind, because it is not
known whether several machines shared trucks with the same combine.

Sources: Laird and Ware, "Random-effects models for longitudinal data", Biometrics 38 (1982): the EM algorithm used here;
Schmidt, "Application of state-space methods to navigation problems" (1966): fixed parameters whose uncertainty still counts;
JCGM 100:2008, annex G.3: t-distribution for a standard deviation estimated from few observations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student_t

from yieldmon.estimation.open_loop import invert_force
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.closed_loop_inputs import joined
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import Array

from .density_and_gain import DENSITY, moved, shifted
from .load_inputs import LoadSettings, WeighedLoad

_STEP = 1e-3
_LINEARISED = 3
_ROUNDS = 500
_SETTLED = 1e-9
_SCATTER_SD = 0.03
"""Prior of the relative scatter of machines about the crop. It has the weight of one machine."""
_TWO_SIDED = 0.975
LEAST_MACHINES = 3


@dataclass(frozen=True)
class MachineLoads:
    """The weighed loads of one machine, and its model."""

    name: str
    model: ForwardModel
    loads: tuple[WeighedLoad, ...]


@dataclass(frozen=True)
class FleetPrior:
    """The result of `pooled`.

    Attributes
    ----------
    parameter_set : ParameterSet
        Start of a new machine. Its covariance contains `between` and `of_crop`, widened where there are few machines, and the
        correlation of density and gain with the other parameters.
    crop_shift : ndarray (2,)
        ln density and ln gain relative to the start.
    between : ndarray (2, 2)
        Covariance of the machines' shifts about `crop_shift`.
    of_crop : ndarray (2, 2)
        Covariance of `crop_shift` with the other parameters fixed.
    machines : ndarray (m, 2)
        Shift of each machine.
    """

    parameter_set: ParameterSet
    crop_shift: Array
    between: Array
    of_crop: Array
    machines: Array


def load_errors(model: ForwardModel, known: ParameterSet, loads: Sequence[WeighedLoad]) -> Array:
    """ln(measured / weighed mass) of each load with these parameters, (n,); nan if a force exceeds that of a full paddle."""
    return np.asarray(np.log(_masses_kg(model, known, loads) / np.array([load.weighed_kg for load in loads])))


def pooled(start: ParameterSet, machines: Sequence[MachineLoads]) -> FleetPrior:
    """Estimate the prior from a fleet's weighed loads.

    Parameters
    ----------
    start : ParameterSet
        The crop's shipped parameters. Their standard deviations are the prior of the crop's mean.
    machines : sequence of MachineLoads
        At least LEAST_MACHINES, each with at least one load.

    Returns
    -------
    FleetPrior

    Raises
    ------
    ValueError
        Too few machines, or a load with a force above that of a full paddle.
    """
    settings = LoadSettings()
    if len(machines) < LEAST_MACHINES:
        raise ValueError(f"{len(machines)} machines with weighed loads; expected at least {LEAST_MACHINES}")
    shift, before = np.zeros(2), np.diag([settings.density_sd**2, settings.gain_sd**2])
    for _ in range(_LINEARISED):
        here = moved(start, *shift)
        linear = [_linear(machine, here, settings, shift) for machine in machines]
        found = _fitted(linear, before)
        shift = found.mean
    wide = _few_machines(len(machines)) ** 2 * (found.between + found.of_mean)
    prior = _with_covariance(moved(start, *shift), wide, found.by_held)
    return FleetPrior(prior, shift, found.between, found.of_mean, found.own)


@dataclass(frozen=True)
class _Linear:
    """Normal equations of one machine's linear model, target = slope @ x + noise.

    Attributes
    ----------
    information : ndarray (2, 2)
        slope.T @ weight @ slope.
    vector : ndarray (2,)
        slope.T @ weight @ target.
    by_held : ndarray (2, h)
        Derivative of `vector` with respect to each held parameter.
    """

    information: Array
    vector: Array
    by_held: Array


def _linear(machine: MachineLoads, known: ParameterSet, settings: LoadSettings, at: Array) -> _Linear:
    loads = [load.condensed for load in machine.loads]
    error, slope = load_errors(machine.model, known, loads), _slopes(machine.model, known, loads)
    if not (np.all(np.isfinite(error)) and np.all(np.isfinite(slope))):
        raise ValueError(f"machine {machine.name}: a load holds more force than a full paddle gives with the crop's parameters")
    common = np.array([load.common_kg / load.weighed_kg for load in loads])
    apart = np.array([load.relative_sd**2 + load.measured_sd(settings.load_error) ** 2 for load in loads]) - common**2
    target = slope @ at - error
    # The other monitor's error is the same in all loads of which it weighed a part.
    weighted = slope.T @ np.linalg.inv(np.diag(apart) + np.outer(common, common))
    return _Linear(weighted @ slope, weighted @ target, -weighted @ _held_slopes(machine.model, known, loads))


@dataclass(frozen=True)
class _Common:
    """Estimate over m machines.

    Attributes
    ----------
    mean : ndarray (2,)
        Mean of x over machines.
    between : ndarray (2, 2)
        Covariance of x between machines.
    of_mean : ndarray (2, 2)
        Covariance of `mean`.
    own : ndarray (m, 2)
        x of each machine.
    by_held : ndarray (2, h)
        Derivative of `mean` with respect to each held parameter.
    """

    mean: Array
    between: Array
    of_mean: Array
    own: Array
    by_held: Array


def _fitted(machines: Sequence[_Linear], before: Array) -> _Common:
    """EM estimate of the common mean and scatter. before: prior covariance of the mean, (2, 2)."""
    mean, between = np.zeros(2), np.eye(2) * (2.0 * _SCATTER_SD) ** 2
    inverse_before, own = np.linalg.inv(before), np.zeros((len(machines), 2))
    of_mean = before
    for _ in range(_ROUNDS):
        inverse = np.linalg.inv(between)
        spreads = [np.linalg.inv(m.information + inverse) for m in machines]
        # Information of each machine's loads on the common mean, with the machine's own vector marginalised.
        gains = [m.information @ (np.eye(2) - s @ m.information) for m, s in zip(machines, spreads, strict=True)]
        of_mean = np.linalg.inv(sum(gains) + inverse_before)
        shares = [np.eye(2) - m.information @ s for m, s in zip(machines, spreads, strict=True)]
        new = of_mean @ np.sum([share @ m.vector for m, share in zip(machines, shares, strict=True)], axis=0)
        own = np.array([s @ (m.vector + inverse @ new) for m, s in zip(machines, spreads, strict=True)])
        scatter = np.eye(2) * _SCATTER_SD**2
        for s, x in zip(spreads, own, strict=True):
            # Propagation of the mean's error into a machine's vector.
            carried = s @ inverse - np.eye(2)
            scatter = scatter + s + np.outer(x - new, x - new) + carried @ of_mean @ carried.T
        after = scatter / (len(machines) + 1.0)
        settled = np.max(np.abs(after - between)) < _SETTLED and np.max(np.abs(new - mean)) < _SETTLED
        mean, between = new, after
        if settled:
            break
    by_held = of_mean @ np.sum([share @ m.by_held for m, share in zip(machines, shares, strict=True)], axis=0)
    return _Common(mean, between, of_mean, own, by_held)


def _masses_kg(model: ForwardModel, known: ParameterSet, loads: Sequence[WeighedLoad]) -> Array:
    """Measured mass of each load, kg, (n,). One inversion for all, since its time is mostly overhead per call."""
    duration, force, angle, speed = joined(loads)
    moisture = np.concatenate(
        [np.full(load.force_n.shape, np.nan) if load.moisture_pct is None else load.moisture_pct for load in loads]
    )
    flow, _ = invert_force(model.throw(angle[:, None], speed[:, None], known.values, moisture[:, None]), force)
    ends = np.cumsum([load.force_n.size for load in loads])[:-1]
    return np.array([np.sum(part) for part in np.split(flow * duration, ends)])


def _slopes(model: ForwardModel, known: ParameterSet, loads: Sequence[WeighedLoad]) -> Array:
    """Derivatives of ln mass with respect to ln density and ln gain, (n, 2)."""
    columns = []
    for step in ((_STEP, 0.0), (0.0, _STEP)):
        up, down = moved(known, *step), moved(known, -step[0], -step[1])
        columns.append((load_errors(model, up, loads) - load_errors(model, down, loads)) / (2.0 * _STEP))
    return np.stack(columns, axis=-1)


def _held_slopes(model: ForwardModel, known: ParameterSet, loads: Sequence[WeighedLoad]) -> Array:
    """Derivatives of ln mass with respect to each held parameter, (n, h)."""
    columns = []
    for name in _held(known):
        step = _STEP * known.standard_deviation(name)
        sets = (replace(known, values=shifted(known.values, name, sign * step)) for sign in (1.0, -1.0))
        up, down = (load_errors(model, one, loads) for one in sets)
        columns.append((up - down) / (2.0 * step))
    return np.reshape(columns, (len(columns), len(loads))).T


def _held(known: ParameterSet) -> list[str]:
    """Parameters that have a standard deviation and are not determined by loads."""
    of_loads = (DENSITY, _scales(known)[0])
    return [name for name in known.covariance_names if name not in of_loads and known.standard_deviation(name) > 0.0]


def _few_machines(machines: int) -> float:
    """Factor on standard deviations with which two of them contain 95 % when the scatter is estimated from few machines."""
    return float(student_t.ppf(_TWO_SIDED, machines - 1) / norm.ppf(_TWO_SIDED))


def _scales(known: ParameterSet) -> tuple[str, Array]:
    """Name of the gain's parameter, and d(parameter)/d(ln) of density and gain."""
    if "restitution" in known.values:
        return "restitution", np.array([known.values[DENSITY], 1.0 + known.values["restitution"]])
    return "k2", np.array([known.values[DENSITY], known.values["k2"]])


def _with_covariance(known: ParameterSet, relative: Array, by_held: Array) -> ParameterSet:
    """The set with a new covariance of density and gain, correlated with the held parameters.

    relative: covariance of ln density and ln gain with the held parameters fixed, (2, 2). by_held: their derivatives with respect
    to the held parameters, (2, h), whose own covariance stays.
    """
    gain, scale = _scales(known)
    held = _held(known)
    of_held = known.covariance_of(held)
    together = by_held @ of_held
    whole = np.block([[of_held, together.T], [together, relative + together @ by_held.T]])
    sizes = np.concatenate((np.ones(len(held)), scale))
    covariance = whole * np.outer(sizes, sizes)
    return replace(known, covariance_names=(*held, DENSITY, gain), covariance=0.5 * (covariance + covariance.T))

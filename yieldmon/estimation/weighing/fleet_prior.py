"""Prior for a crop from the weighed loads of many machines, for a machine that has none yet: empirical Bayes.

Each machine's density and impact gain differ from the crop's shipped values by a vector of its own (in their logarithms), in
which its sensor, its plate's angle and its grain are all contained; these vectors scatter about one of the crop. The crop's
vector and the scatter between machines are both estimated, and the prior of the next machine is as wide as both together: what
machines differ in stays unknown of a machine that has not weighed anything. A scatter that few machines have shown is itself
uncertain: the prior's deviations are widened by Student's t over the normal quantile, so that two of them hold 95 %.

Loads say nothing of the other parameters, as friction, but what they say of density and gain depends on these: with more friction
the same loads ask for a higher density. The covariance says so: a load is not as uncertain as friction alone would make it, and
density and gain follow when a sweep then finds friction.

Of trucks that another combine filled too a machine's loads share that one's monitor's error (`other_monitor`): however many they
are, they know the machine's scale no better than it does. It is one of each machine: that several shared trucks with the same
other one is not known.

Sources: Laird and Ware, "Random-effects models for longitudinal data", Biometrics 38 (1982): the EM algorithm used here;
Schmidt, "Application of state-space methods to navigation problems" (1966): parameters that are held and go on counting;
JCGM 100:2008, annex G.3: t-distribution for a deviation that rests on few observations.
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
"""Relative; how machines scatter about the crop before the fleet has shown it. Counts as much as one machine."""
_TWO_SIDED = 0.975
LEAST_MACHINES = 3


@dataclass(frozen=True)
class MachineLoads:
    """The weighed loads of one machine. model: of that machine."""

    name: str
    model: ForwardModel
    loads: tuple[WeighedLoad, ...]


@dataclass(frozen=True)
class FleetPrior:
    """The result of `pooled`.

    parameter_set: for a new machine to start from, as wide as between and of_crop together, and wider for few machines; density
    and gain go with the other parameters as the loads ask for.
    crop_shift (2,): ln density and ln gain over those of the start.
    between (2, 2): covariance of machines about the crop; of_crop (2, 2): covariance of crop_shift, the other parameters as they
    are. machines (m, 2): each machine's own shift.
    """

    parameter_set: ParameterSet
    crop_shift: Array
    between: Array
    of_crop: Array
    machines: Array


def load_errors(model: ForwardModel, known: ParameterSet, loads: Sequence[WeighedLoad]) -> Array:
    """ln of measured over weighed mass of each load (n,) with these parameters, nan beyond a full paddle."""
    return np.asarray(np.log(_masses_kg(model, known, loads) / np.array([load.weighed_kg for load in loads])))


def load_deviation(model: ForwardModel, known: ParameterSet, loads: Sequence[WeighedLoad]) -> Array:
    """Standard deviation (n,) of `load_errors` by all parameters that have one."""
    slopes = np.concatenate((_held_slopes(model, known, loads), _slopes(model, known, loads)), axis=-1)
    covariance = _relative_covariance(known)
    return np.asarray(np.sqrt(np.einsum("ni,ij,nj->n", slopes, covariance, slopes)))


def pooled(start: ParameterSet, machines: Sequence[MachineLoads]) -> FleetPrior:
    """The prior that a fleet's weighed loads give.

    Parameters
    ----------
    start : ParameterSet
        The crop's shipped parameters, whose deviations are the prior of the crop.
    machines : sequence of MachineLoads
        At least LEAST_MACHINES, each with a load or more.

    Returns
    -------
    FleetPrior

    Raises
    ------
    ValueError
        Too few machines, or a load that is beyond a full paddle.
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
    """target = slope @ x + noise: information (2, 2) of one machine's loads on its x, and slope.T @ weight @ target (2,), also by
    each held parameter (2, h)."""

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
    # The other monitor's error is one in all loads that it weighed a part of.
    weighted = slope.T @ np.linalg.inv(np.diag(apart) + np.outer(common, common))
    return _Linear(weighted @ slope, weighted @ target, -weighted @ _held_slopes(machine.model, known, loads))


@dataclass(frozen=True)
class _Common:
    """What m machines have in common: the mean of x (2,), its covariance between machines and that of the mean (2, 2), each
    machine's own x (m, 2), and the mean's change by each held parameter (2, h)."""

    mean: Array
    between: Array
    of_mean: Array
    own: Array
    by_held: Array


def _fitted(machines: Sequence[_Linear], before: Array) -> _Common:
    """before: covariance of the mean without the machines (2, 2)."""
    mean, between = np.zeros(2), np.eye(2) * (2.0 * _SCATTER_SD) ** 2
    inverse_before, own = np.linalg.inv(before), np.zeros((len(machines), 2))
    of_mean = before
    for _ in range(_ROUNDS):
        inverse = np.linalg.inv(between)
        spreads = [np.linalg.inv(m.information + inverse) for m in machines]
        # Of each machine's loads on the common mean, its own vector integrated out.
        gains = [m.information @ (np.eye(2) - s @ m.information) for m, s in zip(machines, spreads, strict=True)]
        of_mean = np.linalg.inv(sum(gains) + inverse_before)
        shares = [np.eye(2) - m.information @ s for m, s in zip(machines, spreads, strict=True)]
        new = of_mean @ np.sum([share @ m.vector for m, share in zip(machines, shares, strict=True)], axis=0)
        own = np.array([s @ (m.vector + inverse @ new) for m, s in zip(machines, spreads, strict=True)])
        scatter = np.eye(2) * _SCATTER_SD**2
        for s, x in zip(spreads, own, strict=True):
            # How the mean's own error carries into a machine's vector.
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
    """Measured mass of each load (n,); all in one inversion, most of whose time goes by the call."""
    duration, force, angle, speed = joined(loads)
    moisture = np.concatenate(
        [np.full(load.force_n.shape, np.nan) if load.moisture_pct is None else load.moisture_pct for load in loads]
    )
    flow, _ = invert_force(model.throw(angle[:, None], speed[:, None], known.values, moisture[:, None]), force)
    ends = np.cumsum([load.force_n.size for load in loads])[:-1]
    return np.array([np.sum(part) for part in np.split(flow * duration, ends)])


def _slopes(model: ForwardModel, known: ParameterSet, loads: Sequence[WeighedLoad]) -> Array:
    """(n, 2) of ln mass by ln density and ln gain."""
    columns = []
    for step in ((_STEP, 0.0), (0.0, _STEP)):
        up, down = moved(known, *step), moved(known, -step[0], -step[1])
        columns.append((load_errors(model, up, loads) - load_errors(model, down, loads)) / (2.0 * _STEP))
    return np.stack(columns, axis=-1)


def _held_slopes(model: ForwardModel, known: ParameterSet, loads: Sequence[WeighedLoad]) -> Array:
    """(n, h) of ln mass by each parameter beside density and gain."""
    columns = []
    for name in _held(known):
        step = _STEP * known.standard_deviation(name)
        sets = (replace(known, values=shifted(known.values, name, sign * step)) for sign in (1.0, -1.0))
        up, down = (load_errors(model, one, loads) for one in sets)
        columns.append((up - down) / (2.0 * step))
    return np.reshape(columns, (len(columns), len(loads))).T


def _held(known: ParameterSet) -> list[str]:
    """Parameters with a standard deviation that loads do not determine."""
    of_loads = (DENSITY, _scales(known)[0])
    return [name for name in known.covariance_names if name not in of_loads and known.standard_deviation(name) > 0.0]


def _few_machines(machines: int) -> float:
    """Factor on deviations by which two of them hold 95 % although the scatter was estimated from few machines."""
    return float(student_t.ppf(_TWO_SIDED, machines - 1) / norm.ppf(_TWO_SIDED))


def _scales(known: ParameterSet) -> tuple[str, Array]:
    """Name of the gain's parameter, and d(parameter)/d(ln) of density and gain."""
    if "restitution" in known.values:
        return "restitution", np.array([known.values[DENSITY], 1.0 + known.values["restitution"]])
    return "k2", np.array([known.values[DENSITY], known.values["k2"]])


def _relative_covariance(known: ParameterSet) -> Array:
    """Of the held parameters, ln density and ln gain."""
    name, scale = _scales(known)
    held = _held(known)
    sizes = np.concatenate((np.ones(len(held)), scale))
    return known.covariance_of((*held, DENSITY, name)) / np.outer(sizes, sizes)


def _with_covariance(known: ParameterSet, relative: Array, by_held: Array) -> ParameterSet:
    """The set with this covariance of ln density and ln gain beside what these change by held parameters, which keep theirs."""
    gain, scale = _scales(known)
    held = _held(known)
    of_held = known.covariance_of(held)
    together = by_held @ of_held
    whole = np.block([[of_held, together.T], [together, relative + together @ by_held.T]])
    sizes = np.concatenate((np.ones(len(held)), scale))
    covariance = whole * np.outer(sizes, sizes)
    return replace(known, covariance_names=(*held, DENSITY, gain), covariance=0.5 * (covariance + covariance.T))

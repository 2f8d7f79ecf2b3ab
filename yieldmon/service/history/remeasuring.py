"""RemeasuringJob: loads of the last days measured again with the parameters of updates after them.

A ticket in the evening also says something of the hours and days before it: a day whose one ticket is of a load at low flow
is measured better with what the next evening's says of its grain at high flow. The updates' steps, kept in the store, are taken
without those of sweeps (`estimation.self_calibration.drift_updates`) and smoothed
(`estimation.self_calibration.steady_drift.smoothed`), and each load's seconds are measured again with the parameters as the
weighed masses together have them at its time. What was measured at first stays as it is: the result is a factor for each load.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from yieldmon.engine.self_calibration.calibrator import CalibrationStep
from yieldmon.engine.self_calibration.curve_states import in_names
from yieldmon.errors import InputError
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.drift_spread import MEAN_SQUARE
from yieldmon.estimation.self_calibration.drift_updates import DriftUpdate, by_weighed_masses, ending
from yieldmon.estimation.self_calibration.steady_drift import Advance, DriftingParameters, smoothed, smoothed_covariances, updated
from yieldmon.physics.machine import Machine
from yieldmon.physics.numerics import Array
from yieldmon.service.history.load_factor import load_factor
from yieldmon.service.history.parameter_spread import parameter_spread
from yieldmon.service.history.update_steps import step_from_document
from yieldmon.service.logs.recorded import opened, parameter_sets
from yieldmon.service.logs.weighed_loads import MeasuredLoad, loads_of, of_loads
from yieldmon.service.storage.batch import Action, Step
from yieldmon.service.storage.ledger import HARDWARE, PARAMETERS, recropped, undone_versions
from yieldmon.service.storage.load_spread import ParameterSpread
from yieldmon.service.storage.rows import SecondRow
from yieldmon.service.storage.store import Store
from yieldmon.units import S_PER_DAY

SPAN_S = 72.0 * 3600.0
"""Loads that began at most so long before an update are measured again after it."""
_CONTRADICTION = 10.83
"""Squared standard deviations that an update moves the parameters by, which chance reaches once in a thousand."""
_MOST_ROWS = 270_000


@dataclass(frozen=True)
class Way:
    """A time at whose ends parameters are known, and the covariance (n, n) that it adds from one to the other."""

    begin_s: float
    end_s: float
    added: Array

    def at(self, time_s: float) -> Array:
        """What is left of it in between, where both ends are known: that of a Brownian bridge."""
        if not self.begin_s < time_s < self.end_s:
            return np.zeros_like(self.added)
        share = (time_s - self.begin_s) / (self.end_s - self.begin_s)
        return np.asarray(share * (1.0 - share) * self.added)


@dataclass(frozen=True)
class Timeline:
    """Parameters over time. times_s: (k,) bus time, rising; values: (k, n) of `names`; versions: those that were in use there.
    holds_from_s: when the newest update that contradicts the drift began; what follows does not count for the days before.
    covariances: (k, n, n) of the values. ways: what the time between two of them, or two weighed masses, may have added."""

    parameters: ParameterSet
    names: tuple[str, ...]
    times_s: Array
    values: Array
    versions: frozenset[int]
    holds_from_s: float = -np.inf
    covariances: Array | None = None
    ways: tuple[Way, ...] = ()

    def at(self, time_s: float) -> ParameterSet:
        """The parameters at a time, as the weighed masses together have them."""
        here = {name: float(np.interp(time_s, self.times_s, self.values[:, i])) for i, name in enumerate(self.names)}
        return replace(self.parameters, values={**self.parameters.values, **here})

    def covariance_at(self, time_s: float) -> Array:
        """Their covariance at a time: between two that are known it is that of both, and of the way from one to the other."""
        if self.covariances is None:
            return self.parameters.covariance
        entries = np.array(
            [np.interp(time_s, self.times_s, column) for column in self.covariances.reshape(len(self.times_s), -1).T]
        )
        return np.asarray(sum((way.at(time_s) for way in self.ways), entries.reshape(self.covariances.shape[1:])))


@dataclass(frozen=True)
class MeasuredAgain:
    """A load that was measured again. factor: its mass over that as measured. spread: what it may be off by through the
    parameters; None where their errors are no better known than as it was measured."""

    factor: float
    spread: ParameterSpread | None


def timeline(steps: Sequence[Step], parameters: ParameterSet, sets: Mapping[int, ParameterSet] | None = None) -> Timeline:
    """From the steps that led to these parameters without a break, the last one's version being theirs; others are left out.

    sets: parameters by version, of which those that say the same count as one: a change of crop keeps parameters as a further
    version.
    """
    chain: list[CalibrationStep] = []
    by_version = {step.version: step for step in steps}
    equal = _copies(parameters.version, sets or {})
    versions = set(equal)
    while True:
        version = max(equal & by_version.keys(), default=None)
        if version is None:
            break
        # Each once: versions of a store that was tampered with may lead to themselves.
        found = step_from_document(by_version.pop(version).document)
        if found is not None and found.names:
            found = in_names(found, parameters.covariance_names)
        if found is None or len(found.state) < len(parameters.covariance_names):
            break
        if chain and len(found.state) != len(chain[-1].state):
            break
        chain.append(found)
        equal = _copies(found.from_version, sets or {})
        versions |= equal
    names = parameters.covariance_names
    if not chain:
        return Timeline(parameters, (), np.zeros(1), np.zeros((1, 0)), frozenset(versions))
    chain.reverse()
    state = np.array(chain[-1].state)
    rates = tuple(names[: len(state) - len(names)])  # Only their number counts here.
    updates = by_weighed_masses(_updates(chain, parameters, rates))
    last = DriftingParameters(parameters, rates, state[len(names) :], np.zeros((state.size,) * 2))
    advances, end = [update.advance for update in updates], ending(last, updates[-1])
    known = smoothed(advances, end)
    covariances = np.array(smoothed_covariances(advances, end))
    times = np.array([*(step.begin_s for step in chain), chain[-1].end_s])
    values = np.array([[point[name] for name in names] for point in known])
    broken = [step.begin_s for step, update in zip(chain, updates, strict=True) if _contradicts(update.advance, update.state)]
    return Timeline(
        parameters,
        names,
        np.maximum.accumulate(times),
        values,
        frozenset(versions),
        max(broken, default=-np.inf),
        covariances,
        _ways(chain, advances, len(names)),
    )


def _ways(chain: Sequence[CalibrationStep], advances: Sequence[Advance], count: int) -> tuple[Way, ...]:
    """What each step's time adds, and what rates may add from one weighed mass to the next: that they are steady in between, as
    the values there take them to be, nothing has shown. count: of the parameters."""
    found, begin_s, rates, move = list[Way](), chain[0].begin_s, _rates_of(advances[0], count), np.eye(len(advances[0].before))
    for step, advance in zip(chain, advances, strict=True):
        added = advance.covariance_after - advance.transition @ advance.covariance_before @ advance.transition.T
        found.append(Way(step.begin_s, step.end_s, added[:count, :count]))
        move = advance.transition @ move
        if step.sweep_alone:
            continue
        by_rates = move[:count, count:] @ rates @ move[:count, count:].T
        found.append(Way(begin_s, step.end_s, MEAN_SQUARE * by_rates))
        begin_s, move = step.end_s, np.eye(len(move))
        rates = _rates_of(advance, count)
    return tuple(found)


def _rates_of(advance: Advance, count: int) -> Array:
    return advance.covariance_before[count:, count:]


def _copies(version: int, sets: Mapping[int, ParameterSet]) -> set[int]:
    """The versions that say what this one says, of the same crop."""
    known = sets.get(version)
    return {version} if known is None else {version, *(other for other, found in sets.items() if _is_copy(found, known))}


def _is_copy(found: ParameterSet, known: ParameterSet) -> bool:
    crops = {parameters.provenance["crop"] for parameters in (found, known) if "crop" in parameters.provenance}
    same = found.values == known.values and found.covariance_names == known.covariance_names and len(crops) < 2
    return same and np.array_equal(found.covariance, known.covariance)


def _updates(chain: Sequence[CalibrationStep], parameters: ParameterSet, rates: tuple[str, ...]) -> list[DriftUpdate]:
    """What each update made of the state: where the next step begins, and after the last the parameters in use."""
    end, names = chain[-1], parameters.covariance_names
    after = end.advance.after
    values = dict(zip(names, map(float, after), strict=False))
    covariance = end.advance.covariance_after
    prior = replace(parameters, values={**parameters.values, **values}, covariance=covariance[: len(names), : len(names)])
    known = DriftingParameters(prior, rates, after[len(names) :], covariance)
    states = [*(step.advance.before for step in chain[1:]), np.array(end.state)]
    covariances = [
        *(step.advance.covariance_before for step in chain[1:]),
        updated(known, parameters, widening=end.widening).joint,
    ]
    return [
        DriftUpdate(step.advance, state, covariance, step.widening, step.sweep_alone, len(rates), names)
        for step, state, covariance in zip(chain, states, covariances, strict=True)
    ]


def _contradicts(expected: Advance, state: Array) -> bool:
    """Whether an update moved the state further than what was expected before it allows."""
    scale = np.sqrt(np.maximum(np.diag(expected.covariance_after), 1e-300))
    moved = (state - expected.after) / scale
    inverse = np.linalg.pinv(expected.covariance_after / np.outer(scale, scale), rcond=1e-12, hermitian=True)
    return bool(moved @ inverse @ moved > _CONTRADICTION)


def factors(
    loads: Sequence[MeasuredLoad], known: Timeline, machine: Machine, of_crop: Mapping[int, bool] | None = None
) -> dict[int, float]:
    """Mass measured again over the mass as measured, by load number; as `measured_again`."""
    return {number: found.factor for number, found in measured_again(loads, known, machine, of_crop).items()}


def measured_again(
    loads: Sequence[MeasuredLoad], known: Timeline, machine: Machine, of_crop: Mapping[int, bool] | None = None
) -> dict[int, MeasuredAgain]:
    """Loads measured again, by number.

    Loads with seconds from before the timeline, or of which less than 90 % rests on a known force, are left out. of_crop: whether
    a load that was given another crop is of the timeline's; those that are count whatever parameters measured them.
    """
    renamed = {} if of_crop is None else of_crop
    out = {}
    # What no load of this machine has set the scale of may be off otherwise than by the parameters' own covariance.
    stated = known.parameters.is_weighed or known.parameters.scale_error > 0.0
    for load in loads:
        versions = {row.parameter_version for row in load.seconds}
        if not renamed.get(int(load.name), versions <= known.versions):
            continue
        moment_s = float(np.average([row.time_s for row in load.seconds], weights=[row.mass_kg for row in load.seconds]))
        there = known.at(moment_s)
        factor = load_factor(load, there, machine)
        if factor is not None:
            spread = parameter_spread(load, there, machine, known.covariance_at(moment_s)) if stated else None
            out[int(load.name)] = MeasuredAgain(factor, spread)
    return out


def of_store(
    path: Path,
    machine: Machine,
    version: int,
    open_load: int | None,
    now_s: float,
    *,
    undone_only: bool = False,
    only: int | None = None,
    crop: str = "",
) -> dict[int, MeasuredAgain]:
    """A store's loads of the last days measured again, by the parameters of `version`; what a version that was taken back has
    measured since they came is measured again with them. now_s: bus time. undone_only: nothing else is but loads that were given
    this crop. only: this load alone. crop: of the parameters, where they do not say so. Raises InputError."""
    out: dict[int, MeasuredAgain] = {}
    with opened(path) as store:
        sets = parameter_sets(store)
        if version not in sets:
            raise InputError(str(path), f"has no parameters of version {version}", "a store that is being written")
        known, loads, actions = timeline(store.steps(), sets[version], sets), store.loads(), store.actions()
        gone = _taken_back(undone_versions(actions), known, sets) | _begun_with(known, sets, actions)
        known = replace(known, versions=known.versions | gone)
        renamed, of_version = recropped(actions), sets[version].provenance.get("crop", crop)
        of_crop = {load.number: load.crop == of_version for load in loads if load.number in renamed}
        for rows in _newest_loads(store, begins(known, now_s), open_load, only):
            measured = loads_of(of_loads(rows, loads), sets)
            if undone_only:
                measured = tuple(
                    load
                    for load in measured
                    if of_crop.get(int(load.name)) or any(row.parameter_version in gone for row in load.seconds)
                )
            out |= measured_again(measured, known, machine, of_crop)
    return out


def _taken_back(undone: Collection[int], known: Timeline, sets: Mapping[int, ParameterSet]) -> frozenset[int]:
    """Versions after the timeline's first one that were taken back, of its crop where they say theirs."""
    crop, first = known.parameters.provenance.get("crop"), min(known.versions)
    later = {version: sets[version].provenance.get("crop") for version in undone if version > first and version in sets}
    return frozenset(version for version, of in later.items() if of is None or crop is None or of == crop)


def _begun_with(known: Timeline, sets: Mapping[int, ParameterSet], actions: Iterable[Action]) -> frozenset[int]:
    """Versions with which the timeline's crop began on this machine as it is, where the scale was another crop's: it may have
    changed before the crop was weighed."""
    crop = known.parameters.provenance.get("crop")
    changed = (int(a.document["version"]) for a in actions if a.kind == PARAMETERS and a.document.get("origin") == HARDWARE)
    first = max((version for version in changed if version <= known.parameters.version), default=0)
    begun = {
        version: of
        for version, of in sets.items()
        if version >= first and of.scale_error > 0.0 and of.provenance.get("crop") == crop
    }
    carried = any(of.carried_from for of in begun.values())
    unweighed = known.parameters.scale_error > 0.0 or bool(known.versions & begun.keys())
    return frozenset(begun if carried and unweighed else ())


def begins(known: Timeline, now_s: float) -> float:
    """Bus time from which on loads are measured again: three days, but one where an update since then contradicts the drift."""
    return max(now_s - SPAN_S, min(now_s - S_PER_DAY, known.holds_from_s))


def at_its_end(path: Path, load: int, version: int) -> int:
    """The version that measured the end of a load, where it followed on this one and was not taken back. Raises InputError."""
    with opened(path) as store:
        last = store.seconds_of_load(load, on_damage=_passed_over)[-1:]
        return max({version, *(row.parameter_version for row in last)} - undone_versions(store.actions()), default=version)


def _passed_over(number: int) -> None:
    """A second that is damaged is left out."""


def _newest_loads(store: Store, begin_s: float, open_load: int | None, only: int | None) -> Iterator[list[SecondRow]]:
    """Rows of each load that is whole and began in the time that counts, the newest first: days at once would fill a memory.
    only: of this one alone."""
    last, oldest, read = store.last_second(), store.oldest_second(), 0
    newest = last.load_number if last is not None else 0
    for number in range(newest, 0, -1) if only is None else (only,):
        rows = store.seconds_of_load(number, on_damage=_passed_over)
        read += len(rows)
        if read > _MOST_ROWS or (rows and rows[0].time_s < begin_s):
            return
        yield whole(rows, begin_s, open_load, oldest)


def whole(rows: Sequence[SecondRow], begin_s: float, open_load: int | None, oldest: int) -> list[SecondRow]:
    """Rows of loads that began and ended in the time that counts. oldest: number of the first second on record; a load that
    holds it has lost what came before, unless it is the first of all."""
    cut = {row.load_number for row in rows if row.time_s < begin_s or row.number == oldest > 1}
    return [row for row in rows if row.load_number not in cut and row.load_number != open_load]

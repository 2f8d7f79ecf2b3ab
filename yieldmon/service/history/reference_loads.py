"""Loads that an earlier run of the daemon measured, as the store holds them, so that a ticket for one still counts.

The run itself knows whether every second of a load was measured and keeps the forces over it; after a restart both follow from
the load's seconds.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from math import inf, nan, sqrt
from pathlib import Path

import numpy as np

from yieldmon.engine.mass.budget import MassBudget
from yieldmon.engine.mass.load_summary import LoadSummary
from yieldmon.engine.sampling.since_zero import KeptSecond
from yieldmon.engine.settings import EngineSettings
from yieldmon.estimation.estimators import estimator_of
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files import parameter_file
from yieldmon.physics.machine import RPM, Machine
from yieldmon.service.logs.recorded import opened
from yieldmon.service.logs.unmeasured import is_available, unmeasured
from yieldmon.service.storage import ledger
from yieldmon.service.storage.batch import Action, Load
from yieldmon.service.storage.load_ends import between_loads, load_of
from yieldmon.service.storage.rows import SecondRow, kept_second
from yieldmon.service.storage.store import Store

MOST_LOADS = 64
"""Loads of an earlier run that one ticket, or one start, reads from the store."""
_SAME_MASS = 1e-4
"""Relative difference of a load's mass from that of its seconds that is rounding."""


@dataclass(frozen=True)
class StoredLoad:
    """A closed load with its seconds and the parameters of each version that measured them. doubted: a part of it may rest on a
    zero that was taken against the signs of grain."""

    load: Load
    seconds: tuple[SecondRow, ...]
    parameters: Mapping[int, ParameterSet]
    doubted: bool


@dataclass(frozen=True)
class ReferenceLoad:
    """A load as the engine takes it; versions: of the parameters that measured it."""

    summary: LoadSummary
    seconds: tuple[KeptSecond, ...]
    versions: frozenset[int]


def of_new_ticket(path: Path, named: Collection[int]) -> tuple[StoredLoad, ...]:
    """The loads named, of the store at a path, as `of_store`; where one has a ticket, which a new one may replace, with those of
    all tickets that stand. Raises InputError."""
    with opened(path) as store:
        ticketed = ledger.ledger(store.tickets(), store.actions()).newest
        if ticketed.keys().isdisjoint(named):
            return of_store(store, named)
    return of_standing_tickets(path, named)


def of_standing_tickets(path: Path, named: Collection[int] = ()) -> tuple[StoredLoad, ...]:
    """The loads of the tickets that stand and those named, of the store at a path, as `of_store`. Raises InputError."""
    with opened(path) as store:
        ticketed = set(ledger.ledger(store.tickets(), store.actions()).newest)
        of_named = of_store(store, named)
        return (*of_named, *of_store(store, ticketed - {load.load.number for load in of_named}))


def of_store(store: Store, numbers: Collection[int]) -> tuple[StoredLoad, ...]:
    """The closed loads with these numbers, the newest MOST_LOADS of them at most, of which the store holds seconds."""
    wanted = set(sorted(numbers)[-MOST_LOADS:])
    loads = [load for load in store.loads() if load.number in wanted and load.ended_s is not None]
    if not loads:
        return ()
    actions = store.actions()
    documents = {v.version: v.document for v in store.parameter_versions()}
    found = []
    for load in loads:
        numbered = tuple(store.seconds_of_load(load.number))
        between = between_loads(numbered, (load,))
        seconds = [s for s in numbered if load_of(s, between) is not None]
        versions = {s.parameter_version for s in seconds if s.mass_kg > 0.0}
        if seconds and versions <= set(documents):
            sets = {v: parameter_file.from_document(documents[v], str(store.path)) for v in versions}
            found.append(StoredLoad(load, tuple(seconds), sets, _zero_doubted(seconds, actions)))
    return tuple(found)


def _zero_doubted(seconds: Sequence[SecondRow], actions: Sequence[Action]) -> bool:
    """Whether one of the seconds came after a zero against the signs of grain, and before the next zero or its undo."""
    since: int | None = None
    spans: list[tuple[int, float]] = []
    for action in actions:
        if action.kind in (ledger.ZERO, ledger.ZERO_UNDO):
            if since is not None:
                spans.append((since, action.time_s))
            since = int(action.document["second"]) if action.kind == ledger.ZERO and action.document.get("signs") else None
    if since is not None:
        spans.append((since, inf))
    return any(s.number > begun and s.time_s - s.duration_s < end_s for begun, end_s in spans for s in seconds)


def reference(stored: StoredLoad, machine: Machine, settings: EngineSettings) -> ReferenceLoad:
    """As the run that measured it knew it."""
    load, seconds, budget = stored.load, stored.seconds, _budget(stored, machine)
    summary = LoadSummary(
        number=load.number,
        start_s=seconds[0].time_s - seconds[0].duration_s if load.started_s is None else load.started_s,
        end_s=nan if load.ended_s is None else load.ended_s,
        measured_kg=load.mass_kg,
        dry_kg=load.dry_mass_kg or 0.0,
        unknown_moisture_kg=0.0 if load.dry_mass_kg is not None else load.mass_kg,
        complete=not stored.doubted and _whole(load, seconds, machine, settings),
        std_dev_kg=budget.std_dev_kg,
        budget=budget,
    )
    versions = frozenset(s.parameter_version for s in seconds if s.mass_kg > 0.0)
    return ReferenceLoad(summary, tuple(map(kept_second, seconds)), versions)


def _whole(load: Load, seconds: Sequence[SecondRow], machine: Machine, settings: EngineSettings) -> bool:
    """Whether every second was measured: none missing but in a pause, none without a flow for want of an input or contested."""
    counted_kg = sum(s.mass_kg for s in seconds)
    if not load.mass_kg > 0.0 or abs(counted_kg - load.mass_kg) > _SAME_MASS * load.mass_kg:
        return False
    if not unmeasured(seconds, machine, settings, started_s=load.started_s, ended_s=load.ended_s).none:
        return False
    counted = [s for s in seconds if s.mass_flow_kg_s is not None or (not is_available(s) and s.mass_kg > 0.0)]
    return all(s.coverage >= settings.windows.min_coverage and s.surplus_frames <= 0 for s in counted)


def _budget(stored: StoredLoad, machine: Machine) -> MassBudget:
    """Of the load's mass, by cause. Of a load that was stored without it noise is in the seconds, the parameters' share follows
    from them, and what is left of the whole (that of zero and moisture) stands under zero."""
    if stored.load.budget is not None:
        return stored.load.budget
    at_its_end_kg = next((s.load_std_dev_kg for s in reversed(stored.seconds) if s.load_std_dev_kg is not None), None)
    whole_kg = stored.load.std_dev_kg or at_its_end_kg
    counted = [s for s in stored.seconds if s.mass_kg > 0.0]
    if whole_kg is None or any(s.noise_std_dev_kg_s is None for s in counted):
        return MassBudget.unknown()
    noise_kg2 = float(sum((s.noise_std_dev_kg_s * s.duration_s) ** 2 for s in counted))
    parameters_kg = sum(
        _parameters_kg([s for s in counted if s.parameter_version == v], known, machine) for v, known in stored.parameters.items()
    )
    rest_kg2 = whole_kg**2 - noise_kg2 - parameters_kg**2
    return MassBudget(noise_kg2, parameters_kg, sqrt(max(rest_kg2, 0.0)))


def _parameters_kg(seconds: Sequence[SecondRow], known: ParameterSet, machine: Machine) -> float:
    if not seconds:
        return 0.0
    columns = np.array([
        [nan if v is None else v for v in (s.force_n, s.plate_angle_deg, s.elevator_speed_rpm, s.moisture_pct, s.duration_s)]
        for s in seconds
    ]).T  # fmt: skip
    loop = estimator_of(machine, known)
    found = loop.estimate(columns[0], np.radians(columns[1]), columns[2] * RPM, moisture_pct=columns[3])
    return float(np.nansum(found.std_dev_kg_s * columns[4]))

"""Diagnosis over the sweeps of many machines: what all show is the model's, what one shows beside the others is its own.

Machines of one geometry are brought to one gain, that of their tickets, and compared at equal force at home: see
`discrepancy.machines.fleet`.
"""

from __future__ import annotations

import json
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple, get_args

import numpy as np

from yieldmon.discrepancy.choice import Choice
from yieldmon.discrepancy.machines.fleet import LEAST_MACHINES, examine
from yieldmon.discrepancy.machines.force_change import Visible
from yieldmon.discrepancy.machines.lattice import Lattice, lay, reference_force_n, with_force
from yieldmon.discrepancy.machines.machine_comparison import Own
from yieldmon.discrepancy.policy import Policy
from yieldmon.errors import InputError, brief
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.home_flow import AwayVisits
from yieldmon.files import machine_file, parameter_file
from yieldmon.fleet.querying import Query, opened
from yieldmon.fleet.usable_seconds import usable_seconds
from yieldmon.physics.machine import ImpactSensor, Implement, Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.service.logs.sweep_table import away_of_seconds
from yieldmon.service.storage.rows import SecondRow
from yieldmon.units import counted

SharedVerdict = Literal["effect", "unknown", "none", "not compared"]
_ORDER: tuple[SharedVerdict, ...] = get_args(SharedVerdict)
"""Of several geometries the verdict is the first of these that one of them has."""
_LEAST_ANGLES = 3
"""Away from home."""
_LEAST_VISITS = 40
_SEED = 4
POLICY = Policy(starts=3)
"""With flows that follow the parameters a valley bends: each effect is also fitted from its typical size in both senses."""


@dataclass(frozen=True)
class Named:
    """An effect that a diagnosis names. equivalent: those that its data do not distinguish from it; confidence: that it is one of
    these; values: of its parameters."""

    effect: str
    equivalent: tuple[str, ...] = ()
    confidence: float = 1.0
    values: Mapping[str, float] = field(default_factory=dict)

    def may_be(self, effect: str) -> bool:
        """Whether the data allow that it is this one."""
        return effect == self.effect or effect in self.equivalent


@dataclass(frozen=True)
class MachineSweeps:
    """One machine's seconds that count for sweeps, by day, and what measured them."""

    name: str
    machine: Machine
    parameters: ParameterSet
    days: tuple[tuple[SecondRow, ...], ...]


@dataclass(frozen=True)
class MachineVerdict:
    """What one machine shows beside the others. verdict: effect, none, unknown (it differs, and too many effects would explain
    it), or why there is none."""

    name: str
    verdict: str
    named: tuple[Named, ...] = ()

    @property
    def judged(self) -> bool:
        """Whether its sweeps could be compared with others."""
        return self.verdict in ("effect", "none", "unknown")


@dataclass(frozen=True)
class FleetDiagnosis:
    """What machines share and what each has for itself.

    shared: whether the model lacks an effect for all machines; unknown: they all show something, and no effect is certain enough
    to be named; not compared: too few could be. model: those effects; candidates: what comes nearest to a name where shared is
    unknown. machines: what is each one's own, alike ones with the verdict none. visible_from: what an effect of one machine's
    own has to be to show, of the geometry with most machines.
    """

    shared: SharedVerdict
    model: tuple[Named, ...]
    candidates: tuple[Named, ...]
    machines: tuple[MachineVerdict, ...]
    visible_from: tuple[Visible, ...] = ()


Map = Callable[[Callable[["_Group"], "_Answer"], Sequence["_Group"]], Iterable["_Answer"]]
"""`map`, or that of a pool of processes."""


def diagnose(machines: Sequence[MachineSweeps], policy: Policy = POLICY, each: Map = map) -> FleetDiagnosis:
    """What the machines share and what each has for itself.

    Parameters
    ----------
    machines : sequence of MachineSweeps
        Compared are those of one geometry, at least LEAST_MACHINES of it.
    policy : Policy
        Thresholds.
    each : callable
        Works through the geometries.

    Returns
    -------
    FleetDiagnosis
        Machines in the order given; effects of the geometry with most machines first.
    """
    groups = [_Group(tuple(group), policy) for group in sorted(_alike(machines), key=len, reverse=True)]
    answers = list(each(_of_geometry, groups))
    verdicts = {verdict.name: verdict for answer in answers for verdict in answer.own}
    shared = min((answer.shared for answer in answers), key=_ORDER.index, default=_ORDER[-1])
    nearest: dict[str, Named] = {}
    for item in (item for answer in answers if answer.shared == shared for item in answer.nearest):
        nearest.setdefault(item.effect, item)
    found, none = tuple(nearest.values()), ()
    return FleetDiagnosis(
        shared,
        found if shared == "effect" else none,
        found if shared == "unknown" else none,
        tuple(verdicts[m.name] for m in machines),
        next((answer.visible_from for answer in answers if answer.visible_from), none),
    )


@dataclass(frozen=True)
class _Group:
    """Machines of one geometry."""

    machines: tuple[MachineSweeps, ...]
    policy: Policy

    def __str__(self) -> str:
        return f"sweeps of {brief(', '.join(machine.name for machine in self.machines))}"


class _Answer(NamedTuple):
    """nearest: effects that are named, or come nearest to it."""

    shared: SharedVerdict
    nearest: tuple[Named, ...]
    own: tuple[MachineVerdict, ...]
    visible_from: tuple[Visible, ...] = ()


def _of_geometry(group: _Group) -> _Answer:
    if "restitution" not in group.machines[0].parameters.values:
        own_verdicts = tuple(MachineVerdict(m.name, "parameters without restitution") for m in group.machines)
        return _Answer("not compared", (), own_verdicts)
    sweeps = {m.name: away_of_seconds(m.days, m.machine, m.parameters) for m in group.machines}
    lacks = {name: _lack(of_machine) for name, of_machine in sweeps.items()}
    usable = [m for m in group.machines if not lacks[m.name]]
    own = {m.name: MachineVerdict(m.name, lacks[m.name]) for m in group.machines}
    if len(usable) < LEAST_MACHINES:
        own |= {m.name: MachineVerdict(m.name, f"fewer than {LEAST_MACHINES} machines of its geometry") for m in usable}
        return _Answer("not compared", (), tuple(own.values()))
    found = examine(_lattice(usable, sweeps), np.random.default_rng(_SEED), group.policy)
    for name, one in found.own.items():
        own[name] = _verdict(name, one, group.policy, differs=name in found.deviating)
    return _Answer(found.shared.verdict, _nearest(found.shared), tuple(own.values()), found.visible_from)


def _alike(machines: Sequence[MachineSweeps]) -> list[list[MachineSweeps]]:
    """Machines by geometry and by what their parameters speak of."""
    groups: dict[tuple[object, ...], list[MachineSweeps]] = {}
    for m in machines:
        bare = replace(m.machine, name="", sensor=ImpactSensor(), implement=Implement())
        groups.setdefault((bare, tuple(sorted(m.parameters.values))), []).append(m)
    return list(groups.values())


def _lack(sweeps: Sequence[AwayVisits]) -> str:
    """What a machine's sweeps have too little of; "" for nothing."""
    angles = {round(float(np.degrees(angle))) for sweep in sweeps for angle in sweep.plate_angle_rad}
    visits = sum(map(len, sweeps))
    if visits >= _LEAST_VISITS and len(angles) >= _LEAST_ANGLES:
        return ""
    return f"has {visits} visits away from home at {len(angles)} angles, needs {_LEAST_VISITS} at {_LEAST_ANGLES}"


def _lattice(group: Sequence[MachineSweeps], sweeps: Mapping[str, Sequence[AwayVisits]]) -> Lattice:
    """The machines with flows by the same grain, and forces of the same gain."""
    every = [sweep for m in group for sweep in sweeps[m.name]]
    flow = float(np.median(np.concatenate([sweep.mass_flow_kg_s for sweep in every])))
    moisture = float(np.nanmedian([s.moisture_pct for s in every])) if any(np.isfinite(s.moisture_pct) for s in every) else np.nan
    machine, first = group[0].machine, group[0].parameters
    model = ForwardModel(machine, first.effects)
    shared = {name: statistics.median(m.parameters.values[name] for m in group) for name in first.values}
    common = ParameterSet(shared)
    forces = {m.name: reference_force_n(model, m.parameters, flow, moisture) for m in group}
    force = statistics.median(forces.values())
    laid = []
    for m in group:
        own = with_force(model, common, forces[m.name], flow, moisture)
        away = away_of_seconds(m.days, m.machine, own)
        scale = force / forces[m.name]
        laid.append((m.name, [replace(sweep, force_n=scale * sweep.force_n) for sweep in away]))
    return lay(machine, with_force(model, common, force, flow, moisture), flow, laid)


def _nearest(choice: Choice) -> tuple[Named, ...]:
    return tuple(
        Named(
            step.added, tuple(step.equivalent), step.confidence,
            {name: value for name, value in choice.best.values.items() if name.startswith(f"{step.law}.")},
        )
        for step in choice.steps
    )  # fmt: skip


def _verdict(name: str, own: Own, policy: Policy, *, differs: bool) -> MachineVerdict:
    if not differs or own.p_value >= policy.next_p:
        return MachineVerdict(name, "none")
    best, *others = own.explanations
    tied = tuple(e.effect for e in others if e.behind <= policy.tie)
    evidence = np.exp(-0.5 * np.array([e.behind for e in own.explanations]))
    share = float(evidence[: 1 + len(tied)].sum() / evidence.sum())
    named = Named(best.effect, tied, (1.0 - own.p_value) * share, best.values)
    return MachineVerdict(name, "effect" if 1 + len(tied) <= policy.largest_class else "unknown", (named,))


def sweeps_of(address: str) -> tuple[MachineSweeps, ...]:
    """The sweeps in a dataset, by machine, each once (`usable_seconds`). Raises InputError where too few machines have any."""
    with opened(address) as query:
        found = tuple(_machines(query))
    if len(found) < LEAST_MACHINES:
        raise InputError(address, f"has sweeps of {counted(len(found), 'machine')}", f"at least {LEAST_MACHINES}")
    return found


def _machines(query: Query) -> Iterable[MachineSweeps]:
    days: dict[str, list[tuple[SecondRow, ...]]] = {}
    for name, rows in usable_seconds(query):
        days.setdefault(name, []).append(rows)
    statement = "SELECT machine_document, parameters_document FROM provenance WHERE machine = ? ORDER BY day LIMIT 1"
    for name, found in days.items():
        [known] = query.rows(statement, (name,))
        yield MachineSweeps(
            name,
            machine_file.from_document(json.loads(known["machine_document"]), name),
            parameter_file.from_document(json.loads(known["parameters_document"]), name),
            tuple(found),
        )

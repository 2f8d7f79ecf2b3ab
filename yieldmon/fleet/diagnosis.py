"""Diagnosis over the sweeps of many machines: what many show is the model's, what one shows is the machine's.

Each machine's sweeps are diagnosed by themselves. An effect that most machines name (or hold for possible, where several cannot
be told apart) is taken into the model, and all machines are diagnosed once more with it: what is named then is their own.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from yieldmon.discrepancy import diagnosis
from yieldmon.errors import InputError
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files import machine_file, parameter_file
from yieldmon.fleet.querying import Query, opened
from yieldmon.physics.machine import Machine
from yieldmon.service import sweep_table
from yieldmon.service.rows import SecondRow

LEAST_MACHINES = 3
_SECONDS = """
SELECT * EXCLUDE (machine, day) FROM records WHERE usable_for_calibration = 1 AND machine = ? AND day = ? ORDER BY number
"""
_SHARE = 0.5
"""Of the machines with a verdict that must show an effect which is the model's."""


@dataclass(frozen=True)
class Named:
    """An effect that a diagnosis names. equivalent: those that its data cannot tell from it; values: of its parameters."""

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
    """What one machine's sweeps say. verdict: effect, none, unknown, or why there is none."""

    name: str
    verdict: str
    named: tuple[Named, ...] = ()


@dataclass(frozen=True)
class FleetDiagnosis:
    """model: effects that most machines show, with parameter values; of_machines: what is a machine's own; before: each machine
    by itself."""

    model: tuple[Named, ...]
    of_machines: tuple[MachineVerdict, ...]
    before: tuple[MachineVerdict, ...]


Ask = Callable[[Sequence[tuple[MachineSweeps, ParameterSet]]], Iterable[MachineVerdict]]
"""Diagnoses machines, each with the parameters of a model; verdicts in the same order."""


def shared_effects(verdicts: Sequence[MachineVerdict]) -> tuple[Named, ...]:
    """Effects that most machines show, the most frequent first; each with the machines' mean values.

    A machine whose diagnosis holds several effects for possible counts for each of them; among equally frequent ones that which
    is named first more often is taken.
    """
    judged = [verdict for verdict in verdicts if verdict.verdict in ("effect", "none", "unknown")]
    left = [list(verdict.named) for verdict in judged]
    found: list[Named] = []
    while True:
        possible = Counter(effect for named in left for effect in {e for item in named for e in (item.effect, *item.equivalent)})
        first = Counter(item.effect for named in left for item in named)
        enough = [e for e, count in possible.items() if count >= LEAST_MACHINES and count > _SHARE * len(judged) and first[e]]
        if not enough:
            return tuple(found)
        best = max(enough, key=lambda effect: (possible[effect], first[effect], effect))
        values = [item.values for named in left for item in named if item.effect == best]
        mean = {key: sum(each[key] for each in values) / len(values) for key in values[0]}
        confidence = possible[best] / len(judged)
        found.append(Named(best, (), confidence, mean))
        left = [[item for item in named if not item.may_be(best)] for named in left]


def diagnose(machines: Sequence[MachineSweeps], ask: Ask) -> FleetDiagnosis:
    """What the machines share and what each has for itself.

    Parameters
    ----------
    machines : sequence of MachineSweeps
        At least LEAST_MACHINES.
    ask : callable
        `verdict_of` for several machines, side by side where it pays.

    Returns
    -------
    FleetDiagnosis
    """
    before = tuple(ask([(machine, machine.parameters) for machine in machines]))
    model = shared_effects(before)
    if not model:
        return FleetDiagnosis((), tuple(verdict for verdict in before if verdict.verdict != "none"), before)
    values = {name: value for item in model for name, value in item.values.items()}
    after = ask([(machine, replace(machine.parameters, values={**machine.parameters.values, **values})) for machine in machines])
    return FleetDiagnosis(model, tuple(verdict for verdict in after if verdict.verdict != "none"), before)


def verdict_of(machine: MachineSweeps, parameters: ParameterSet) -> MachineVerdict:
    """The diagnosis of one machine's sweeps by a model that has the effects of these parameters."""
    try:
        table = sweep_table.of_seconds(machine.days, machine.name, machine.machine, parameters).table
        found = diagnosis.diagnose(table, machine.machine, parameters, diagnosis.Options(keep_effects=True))
    except InputError as error:
        return MachineVerdict(machine.name, str(error))
    steps = found.choice.steps if found.verdict == "effect" else ()
    named = tuple(
        Named(step.added, tuple(step.equivalent), step.confidence,
              {name: value for name, value in found.best.values.items() if name.startswith(f"{step.added}.")})
        for step in steps
    )  # fmt: skip
    return MachineVerdict(machine.name, found.verdict, named)


def sweeps_of(address: str) -> tuple[MachineSweeps, ...]:
    """The sweeps in a dataset, by machine. Raises InputError where too few machines have any."""
    with opened(address) as query:
        found = tuple(_machines(query))
    if len(found) < LEAST_MACHINES:
        raise InputError(address, f"has sweeps of {len(found)} machines", f"at least {LEAST_MACHINES}")
    return found


def _machines(query: Query) -> Iterable[MachineSweeps]:
    days: dict[str, list[tuple[SecondRow, ...]]] = {}
    for commit in query.commits:
        rows = query.rows(_SECONDS, (commit.machine, commit.day))
        if rows:
            days.setdefault(commit.machine, []).append(tuple(SecondRow(**row) for row in rows))
    statement = "SELECT machine_document, parameters_document FROM provenance WHERE machine = ? ORDER BY day LIMIT 1"
    for name, found in days.items():
        [known] = query.rows(statement, (name,))
        yield MachineSweeps(
            name,
            machine_file.from_document(json.loads(known["machine_document"]), name),
            parameter_file.from_document(json.loads(known["parameters_document"]), name),
            tuple(found),
        )

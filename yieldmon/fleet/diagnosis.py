"""Diagnosis over the sweeps of many machines: what many show is the model's, what one shows is the machine's.

Each machine's sweeps are diagnosed by themselves. An effect that most machines name (or hold for possible, where several cannot
be told apart) is taken into the model, and all machines are diagnosed once more with it: what is named then is their own, unless
most machines show it again. Among effects that one machine cannot tell apart, all machines' evidence together decides.
"""

from __future__ import annotations

import json
import statistics
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from yieldmon.discrepancy import diagnosis, observations
from yieldmon.discrepancy.selection import Choice, Policy, Step, merit, misfit
from yieldmon.errors import InputError
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files import machine_file, parameter_file
from yieldmon.fleet.querying import Query, opened
from yieldmon.physics.effects import family_of
from yieldmon.physics.machine import Machine
from yieldmon.service import sweep_table
from yieldmon.service.rows import SecondRow

LEAST_MACHINES = 3
_SECONDS = """
SELECT * EXCLUDE (machine, day) FROM records WHERE usable_for_calibration = 1 AND machine = ? AND day = ? ORDER BY number
"""
_SHARE = 0.5
"""Of the machines with a verdict that must show an effect which is the model's."""
_FAR = 30.0
"""-2 log evidence that counts against an effect which a machine has not fitted in the place of the one it names."""
_ROUNDS = 3
"""Diagnoses of all machines, each with what the last one found to be the model's."""


@dataclass(frozen=True)
class Explanation:
    """An effect in the place of a named one. law: by which it was fitted; values: of the law's parameters; behind: -2 log
    evidence by which it is worse than the named one."""

    law: str
    values: Mapping[str, float]
    behind: float


@dataclass(frozen=True)
class Named:
    """An effect that a diagnosis names. equivalent: those that its data cannot tell from it; values: of its parameters;
    explanations: by effect, itself and what was fitted in its place."""

    effect: str
    equivalent: tuple[str, ...] = ()
    confidence: float = 1.0
    values: Mapping[str, float] = field(default_factory=dict)
    explanations: Mapping[str, Explanation] = field(default_factory=dict)

    def may_be(self, effect: str) -> bool:
        """Whether the data allow that it is this one."""
        return effect == self.effect or effect in self.equivalent

    def behind(self, effect: str) -> float:
        """-2 log evidence by which the effect is worse than the named one."""
        if effect in self.explanations:
            return self.explanations[effect].behind
        return 0.0 if self.may_be(effect) else _FAR


@dataclass(frozen=True)
class MachineSweeps:
    """One machine's seconds that count for sweeps, by day, and what measured them."""

    name: str
    machine: Machine
    parameters: ParameterSet
    days: tuple[tuple[SecondRow, ...], ...]


@dataclass(frozen=True)
class MachineVerdict:
    """What one machine's sweeps say. verdict: effect, none, unknown, or why there is none; partial: effects of an unknown one
    that help and are no name by this machine alone."""

    name: str
    verdict: str
    named: tuple[Named, ...] = ()
    partial: tuple[Named, ...] = ()


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
    """Effects that most machines show, the most frequent first; each with the machines' median values.

    A machine whose diagnosis holds several effects for possible counts for each of them, also where they are too many for a name
    by itself; but LEAST_MACHINES must name the effect or one tied with it. Among those that most machines may have, that is taken
    for which the evidence of all machines together is best.
    """
    judged = [verdict for verdict in verdicts if verdict.verdict in ("effect", "none", "unknown")]
    named_by = Counter(effect for v in judged for effect in {e for item in v.named for e in (item.effect, *item.equivalent)})
    left = [list(verdict.named or verdict.partial) for verdict in judged]
    found: list[Named] = []
    while True:
        possible = Counter(effect for named in left for effect in {e for item in named for e in (item.effect, *item.equivalent)})
        first = Counter(item.effect for named in left for item in named)
        enough = [e for e, n in possible.items() if named_by[e] >= LEAST_MACHINES and n > _SHARE * len(judged) and first[e]]
        if not enough:
            return tuple(found)
        behind = {e: sum(min(item.behind(e) for item in named) for named in left if named) for e in enough}
        best = min(enough, key=lambda effect: (behind[effect], -possible[effect], -first[effect], effect))
        showing = [item for named in left for item in named if item.may_be(best)]
        found.append(Named(best, (), possible[best] / len(judged), _common_values(best, showing)))
        left = [[item for item in named if not item.may_be(best)] for named in left]


def _common_values(effect: str, showing: Sequence[Named]) -> dict[str, float]:
    """The median values of an effect's parameters, by the law that most machines fitted."""
    fitted = [item.explanations[effect] for item in showing if effect in item.explanations]
    if not fitted:
        values = [item.values for item in showing if item.effect == effect]
    else:
        law = Counter(item.law for item in fitted).most_common(1)[0][0]
        values = [item.values for item in fitted if item.law == law]
    return {key: statistics.median(each[key] for each in values) for key in values[0]}


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
    before = after = tuple(ask([(machine, machine.parameters) for machine in machines]))
    model: tuple[Named, ...] = ()
    for _ in range(_ROUNDS - 1):
        more = tuple(item for item in shared_effects(after) if item.effect not in {known.effect for known in model})
        if not more:
            break
        model += more
        values = {name: value for item in model for name, value in item.values.items()}
        with_model = [replace(machine.parameters, values={**machine.parameters.values, **values}) for machine in machines]
        after = tuple(ask(list(zip(machines, with_model, strict=True))))
    return FleetDiagnosis(model, tuple(verdict for verdict in after if verdict.verdict != "none"), before)


def verdict_of(machine: MachineSweeps, parameters: ParameterSet) -> MachineVerdict:
    """The diagnosis of one machine's sweeps by a model that has the effects of these parameters."""
    try:
        table = sweep_table.of_seconds(machine.days, machine.name, machine.machine, parameters).table
        options = diagnosis.Options(keep_effects=True)
        rows = observations.from_table(table, machine.machine)
        choice = diagnosis.examine(rows, parameters, options, name=machine.name).choice
    except InputError as error:
        return MachineVerdict(machine.name, str(error))
    steps = tuple(_named(step, choice, options.policy) for step in choice.steps)
    if choice.verdict == "effect":
        return MachineVerdict(machine.name, choice.verdict, steps)
    return MachineVerdict(machine.name, choice.verdict, (), steps if choice.verdict == "unknown" else ())


def _named(step: Step, choice: Choice, policy: Policy) -> Named:
    usable = [c for c in step.candidates if not c.refused and family_of(c.effect) != step.added]
    scale = misfit([choice.best, *(c.fit for c in usable)])
    here = merit(choice.best, scale, policy)
    fitted = [(step.law, choice.best), *((c.effect, c.fit) for c in usable)]
    explanations = {
        family_of(law): Explanation(law, _values(law, fit.values), merit(fit, scale, policy) - here) for law, fit in fitted
    }
    return Named(step.added, tuple(step.equivalent), step.confidence, explanations[step.added].values, explanations)


def _values(law: str, values: Mapping[str, float]) -> dict[str, float]:
    return {name: value for name, value in values.items() if name.startswith(f"{law}.")}


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

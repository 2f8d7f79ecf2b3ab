"""What the monitor did, collected into batches for the store; and from the store what a monitor goes on from."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from dataclasses import field as dataclass_field
from typing import Any

from yieldmon.engine.health import FaultEvent
from yieldmon.engine.learning import ParametersChanged
from yieldmon.engine.loads import LoadClosed, LoadOpened, LoadSummary
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.plate import SweepEnded
from yieldmon.engine.records import CalibrationStep, WindowRecord
from yieldmon.engine.results import Event, Result, WindowResult
from yieldmon.engine.since_zero import KEPT_S
from yieldmon.engine.state import EngineState
from yieldmon.errors import InputError
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files import parameter_file
from yieldmon.files.crops import crops
from yieldmon.finite import finite
from yieldmon.service import batch as rows_of
from yieldmon.service import ledger as ledgers
from yieldmon.service.batch import Action, Batch, Load, ParameterVersion, Step, SweepRecord, Ticket
from yieldmon.service.reference_loads import StoredLoad, of_store
from yieldmon.service.rows import SecondRow, second_row
from yieldmon.service.store import Store
from yieldmon.service.store_errors import StoreDamagedError
from yieldmon.service.update_steps import step_document

_log = logging.getLogger(__name__)

_UNKNOWN_MOISTURE_KG = 1e-6
_UNKNOWN_AREA_SHARE = 0.02
"""Share of a load's mass without a known area above which the load's area counts as not known."""
_KEPT_VERSIONS = 200
"""Newest parameter versions that an undo can go back to."""
_SHIPPED_CROP = "corn"
"""Of the shipped parameter file."""


def digest(parameters: ParameterSet) -> str:
    """Tells one parameter file's content from another's."""
    text = json.dumps(parameter_file.to_document(parameters), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True)
class Memory:
    """What a store remembers. engine and parameters are None in a new store; parameters are those last in use, and
    parameter_digest is of the file that they began with."""

    engine: EngineState | None = None
    saved_s: float = 0.0
    parameters: ParameterSet | None = None
    parameter_origin: str = "file"
    parameter_digest: str = ""
    last_batch: int = 0
    last_second: int = 0
    last_version: int = 0
    loads: tuple[Load, ...] = ()
    tickets: tuple[Ticket, ...] = ()
    field: str = ""
    crop: str = ""
    kernel_weight_g: float | None = None
    """Of a thousand kernels, as an operator told it."""
    faults: tuple[str, ...] = ()
    counters: Mapping[str, int] | None = None
    of_crop: Mapping[str, ParameterSet] = dataclass_field(default_factory=dict)
    """The newest parameters of each crop."""
    versions: Mapping[int, ParameterSet] = dataclass_field(default_factory=dict)
    """The newest parameter versions."""
    actions: tuple[Action, ...] = ()
    since_zero: tuple[SecondRow, ...] = ()
    """Seconds since the operator's last zero calibration, where that can be undone."""
    ticketed: tuple[StoredLoad, ...] = ()
    """Loads of the newest tickets."""


def recall(store: Store) -> Memory:
    """What the store remembers. Raises StoreDamagedError when it makes no sense."""
    document = store.state()
    if document is None:
        return Memory()
    versions = store.parameter_versions()
    last_second = store.last_second()
    try:
        engine, actions = EngineState.from_dict(document["engine"]), tuple(store.actions())
        return Memory(
            engine=engine,
            saved_s=float(document["saved_s"]),
            parameters=parameter_file.from_document(versions[-1].document, str(store.path)),
            parameter_origin=versions[-1].origin,
            parameter_digest=str(document["parameter_digest"]),
            last_batch=store.last_batch(),
            last_second=max(int(document["last_second"]), last_second.number if last_second is not None else 0),
            last_version=versions[-1].version,
            loads=tuple(store.loads()),
            tickets=tuple(store.tickets()),
            field=str(document["field"]),
            crop=str(document["crop"]),
            kernel_weight_g=None if document.get("kernel_weight_g") is None else float(document["kernel_weight_g"]),
            faults=tuple(document["faults"]),
            counters=store.counters(),
            of_crop=_by_crop(versions, str(store.path)),
            versions={v.version: parameter_file.from_document(v.document, str(store.path)) for v in versions[-_KEPT_VERSIONS:]},
            actions=actions,
            since_zero=_since_zero(store, actions) if engine.zero_undo is not None else (),
            ticketed=_ticketed(store, engine),
        )
    except (KeyError, IndexError, TypeError, ValueError, InputError) as error:
        raise StoreDamagedError(f"{store.path}: the state cannot be used: {error!r}") from error


def _since_zero(store: Store, actions: Sequence[Action]) -> tuple[SecondRow, ...]:
    last = next((a for a in reversed(actions) if a.kind == ledgers.ZERO), None)
    if last is None:
        return ()
    newest = store.last_second()
    first = max(int(last.document["second"]) + 1, (newest.number if newest is not None else 0) - KEPT_S)
    return tuple(store.seconds(first, on_damage=lambda number: None))


def _ticketed(store: Store, engine: EngineState) -> tuple[StoredLoad, ...]:
    """Empty where the seconds are damaged: the tickets' corrections stand, and a start must not wait for repairs."""
    try:
        return of_store(store, {ticket.load_number for ticket in engine.tickets})
    except StoreDamagedError as error:
        _log.warning("loads with tickets are not read again: %s", error)
        return ()


def choose_parameters(memory: Memory, configured: ParameterSet) -> tuple[ParameterSet, str]:
    """The parameters to run with, and where they come from.

    What was learnt since goes on for as long as the configured file is the one it began with; another file wins.
    """
    if memory.parameters is not None and memory.parameter_digest == digest(configured):
        return memory.parameters, "store"
    if memory.last_version:
        return replace(configured, version=memory.last_version + 1), "file"
    return configured, "file"


def _by_crop(versions: Iterable[ParameterVersion], where: str) -> dict[str, ParameterSet]:
    found = {}
    for version in versions:
        known = parameter_file.from_document(version.document, where)
        if "crop" in known.provenance:
            found[known.provenance["crop"]] = known
    return found


class Journal:
    """Numbers batches and seconds, and collects what the monitor hands back until the next batch."""

    def __init__(self, memory: Memory, configured: ParameterSet, field: str = "", crop: str = "", *, now_s: float) -> None:
        """memory: what the store holds. configured: the parameters as their file has them. now_s: Unix time."""
        self.field = memory.field or field
        self.crop = memory.crop or crop
        self.kernel_weight_g = memory.kernel_weight_g
        self._digest = digest(configured)
        self._shipped_digest = digest(parameter_file.load())
        self._batch = memory.last_batch
        self._second = memory.last_second
        self._version = memory.last_version
        self._loads = {load.number: load for load in memory.loads}
        self._faults = set(memory.faults)
        self._faults_known = False
        """Whether the monitor has said which of the faults that the store shows it shows as well."""
        self._counters_before = dict(memory.counters or {})
        self._all_tickets = list(memory.tickets)
        self._in_use: tuple[ParameterSet, str] | None = None
        if memory.parameters is not None:
            self._in_use = (memory.parameters, memory.parameter_origin)
        self._pending = _Pending()
        self._of_crop = dict(memory.of_crop)
        self._versions = dict(memory.versions)
        self._actions = list(memory.actions)
        self._now_s = now_s
        self._waiting_tickets: list[int] = []
        """Numbers of tickets that are to teach."""

    @property
    def loads(self) -> tuple[Load, ...]:
        """All loads as measured, in order."""
        return tuple(self._loads[number] for number in sorted(self._loads))

    def name_load(self, field: str | None, crop: str | None) -> None:
        """Names for the loads from now on; None leaves one as it is."""
        self.field = self.field if field is None else field
        self.crop = self.crop if crop is None else crop

    def change_crop(self, crop: str, in_use: ParameterSet, who: str = "") -> ParameterSet | None:
        """The parameters for another crop: what was last known of it, else what is shipped. None where those in use stay: they
        are this crop's, whose they are is not stated, or nothing is known of this one.

        What is known of the crop before is kept.
        """
        before = self._crop_of(in_use)
        if crop == before or not before:
            return None
        known = self._of_crop.get(crop)
        if known is None and crop in crops():
            known = crops()[crop].parameters()
        if known is None:
            return None
        if before:
            kept = replace(in_use, version=self._version + 1, provenance={**in_use.provenance, "crop": before})
            self._of_crop[before] = kept
            self._use(kept, "crop", who, f"what is known of {before} is kept")
        chosen = replace(known, version=self._version + 1)
        self._use(chosen, "crop", who, f"what is known of {crop}")
        return chosen

    def _crop_of(self, in_use: ParameterSet) -> str:
        """Whose crop the parameters are, "" where nobody said."""
        before = in_use.provenance.get("crop", self.crop)
        return before or (_SHIPPED_CROP if self._digest == self._shipped_digest else "")

    def crop_in_use(self, in_use: ParameterSet) -> str:
        """The crop that is harvested: as named, else that of the parameters in use; "" where neither says."""
        return self.crop or self._crop_of(in_use)

    def use_parameter_file(self, configured: ParameterSet) -> ParameterSet | None:
        """A parameter file read anew: the set to use from now on, None when it is the one that is in use."""
        found = digest(configured)
        if found == self._digest:
            return None
        self._digest = found
        return replace(configured, version=self._version + 1)

    # What operators tell

    def act(self, kind: str, who: str, document: Mapping[str, Any], now_s: float | None = None) -> Action:
        """Something that was told or taken back, with who and when (Unix time; None: of the last batch)."""
        number = self._actions[-1].number + 1 if self._actions else 1
        action = Action(number, self._now_s if now_s is None else now_s, kind, who, document)
        self._actions.append(action)
        self._pending.actions.append(action)
        return action

    def ticket(self, ticket: Ticket, who: str = "", *, teaches: bool = False) -> int:
        """A ticket for the next batch; returns its number. teaches: it was handed to the calibration."""
        self._pending.tickets.append(ticket)
        self._all_tickets.append(ticket)
        number = len(self._all_tickets)
        self.act(ledgers.TICKET, who, {"ticket": number}, ticket.time_s)
        if teaches:
            self._waiting_tickets.append(number)
        return number

    def undo_ticket(self, number: int, who: str, now_s: float) -> tuple[Ticket, int | None]:
        """Take a ticket back; returns it, and the version of the parameters that came of it. Raises InputError."""
        standing = self.ledger.tickets
        if number not in standing:
            known = ", ".join(map(str, standing)) or "a ticket that was entered; there is none"
            done = "is undone already" if 1 <= number <= len(self._all_tickets) else "no such ticket"
            raise InputError(f"ticket {number}", done, known)
        self.act(ledgers.TICKET_UNDO, who, {"ticket": number}, now_s)
        if number in self._waiting_tickets:
            self._waiting_tickets.remove(number)
        updates = [a for a in self._actions if a.kind == ledgers.PARAMETERS and number in a.document.get("tickets", ())]
        undone = self._undone_versions()
        version = next((int(a.document["version"]) for a in updates if int(a.document["version"]) not in undone), None)
        return standing[number], version

    def undo_parameters(self, version: int, who: str, now_s: float) -> ParameterSet:
        """The parameters before a version, as a new version in use. Raises InputError."""
        changes = {int(a.document["version"]): a for a in self._actions if a.kind == ledgers.PARAMETERS}
        if version not in changes:
            raise InputError(f"version {version}", "no such calibration", "a version that `yieldmon calibrations list` shows")
        before = int(changes[version].document.get("from_version", 0))
        if version in self._undone_versions():
            raise InputError(f"version {version}", "is undone already", "one that stands")
        if before not in self._versions:
            raise InputError(f"version {version}", "the parameters before it are not known", "a later version")
        self.act(ledgers.PARAMETERS_UNDO, who, {"version": version}, now_s)
        chosen = replace(self._versions[before], version=self._version + 1)
        self._use(chosen, "undo", who, f"version {version} undone: as version {before}")
        return chosen

    def _undone_versions(self) -> set[int]:
        return {int(a.document["version"]) for a in self._actions if a.kind == ledgers.PARAMETERS_UNDO}

    def zero(self, who: str, signs: str, now_s: float) -> None:
        """An operator's zero calibration; signs: what spoke of grain."""
        self.act(ledgers.ZERO, who, {"second": self._second, "signs": signs}, now_s)

    def zero_undone(self, who: str, restored: Mapping[int, float], told: Iterable[int], now_s: float) -> None:
        """It was taken back. restored: load number -> kg; told: loads whose new mass the monitor has told itself."""
        last = next((a.number for a in reversed(self._actions) if a.kind == ledgers.ZERO), 0)
        self.act(ledgers.ZERO_UNDO, who, {"action": last, "restored_kg": sum(restored.values())}, now_s)
        for number in set(restored) - set(told):
            known = self._loads.get(number)
            if known is not None:
                mass = max(0.0, known.mass_kg + restored[number])
                self._loads[number] = self._pending.loads[number] = replace(known, mass_kg=mass)

    def take_applied_tickets(self) -> tuple[int, ...]:
        """Tickets that updated the parameters and whose loads are to be measured again; each is returned once."""
        numbers, self._waiting_tickets = tuple(self._waiting_tickets), []
        return numbers

    @property
    def tickets_wait(self) -> bool:
        """Whether a ticket is to update the parameters, or did and its loads are not measured again yet."""
        return bool(self._waiting_tickets)

    def posted(self, tickets: Sequence[int], version: int, factors: Mapping[int, float]) -> None:
        """Loads were measured again after these tickets."""
        document = {
            "tickets": list(tickets), "version": version, "factors": {str(n): factor for n, factor in sorted(factors.items())}
        }  # fmt: skip
        self.act(ledgers.POSTING, "", document)

    # What stands

    @property
    def calibrated_version(self) -> int:
        """Version with which the newest parameter file came; what was measured before it says nothing about it."""
        return max(
            (
                int(a.document["version"])
                for a in self._actions
                if a.kind == ledgers.PARAMETERS and a.document.get("origin") == "file"
            ),
            default=0,
        )

    @property
    def ledger(self) -> ledgers.Ledger:
        """Tickets and postings that stand."""
        return ledgers.ledger(self._all_tickets, self._actions)

    def load_table(self) -> list[dict[str, Any]]:
        """All loads as measured, as measured again, as weighed, and the best of these."""
        standing = self.ledger
        return [standing.row(load) for load in self.loads]

    def ticket_table(self) -> list[dict[str, Any]]:
        """All tickets, with who entered them and who took them back."""
        return ledgers.ticket_rows(self._all_tickets, self._actions)

    def calibration_table(self) -> list[dict[str, Any]]:
        """All changes of parameters and zeros by an operator, with who and when."""
        return ledgers.calibration_rows(self._actions, self._version)

    def report_all(self) -> None:
        """For a store that was made anew while in use: the next batch brings all that this run knows."""
        self._pending.loads = dict(self._loads) | self._pending.loads
        self._pending.tickets = list(self._all_tickets)
        self._pending.actions = list(self._actions)
        if self._in_use is not None and self._in_use not in self._pending.parameters:
            self._pending.parameters.insert(0, self._in_use)

    def new_monitor(self, parameters: ParameterSet, origin: str) -> None:
        """A monitor begins, or begins anew after a reload, with these parameters; origin: where they come from."""
        self._faults_known = False
        if parameters.version != self._version or not self._version:
            self._use(parameters, origin)

    def take(self, results: Iterable[Result]) -> tuple[SecondRow, ...]:
        """What the monitor handed back; returns the rows of the windows among it."""
        rows = []
        for result in results:
            if isinstance(result, WindowResult):
                self._second += 1
                rows.append(second_row(self._second, result.record))
                self._compare_faults(result.record)
            self.happened(result.events)
        self._pending.seconds += rows
        return tuple(rows)

    def happened(self, events: Iterable[Event]) -> None:
        """Events for the next batch."""
        for event in events:
            if isinstance(event, FaultEvent):
                self._fault(event.code.value, event.active, event.detail)
            elif isinstance(event, LoadOpened | LoadClosed):
                self._load(event.load)
            elif isinstance(event, ParametersChanged):
                self._use(event.parameters, event.origin, "", event.reason, self._waiting_tickets, event.step)
            elif isinstance(event, SweepEnded):
                self._pending.sweeps.append(event)

    def batch(self, monitor: Monitor, time_s: float, counters: Mapping[str, int]) -> Batch:
        """All that came since the last one. time_s: Unix time."""
        self._batch += 1
        self._now_s = time_s
        if monitor.open_load is not None:
            self._load(monitor.open_load)
        pending, self._pending = self._pending, _Pending()
        return Batch(
            number=self._batch,
            time_s=time_s,
            state=self._state(monitor, time_s),
            seconds=tuple(pending.seconds),
            loads=tuple(pending.loads.values()),
            sweeps=tuple(_sweep_row(sweep, time_s) for sweep in pending.sweeps),
            parameter_versions=tuple(
                ParameterVersion(parameters.version, time_s, origin, parameter_file.to_document(parameters))
                for parameters, origin in pending.parameters
            ),
            faults=tuple(rows_of.FaultEvent(time_s, code, active, detail) for code, active, detail in pending.faults),
            tickets=tuple(pending.tickets),
            actions=tuple(pending.actions),
            steps=tuple(Step(version, step.end_s, step_document(step)) for version, step in pending.steps),
            counters={name: self._counters_before.get(name, 0) + value for name, value in counters.items()},
        )

    def _state(self, monitor: Monitor, time_s: float) -> dict[str, Any]:
        return {
            "engine": monitor.snapshot().as_dict(),
            "saved_s": time_s,
            "last_second": self._second,
            "parameter_digest": self._digest,
            "field": self.field,
            "crop": self.crop,
            "kernel_weight_g": self.kernel_weight_g,
            "faults": sorted(self._faults),
        }

    def _load(self, summary: LoadSummary) -> None:
        known = self._loads.get(summary.number)
        started_s = known.started_s if known is not None else None
        dry_known = summary.unknown_moisture_kg <= _UNKNOWN_MOISTURE_KG
        area_known = summary.area_m2 > 0.0 and summary.unknown_area_kg <= _UNKNOWN_AREA_SHARE * summary.measured_kg
        load = Load(
            number=summary.number,
            field=known.field if known is not None else self.field,
            crop=known.crop if known is not None else self.crop,
            started_s=started_s if started_s is not None else finite(summary.start_s),
            ended_s=finite(summary.end_s),
            mass_kg=summary.measured_kg,
            dry_mass_kg=summary.dry_kg if dry_known else None,
            area_m2=summary.area_m2 if area_known else None,
        )
        if load != known:
            self._loads[load.number] = self._pending.loads[load.number] = load

    def _use(
        self,
        parameters: ParameterSet,
        origin: str,
        who: str = "",
        reason: str = "",
        tickets: Sequence[int] = (),
        step: CalibrationStep | None = None,
    ) -> None:
        document = {
            "version": parameters.version, "from_version": self._version, "origin": origin, "reason": reason,
            "effects": list(parameters.effects), "tickets": list(tickets),
        }  # fmt: skip
        self.act(ledgers.PARAMETERS, who, document)
        self._versions[parameters.version] = parameters
        while len(self._versions) > _KEPT_VERSIONS:
            del self._versions[min(self._versions)]
        if step is not None:
            self._pending.steps.append((parameters.version, step))
        self._version = parameters.version
        self._in_use = (parameters, origin)
        self._pending.parameters.append(self._in_use)

    def _fault(self, code: str, active: bool, detail: str) -> None:
        if active is not (code in self._faults):
            self._pending.faults.append((code, active, detail if active else ""))
            (self._faults.add if active else self._faults.discard)(code)

    def _compare_faults(self, record: WindowRecord) -> None:
        """Once for each monitor: faults that the store shows and a monitor that began anew does not are gone."""
        if not self._faults_known:
            self._faults_known = True
            for code in sorted(self._faults - {code.value for code in record.faults}):
                self._fault(code, False, "")


@dataclass
class _Pending:
    """What the next batch will bring."""

    seconds: list[SecondRow] = dataclass_field(default_factory=list)
    loads: dict[int, Load] = dataclass_field(default_factory=dict)
    sweeps: list[SweepEnded] = dataclass_field(default_factory=list)
    parameters: list[tuple[ParameterSet, str]] = dataclass_field(default_factory=list)
    faults: list[tuple[str, bool, str]] = dataclass_field(default_factory=list)
    tickets: list[Ticket] = dataclass_field(default_factory=list)
    actions: list[Action] = dataclass_field(default_factory=list)
    steps: list[tuple[int, CalibrationStep]] = dataclass_field(default_factory=list)


def _sweep_row(sweep: SweepEnded, time_s: float) -> SweepRecord:
    document = {
        "sweep_id": sweep.sweep_id,
        "angles_deg": list(sweep.angles_deg),
        "parameter_version": sweep.parameter_version,
    }
    return SweepRecord(time_s, sweep.state.name.lower(), sweep.reason, document)

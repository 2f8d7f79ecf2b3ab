"""What the monitor did since the last time, as batches for the store; and from the store what a monitor goes on from."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from math import isfinite
from typing import Any

from yieldmon.engine.monitor import LoadSummary, Monitor
from yieldmon.engine.state import EngineState
from yieldmon.errors import InputError
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files import parameter_file
from yieldmon.frames import SweepState
from yieldmon.service.rows import second_row
from yieldmon.service.store import Batch, FaultEvent, Load, ParameterVersion, Store, StoreDamagedError, SweepRecord, Ticket

_SWEEP_ENDS = frozenset({SweepState.ABORTED, SweepState.UPDATED, SweepState.NOT_LEARNED})
_UNKNOWN_MOISTURE_KG = 1e-6


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
    parameter_digest: str = ""
    last_batch: int = 0
    last_second: int = 0
    last_version: int = 0
    loads: tuple[Load, ...] = ()
    tickets: tuple[Ticket, ...] = ()
    field: str = ""
    crop: str = ""
    faults: tuple[str, ...] = ()
    counters: Mapping[str, int] | None = None


def recall(store: Store) -> Memory:
    """What the store remembers. Raises StoreDamagedError when it makes no sense."""
    document = store.state()
    if document is None:
        return Memory()
    versions = store.parameter_versions()
    last_second = store.last_second()
    try:
        return Memory(
            engine=EngineState.from_dict(document["engine"]),
            saved_s=float(document["saved_s"]),
            parameters=parameter_file.from_document(versions[-1].document, str(store.path)),
            parameter_digest=str(document["parameter_digest"]),
            last_batch=store.last_batch(),
            last_second=max(int(document["last_second"]), last_second.number if last_second is not None else 0),
            last_version=versions[-1].version,
            loads=tuple(store.loads()),
            tickets=tuple(store.tickets()),
            field=str(document["field"]),
            crop=str(document["crop"]),
            faults=tuple(document["faults"]),
            counters=store.counters(),
        )
    except (KeyError, IndexError, TypeError, ValueError, InputError) as error:
        raise StoreDamagedError(f"{store.path}: the state cannot be used: {error!r}") from error


def choose_parameters(memory: Memory, configured: ParameterSet) -> tuple[ParameterSet, str]:
    """The parameters to run with, and where they come from.

    What was learnt since goes on for as long as the configured file is the one it began with; another file wins.
    """
    if memory.parameters is not None and memory.parameter_digest == digest(configured):
        return memory.parameters, "store"
    if memory.last_version:
        return replace(configured, version=memory.last_version + 1), "file"
    return configured, "file"


class Journal:
    """Numbers batches and seconds, and finds out what changed from one batch to the next."""

    def __init__(self, memory: Memory, configured: ParameterSet, field: str = "", crop: str = "") -> None:
        """memory: what the store holds. configured: the parameters as their file has them."""
        self.field = memory.field or field
        self.crop = memory.crop or crop
        self._digest = digest(configured)
        self._batch = memory.last_batch
        self._second = memory.last_second
        self._version = memory.last_version
        self._loads = {load.number: load for load in memory.loads}
        self._faults = set(memory.faults)
        self._ended_sweep: int | None = None
        self._parameters: ParameterSet | None = None
        self._counters_before = dict(memory.counters or {})
        self._tickets: list[Ticket] = []
        self._all_tickets = list(memory.tickets)

    @property
    def loads(self) -> tuple[Load, ...]:
        """All loads as measured, in order."""
        return tuple(self._loads[number] for number in sorted(self._loads))

    def name_load(self, field: str | None, crop: str | None) -> None:
        """Names for the loads from now on; None leaves one as it is."""
        self.field = self.field if field is None else field
        self.crop = self.crop if crop is None else crop

    def use_parameter_file(self, configured: ParameterSet) -> ParameterSet | None:
        """A parameter file read anew: the set to use from now on, None when it is the one that is in use."""
        found = digest(configured)
        if found == self._digest:
            return None
        self._digest = found
        return replace(configured, version=self._version + 1)

    def ticket(self, ticket: Ticket) -> None:
        """A ticket for the next batch."""
        self._tickets.append(ticket)
        self._all_tickets.append(ticket)

    def load_table(self) -> list[dict[str, Any]]:
        """All loads as measured, and corrected by the newest ticket that covers each."""
        table = []
        for load in self.loads:
            ticket = next((t for t in reversed(self._all_tickets) if t.first_load <= load.number <= t.last_load), None)
            factor = 1.0 if ticket is None else ticket.factor
            corrected = {
                "corrected_mass_kg": load.mass_kg * factor,
                "corrected_dry_mass_kg": None if load.dry_mass_kg is None else load.dry_mass_kg * factor,
                "ticket_mass_kg": None if ticket is None else ticket.weighed_mass_kg,
            }
            table.append(asdict(load) | corrected)
        return table

    def batch(self, monitor: Monitor, time_s: float, counters: Mapping[str, int], origin: str) -> Batch:
        """All that is new. time_s: Unix time; origin: where new parameters come from."""
        seconds = tuple(second_row(self._second + n, record) for n, record in enumerate(monitor.take_records(), 1))
        self._second += len(seconds)
        self._batch += 1
        tickets, self._tickets = tuple(self._tickets), []
        loads = self._changed_loads(monitor)
        faults = self._changed_faults(monitor, time_s)
        return Batch(
            number=self._batch,
            time_s=time_s,
            state=self._state(monitor, time_s),
            seconds=seconds,
            loads=loads,
            sweeps=self._ended_sweeps(monitor, time_s),
            parameter_versions=self._new_parameters(monitor, time_s, origin),
            faults=faults,
            tickets=tickets,
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
            "faults": sorted(self._faults),
        }

    def _changed_loads(self, monitor: Monitor) -> tuple[Load, ...]:
        changed = []
        for summary in monitor.loads:
            load = self._load(summary)
            if load != self._loads.get(load.number):
                self._loads[load.number] = load
                changed.append(load)
        return tuple(changed)

    def _load(self, summary: LoadSummary) -> Load:
        known = self._loads.get(summary.number)
        started_s = known.started_s if known is not None else None
        dry_known = summary.unknown_moisture_kg <= _UNKNOWN_MOISTURE_KG
        return Load(
            number=summary.number,
            field=known.field if known is not None else self.field,
            crop=known.crop if known is not None else self.crop,
            started_s=started_s if started_s is not None else _known(summary.start_s),
            ended_s=_known(summary.end_s),
            mass_kg=summary.measured_kg,
            dry_mass_kg=summary.dry_kg if dry_known else None,
        )

    def _changed_faults(self, monitor: Monitor, time_s: float) -> tuple[FaultEvent, ...]:
        active = {code.value: code for code in monitor.faults.active}
        gone = tuple(FaultEvent(time_s, name, False) for name in sorted(self._faults - set(active)))
        come = tuple(
            FaultEvent(time_s, name, True, monitor.faults.detail(active[name])) for name in sorted(set(active) - self._faults)
        )
        self._faults = set(active)
        return gone + come

    def _ended_sweeps(self, monitor: Monitor, time_s: float) -> tuple[SweepRecord, ...]:
        sweep_id, state = monitor.sweep.sweep_id, monitor.sweep.state
        if self._ended_sweep is None:
            self._ended_sweep = sweep_id
        # Once for each: a plate that is fetched home later on ends the same sweep again.
        if sweep_id == self._ended_sweep or state not in _SWEEP_ENDS:
            return ()
        self._ended_sweep = sweep_id
        outcome, abort = monitor.outcome, monitor.sweep.abort_reason
        if state is SweepState.ABORTED:
            reason = abort.value if abort is not None else ""
        else:
            reason = outcome.reason if outcome is not None else "no calibrator"
        document = {
            "sweep_id": sweep_id,
            "angles_deg": list(monitor.sweep.sequence),
            "parameter_version": monitor.estimator.parameters.version,
        }
        return (SweepRecord(time_s, state.name.lower(), reason, document),)

    def _new_parameters(self, monitor: Monitor, time_s: float, origin: str) -> tuple[ParameterVersion, ...]:
        parameters, before = monitor.estimator.parameters, self._parameters
        self._parameters = parameters
        if parameters.version == self._version and (before is None or before is parameters):
            return ()
        self._version = parameters.version
        if origin == "sweep" and monitor.outcome is not None and monitor.outcome.weighed:
            origin = "ticket"
        return (ParameterVersion(parameters.version, time_s, origin, parameter_file.to_document(parameters)),)


def _known(value: float) -> float | None:
    return value if isfinite(value) else None

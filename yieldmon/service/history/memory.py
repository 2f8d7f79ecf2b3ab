"""What a store remembers, from which a start goes on."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from dataclasses import field as field_of

from yieldmon.engine.mass.missed_mass import NO_LOAD
from yieldmon.engine.sampling.since_zero import KEPT_S, KeptSecond
from yieldmon.engine.state import EngineState
from yieldmon.errors import InputError
from yieldmon.estimation.parameter_origin import ParameterOrigin
from yieldmon.estimation.parameters import SCALE, ParameterSet
from yieldmon.files import calibrated_machine, parameter_file
from yieldmon.physics.machine import Machine
from yieldmon.service.history.reference_loads import StoredLoad, of_store
from yieldmon.service.storage import ledger as ledgers
from yieldmon.service.storage.batch import Action, Load, Ticket
from yieldmon.service.storage.load_ends import between_loads, load_of
from yieldmon.service.storage.rows import kept_second
from yieldmon.service.storage.store import Store
from yieldmon.service.storage.store_errors import StoreDamagedError
from yieldmon.service.tickets.remeasuring_queue import Remeasuring

_log = logging.getLogger(__name__)

KEPT_VERSIONS = 200
"""Newest parameter versions that an undo can go back to."""


@dataclass(frozen=True)
class Memory:
    """What a store remembers. engine and parameters are None in a new store; parameters are those last in use, and
    parameter_digest is of the file that they began with."""

    engine: EngineState | None = None
    saved_s: float = 0.0
    parameters: ParameterSet | None = None
    parameter_origin: str = ParameterOrigin.FILE
    parameter_digest: str = ""
    last_batch: int = 0
    last_second: int = 0
    last_version: int = 0
    loads: tuple[Load, ...] = ()
    tickets: tuple[Ticket, ...] = ()
    field: str = ""
    crop: str = ""
    kernel_weight_g: float | None = None
    """Of a thousand kernels, as an operator entered it."""
    faults: tuple[str, ...] = ()
    counters: Mapping[str, int] | None = None
    of_crop: Mapping[str, ParameterSet] = field_of(default_factory=dict)
    """The newest parameters of each crop."""
    versions: Mapping[int, ParameterSet] = field_of(default_factory=dict)
    """The newest parameter versions."""
    actions: tuple[Action, ...] = ()
    unfinished_tickets: tuple[int, ...] = ()
    """Numbers of those that are still to update the parameters, or whose loads are still to be measured again."""
    unfinished_tickets_of_crop: Mapping[str, tuple[int, ...]] = field_of(default_factory=dict)
    """Those that are to update the parameters of a crop that is not harvested now, by its name."""
    restored_versions: tuple[int, ...] = ()
    """Versions that an undo brought back and with which loads are still to be measured again."""
    open_loads: Mapping[int, Remeasuring] = field_of(default_factory=dict)
    """Those that were open as others were measured again, and by what their turn comes."""
    since_zero: tuple[KeptSecond, ...] = ()
    """Seconds since the operator's last zero calibration, where that can be undone."""
    ticketed: tuple[StoredLoad, ...] = ()
    """Loads of the newest tickets."""

    @property
    def in_words(self) -> str:
        """What a start goes on from."""
        if self.engine is None:
            return "new, the total begins at 0 kg and the parameters are those of their file"
        totals = self.engine.totals
        return f"goes on from {totals.total_kg:.1f} kg, load {totals.load_number}"

    def of_another_machine(self, machine: Machine) -> str:
        """What is to be said of a store whose last parameters were made for another machine; "" where nothing tells so."""
        difference = "" if self.parameters is None else calibrated_machine.difference(self.parameters, machine)
        if not difference:
            return ""
        return f"its last parameters were made for another machine ({difference}); totals and loads may be that one's"


def recall(store: Store) -> Memory:
    """What the store remembers. Raises StoreDamagedError when it makes no sense."""
    document = store.state()
    if document is None:
        return Memory()
    versions = store.parameter_versions()
    last_second = store.last_second()
    try:
        engine, actions = EngineState.from_dict(document["engine"]), tuple(store.actions())
        undone = ledgers.undone_versions(actions)
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
            of_crop=by_crop(
                (parameter_file.from_document(version.document, str(store.path)), version.origin)
                for version in versions
                if version.version not in undone
            ),
            versions={v.version: parameter_file.from_document(v.document, str(store.path)) for v in versions[-KEPT_VERSIONS:]},
            actions=actions,
            unfinished_tickets=tuple(map(int, document.get("unfinished_tickets", ()))),
            unfinished_tickets_of_crop={
                str(crop): tuple(map(int, kept)) for crop, kept in dict(document.get("unfinished_tickets_of_crop", {})).items()
            },
            restored_versions=tuple(map(int, document.get("restored_versions", ()))),
            open_loads={
                int(number): Remeasuring(tuple(map(int, by["tickets"])), int(by["version"]))
                for number, by in dict(document.get("open_loads", {})).items()
            },
            since_zero=_since_zero(store, actions, engine.totals.first_load) if engine.zero_undo is not None else (),
            ticketed=_ticketed(store, engine),
        )
    except (KeyError, IndexError, TypeError, ValueError, InputError) as error:
        raise StoreDamagedError(f"{store.path}: the state cannot be used: {error!r}") from error


def _since_zero(store: Store, actions: Sequence[Action], first_load: int) -> tuple[KeptSecond, ...]:
    """first_load: with which the totals began; what no load was open for before it is in none of them."""
    last = next((a for a in reversed(actions) if a.kind == ledgers.ZERO), None)
    if last is None:
        return ()
    newest, recorded = store.last_second(), int(last.document["second"])
    first = max(recorded + 1, (newest.number if newest is not None else 0) - KEPT_S)
    kept, zero_mv = [], None
    rows = list(store.seconds(first - 1, on_damage=lambda number: None))
    between = between_loads(rows, store.loads())
    for row in rows:
        of_load = load_of(row, between) is not None
        if row.number >= first and (of_load or row.load_number >= first_load):
            second = replace(kept_second(row), load_number=row.load_number if of_load else NO_LOAD)
            kept.append(second if zero_mv is None else replace(second, zero_mv=zero_mv))
        zero_mv = row.zero_mv
    return tuple(kept)


def _ticketed(store: Store, engine: EngineState) -> tuple[StoredLoad, ...]:
    """Empty where the seconds are damaged: the tickets' corrections stand, and a start must not wait for repairs."""
    try:
        return of_store(store, {ticket.load_number for ticket in engine.tickets})
    except StoreDamagedError as error:
        _log.warning("loads with tickets are not read again: %s", error)
        return ()


def choose_parameters(memory: Memory, configured: ParameterSet) -> tuple[ParameterSet, ParameterOrigin]:
    """The parameters to run with, and where they come from.

    Updates since go on for as long as the configured file is the one it began with; another file wins.
    """
    if memory.parameters is not None and memory.parameter_digest == parameter_file.digest(configured):
        known = memory.parameters
        # Stores before 0.2.0 do not say so.
        unmarked = configured.scale_error > 0.0 and SCALE not in known.provenance and not memory.tickets
        return parameter_file.not_calibrated(known) if unmarked else known, ParameterOrigin.STORE
    if memory.last_version:
        return replace(configured, version=memory.last_version + 1), ParameterOrigin.FILE
    return configured, ParameterOrigin.FILE


def by_crop(versions: Iterable[tuple[ParameterSet, str]]) -> dict[str, ParameterSet]:
    """The newest parameters of each crop, by its name; of none from before a change of the machine. versions: with their origins,
    in order."""
    found: dict[str, ParameterSet] = {}
    for parameters, origin in versions:
        if origin == ParameterOrigin.HARDWARE:
            found.clear()
        if "crop" in parameters.provenance:
            found[parameters.provenance["crop"]] = parameters
    return found

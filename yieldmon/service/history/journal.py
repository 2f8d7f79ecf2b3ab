"""What the monitor did, collected into batches for the store."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, replace
from math import isfinite
from typing import Any

from yieldmon.documents.loads import ListedLoad
from yieldmon.engine.health import FaultEvent
from yieldmon.engine.mass.load_summary import LoadClosed, LoadOpened, LoadRestated
from yieldmon.engine.mass.missed_mass import MissedMass
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.results import Event, Result, WindowResult
from yieldmon.engine.self_calibration.parameter_updater import ParametersChanged
from yieldmon.engine.sweeps.plate import SweepEnded
from yieldmon.estimation.parameter_origin import ParameterOrigin
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.service.history.load_book import LoadBook
from yieldmon.service.history.memory import Memory
from yieldmon.service.history.parameter_history import ParameterHistory
from yieldmon.service.storage import batch as rows_of
from yieldmon.service.storage import ledger as ledgers
from yieldmon.service.storage.batch import Batch, SweepRecord
from yieldmon.service.storage.rows import SecondRow, second_row
from yieldmon.service.tickets.action_log import ActionLog
from yieldmon.utc import EARLIEST_BUS_TIME_S


class Journal:
    """Numbers batches and seconds, and collects what the monitor hands back until the next batch.

    unrecorded: number of the load that was open as a run before ended, and the time, s, from its last record to this run; None
    where none was, or where the clock does not tell how long. actions: what operators entered. parameters: those in use and
    before. loads: as measured. field, crop: names of the loads from now on. kernel_weight_g: of a thousand kernels, as an
    operator entered it.
    """

    def __init__(self, memory: Memory, configured: ParameterSet, *, now_s: float) -> None:
        """memory: what the store holds. configured: the parameters as their file has them. now_s: Unix time."""
        self.actions = ActionLog(
            memory.tickets,
            memory.actions,
            now_s,
            memory.unfinished_tickets,
            memory.unfinished_tickets_of_crop,
            restored=memory.restored_versions,
            open_loads=memory.open_loads,
        )
        self.parameters = ParameterHistory(memory, configured, self.actions)
        self.unrecorded = _unrecorded(memory, now_s)
        self.loads = LoadBook(memory.loads)
        self.field = memory.field
        self.crop = memory.crop
        self.kernel_weight_g = memory.kernel_weight_g
        self._batch = memory.last_batch
        self._second = memory.last_second
        self._faults = set(memory.faults)
        self._faults_known = False
        """Whether the monitor has said which of the faults that the store shows it shows as well."""
        self._counters_before = dict(memory.counters or {})
        self._new_seconds: list[SecondRow] = []
        self._new_sweeps: list[SweepEnded] = []
        self._new_faults: list[tuple[str, bool, str]] = []

    def name_load(self, field: str | None, crop: str | None) -> None:
        """Names for the loads from now on; None leaves one as it is."""
        self.field = self.field if field is None else field
        self.crop = self.crop if crop is None else crop

    def crop_in_use(self, in_use: ParameterSet) -> str:
        """The crop that is harvested: as named, else that of the parameters in use; "" where neither says."""
        return self.crop or self.parameters.crop_of(in_use, self.crop)

    def zero(self, who: str, signs: str, now_s: float, *, goes_on: bool) -> None:
        """An operator's zero calibration; signs: what spoke of grain. goes_on: an undo reaches back before the one before it."""
        earlier = [action for action in self.actions if action.kind == ledgers.ZERO] if goes_on else []
        second = int(earlier[-1].document["second"]) if earlier else self._second
        self.actions.add(ledgers.ZERO, who, {"second": second, "signs": signs}, now_s)

    def zero_undone(self, who: str, restored: Mapping[int, MissedMass], reported: Iterable[int], now_s: float) -> None:
        """It was taken back. restored: by load number, what it had missed; reported: loads whose new mass it reported."""
        last = max((action.number for action in self.actions if action.kind == ledgers.ZERO), default=0)
        restored_kg = sum(missed.kg for missed in restored.values())
        self.actions.add(ledgers.ZERO_UNDO, who, {"action": last, "restored_kg": restored_kg}, now_s)
        for number in set(restored) - set(reported):
            self.loads.corrected(number, restored[number])

    def load_table(self) -> list[ListedLoad]:
        """All loads as measured, as measured again, as weighed, and the best of these."""
        standing = self.actions.history.ledger
        return standing.rows(self.loads)

    def report_all(self) -> None:
        """For a store that was made anew while in use: the next batch brings all that this run knows."""
        for part in (self.actions, self.parameters, self.loads):
            part.report_all()

    def new_monitor(self, parameters: ParameterSet, origin: ParameterOrigin) -> None:
        """A monitor begins, or begins anew after a reload, with these parameters; origin: where they come from."""
        self._faults_known = False
        if parameters.version != self.parameters.version or not self.parameters.version:
            self.parameters.use(parameters, origin)

    def take(self, results: Iterable[Result]) -> tuple[SecondRow, ...]:
        """What the monitor handed back; returns the rows of the windows among it."""
        rows = []
        for result in results:
            if isinstance(result, WindowResult):
                self._second += 1
                rows.append(second_row(self._second, result.record))
                self._compare_faults(result.record)
            self.happened(result.events)
        self._new_seconds += rows
        return tuple(rows)

    def happened(self, events: Iterable[Event]) -> None:
        """Events for the next batch."""
        for event in events:
            if isinstance(event, FaultEvent):
                self._fault(event.code.value, event.detail, active=event.active)
            elif isinstance(event, LoadOpened):
                self.loads.measured(event.load, self.field, self.crop)
            elif isinstance(event, LoadClosed):
                # Before the first frame no bus time is known.
                known = isfinite(event.load.end_s)
                load = event.load if known else replace(event.load, end_s=self.actions.now_s)
                self.loads.measured(load, self.field, self.crop)
            elif isinstance(event, LoadRestated):
                self.loads.restated(event.number, event.budget)
            elif isinstance(event, ParametersChanged):
                self.parameters.use(
                    event.parameters,
                    event.origin,
                    reason=event.reason,
                    tickets=self.actions.take_behind(event),
                    step=event.step,
                )
            elif isinstance(event, SweepEnded):
                self._new_sweeps.append(event)

    def batch(self, monitor: Monitor, time_s: float, counters: Mapping[str, int]) -> Batch:
        """All that came since the last one. time_s: Unix time."""
        self._batch += 1
        self.actions.now_s = time_s
        if not monitor.masses_wait:
            self.actions.updates.handed_over()
        if monitor.open_load is not None:
            self.loads.measured(monitor.open_load, self.field, self.crop)
        seconds, self._new_seconds = self._new_seconds, []
        sweeps, self._new_sweeps = self._new_sweeps, []
        faults, self._new_faults = self._new_faults, []
        versions, steps = self.parameters.take(time_s)
        tickets, actions = self.actions.take()
        return Batch(
            number=self._batch,
            time_s=time_s,
            state=self._state(monitor, time_s),
            seconds=tuple(seconds),
            loads=self.loads.take(),
            sweeps=tuple(_sweep_row(sweep, time_s) for sweep in sweeps),
            parameter_versions=versions,
            faults=tuple(rows_of.FaultEvent(time_s, code, active, detail) for code, active, detail in faults),
            tickets=tickets,
            actions=actions,
            steps=steps,
            counters={name: self._counters_before.get(name, 0) + value for name, value in counters.items()},
        )

    def _state(self, monitor: Monitor, time_s: float) -> dict[str, Any]:
        return {
            "engine": monitor.snapshot().as_dict(),
            "saved_s": time_s,
            "last_second": self._second,
            "parameter_digest": self.parameters.digest,
            "field": self.field,
            "crop": self.crop,
            "kernel_weight_g": self.kernel_weight_g,
            "faults": sorted(self._faults),
            "unfinished_tickets": list(self.actions.unfinished),
            "restored_versions": list(self.actions.remeasuring.restored),
            "open_loads": {str(n): asdict(by) for n, by in self.actions.remeasuring.open_loads.items()},
            "doubted_loads": sorted(monitor.doubted_loads),
            "unfinished_tickets_of_crop": {crop: list(kept) for crop, kept in self.actions.updates.of_crop.items()},
        }

    def _fault(self, code: str, detail: str, *, active: bool) -> None:
        if active is not (code in self._faults):
            self._new_faults.append((code, active, detail if active else ""))
            (self._faults.add if active else self._faults.discard)(code)

    def _compare_faults(self, record: WindowRecord) -> None:
        """Once for each monitor: faults that the store shows and a monitor that began anew does not are gone."""
        if not self._faults_known:
            self._faults_known = True
            for code in sorted(self._faults - {code.value for code in record.faults}):
                self._fault(code, "", active=False)


def _unrecorded(memory: Memory, now_s: float) -> tuple[int, float] | None:
    if not EARLIEST_BUS_TIME_S <= memory.saved_s <= now_s:
        return None
    if memory.engine is None or not memory.engine.totals.load_open or not memory.engine.totals.load_kg > 0.0:
        return None
    return memory.engine.totals.load_number, now_s - memory.saved_s


def _sweep_row(sweep: SweepEnded, time_s: float) -> SweepRecord:
    document = {
        "sweep_id": sweep.sweep_id,
        "angles_deg": list(sweep.angles_deg),
        "parameter_version": sweep.parameter_version,
    }
    return SweepRecord(time_s, sweep.state.name.lower(), sweep.reason, document)

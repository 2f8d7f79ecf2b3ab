"""The daemon: bus, engine, store, service manager and operator around one monitor.

Threads: the receiver takes frames off the bus, the engine's thread (the caller of `run`) feeds them to the monitor, the
transmitter sends what comes out, the store's writer commits it, the control server answers `yieldmon status`; a configuration
that is read anew is read on one more. Only the engine's thread touches the monitor; the others reach it through queues.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from time import monotonic
from typing import Any

import can

from yieldmon import frames
from yieldmon.bus.receiver import BusEvent, Receiver
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.results import Result, records_in
from yieldmon.service.assembly import monitor_of
from yieldmon.service.config.configuration import Configuration
from yieldmon.service.config.reload_check import at_next_start, usable_now
from yieldmon.service.history.journal import Journal
from yieldmon.service.history.late_store import KeptInput, StoreReading, without_sweeps_for
from yieldmon.service.history.memory import Memory, choose_parameters
from yieldmon.service.history.posting import Poster
from yieldmon.service.history.recovery import Recovery, recover
from yieldmon.service.history.resumption import resume, successor
from yieldmon.service.metrics import MetricsFile
from yieldmon.service.notify import ServiceManager
from yieldmon.service.operator import commands
from yieldmon.service.operator.command_loads import CommandLoads
from yieldmon.service.operator.command_queue import CommandQueue, Job
from yieldmon.service.operator.control import ControlServer
from yieldmon.service.operator.control_protocol import Answer, ControlError
from yieldmon.service.operator.snapshot import snapshot
from yieldmon.service.patience import DEFAULT, Patience
from yieldmon.service.reloading import Reloading
from yieldmon.service.reloads import Reloads
from yieldmon.service.storage.identity import this_computer
from yieldmon.service.storage.ownership import Ownership
from yieldmon.service.storage.rows import SecondRow
from yieldmon.service.storage.store import Store
from yieldmon.service.storage.writer import StoreWriter
from yieldmon.service.supervision import Supervisor, ended, require_alive
from yieldmon.service.traffic.bus_node import BusNode
from yieldmon.service.traffic.transmit import Transmitter

_log = logging.getLogger(__name__)

_LAST_ROWS = 10
#: From this age on what `status` says is marked as stale.
_STALE_S = 5.0


class Daemon:
    """One run of the service. `request_stop` and `request_reload` may be called from signal handlers and other threads."""

    def __init__(
        self,
        configuration: Configuration,
        reload: Callable[[], Configuration] | None = None,
        *,
        environment: Mapping[str, str] = os.environ,
        bus_factory: Callable[[], can.BusABC] | None = None,
        network_clock: Callable[[], float] = monotonic,
        patience: Patience = DEFAULT,
    ) -> None:
        """reload: reads the configuration anew, on a thread of its own; raises InputError when it cannot be used. bus_factory:
        opens the bus, by default the configured one. network_clock: times the address claim and what else the network's protocols
        time."""
        self.configuration = configuration
        self._at_start = configuration
        self._manager = ServiceManager(environment)
        self._reloads = Reloads(Reloading(reload, patience.reload_s))
        self._bus = BusNode(
            configuration,
            bus_factory=bus_factory,
            silence_s=patience.silence_s,
            listen_s=patience.listen_s,
            clock=network_clock,
        )
        self._receiver, self._transmitter = self._bus.receiver, self._bus.transmitter
        self._patience = patience
        self.started = threading.Event()
        """Set once frames are taken and commands answered."""
        # Plain flags: a signal handler runs between any two instructions of this thread, where it may hold any lock.
        self._stop_wanted = self._reload_wanted = False
        self._commands = CommandQueue(patience.command_s, self._receiver.wake)
        self._command_loads = CommandLoads(patience.written_s)
        self._rows: deque[SecondRow] = deque(maxlen=_LAST_ROWS)
        self._record: WindowRecord | None = None
        """Of the last window of the monitor in use."""
        self._started_s = monotonic()
        self._store_note = ""
        self._answer: Answer = {}
        self._ownership = Ownership(configuration.store_path)
        pending_seconds, keep = configuration.document.store.pending_seconds, self._ownership.keep
        self._writer = StoreWriter(self._open_store, pending_seconds, path=configuration.store_path, keep=keep)
        self._poster = Poster(configuration.store_path, self._writer.wait_until_written)
        self._answered_s = monotonic()
        self._replacements = 0
        self._computer = this_computer()
        self._supervisors: list[Supervisor] = []
        self._reading_store: StoreReading | None = None
        """Until the store has been read; from then on batches go to it."""
        self._kept = KeptInput(patience.kept_frames)

    @property
    def monitor(self) -> Monitor:
        """The one in use, from the start on; a reload makes another. The engine's thread feeds it."""
        return self._monitor

    @property
    def receiver(self) -> Receiver:
        """Takes frames off the bus."""
        return self._receiver

    @property
    def transmitter(self) -> Transmitter:
        """Sends frames."""
        return self._transmitter

    @property
    def writer(self) -> StoreWriter:
        """Commits to the store."""
        return self._writer

    @property
    def heard_bus_s(self) -> float | None:
        """Bus time of the last frame that the engine has taken, s; None before the first."""
        return self._bus.time.last_s

    @property
    def snapshot(self) -> Answer:
        """What `status` answers, as of the last window or command."""
        return self._answer

    def request_stop(self) -> None:
        """End `run` soon, with everything written."""
        self._stop_wanted = True

    def request_reload(self) -> None:
        """Read the configuration anew soon."""
        self._reload_wanted = True

    def run(self) -> int:
        """Run until asked to stop; returns the exit code.

        Raises can.CanError or InputError when the bus cannot be opened at the start, StoreError when there is a store that
        cannot be read, OccupiedError when another daemon uses it or the control socket, InputError when that cannot be made.
        """
        try:
            return self._run()
        finally:
            self._ownership.release()

    def _run(self) -> int:
        # Frames are kept from here on, however long the disk takes.
        self._receiver.start()
        try:
            self._reading_store = reading = StoreReading(self._take_store)
            reading.wait(self._patience.store_s, lambda: self._stop_wanted)
            if not reading.done and self._stop_wanted:
                _log.error("%s: the disk has not answered since the start", self.configuration.store_path)
                self._receiver.stop()
                return 0
            self._begin(reading)
            self._answer = self._snapshot()
            status = self.configuration.document.status
            control = ControlServer(self.configuration.socket_path, status.group, self.command)
        except BaseException:
            self._receiver.stop()
            raise
        metrics = MetricsFile(self.configuration.prometheus_path, status.prometheus_interval_s, self._status)
        self._supervisors = [Supervisor("control", control), Supervisor("metrics", metrics)]
        helpers = (self._bus.transmitter, *(() if self._reading_store else (self._writer,)), control, metrics)
        for helper in helpers:
            helper.start()
        self._report_faults()
        self._bus.claim_address()
        self.started.set()
        self._manager.ready()
        for note in self.configuration.notes:
            _log.warning("%s", note)
        _log.info("running on %s %s", self.configuration.document.bus.interface, self.configuration.document.bus.channel)
        try:
            while not self._stop_wanted:
                self._round()
        finally:
            whole = self._end(metrics, control)
        _log.info("stopped; total %.1f kg", self._monitor.totals.total_kg)
        return 0 if whole else 1

    def _end(self, metrics: MetricsFile, control: ControlServer) -> bool:
        """Everything is stopped and written; False where a step failed. None takes for ever."""

        def write() -> None:
            if self._reading_store is not None:
                lost_kg = self._monitor.totals.total_kg
                _log.error("the disk has not answered since the start; %.1f kg measured since then are in no store", lost_kg)
            elif not self._writer.stop(self._patience.stop_s):
                _log.error("the disk hangs; %d batches are not written", self._writer.health().pending)
            elif self._fill_new_store():
                # The last batches went into a new store, which lacks what an earlier one was given.
                self._commit()
                self._writer.work()
                self._writer.close()

        return ended(
            self._manager.stopping,
            self._transmitter.stop,
            self._receiver.stop,
            self._commit,
            write,
            metrics.stop,
            control.stop,
        )

    # Start

    def _take_store(self) -> Recovery:
        """On a thread of its own: the disk may hang."""
        self._ownership.take()
        return recover(self.configuration.store_path, self.configuration.retention, self._open_store, self._computer)

    def _begin(self, reading: StoreReading) -> None:
        """The first monitor; on a disk that does not answer one that knows nothing of the store until it does."""
        if reading.done:
            self._reading_store = None
            self._go_on_from(reading.result())
            return
        self._store_note = f"the disk has not answered for {reading.age_s:.0f} s; until it does, totals are those since the start"
        _log.error("%s: %s", self.configuration.store_path, self._store_note)
        self._remember(Memory())

    def _go_on_from(self, recovery: Recovery) -> None:
        self._store_note = recovery.note
        if recovery.made:
            self._writer.expect(recovery.last_batch)
        self._remember(recovery.memory)

    def _remember(self, memory: Memory) -> None:
        """A journal and a monitor that go on from what a store remembers."""
        configured = self.configuration.parameters
        parameters, origin = choose_parameters(memory, configured)
        self._journal = Journal(memory, configured, now_s=time.time())
        self._journal.new_monitor(parameters, origin)
        self._monitor = monitor_of(self.configuration, parameters, waveform_later=True)
        resume(self._monitor, memory, origin, configured, time.time())
        commands.set_crop(self._monitor, self._journal)

    def _take_late_store(self, reading: StoreReading) -> None:
        """The disk has answered after all: what came meanwhile is measured again from what the store remembers."""
        recovery, without, kept = reading.result(), self._monitor, self._kept
        self._reading_store, self._kept = None, KeptInput(0)
        self._rows.clear()
        self._record = None
        self._go_on_from(replace(recovery, memory=without_sweeps_for(recovery.memory, kept.duration_s)))
        self._writer.start()
        for results in kept.into(self._monitor):
            rows = self._journal.take(results)
            if rows:
                self._rows.extend(rows)
                self._record = records_in(results)[-1]
                self._commit()
        note = f"the disk answered {reading.age_s:.0f} s after the start"
        if kept.full:
            more = without.totals
            note += f"; {more.total_kg:.1f} kg from {kept.duration_s:.0f} s after it on are in the totals, without records"
            self._monitor = successor(self._monitor, self.configuration, None, time.time(), more)
            commands.set_crop(self._monitor, self._journal)
            self._record = None
        self._store_note = "; ".join(part for part in (recovery.note, note if kept.full else "") if part)
        _log.warning("%s: %s", self.configuration.store_path, note)
        self._bus.faults.report_all_anew()
        self._report_faults()
        self._commit()
        self._answer = self._snapshot()

    def _keep(self, item: frames.Frame | float) -> None:
        """For when the store is known."""
        if self._kept.add(item):
            _log.error("%s: still does not answer; seconds from now on have no records", self.configuration.store_path)
            # What these count now is what cannot be measured again.
            self._journal.happened(self._monitor.reset_totals())

    def _open_store(self) -> Store:
        return Store(self.configuration.store_path, self.configuration.retention, computer=self._computer)

    # The engine's thread

    def _round(self) -> None:
        items, empty_until_s = self._bus.items()
        windows = 0
        heard_bus_s: float | None = None
        for item in items:
            if isinstance(item, BusEvent):
                self._bus.take_event(item)
            else:
                windows += self._take_message(item)
                heard_bus_s = item.timestamp
        if heard_bus_s is not None:
            self._bus.time.heard(heard_bus_s, monotonic())
        silent_until_s = self._bus.silent_until_s(empty_until_s)
        if silent_until_s is not None:
            windows += self._feed(silent_until_s)
        if self._bus.poll(self._monitor.due_s):
            self._answer = self._snapshot()
        self._report_faults()
        # A command has ended the wait for frames early.
        asked = self._commands.waiting
        self._do_commands()
        if windows:
            self._post()
        between_windows = bool(windows or not (items or asked))
        if self._reading_store is not None and self._reading_store.done and between_windows:
            self._take_late_store(self._reading_store)
        if self._reload_wanted and not self._reloads.under_way:
            # Before the reading: what is written from now on may need another one.
            self._reload_wanted = False
            self._manager.reloading()
            self._reloads.begin()
        # Between two windows a new monitor has least to miss; a quiet bus has none.
        if between_windows and self._reloads.due:
            self._do_reload()
        require_alive(self._threads())

    def _threads(self) -> dict[str, bool]:
        """Those without which measuring is of no use, and whether they are alive."""
        own = {} if self._reading_store is not None else {"store": self._writer.alive}
        return {"receive": self._receiver.alive, "transmit": self._transmitter.alive, **own}

    def _take_message(self, message: can.Message) -> int:
        """One message; returns how many windows it closed."""
        return sum(self._feed(frame) for frame in self._bus.hear(message))

    def _feed(self, item: frames.Frame | float) -> int:
        """A frame, or a bus time up to which there is none; returns how many windows that closed."""
        if self._reading_store is not None:
            self._keep(item)
        results = self._monitor.feed(item) if isinstance(item, frames.Frame) else self._monitor.tick(item)
        return self._happened(results) if results else 0

    def _happened(self, results: Sequence[Result]) -> int:
        """Frames go out, records and events to the journal; with a window the second is done. Returns the windows closed."""
        self._bus.send(results, self._monitor.totals)
        completed = self._monitor.completed(results)
        rows = self._journal.take(completed)
        if rows:
            self._rows.extend(rows)
            self._record = records_in(completed)[-1]
            self._second_done()
        return len(rows)

    def _second_done(self) -> None:
        """A window has closed: the engine lives, its frames are out, and the second goes to the store."""
        self._fill_new_store()
        self._bus.report_second(self._record, self._monitor.faults.active, self._monitor.totals)
        self._commit()
        if self._bus.lives:
            # A daemon that hears or says nothing any more is one to start anew.
            self._manager.alive()
        for supervisor in self._supervisors:
            supervisor.look(monotonic())
        self._bus.count_second()
        self._answer = self._snapshot()
        self._manager.status(commands.summary(self._answer))

    def _fill_new_store(self) -> bool:
        """Let the next batch bring all that is known where the store was replaced since the last look; whether it was."""
        replacements = self._writer.health().replacements
        replaced = replacements != self._replacements
        if replaced:
            self._replacements = replacements
            self._journal.report_all()
        return replaced

    def _commit(self) -> None:
        batch = self._journal.batch(self._monitor, time.time(), self._bus.traffic().counters())
        if self._reading_store is None:
            self._writer.submit(batch)
        # Else it has the number of a batch that the store may have already.

    # Faults that only the service sees

    def _report_faults(self) -> None:
        """Reports to the monitor each condition that came, went or changed."""
        changed = self._bus.faults.changes(
            monotonic(),
            sent=self._transmitter.counters(),
            hangs_s=self._bus.hangs_s(),
            store=self._writer.health(),
            store_note=self._store_note,
            network=self._bus.network_troubles(),
        )
        for code, detail in changed.items():
            self._monitor.report_fault(code, bool(detail), detail)

    def _status(self) -> Answer:
        """The last snapshot with its age: the engine's thread makes one each second, whoever asks."""
        age_s = monotonic() - self._answered_s
        return {**self._answer, "age_s": round(age_s, 1), "stale": age_s > _STALE_S}

    # Operator

    def command(self, request: Mapping[str, Any]) -> Answer:
        """Carries out a request as it comes over the control socket; called on any thread but the engine's.

        Raises InputError for a request that is refused, ControlError where the engine does not answer in time.
        """
        if request["command"] == "status":
            return self._status()
        if self._reading_store is not None:
            raise ControlError("the disk has not answered since the start, so the store is not known yet; nothing was done")
        answer = self._commands.ask(request, self._command_loads.of(request, self.configuration.store_path))
        if request["command"] not in commands.QUERIES and not self._writer.wait_until_written(self._patience.written_s):
            _log.warning("%s: done, and not in the store yet", request["command"])
        return answer

    def _do_commands(self) -> None:
        def execute(job: Job) -> Answer:
            return commands.execute(job.request, self._monitor, self._journal, time.time(), job.stored)

        done = self._commands.carry_out(execute)
        if done:
            self._commit()
            self._answer = self._snapshot()
        # What is answered has been handed to the store.
        for job, answer in done:
            job.answer.set_result({**answer, "units": self.configuration.document.units})

    def _post(self) -> None:
        """After a ticket updated the parameters, or an undo brought others back, the last days' loads are measured again, the one
        that is open then once it is closed; what comes of it goes to the store."""
        actions, totals = self._journal.actions, self._monitor.totals
        posted = self._poster.take()
        if posted is not None:
            actions.posted(
                posted.tickets,
                posted.version,
                posted.factors,
                open_load=posted.open_load,
                closed_load=posted.closed_load,
            )
            if posted.factors:
                self._commit()
        if self._monitor.masses_wait or self._poster.busy:
            return
        machine, now_s = self._monitor.machine, self._monitor.bus_time_s
        open_load = totals.load_number if totals.load_open else None
        if actions.restored_waits or actions.waiting:
            # First what an undo brought back: what tickets teach after it counts.
            in_use = self._monitor.estimator.parameters.version
            taken = actions.take_restored() if actions.restored_waits else actions.take_waiting(in_use)
            self._poster.start(machine, *taken, open_load, now_s)
        elif (closed := actions.closed_load(open_load)) is not None:
            number, by = closed
            self._poster.start(machine, by.tickets, by.version, open_load, now_s, number)

    def _do_reload(self) -> None:
        self._reloads.take(self._use)
        self._answer = self._snapshot()
        self._manager.ready()

    def _use(self, new: Configuration) -> list[str]:
        """Goes on with a configuration; returns its sections that will be taken at the next start only."""
        later = at_next_start(self._at_start, new)
        new = usable_now(self._at_start, new)
        fresh = self._journal.parameters.unlike(new.parameters)
        self._commit()
        monitor = successor(self._monitor, new, fresh, time.time(), loads=self._journal.loads)
        commands.set_crop(monitor, self._journal)
        self._monitor, self._record = monitor, None
        # The next batch brings both: the file's name alone would make a start take the parameters before it for the file's.
        self._journal.parameters.configure(new.parameters)
        self._journal.new_monitor(monitor.estimator.parameters, "file")
        self._bus.faults.report_all_anew()
        self.configuration = new
        self._bus.use(new)
        logging.getLogger("yieldmon").setLevel(new.document.logging.level.upper())
        return later

    def _snapshot(self) -> Answer:
        self._answered_s = monotonic()
        return snapshot(
            configuration=self.configuration,
            monitor=self._monitor,
            record=self._record,
            journal=self._journal,
            rows=tuple(self._rows),
            traffic=self._bus.traffic(),
            store=self._writer.health(),
            store_note=self._store_note,
            reload_note=self._reloads.note,
            reloads=self._reloads.count,
            uptime_s=monotonic() - self._started_s,
            network=self._bus.network_status(),
        )

"""The daemon: bus, engine, store, service manager and operator around one monitor.

Threads: the receiver takes frames off the bus, the engine's thread (the caller of `run`) feeds them to the monitor, the
transmitter sends what comes out, the store's writer commits it, the control server answers `yieldmon status`; a configuration
that is read anew is read on one more. Only the engine's thread touches the monitor; the others reach it through queues.
"""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Mapping, Sequence
from time import monotonic
from typing import Any

import can

from yieldmon import frames
from yieldmon.bus.receiver import BusEvent, Receiver
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.results import Result
from yieldmon.service.config.configuration import Configuration
from yieldmon.service.config.reload_check import at_next_start, usable_now
from yieldmon.service.history.late_store import without_sweeps_for
from yieldmon.service.history.remeasuring_thread import RemeasuringThread
from yieldmon.service.history.run_store import RunStore
from yieldmon.service.measuring import Measuring
from yieldmon.service.metrics import MetricsFile
from yieldmon.service.notify import ServiceManager
from yieldmon.service.operator import commands
from yieldmon.service.operator.command_loads import CommandLoads
from yieldmon.service.operator.command_queue import CommandQueue
from yieldmon.service.operator.control import ControlServer
from yieldmon.service.operator.control_protocol import Answer, ControlError
from yieldmon.service.operator.snapshot import snapshot
from yieldmon.service.preloading import preload
from yieldmon.service.reloading import Reloading
from yieldmon.service.storage.writer import StoreWriter
from yieldmon.service.supervision import Supervisor, ended, require_alive
from yieldmon.service.timeouts import DEFAULT, Timeouts
from yieldmon.service.traffic.bus_node import BusNode
from yieldmon.service.traffic.transmit import Transmitter

_log = logging.getLogger(__name__)

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
        timeouts: Timeouts = DEFAULT,
    ) -> None:
        """reload: reads the configuration anew, on a thread of its own; raises InputError when it cannot be used. bus_factory:
        opens the bus, by default the configured one. network_clock: times the address claim and what else the network's protocols
        time."""
        self.configuration = configuration
        self._at_start = configuration
        self._manager = ServiceManager(environment)
        self._reloading = Reloading(reload, timeouts.reload_s)
        self._bus = BusNode(
            configuration,
            bus_factory=bus_factory,
            silence_s=timeouts.silence_s,
            listen_s=timeouts.listen_s,
            clock=network_clock,
        )
        self._receiver, self._transmitter = self._bus.receiver, self._bus.transmitter
        self._timeouts = timeouts
        self.started = threading.Event()
        """Set once frames are taken and commands answered."""
        # Plain flags: a signal handler runs between any two instructions of this thread, where it may hold any lock.
        self._stop_wanted = self._reload_wanted = False
        self._commands = CommandQueue(timeouts.command_s, self._receiver.wake)
        self._command_loads = CommandLoads(timeouts.written_s)
        self._started_s = monotonic()
        self._answer: Answer = {}
        self._answered_s = monotonic()
        self._store = RunStore(configuration, timeouts)
        self._writer = self._store.writer
        self._remeasuring = RemeasuringThread(configuration.store_path, self._writer.wait_until_written)
        self._supervisors: list[Supervisor] = []

    @property
    def monitor(self) -> Monitor:
        """The one in use, from the start on; a reload makes another. The engine's thread feeds it."""
        return self._measuring.monitor

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
    def newest_bus_s(self) -> float | None:
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
            self._store.release()

    def _run(self) -> int:
        # Frames are kept from here on, however long the disk takes.
        self._receiver.start()
        try:
            preload()
            if not self._store.read(lambda: self._stop_wanted):
                self._receiver.stop()
                return 0
            memory = self._store.remembered()
            self._measuring = Measuring(self.configuration, memory)
            self._answer = self._snapshot()
            status = self.configuration.document.status
            control = ControlServer(self.configuration.socket_path, status.group, self.command)
        except BaseException:
            self._receiver.stop()
            raise
        metrics = MetricsFile(self.configuration.prometheus_path, status.prometheus_interval_s, self._status)
        self._supervisors = [Supervisor("control", control), Supervisor("metrics", metrics)]
        helpers = (self._bus.transmitter, *((self._writer,) if self._store.known else ()), control, metrics)
        for helper in helpers:
            helper.start()
        self._report_faults()
        self._bus.claim_address()
        self.started.set()
        self._manager.ready()
        for note in self.configuration.notes:
            _log.warning("%s", note)
        _log.info("running on %s %s", self.configuration.document.bus.interface, self.configuration.document.bus.channel)
        if self._store.known:
            _log.info("store %s: %s", self._store.path, memory.in_words)
            if doubt := memory.of_another_machine(self.configuration.machine):
                _log.warning("store %s: %s", self._store.path, doubt)
        try:
            while not self._stop_wanted:
                self._round()
        finally:
            whole = self._end(metrics, control)
        _log.info("stopped; total %.1f kg", self.monitor.totals.total_kg)
        return 0 if whole else 1

    def _end(self, metrics: MetricsFile, control: ControlServer) -> bool:
        """Everything is stopped and written; False where a step failed. None takes for ever."""

        def write() -> None:
            if not self._store.known:
                lost_kg = self.monitor.totals.total_kg
                _log.error("the disk has not answered since the start; %.1f kg measured since then are in no store", lost_kg)
            elif not self._writer.stop(self._timeouts.stop_s):
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

    def _take_late_store(self) -> None:
        """The disk has answered after all: what came meanwhile is measured again from what the store remembers."""
        age_s, without, kept = self._store.reading_age_s, self.monitor, self._store.take_kept()
        recovery = self._store.take()
        memory = without_sweeps_for(recovery.memory, kept.duration_s)
        self._measuring = measuring = Measuring(self.configuration, memory)
        self._writer.start()
        for results in kept.into(measuring.monitor):
            if measuring.take(results):
                self._commit()
        note = f"the disk answered {age_s:.0f} s after the start"
        if kept.full:
            more = without.totals
            note += (
                f"; {more.total_kg:.1f} kg measured after the first {kept.duration_s:.0f} s are in the totals, without records"
            )
            measuring.add(self.configuration, more)
            self._store.note = "; ".join(part for part in (recovery.note, note) if part)
        _log.warning("%s: %s", self._store.path, note)
        self._bus.faults.report_all_anew()
        self._report_faults()
        self._commit()
        self._answer = self._snapshot()

    # The engine's thread

    def _round(self) -> None:
        items, empty_until_s = self._bus.items()
        windows = 0
        newest_bus_s: float | None = None
        for item in items:
            if isinstance(item, BusEvent):
                self._bus.take_event(item)
            else:
                windows += self._take_message(item)
                newest_bus_s = item.timestamp
        if newest_bus_s is not None:
            self._bus.time.frame_came(newest_bus_s, monotonic())
        silent_until_s = self._bus.silent_until_s(empty_until_s)
        if silent_until_s is not None:
            windows += self._feed(silent_until_s)
        if self._bus.poll(self.monitor.due_s):
            self._answer = self._snapshot()
        self._report_faults()
        # A command has ended the wait for frames early.
        asked = self._commands.waiting
        self._do_commands()
        if windows:
            self._post()
        between_windows = bool(windows or not (items or asked))
        if self._store.answers and between_windows:
            self._take_late_store()
        if self._reload_wanted and not self._reloading.under_way:
            # Before the reading: what is written from now on may need another one.
            self._reload_wanted = False
            self._manager.reloading()
            self._reloading.begin()
        # Between two windows a new monitor has least to miss; a quiet bus has none.
        if between_windows and self._reloading.due:
            self._do_reload()
        require_alive(self._threads())

    def _threads(self) -> dict[str, bool]:
        """Those without which measuring is of no use, and whether they are alive."""
        own = {"store": self._writer.alive} if self._store.known else {}
        return {"receive": self._receiver.alive, "transmit": self._transmitter.alive, **own}

    def _take_message(self, message: can.Message) -> int:
        """One message; returns how many windows it closed."""
        return sum(self._feed(frame) for frame in self._bus.receive(message))

    def _feed(self, item: frames.Frame | float) -> int:
        """A frame, or a bus time up to which there is none; returns how many windows that closed."""
        if self._store.keep(item):
            # What these count now is what cannot be measured again.
            self._measuring.reset_totals()
        results = self.monitor.feed(item) if isinstance(item, frames.Frame) else self.monitor.tick(item)
        return self._happened(results) if results else 0

    def _happened(self, results: Sequence[Result]) -> int:
        """Frames go out, records and events to the journal; with a window the second is done. Returns the windows closed."""
        self._bus.send(results, self.monitor.totals)
        windows = self._measuring.take(self.monitor.completed(results))
        if windows:
            self._second_done()
        return windows

    def _second_done(self) -> None:
        """A window has closed: the engine lives, its frames are out, and the second goes to the store."""
        self._fill_new_store()
        self._bus.report_second(self._measuring.record, self.monitor.faults.active, self.monitor.totals)
        self._commit()
        if self._bus.lives:
            # A daemon that receives or sends nothing any more is one to start anew.
            self._manager.alive()
        for supervisor in self._supervisors:
            supervisor.look(monotonic())
        self._bus.count_second()
        self._answer = self._snapshot()
        self._manager.status(commands.summary(self._answer))

    def _fill_new_store(self) -> bool:
        """Let the next batch bring all that is known where the store was replaced since the last look; whether it was."""
        replaced = self._store.replaced()
        if replaced:
            self._measuring.journal.report_all()
        return replaced

    def _commit(self) -> None:
        self._store.submit(self._measuring.batch(self._bus.traffic().counters()))

    # Faults that only the service sees

    def _report_faults(self) -> None:
        """Reports to the monitor each condition that came, went or changed."""
        changed = self._bus.faults.changes(
            monotonic(),
            sent=self._transmitter.counters(),
            hangs_s=self._bus.hangs_s(),
            store=self._writer.health(),
            store_note=self._store.note,
            network=self._bus.network_troubles(),
        )
        for code, detail in changed.items():
            self.monitor.report_fault(code, bool(detail), detail)

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
        if not self._store.known:
            raise ControlError("the disk has not answered since the start, so the store is not known yet; nothing was done")
        begun_s = monotonic()
        if commands.measures_again(request) and not self._writer.wait_until_written(self._timeouts.written_s):
            raise ControlError(
                "the store cannot be written, so it lacks seconds of these loads (`yieldmon status`); nothing was done"
            )
        stored = self._command_loads.of(request, self.configuration.store_path)
        # Who has gone would find it done after all, and ask a second time.
        left_s = begun_s + self._timeouts.answer_s - self._timeouts.written_s - monotonic()
        answer = self._commands.ask(request, stored, left_s)
        if request["command"] not in commands.QUERIES and not self._writer.wait_until_written(self._timeouts.written_s):
            _log.warning("%s: done, and not in the store yet", request["command"])
        return answer

    def _do_commands(self) -> None:
        before = self.monitor
        done = self._commands.carry_out(self._measuring.execute)
        if self.monitor is not before:
            self._bus.faults.report_all_anew()
        if done:
            self._commit()
            self._answer = self._snapshot()
        # What is answered has been handed to the store.
        for job, answer in done:
            job.answer.set_result({**answer, "units": self.configuration.document.units})

    def _post(self) -> None:
        """Measure loads again where tickets or an undo ask for it; what comes of it goes to the store."""
        journal = self._measuring.journal
        if self._remeasuring.take_into(journal.actions):
            self._commit()
        self._remeasuring.start_next(journal, self.monitor)

    def _do_reload(self) -> None:
        self._reloading.take(self._use)
        self._answer = self._snapshot()
        self._manager.ready()

    def _use(self, new: Configuration) -> list[str]:
        """Goes on with a configuration; returns what is said of it: sections that will be taken at the next start only, and
        parameters of another crop."""
        later = at_next_start(self._at_start, new)
        new = usable_now(self._at_start, new)
        self._commit()
        self._measuring.use(new)
        self._bus.faults.report_all_anew()
        self.configuration = new
        self._bus.use(new)
        logging.getLogger("yieldmon").setLevel(new.document.logging.level.upper())
        said = [f"{', '.join(later)} will be taken at the next start"] if later else []
        return [*said, *self._measuring.of_another_crop]

    def _snapshot(self) -> Answer:
        self._answered_s = monotonic()
        return snapshot(
            configuration=self.configuration,
            monitor=self.monitor,
            record=self._measuring.record,
            journal=self._measuring.journal,
            rows=self._measuring.rows,
            traffic=self._bus.traffic(),
            store=self._writer.health(),
            store_note=self._store.note,
            reload_note=self._reloading.note,
            reloads=self._reloading.count,
            uptime_s=monotonic() - self._started_s,
            network=self._bus.network_status(),
        )

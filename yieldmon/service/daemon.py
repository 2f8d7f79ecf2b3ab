"""The daemon: bus, engine, store, service manager and operator around one monitor.

Threads: the receiver takes frames off the bus, the engine's thread (the caller of `run`) feeds them to the monitor, the
transmitter sends what comes out, the store's writer commits it, the control server answers `yieldmon status`. Only the engine's
thread touches the monitor; the others reach it through queues.
"""

from __future__ import annotations

import dataclasses
import logging
import os
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from time import monotonic
from typing import Any, Protocol, cast

import can

from yieldmon import frames
from yieldmon.bus.codec import Codec, FrameError
from yieldmon.bus.opening import open_bus
from yieldmon.bus.receiver import BusEvent, BusEventKind, Receiver
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.results import Result, frames_in, records_in
from yieldmon.errors import InputError
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.frames import Frame
from yieldmon.service import commands
from yieldmon.service.assembly import calibration_age_s, monitor_of
from yieldmon.service.configuration import Configuration
from yieldmon.service.control import Answer, ControlError, ControlServer
from yieldmon.service.input_frames import InputFrames
from yieldmon.service.journal import Journal
from yieldmon.service.link import link_for
from yieldmon.service.mapped_outputs import MappedOutputs, OutputMessage
from yieldmon.service.memory import Memory, choose_parameters
from yieldmon.service.metrics import MetricsFile
from yieldmon.service.notify import ServiceManager
from yieldmon.service.ownership import owned
from yieldmon.service.posting import Poster
from yieldmon.service.recovery import recover
from yieldmon.service.reference_loads import StoredLoad, of_path, reference
from yieldmon.service.rows import SecondRow, kept_second
from yieldmon.service.service_faults import ServiceFaults
from yieldmon.service.snapshot import Rates, snapshot
from yieldmon.service.store import Store
from yieldmon.service.transmit import ASKED_ECHO_S, ECHO_S, Transmitter
from yieldmon.service.writer import StoreWriter

_log = logging.getLogger(__name__)

_BATCH_FRAMES = 512
_WAIT_S = 0.05
#: With no frame of ours for this long the engine's time goes on by the monotonic clock, this much behind it, so that frames
#: still on their way are not late.
SILENCE_S = 0.15
_TICK_DELAY_S = 0.1
_LAST_ROWS = 10
_COMMAND_PATIENCE_S = 5.0
#: From this age on what `status` says is marked as stale.
_STALE_S = 5.0
#: A thread that gives no sign of life for so long is a reason to have the daemon started anew.
_HANGS_FOR_GOOD_S = 8.0
#: How long a stop waits for the disk; with the other steps it is over within 5 s.
STOP_WRITING_S = 1.5

#: Sections of the configuration that a reload cannot change.
_FIXED_AT_START = ("bus", "store", "status", "network")


class _Alive(Protocol):
    @property
    def alive(self) -> bool: ...


@dataclass
class _Job:
    """A command on its way to the engine's thread."""

    request: Mapping[str, Any]
    answer: Future[Answer]
    stored: Sequence[StoredLoad] = ()
    """Loads that it names, as the store has them."""


class Daemon:
    """One run of the service. `request_stop` and `request_reload` may be called from signal handlers and other threads."""

    def __init__(
        self,
        configuration: Configuration,
        reload: Callable[[], Configuration] | None = None,
        *,
        environment: Mapping[str, str] = os.environ,
        bus_factory: Callable[[], can.BusABC] | None = None,
        silence_s: float = SILENCE_S,
        network_clock: Callable[[], float] = monotonic,
        stop_writing_s: float = STOP_WRITING_S,
    ) -> None:
        """reload: reads the configuration anew; raises InputError when it cannot be used. bus_factory: opens the bus, by
        default the configured one. silence_s: see SILENCE_S; infinite for traffic that is not sent in real time.
        network_clock: times the address claim and what else the network's protocols time. stop_writing_s: see STOP_WRITING_S."""
        self.configuration = configuration
        self._reload = reload
        self._manager = ServiceManager(environment)
        self._codec = Codec()
        self._inputs = InputFrames(self._codec, configuration.signals)
        self._link = link_for(configuration)
        self._outputs = MappedOutputs(configuration.outputs, configuration.engine.totals)
        self._network_clock = network_clock
        self._address: int | None = None
        self._silence_s = silence_s
        self._stop_writing_s = stop_writing_s
        self.started = threading.Event()
        """Set once frames are taken and commands answered."""
        # Plain flags: a signal handler runs between any two instructions of this thread, where it may hold any lock.
        self._stop_wanted = False
        self._reload_wanted = False
        self._reloads = 0
        self._commands: queue.SimpleQueue[_Job] = queue.SimpleQueue()
        self._faults = ServiceFaults()
        self._reload_note = "none since the start"
        self._rows: deque[SecondRow] = deque(maxlen=_LAST_ROWS)
        self._record: WindowRecord | None = None
        """Of the last window of the monitor in use."""
        self._malformed = 0
        self._unsendable = 0
        self._started_s = monotonic()
        self._store_note = ""
        self._origin = "file"
        self._last_heard: tuple[float, float] | None = None
        """Bus time and monotonic time of the last frame, whoever sent it."""
        self._ours_s = float("-inf")
        self._answer: Answer = {}
        settings = configuration.document.bus
        self._receiver = Receiver(bus_factory or self._open_bus, capacity=settings.receive_queue_frames)
        self._transmitter = Transmitter(
            self._receiver.send, settings.transmit_queue_frames, settings.transmit_max_age_s,
            echo_s=ASKED_ECHO_S if bus_factory is None and settings.interface == "socketcan" else ECHO_S,
        )  # fmt: skip
        self._writer = StoreWriter(self._open_store, configuration.document.store.pending_seconds, path=configuration.store_path)
        self._poster = Poster(configuration.store_path, self._writer.wait_until_written)
        self._rates = Rates()
        self._threads: Mapping[str, _Alive] = {
            "receive": self._receiver, "transmit": self._transmitter, "store": self._writer,
        }  # fmt: skip
        self._answered_s = monotonic()
        self._replacements = 0

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
        return None if self._last_heard is None else self._last_heard[0]

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
        with owned(self.configuration.store_path):
            return self._run()

    def _run(self) -> int:
        recovery = recover(self.configuration.store_path, self.configuration.retention, self._open_store)
        memory, self._store_note = recovery.memory, recovery.note
        if recovery.made:
            self._writer.expect(recovery.last_batch)
        parameters, self._origin = choose_parameters(memory, self.configuration.parameters)
        self._journal = Journal(memory, self.configuration.parameters, now_s=time.time())
        self._journal.new_monitor(parameters, self._origin)
        self._monitor = _monitor_for(self.configuration, parameters)
        self._resume(memory)
        commands.set_crop(self._monitor, self._journal)
        self._answer = self._snapshot()
        self._receiver.start()
        try:
            status = self.configuration.document.status
            control = ControlServer(self.configuration.socket_path, status.group, self.command)
        except BaseException:
            self._receiver.stop()
            raise
        metrics = MetricsFile(self.configuration.prometheus_path, status.prometheus_interval_s, self._status)
        helpers = (self._transmitter, self._writer, control, metrics)
        for helper in helpers:
            helper.start()
        self._report_faults()
        self._submit(self._link.start(self._network_clock()))
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
        """Each step is taken whatever became of the one before, and none takes for ever. False when one failed."""
        whole = True

        def write() -> None:
            if not self._writer.stop(self._stop_writing_s):
                _log.error("the disk hangs; %d batches are not written", self._writer.health().pending)
            elif self._tell_new_store_all():
                # The last batches went into a new store, which lacks what an earlier one was given.
                self._commit()
                self._writer.work()
                self._writer.close()

        steps = (
            self._manager.stopping, self._transmitter.stop, self._receiver.stop, self._commit, write, metrics.stop, control.stop,
        )  # fmt: skip
        for step in steps:
            try:
                step()
            except Exception:  # noqa: BLE001 - the disk is still to be written to when anything else fails
                _log.exception("stopping")
                whole = False
        return whole

    # Start

    def _open_bus(self) -> can.BusABC:
        settings = self.configuration.document.bus
        # Our own messages are let through as well: seen from another node they are a conflict.
        return open_bus(
            settings.interface,
            settings.channel,
            settings.bitrate_bit_s,
            filters=[*self._inputs.filters(), *self._outputs.filters(), *self._link.filters()],
            # A copy that comes back once is our own; without it, another node's first copy would pass for it.
            receive_own=settings.interface == "socketcan",
            receive_buffer_bytes=settings.receive_buffer_bytes,
            **cast("dict[str, Any]", settings.options),
        )

    def _open_store(self) -> Store:
        return Store(self.configuration.store_path, self.configuration.retention)

    def _resume(self, memory: Memory) -> None:
        now_s = time.time()
        if memory.engine is None:
            age_s = calibration_age_s(self.configuration.parameters, now_s)
            self._monitor.set_estimator(self._monitor.estimator, age_s)
            return
        age_s = memory.engine.calibration_age_s
        if self._origin == "file":
            age_s = calibration_age_s(self.configuration.parameters, now_s)
        elif age_s is not None:
            age_s += max(0.0, now_s - memory.saved_s)
        self._monitor.restore(dataclasses.replace(memory.engine, calibration_age_s=age_s))
        self._monitor.remember_since_zero([kept_second(row) for row in memory.since_zero])
        for stored in memory.ticketed if self._origin == "store" else ():
            found = reference(stored, self._monitor.machine, self._monitor.settings.windows.min_coverage)
            self._monitor.know_load(found.summary, found.seconds)
        self._monitor.remember_tickets(memory.engine.tickets)

    # The engine's thread

    def _round(self) -> None:
        # Read before the queue: what came by then is in there.
        empty_until_s = self._receiver.empty_until_s
        self._window_closed = False
        items = self._receiver.get_many(_BATCH_FRAMES, _WAIT_S)
        for item in items:
            if isinstance(item, BusEvent):
                self._take_event(item)
            else:
                self._take_message(item)
        self._tick_if_silent(empty_until_s if not items else float("-inf"))
        self._receiver.due_s = self._monitor.due_s
        self._submit(self._link.poll(self._network_clock()))
        self._send_mapped(self._outputs.poll(self._network_clock()))
        if self._link.address != self._address:
            self._address = self._link.address
            self._answer = self._snapshot()
        self._report_faults()
        self._do_commands()
        if self._window_closed:
            self._post()
        # Between two windows, where a new monitor has least to miss; a quiet bus has none.
        if self._reload_wanted and (self._window_closed or not items):
            self._reload_wanted = False
            self._do_reload()
        for name, thread in self._threads.items():
            if not thread.alive:
                raise RuntimeError(f"the {name} thread has died")

    def _take_message(self, message: can.Message) -> None:
        self._last_heard = (message.timestamp, monotonic())
        try:
            heard = self._inputs.heard(message)
        except FrameError as error:
            # To the network it may still be a frame, the last one of a message that is too short for the mapping.
            heard = []
            self._malformed += 1
            if self._malformed == 1:
                _log.warning("%s", error)
        concerned = self._link.concerns(message)
        published = [frame.message for frame in heard if frame.message in frames.OUTPUTS]
        mapped = self._outputs.name_of(message, self._link.address)
        if (concerned or published or mapped) and self._transmitter.is_echo(message):
            return
        if concerned:
            self._submit(self._link.hear(message, self._network_clock()))
        for frame in heard:
            if frame.message not in frames.OUTPUTS:
                self._ours_s = frame.time_s
                self._happened(self._monitor.feed(frame))
        for name in (*(published if self.configuration.outputs.shipped else ()), *([mapped] if mapped else ())):
            self._faults.conflict(name, monotonic())

    def _tick_if_silent(self, empty_until_s: float) -> None:
        """Lets the engine's time go on without frames of ours: as far as others' frames say, or the bus is known to be empty."""
        if self._last_heard is None:
            # No frame yet, so no bus time either; the system's clock is as good a start as any, once it is needed.
            if monotonic() - self._started_s > self.configuration.document.bus.idle_after_s:
                self._last_heard = (time.time(), monotonic())
                self._happened(self._monitor.tick(self._last_heard[0]))
            return
        bus_s, heard_s = self._last_heard
        if empty_until_s - heard_s > self._silence_s:
            self._happened(self._monitor.tick(bus_s + (empty_until_s - heard_s) - _TICK_DELAY_S))
        elif abs(bus_s - self._ours_s) > self._silence_s:
            self._happened(self._monitor.tick(bus_s))

    def _happened(self, results: Sequence[Result]) -> None:
        """Frames go out, records and events to the journal; with a window the second is done."""
        if not results:
            return
        if self.configuration.outputs.shipped:
            self._send(frames_in(results))
        self._send_mapped(self._outputs.take(results, self._monitor.totals, self._network_clock()))
        rows = self._journal.take(results)
        if rows:
            self._rows.extend(rows)
            self._record = records_in(results)[-1]
            self._second_done()

    def _send(self, out: list[Frame]) -> None:
        for frame in out:
            try:
                # A late command is worse than none.
                waits_from_s = None if frame.message == frames.PLATE_ACTUATOR_COMMAND else self._network_clock()
                message = self._link.addressed(self._codec.encode(frame), waits_from_s)
            except FrameError as error:
                self._unsendable += 1
                if self._unsendable == 1:
                    _log.error("%s", error)
                continue
            if message is not None:
                self._transmitter.submit(message)

    def _send_mapped(self, out: Iterable[OutputMessage]) -> None:
        for item in out:
            message: can.Message | None = item.message
            if item.own_address:
                if self._link.address is not None:
                    item.message.arbitration_id = item.message.arbitration_id & ~0xFF | self._link.address
                message = self._link.addressed(item.message, self._network_clock() if item.may_wait else None)
            if message is not None:
                self._transmitter.submit(message)

    def _submit(self, messages: Iterable[can.Message]) -> None:
        for message in messages:
            self._transmitter.submit(message)

    _window_closed = False

    def _second_done(self) -> None:
        """A window has closed: the engine lives, its frames are out, and the second goes to the store."""
        self._window_closed = True
        self._tell_new_store_all()
        self._tell_network()
        self._commit()
        if max(self._receiver.hangs_s(), self._transmitter.hangs_s()) < _HANGS_FOR_GOOD_S:
            # A daemon that hears or says nothing any more is one to start anew.
            self._manager.alive()
        self._rates.second(monotonic(), self._receiver.counters().received)
        self._answer = self._snapshot()
        self._manager.status(commands.summary(self._answer))

    def _tell_new_store_all(self) -> bool:
        """Let the next batch bring all that is known where the store was replaced since the last look; whether it was."""
        replacements = self._writer.health().replacements
        replaced = replacements != self._replacements
        if replaced:
            self._replacements = replacements
            self._journal.report_all()
        return replaced

    def _tell_network(self) -> None:
        """Trouble codes, and the second's values for a task controller."""
        now_s = self._network_clock()
        if self.configuration.document.diagnostics.dm1_enabled:
            self._submit(self._link.tell_trouble(self._monitor.faults.active, now_s))
        if self._record is not None:
            self._submit(self._link.tell_second(self._record, self._monitor.totals, now_s))

    def _commit(self) -> None:
        self._writer.submit(self._journal.batch(self._monitor, time.time(), self._counters()))

    def _counters(self) -> dict[str, int]:
        received, sent = self._receiver.counters(), self._transmitter.counters()
        return {
            "starts": 1,
            "frames_received": received.received,
            "frames_dropped": received.dropped,
            "kernel_drops": received.kernel_drops,
            "error_frames": received.error_frames,
            "bus_offs": received.bus_offs,
            "interface_losses": received.interface_losses,
            "frames_malformed": self._malformed,
            "frames_sent": sent.sent,
            "frames_late": sent.late,
            "frames_refused": sent.failed,
        }

    # Faults that only the service sees

    def _take_event(self, event: BusEvent) -> None:
        self._faults.bus_event(event, monotonic())
        if event.kind is BusEventKind.INTERFACE_RESTORED:
            self._submit(self._link.start(self._network_clock()))

    def _report_faults(self) -> None:
        """Reports to the monitor each condition that came, went or changed."""
        changed = self._faults.changes(
            monotonic(),
            sent=self._transmitter.counters(),
            hangs_s={"receive": self._receiver.hangs_s(), "transmit": self._transmitter.hangs_s()},
            store=self._writer.health(),
            store_note=self._store_note,
            network=self._link.troubles(self._network_clock()),
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
        job = _Job(request, Future(), self._stored(request))
        self._commands.put(job)
        try:
            return job.answer.result(_COMMAND_PATIENCE_S)
        except TimeoutError:
            # What was said to have failed must not be done later.
            if not job.answer.cancel():
                return job.answer.result()
            raise ControlError("the engine did not answer in time; nothing was done") from None

    def _stored(self, request: Mapping[str, Any]) -> Sequence[StoredLoad]:
        """Loads that a ticket names, read here and not on the engine's thread, which must not wait for a disk."""
        numbers = commands.ticketed_loads(request)
        if not numbers:
            return ()
        try:
            return of_path(self.configuration.store_path, numbers)
        except InputError as error:
            _log.warning("loads of an earlier run cannot be read: %s", error)
            return ()

    def _do_commands(self) -> None:
        done = False
        while not self._commands.empty():
            job = self._commands.get()
            if not job.answer.set_running_or_notify_cancel():
                continue
            try:
                answer = commands.execute(job.request, self._monitor, self._journal, time.time(), job.stored)
                job.answer.set_result({**answer, "units": self.configuration.document.units})
                done = True
            except InputError as error:
                job.answer.set_exception(error)
        if done:
            self._commit()
            self._answer = self._snapshot()

    def _post(self) -> None:
        """After a ticket updated the parameters, the last days' loads are measured again; what comes of it goes to the store."""
        posted = self._poster.take()
        if posted is not None and posted.factors:
            self._journal.actions.posted(posted.tickets, posted.version, posted.factors)
            self._commit()
        if self._journal.actions.waiting and not self._monitor.masses_wait and not self._poster.busy:
            totals, now_s = self._monitor.totals, self._monitor.bus_time_s
            version = self._monitor.estimator.parameters.version
            open_load = totals.load_number if totals.load_open else None
            self._poster.start(self._monitor.machine, self._journal.actions.take_waiting(), version, open_load, now_s)

    def _do_reload(self) -> None:
        """Takes the configuration anew, or goes on with the old one and says so."""
        self._manager.reloading()
        self._reloads += 1
        try:
            if self._reload is None:
                raise InputError("reload", "this run has no configuration file")
            self._use(self._reload())
        except (InputError, OSError) as error:
            # A file that could not be read this time is no reason to stop measuring.
            self._reload_note = f"refused: {error}"
            _log.error("reload refused, going on as before: %s", error)
        self._answer = self._snapshot()
        self._manager.ready()

    def _use(self, new: Configuration) -> None:
        old = self.configuration
        if new.signals != old.signals:
            raise InputError("signals", "changed with the service running", "a restart: the bus is filtered for them")
        if new.outputs != old.outputs:
            raise InputError("outputs", "changed with the service running", "a restart: the bus is filtered for them")
        fixed = [name for name in _FIXED_AT_START if getattr(new.document, name) != getattr(old.document, name)]
        fresh = self._journal.parameters.read_anew(new.parameters)
        state = self._monitor.snapshot()
        self._commit()
        if fresh is not None:
            state = dataclasses.replace(state, calibration_age_s=calibration_age_s(fresh, time.time()))
        monitor = _monitor_for(new, fresh or self._monitor.estimator.parameters)
        monitor.restore(state)
        if fresh is None:
            monitor.take_tickets_of(self._monitor)
        commands.set_crop(monitor, self._journal)
        self._monitor, self._record = monitor, None
        # The next batch brings the parameters.
        self._journal.new_monitor(monitor.estimator.parameters, "file")
        self._faults.report_all_anew()
        self.configuration = new
        self._outputs = MappedOutputs(new.outputs, new.engine.totals)
        logging.getLogger("yieldmon").setLevel(new.document.logging.level.upper())
        self._reload_note = "taken" + (f"; {', '.join(fixed)} will be at the next start" if fixed else "")
        _log.info("configuration reloaded: %s", self._reload_note)
        for note in new.notes:
            _log.warning("%s", note)

    def _snapshot(self) -> Answer:
        self._answered_s = monotonic()
        return snapshot(
            configuration=self.configuration,
            monitor=self._monitor,
            record=self._record,
            journal=self._journal,
            rows=tuple(self._rows),
            received=self._receiver.counters(),
            sent=self._transmitter.counters(),
            store=self._writer.health(),
            store_note=self._store_note,
            frames_per_s=self._rates.frames_per_s,
            malformed=self._malformed,
            incomplete=self._inputs.incomplete,
            reload_note=self._reload_note,
            reloads=self._reloads,
            uptime_s=monotonic() - self._started_s,
            network=self._link.status(),
        )


def _monitor_for(configuration: Configuration, parameters: ParameterSet) -> Monitor:
    return monitor_of(configuration, parameters)

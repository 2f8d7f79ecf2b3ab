"""The daemon beside a virtual combine in simulated time: its own threads, store, journal and reload, nothing replaced.

The combine is the bus. Between two instants at which the engine has something to do (`Monitor.due_s`) frames flow freely; at each
of them the combine waits until the daemon has taken all frames and sent all answers. So the outcome does not depend on the
machine's speed, and simulated time runs as fast as the two can compute.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import can

from yieldmon import frames
from yieldmon.bus.codec import Codec
from yieldmon.frames import Frame
from yieldmon.plant.combine import VirtualCombine
from yieldmon.service.config import configuration
from yieldmon.service.daemon import Daemon
from yieldmon.service.timeouts import Timeouts

_PATIENCE_S = 60.0


class SteppedDaemon:
    """A daemon that runs as long as this context is entered, its time in the caller's hands.

    path: configuration file; the store lies in `folder`. START: the combine's time 0 in bus time.
    """

    START_S = 1_790_000_000.0

    def __init__(self, combine: VirtualCombine, path: Path, folder: Path) -> None:
        self._environment = {"STATE_DIRECTORY": str(folder), "RUNTIME_DIRECTORY": str(folder)}
        self._path = path
        self._combine = combine
        self._bus = _CombineBus(combine, self.START_S)
        self.daemon = _CountingDaemon(self._load(), self._load, self._environment, lambda: self._bus)
        self._bus.daemon = self.daemon
        self._failure: list[BaseException] = []
        self._thread = threading.Thread(target=self._body, name="stepped-daemon")

    def __enter__(self) -> SteppedDaemon:
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._bus.end()
        self.daemon.request_stop()
        self._thread.join()
        if self._failure and exception == (None, None, None):
            raise self._failure[0]

    def run_until(self, time_s: float, progress: Callable[[float], None] = lambda time_s: None) -> None:
        """Let the combine work until its time_s, and the daemon take and store all of it."""
        with self._bus.changed:
            self._bus.until_s, self._bus.arrived = time_s, False
            self._bus.changed.notify_all()
            while not self._bus.arrived:
                self._bus.changed.wait(0.5)
                self._raise_failure()
                progress(self._bus.time_s)
        if not self.daemon.written(_PATIENCE_S):
            raise TimeoutError(f"the store did not take the records within {_PATIENCE_S:.0f} s")

    def reload(self) -> str:
        """What the daemon made of its configuration, read anew as on SIGHUP."""
        before = self.daemon.reload_count
        self.daemon.request_reload()
        with self._bus.changed:
            while self.daemon.reload_count == before:
                self._bus.changed.wait(0.05)
                self._raise_failure()
        return self.daemon.reload_note

    def _load(self) -> configuration.Configuration:
        loaded = configuration.load(self._path, self._environment)
        # A claim takes half a second of real time, in which hours pass here.
        off = loaded.document.network.model_copy(update={"enabled": False})
        return replace(loaded, document=loaded.document.model_copy(update={"network": off}))

    def _body(self) -> None:
        try:
            self.daemon.run()
        except BaseException as error:  # noqa: BLE001 - raised again on the caller's thread
            self._failure.append(error)

    def _raise_failure(self) -> None:
        if self._failure:
            raise self._failure[0]
        if self._thread.ident is not None and not self._thread.is_alive():
            raise RuntimeError("the daemon has ended")


class _CountingDaemon(Daemon):
    """Counts what it has taken and what it has given to the transmitter."""

    def __init__(
        self,
        configured: configuration.Configuration,
        reload: Callable[[], configuration.Configuration],
        environment: Mapping[str, str],
        bus_factory: Callable[[], can.BusABC],
    ) -> None:
        timeouts = Timeouts(silence_s=math.inf)
        super().__init__(configured, reload, environment=environment, bus_factory=bus_factory, timeouts=timeouts)
        self.taken = 0
        self.submitted = 0
        self.reload_count = 0
        self.stepped: threading.Condition | None = None
        submit = self.transmitter.submit

        def counted(*messages: can.Message) -> None:
            self.submitted += len(messages)
            submit(*messages)

        self.transmitter.submit = counted  # type: ignore[method-assign]

    @property
    def due_s(self) -> float:
        """Bus time of the next frame at which the engine acts."""
        return self.monitor.due_s

    @property
    def reload_note(self) -> str:
        """Of the last reload."""
        return self._reloading.note

    def written(self, timeout_s: float) -> bool:
        """Whether all records are in the store within timeout_s."""
        return self._writer.wait_until_written(timeout_s)

    def _take_message(self, message: can.Message) -> int:
        windows = super()._take_message(message)
        self.taken += 1
        self._report()
        return windows

    def _do_reload(self) -> None:
        super()._do_reload()
        self.reload_count += 1
        self._report()

    def _report(self) -> None:
        if self.stepped is not None:
            with self.stepped:
                self.stepped.notify_all()


class _CombineBus(can.BusABC):
    """The combine as the daemon's bus."""

    def __init__(self, combine: VirtualCombine, start_s: float) -> None:
        super().__init__(channel="virtual combine")
        self.changed = threading.Condition()
        self.until_s = 0.0
        self.time_s = 0.0
        self.arrived = False
        self.daemon: _CountingDaemon
        self._combine = combine
        self._start_s = start_s
        self._codec = Codec()
        self._frames: Iterator[Frame] = combine.frames_until(combine.scenario.duration_s)
        self._waiting: Frame | None = None
        self._given = self._heard = 0
        self._ended = False
        self._due = False

    def end(self) -> None:
        """Nothing more will come."""
        with self.changed:
            self._ended = True
            self.changed.notify_all()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """What the daemon says; commands reach the plate."""
        frame = self._codec.decode(msg)
        if frame is not None and frame.message == frames.PLATE_ACTUATOR_COMMAND:
            self._combine.handle(frame._replace(time_s=self.time_s))
        with self.changed:
            self._heard += 1
            self.changed.notify_all()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        self.daemon.stepped = self.changed
        # Before there is a monitor nobody says when a frame is due.
        if not self.daemon.started.wait(timeout):
            return None, True
        with self.changed:
            if self._due and not self._settled(timeout):
                return None, True
            self._due = False
            if self._waiting is None:
                self._waiting = next(self._frames, None)
            frame = self._waiting
            if frame is None or frame.time_s > self.until_s or self._ended:
                if self._settled(timeout):
                    self.arrived = True
                    self.changed.notify_all()
                    self.changed.wait(timeout)
                return None, True
            self._waiting = None
            self.time_s = frame.time_s
            message = self._codec.encode(frame)
            message.timestamp = self._start_s + frame.time_s
            self._due = message.timestamp >= self.daemon.due_s
            self._given += 1
            return message, True

    def _settled(self, timeout: float | None) -> bool:
        """Whether the daemon has taken and answered all that was given, waiting for it."""
        return self.changed.wait_for(
            lambda: (self.daemon.taken == self._given and self.daemon.submitted == self._heard) or self._ended, timeout
        )

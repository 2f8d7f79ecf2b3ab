"""A daemon on a virtual bus, and a peer that plays sensor and combine faster than time: its frames carry their own times."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import itertools
import json
import math
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import can
import pytest

from tests.schema_check import problems
from yieldmon import frames
from yieldmon.bus.codec import Codec
from yieldmon.cli import main as cli
from yieldmon.frames import NOT_AVAILABLE, Frame
from yieldmon.service.config import configuration
from yieldmon.service.daemon import Daemon
from yieldmon.service.timeouts import Timeouts

CODEC = Codec()
START_S = 1_760_000_000.0
ZERO_MV = 120.0
PATIENCE_S = 120.0
EMPTY_MV, GRAIN_MV = 0.0, 60.0
"""Above the zero: an empty elevator, and grain."""
UNHURRIED = Timeouts(
    silence_s=math.inf,
    listen_s=0.01,
    store_s=PATIENCE_S,
    reload_s=PATIENCE_S,
    command_s=PATIENCE_S,
    answer_s=math.inf,
    stop_s=60.0,
)
"""For machines that other tests keep busy, and traffic that is not sent in real time."""
_channels = itertools.count()


def traffic(
    start_s: float, duration_s: float, force_mv: float, angle_deg: float = 70.0, speed_rpm: float = 400.0
) -> Iterator[Frame]:
    """Nominal traffic at a constant mean signal with pulses at the paddles' pace, in order of time; counters by time."""
    first = round(start_s * 250)
    samples = _samples(round((start_s + duration_s) * 250) - first, force_mv, speed_rpm)
    for number, volts in enumerate(samples, first):
        at_s = number / 250.0
        yield Frame(at_s, frames.IMPACT_SENSOR_SAMPLES, {**volts, "SampleCounter": number % 256, "SensorStatus": 0})
        for message, signals in _beside(number, angle_deg, speed_rpm):
            yield Frame(at_s, message, dict(signals))


@functools.lru_cache(maxsize=256)
def _samples(count: int, force_mv: float, speed_rpm: float) -> list[dict[str, float]]:
    """Of so many frames, 250 a second."""
    pass_hz = speed_rpm / 60.0 * 2.0 * math.pi * 0.0541 / 0.18635
    found = []
    for number in range(count):
        volts = {}
        for k in range(frames.SAMPLES_PER_FRAME):
            phase = 2.0 * math.pi * pass_hz * (number / 250.0 + 0.001 * k)
            ripple = force_mv * math.sin(phase) + 0.8 * math.sin(1.7 * phase + 0.3)
            volts[f"Sample{k}"] = max(0.0, round(2.0 * (ZERO_MV + force_mv + ripple)) / 2.0)
        found.append(volts)
    return found


def _beside(number: int, angle_deg: float, speed_rpm: float) -> Iterator[tuple[str, tuple[tuple[str, object], ...]]]:
    """Messages and signals that are sent with the frame of samples of this number."""
    if number % 25 == 0:
        yield frames.ELEVATOR_SPEED, (("ElevatorSpeed", speed_rpm),)
    if number % 12 == 0:
        yield frames.PLATE_ACTUATOR_FEEDBACK, (("PlateAngle", angle_deg), ("ActuatorState", 0))
    if number % 250 == 0:
        yield frames.GRAIN_CONDITION, (("Moisture", 15.5), ("GrainTemperature", 20.0), ("TestWeight", NOT_AVAILABLE))


class _HandedOn(can.Message):
    """A message that the virtual bus need not copy for each listener, since nobody changes it."""

    __slots__ = ()

    def __deepcopy__(self, memo: dict[int, object]) -> can.Message:
        return self


def encoded(frame: Frame) -> can.Message:
    """The frame as a message for the virtual bus."""
    message = CODEC.encode(frame)
    message.__class__ = _HandedOn
    return message


def messages(start_s: float, duration_s: float, force_mv: float, angle_deg: float = 70.0, speed_rpm: float = 400.0):
    """`traffic` as messages; what is sent again with another counter or time is not encoded again."""
    first = round(start_s * 250)
    payloads = _payloads(round((start_s + duration_s) * 250) - first, force_mv, speed_rpm)
    for number, payload in enumerate(payloads, first):
        at_s = number / 250.0
        yield _message(at_s, frames.IMPACT_SENSOR_SAMPLES, (payload ^ _counter(number % 256)).to_bytes(8, "big"))
        for message, signals in _beside(number, angle_deg, speed_rpm):
            yield _message(at_s, message, _data(message, signals))


@functools.lru_cache(maxsize=256)
def _payloads(count: int, force_mv: float, speed_rpm: float) -> list[int]:
    """Data of frames of samples whose counters are 0."""
    return [_payload(volts, 0) for volts in _samples(count, force_mv, speed_rpm)]


@functools.lru_cache(maxsize=256)
def _counter(counter: int) -> int:
    """Bits by which a frame's data differ with this counter from those with 0."""
    volts = {f"Sample{k}": 0.0 for k in range(frames.SAMPLES_PER_FRAME)}
    return _payload(volts, counter) ^ _payload(volts, 0)


def _payload(volts: dict[str, float], counter: int) -> int:
    signals = {**volts, "SampleCounter": counter, "SensorStatus": 0}
    return int.from_bytes(CODEC.encode(Frame(0.0, frames.IMPACT_SENSOR_SAMPLES, signals)).data, "big")


@functools.lru_cache(maxsize=256)
def _data(message: str, signals: tuple[tuple[str, object], ...]) -> bytes:
    return bytes(CODEC.encode(Frame(0.0, message, dict(signals))).data)


def _message(at_s: float, message: str, data: bytes) -> can.Message:
    return _HandedOn(timestamp=at_s, arbitration_id=CODEC.layouts[message].frame_id, is_extended_id=True, data=data)


def wait_for(condition: Callable[[], object], what: str) -> None:
    """Waits until the condition holds; fails loudly when it does not within PATIENCE_S."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, f"still waiting for: {what}"
        threading.Event().wait(0.005)


@dataclass
class Bench:
    """The daemon under test and its peer."""

    daemon: Daemon
    peer: can.BusABC
    now_s: float = START_S
    seen: list[can.Message] = field(default_factory=list)
    failure: list[BaseException] = field(default_factory=list)
    thread: threading.Thread | None = None
    _signals: dict[int, dict] = field(default_factory=dict)
    """Of the messages in `seen`, by their identity."""

    def play(self, duration_s: float, force_mv: float, **how: float) -> None:
        """Sends traffic for so long, as fast as the daemon takes it."""
        for message in messages(self.now_s, duration_s, force_mv, **how):
            self.peer.send(message)
        self.now_s += duration_s

    def played(self) -> None:
        """Waits until the engine has worked off what was played, but for the last open window."""
        # Windows end a tenth after the full second.
        last = math.floor(self.now_s - 0.11)
        wait_for(lambda: self.rows and self.rows[-1]["time_s"] >= last, f"window {last}, have {self.rows[-1:]}")

    def taken(self) -> None:
        """Waits until the engine has taken the last samples that were played: a command before them ends a load earlier."""
        wait_for(lambda: self.daemon.monitor.bus_time_s > self.now_s - 0.006, "the last samples that were played")

    @property
    def status(self) -> dict:
        return dict(self.daemon.snapshot)

    @property
    def rows(self) -> list[dict]:
        return self.status.get("windows", [])

    @property
    def faults(self) -> dict[str, str]:
        return {fault["code"]: fault["detail"] for fault in self.status["faults"]}

    def published(self, message: str) -> list[dict]:
        """Signals of the daemon's frames of this name so far."""
        identifier = CODEC.layouts[message].frame_id
        return [dict(self._signals_of(frame)) for frame in self.heard() if frame.arbitration_id == identifier]

    def _signals_of(self, frame: can.Message) -> dict:
        if id(frame) not in self._signals:
            self._signals[id(frame)] = dict(CODEC.decode(frame).signals)
        return self._signals[id(frame)]

    def heard(self) -> list[can.Message]:
        """The daemon's frames so far."""
        while (received := self.peer.recv(0)) is not None:
            self.seen.append(received)
        return self.seen

    def start(self) -> None:
        def body() -> None:
            try:
                self.daemon.run()
            except BaseException as error:  # noqa: BLE001 - handed to the test's own thread
                self.failure.append(error)

        self.thread = threading.Thread(target=body)
        self.thread.start()
        wait_for(lambda: self.daemon.started.is_set() or self.failure, "the daemon's start")
        wait_for(lambda: self.status.get("network", {}).get("address") or self.failure, "the daemon's address")

    def stop(self) -> None:
        self.daemon.request_stop()
        self.daemon.receiver.wake()
        assert self.thread is not None
        self.thread.join(PATIENCE_S)
        assert not self.thread.is_alive()
        self.peer.shutdown()
        if self.failure:
            raise self.failure[0]


def warm_up(bench: Bench) -> None:
    """Zero learnt, then grain for a few seconds."""
    bench.play(14, EMPTY_MV)
    bench.play(6, GRAIN_MV)
    bench.played()


def ask(folder: Path, capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    """The answer to a command as `yieldmon WORDS --json` prints it."""
    assert cli.main([*words, "--socket", str(folder / "yieldmon.sock"), "--json"]) == 0
    answer: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert problems(answer, _schema_of(*words)) == []
    return answer


def _schema_of(verb: str, action: str = "", *_: str) -> str:
    """The published schema of what such a command prints."""
    if verb in ("load", "calibrations") or action in ("list", "undo"):
        return f"{verb}-{action}"
    return "zero-undo" if action == "--undo" else verb


@contextlib.contextmanager
def running(
    folder: Path,
    text: str = "",
    notify: socket.socket | None = None,
    start_s: float = START_S,
    socketcan: str | None = None,
    state: Path | None = None,
    **timeouts: float,
) -> Iterator[Bench]:
    """A running daemon whose state lies in `state` or `folder`, with the configuration `text` in folder/c.yaml.

    On a virtual bus, or on the SocketCAN interface that its configuration then has to name. timeouts: where it is another than
    `UNHURRIED`.
    """
    channel = socketcan or f"service-{next(_channels)}"
    path = folder / "c.yaml"
    path.write_text(text or "bus: {transmit_max_age_s: 60}")
    environment = {"STATE_DIRECTORY": str(state or folder), "RUNTIME_DIRECTORY": str(folder)}
    if notify is not None:
        environment |= {"NOTIFY_SOCKET": str(notify.getsockname()), "WATCHDOG_USEC": "10000000"}

    def load() -> configuration.Configuration:
        return configuration.load(path, environment)

    daemon = Daemon(
        load(),
        load,
        environment=environment,
        bus_factory=None if socketcan else lambda: can.Bus(interface="virtual", channel=channel),
        # A claim takes half a second.
        network_clock=time.monotonic if socketcan else lambda: 20.0 * time.monotonic(),
        timeouts=dataclasses.replace(UNHURRIED, **timeouts),
    )
    if socketcan:
        peer = can.Bus(interface="socketcan", channel=channel)
    else:
        peer = can.Bus(interface="virtual", channel=channel, preserve_timestamps=True)
    bench = Bench(daemon, peer, start_s)
    bench.start()
    try:
        yield bench
    finally:
        bench.stop()

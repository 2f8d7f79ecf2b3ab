"""Nodes on a real CAN interface as processes of their own: the daemon, the virtual combine, and can-utils' recorder.

The project's commands are forked rather than started anew: in the emulated guest the imports alone take half a minute.
"""

from __future__ import annotations

import itertools
import math
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import cantools
import numpy as np

from yieldmon import frames
from yieldmon.bus.codec import Codec
from yieldmon.bus.opening import open_bus
from yieldmon.cli import run, simulate
from yieldmon.cli.main import main
from yieldmon.files import parameter_file
from yieldmon.frames import Frame
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.plant.actuator import ActuatorFault, ActuatorSettings, PlateActuator
from yieldmon.resources import shipped
from yieldmon.service.control import ControlError, ask
from yieldmon.service.store import Store

CODEC = Codec()
#: Bounds a hang only; the emulated guest is several times slower than its host.
PATIENCE_S = 120.0
#: The kernel's list of raw sockets that take every frame.
RECEIVERS = Path("/proc/net/can/rcvlist_all")

#: Verbs that are forked, so that their imports are done by then.
VERBS = (run, simulate)
_FORK = multiprocessing.get_context("fork")


def eventually(condition: Callable[[], object], what: str) -> None:
    """Waits for what another process does in its own time."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, f"still waiting for: {what}"
        time.sleep(0.05)


class Command:
    """`yieldmon WORDS...` in a process of its own; what it prints goes to `output`."""

    def __init__(self, words: list[str], output: Path, environment: dict[str, str]) -> None:
        self.output = output
        self.process = _FORK.Process(target=self._run, args=(words, environment), daemon=True)
        self.process.start()

    def _run(self, words: list[str], environment: dict[str, str]) -> None:
        with self.output.open("w") as file:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
        sys.stdout, sys.stderr = sys.__stdout__, sys.__stderr__
        os.environ.update(environment)
        os._exit(main(words))

    def end(self) -> None:
        """Ends it as a service manager would; fails when it does not end well."""
        self.process.terminate()
        self.finished()

    def finished(self) -> None:
        """Waits for its own end; fails when it does not end well."""
        self.process.join(PATIENCE_S)
        if self.process.is_alive():
            self.process.kill()
        printed = self.output.read_text()
        assert self.process.exitcode == 0, printed
        assert "Traceback" not in printed, printed


@dataclass
class DaemonNode:
    """A running daemon, seen from outside only: its socket, its store, its process."""

    command: Command
    folder: Path

    def ask(self, **request: Any) -> dict[str, Any]:
        return ask(self.folder / "yieldmon.sock", request)

    @property
    def status(self) -> dict[str, Any]:
        return self.ask(command="status")

    @property
    def faults(self) -> dict[str, str]:
        return {fault["code"]: fault["detail"] for fault in self.status["faults"]}

    @property
    def windows(self) -> int:
        """Windows closed so far."""
        rows = self.status["windows"]
        return int(rows[-1]["number"]) if rows else 0

    @property
    def resident_kb(self) -> int:
        lines = Path(f"/proc/{self.command.process.pid}/status").read_text().splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS"))

    def store(self) -> Store:
        return Store(self.folder / "yieldmon.sqlite")

    def answers(self) -> bool:
        assert self.command.process.is_alive(), self.command.output.read_text()
        try:
            return bool(self.status)
        except ControlError:
            return False


@contextmanager
def daemon(channel: str, folder: Path, sections: str = "") -> Iterator[DaemonNode]:
    """`yieldmon run` on the interface, its state in `folder`. It must live, and end well at SIGTERM."""
    path = folder / "c.yaml"
    # Frames may wait long here: the guest now and then stops for more than the half second that is the default.
    path.write_text(f"bus: {{interface: socketcan, channel: {channel}, transmit_max_age_s: 30}}\n{sections}")
    environment = {"STATE_DIRECTORY": str(folder), "RUNTIME_DIRECTORY": str(folder)}
    node = DaemonNode(Command(["run", "--config", str(path)], folder / "daemon.txt", environment), folder)
    try:
        eventually(node.answers, "the daemon's first answer")
        yield node
    except BaseException:
        node.command.process.kill()
        raise
    node.command.end()


class LeanCombine:
    """The virtual actuator, elevator speed and a force that follows the plate's true angle, at nominal rates, as a process.

    The whole virtual combine takes more than a processor of the emulated guest in real time. EMPTY_S without grain, then a
    constant flow. A fault begins begin_s after the start; `true_deg` is where the plate is.
    """

    EMPTY_S = 5.0
    FLOW_KG_S = 14.0
    ZERO_MV = 120.0

    def __init__(self, channel: str, fault: str | None = None, begin_s: float = 0.0) -> None:
        machine = Machine()
        self._actuator = PlateActuator(ActuatorSettings(), machine, np.random.default_rng(20261121))
        self._fault = ActuatorFault(fault) if fault else None
        self._begin_s = begin_s
        self._angle = _FORK.Value("d", self._actuator.angle_deg)
        self._grid_deg = np.arange(40.0, 91.0, 5.0)
        speed = 400.0 * RPM
        self._pass_hz = machine.paddle_speed_m_s(speed) / machine.paddle_spacing_m
        conditions = Conditions(np.radians(self._grid_deg), speed, mass_flow_kg_s=self.FLOW_KG_S)
        force_n = ForwardModel(machine).force(conditions, parameter_file.load(shipped("config/parameters/corn.yaml")).values)
        self._millivolts = force_n / machine.sensor.gain_n_per_mv
        self.process = _FORK.Process(target=self._run, args=(channel,), daemon=True)
        self.process.start()

    @property
    def true_deg(self) -> float:
        return float(self._angle.value)

    def end(self) -> None:
        self.process.terminate()
        self.process.join(PATIENCE_S)

    def _run(self, channel: str) -> None:
        signal.signal(signal.SIGTERM, lambda *_: os._exit(0))
        with open_bus("socketcan", channel, filters=CODEC.filters([frames.PLATE_ACTUATOR_COMMAND])) as bus:
            begin_s = time.monotonic()
            for number in itertools.count():
                at_s = number * 0.004
                while (left_s := begin_s + at_s - time.monotonic()) > 0.0:
                    if (message := bus.recv(left_s)) is not None:
                        self._actuator.command(CODEC.decode(message), at_s)
                for frame in self._frames(number, at_s):
                    bus.send(CODEC.encode(frame))

    def _frames(self, number: int, at_s: float) -> Iterator[Frame]:
        if number % 12 == 0:
            self._actuator.fault = self._fault if at_s >= self._begin_s else None
            self._angle.value = self._actuator.step(at_s, 0.048)
            if (told := self._actuator.feedback()) is not None:
                signals = {"PlateAngle": told[0], "ActuatorState": int(told[1])}
                yield Frame(at_s, frames.PLATE_ACTUATOR_FEEDBACK, signals)
        if number % 25 == 0:
            yield Frame(at_s, frames.ELEVATOR_SPEED, {"ElevatorSpeed": 400.0})
        mean = float(np.interp(self.true_deg, self._grid_deg, self._millivolts)) if at_s > self.EMPTY_S else 0.0
        signals = {"SampleCounter": number % 256, "SensorStatus": 0}
        for k in range(frames.SAMPLES_PER_FRAME):
            phase = 2.0 * math.pi * self._pass_hz * (at_s + 0.001 * k)
            ripple = mean * math.sin(phase) + 0.8 * math.sin(1.7 * phase)
            signals[f"Sample{k}"] = round(2.0 * max(0.0, self.ZERO_MV + mean + ripple)) / 2.0
        yield Frame(at_s, frames.IMPACT_SENSOR_SAMPLES, signals)


@contextmanager
def candump(channel: str, log: Path) -> Iterator[None]:
    """can-utils' recorder, listening from the first line of the block on."""
    before = RECEIVERS.read_text()
    with log.open("w") as out:
        recorder = subprocess.Popen(["candump", "-L", "-r", "8388608", channel], stdout=out)
        try:
            while RECEIVERS.read_text() == before:
                assert recorder.poll() is None, "candump ended before it listened"
            yield
        finally:
            recorder.terminate()
            recorder.wait(PATIENCE_S)


@dataclass(frozen=True)
class Recorded:
    """A frame of a log, decoded by stock cantools."""

    time_s: float
    message: str
    signals: dict[str, Any]


def read_back(log: Path, only: str | None = None) -> list[Recorded]:
    """A candump log through python-can's reader and cantools, without a line of the project's own decoding.

    Fails at a frame that the database does not know or cannot decode; `only` leaves all but this message unread.
    """
    database = cantools.database.load_file(shipped("dbc/yieldmon.dbc"))
    wanted = database.get_message_by_name(only).frame_id if only else None
    found = []
    for message in can.LogReader(log):
        if wanted not in (None, message.arbitration_id):
            continue
        known = database.get_message_by_frame_id(message.arbitration_id)
        signals = known.decode(bytes(message.data), decode_choices=False)
        found.append(Recorded(message.timestamp, known.name, signals))
    return found

"""Nodes on a real CAN interface as processes of their own: the daemon, the virtual combine, and can-utils' recorder.

The project's commands are forked rather than started anew: in the emulated guest the imports alone take half a minute.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
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

from yieldmon.bus.codec import Codec
from yieldmon.cli import replay, run, simulate
from yieldmon.cli.main import main
from yieldmon.resources import shipped
from yieldmon.service.operator.control_client import ask
from yieldmon.service.operator.control_protocol import ControlError
from yieldmon.service.storage.store import Store

CODEC = Codec()
#: Bounds a hang only; the emulated guest is several times slower than its host.
PATIENCE_S = 180.0
#: The kernel's list of raw sockets that take every frame.
RECEIVERS = Path("/proc/net/can/rcvlist_all")

#: Verbs that are forked, so that their imports are done by then.
VERBS = (replay, run, simulate)
_FORK = multiprocessing.get_context("fork")


def eventually(condition: Callable[[], object], what: str, every_s: float = 0.2) -> None:
    """Waits for what another process does in its own time."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, f"still waiting for: {what}"
        time.sleep(every_s)


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
        # pytest's own would take the daemon's lines.
        logging.getLogger().handlers.clear()
        os.environ.update(environment)
        os._exit(main(words))

    def end(self) -> None:
        """Ends it as a service manager would; fails when it does not end well."""
        self.process.terminate()
        self.finished()

    def finished(self, timeout_s: float = PATIENCE_S) -> None:
        """Waits for its own end; fails when it does not end well."""
        self.process.join(timeout_s)
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
    def printed(self) -> str:
        return self.command.output.read_text()

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
    path.write_text(f"bus: {{interface: socketcan, channel: {channel}}}\n{sections}")
    environment = {"STATE_DIRECTORY": str(folder), "RUNTIME_DIRECTORY": str(folder)}
    node = DaemonNode(Command(["run", "--config", str(path)], folder / "daemon.txt", environment), folder)
    try:
        eventually(node.answers, "the daemon's first answer")
        yield node
    except BaseException:
        node.command.process.kill()
        raise
    node.command.end()


@contextmanager
def combine(channel: str, folder: Path, scenario: str) -> Iterator[None]:
    """The virtual combine on the interface in real time, until the block ends; then its truth is in folder/truth.csv."""
    path = folder / "scenario.yaml"
    path.write_text(scenario)
    words = ["simulate", "--scenario", str(path), "--truth", str(folder / "truth.csv"), "-i", "socketcan", "-c", channel]
    node = Command(words, folder / "combine.txt", {})
    try:
        yield
    except BaseException:
        node.process.kill()
        raise
    node.end()


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


#: PDU formats of J1939-21 and -81: acknowledgement, request, transport data and connection, address claim.
NETWORK_FORMATS = (0xE8, 0xEA, 0xEB, 0xEC, 0xEE)


def read_back(log: Path, only: str | None = None) -> list[Recorded]:
    """A candump log through python-can's reader and cantools, without a line of the project's own decoding.

    Frames of the network itself (address claims, requests, transport) are passed over. Fails at any other frame that the database
    does not know or cannot decode; `only` leaves all but this message unread.
    """
    database = cantools.database.load_file(shipped("dbc/yieldmon.dbc"))
    wanted = database.get_message_by_name(only).frame_id if only else None
    found = []
    for message in can.LogReader(log):
        if wanted not in (None, message.arbitration_id):
            continue
        if message.arbitration_id >> 16 & 0xFF in NETWORK_FORMATS:
            continue
        known = database.get_message_by_frame_id(message.arbitration_id)
        signals = known.decode(bytes(message.data), decode_choices=False)
        found.append(Recorded(message.timestamp, known.name, signals))
    return found

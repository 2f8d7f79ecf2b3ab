"""`yieldmon run` at its start: what may pass by itself exits with 1 and is tried again, what only a person can mend with 2."""

from __future__ import annotations

import os
import re
import signal
import threading
from contextlib import ExitStack
from pathlib import Path

import pytest

import yieldmon
from tests.service.bench import PATIENCE_S, running
from yieldmon.cli import main as cli
from yieldmon.service.config import configuration
from yieldmon.service.daemon import Daemon

UNIT = Path(yieldmon.__file__).parents[1] / "systemd" / "yieldmon.service"
VIRTUAL = "bus: {interface: virtual, channel: start}\n"


def another_daemon(folder: Path, stack: ExitStack) -> str:
    (folder / "first").mkdir()
    stack.enter_context(running(folder / "first", state=folder))
    return VIRTUAL


def a_pipe_for_parameters(folder: Path, stack: ExitStack) -> str:
    os.mkfifo(folder / "p.yaml")
    return VIRTUAL + "parameter_file: p.yaml\n"


def another_daemon_by_a_link(folder: Path, stack: ExitStack) -> str:
    (folder / "link.sqlite").symlink_to("yieldmon.sqlite")
    return another_daemon(folder, stack) + "store: {path: link.sqlite}\n"


def a_store_that_cannot_be_read(folder: Path, stack: ExitStack) -> str:
    (folder / "yieldmon.sqlite").mkdir()
    return VIRTUAL


STARTS = [
    (a_pipe_for_parameters, 2, "p.yaml: is empty"),
    (lambda *_: "bus: {channl: can0}", 2, "bus.channl: unknown key"),
    (lambda *_: "bus: {interface: udp_multicast, channel: 239.74.163.2, options: {port: 70000}}", 2, "udp_multicast channel"),
    (lambda *_: VIRTUAL + "status: {group: no-such-group}", 2, "status.group: 'no-such-group'"),
    (lambda *_: VIRTUAL + f"status: {{socket: {'x' * 200}}}", 2, "status.socket: "),
    (lambda *_: VIRTUAL + "status: {socket: /proc/nope.sock}", 1, "yieldmon: /proc/nope.sock: No such file"),
    (lambda *_: "bus: {interface: socketcan, channel: absent0}", 1, "socketcan channel absent0: "),
    (another_daemon, 1, "another daemon is using it"),
    (another_daemon_by_a_link, 1, "another daemon is using it"),
    (a_store_that_cannot_be_read, 2, "is a folder; expected a store"),
]


@pytest.mark.parametrize(("prepare", "code", "says"), STARTS)
def test_a_start_that_fails_says_whether_another_try_can_help(prepare, code, says, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    handlers = {}
    monkeypatch.setattr("yieldmon.cli.run.signal.signal", handlers.__setitem__)

    def end() -> None:
        """For a daemon that starts all the same: its exit code is 0."""
        handlers[signal.SIGTERM]()

    with ExitStack() as stack:
        late = threading.Timer(PATIENCE_S, end)
        stack.callback(late.cancel)
        late.start()
        path = tmp_path / "yieldmon.yaml"
        path.write_text(prepare(tmp_path, stack))
        assert cli.main(["run", "--config", str(path)]) == code
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("yieldmon: ")]
    assert len(lines) == 1
    assert says in lines[0]


def test_the_unit_is_not_started_again_on_bad_input_alone():
    prevented = re.findall(r"^RestartPreventExitStatus=(.*)$", UNIT.read_text(encoding="utf-8"), re.MULTILINE)
    assert prevented == [str(cli.EXIT_USAGE)]


def test_a_hangup_before_the_daemon_is_there_reloads_it(tmp_path, monkeypatch):
    """It would end the process."""
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    path = tmp_path / "yieldmon.yaml"
    path.write_text(VIRTUAL)
    read, loads = configuration.load, []

    def load(*how: Path) -> configuration.Configuration:
        # Counted first: the daemon may have ended by the signal before this thread goes on.
        loads.append(read(*how))
        signal.raise_signal(signal.SIGHUP if len(loads) == 1 else signal.SIGTERM)
        return loads[-1]

    monkeypatch.setattr(configuration, "load", load)
    before = {number: signal.getsignal(number) for number in (signal.SIGHUP, signal.SIGTERM, signal.SIGINT)}
    try:
        assert cli.main(["run", "--config", str(path)]) == 0
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert len(loads) == 2


def test_signals_that_ask_for_nothing_end_nothing(tmp_path, monkeypatch):
    """They would end the process, from its first moment on."""
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    path = tmp_path / "yieldmon.yaml"
    path.write_text(VIRTUAL)
    read = configuration.load
    sent = (signal.SIGUSR1, signal.SIGUSR2, signal.SIGIO, signal.SIGPWR, signal.SIGPIPE)
    before = {number: signal.getsignal(number) for number in (*sent, signal.SIGHUP, signal.SIGTERM, signal.SIGINT)}

    def load(*how: Path) -> configuration.Configuration:
        assert {signal.getsignal(number) for number in sent} == {signal.SIG_IGN}
        for number in sent:
            signal.raise_signal(number)
        return read(*how)

    class Stopping(Daemon):
        def run(self) -> int:
            signal.raise_signal(signal.SIGTERM)
            return super().run()

    monkeypatch.setattr(configuration, "load", load)
    monkeypatch.setattr("yieldmon.cli.run.Daemon", Stopping)
    try:
        assert cli.main(["run", "--config", str(path)]) == 0
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)

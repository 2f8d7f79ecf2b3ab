"""Log lines to a journal that takes them, takes nothing for a while, or is gone."""

from __future__ import annotations

import fcntl
import logging
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from tests.service.bench import wait_for
from yieldmon.service.journal_lines import CAPACITY, JournalLines
from yieldmon.service.operator.control_client import ask
from yieldmon.service.operator.control_protocol import ControlError

_F_SETPIPE_SZ = 1031


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    """A small one, from its reading to its writing end."""
    ends = os.pipe()
    fcntl.fcntl(ends[1], _F_SETPIPE_SZ, 4096)
    yield ends
    for end in ends:
        os.close(end)


def record(text: str) -> logging.LogRecord:
    return logging.LogRecord("x", logging.WARNING, "f.py", 1, text, None, None)


def test_without_a_line_there_is_nothing_to_wait_for() -> None:
    assert JournalLines().finish(0.0)


def test_lines_come_in_order(pipe: tuple[int, int]) -> None:
    lines = JournalLines(pipe[1])
    for number in range(50):
        lines.handle(record(f"{number} \udcff"))
    assert lines.finish(60.0)
    assert os.read(pipe[0], 4096).decode().splitlines() == [f"{number} \\udcff" for number in range(50)]


def test_a_journal_that_takes_nothing_for_a_while_gets_what_it_missed(pipe: tuple[int, int]) -> None:
    lines = JournalLines(pipe[1])
    for number in range(CAPACITY + 500):
        lines.handle(record(f"{number:100}"))
    assert not lines.finish(0.05)
    reported = ""

    def all_told() -> bool:
        nonlocal reported
        reported += os.read(pipe[0], 65536).decode()
        return f"{CAPACITY + 499:100}\n" in reported

    wait_for(all_told, "the last line")
    numbers = [int(line) for line in reported.splitlines() if line.strip().isdigit()]
    left_out = [int(line.split()[2]) for line in reported.splitlines() if "left out" in line]
    assert numbers == sorted(numbers)
    assert len(numbers) + sum(left_out) == CAPACITY + 500
    assert sum(left_out) >= 1


def test_a_journal_that_is_gone_ends_nothing() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    lines = JournalLines(writing)
    for _ in range(3):
        lines.handle(record("nobody hears"))
        assert lines.finish(60.0)
    os.close(writing)


def test_a_daemon_whose_journal_takes_nothing_goes_on_and_ends(tmp_path: Path, pipe: tuple[int, int]) -> None:
    path = tmp_path / "c.yaml"
    path.write_text("bus: {interface: virtual, channel: full}\n")
    environment = {**os.environ, "STATE_DIRECTORY": str(tmp_path), "RUNTIME_DIRECTORY": str(tmp_path)}
    command = [sys.executable, "-m", "yieldmon.cli.main", "run", "--config", str(path)]

    def reload() -> str | None:
        try:
            return str(ask(tmp_path / "yieldmon.sock", {"command": "status"})["configuration"]["reload"])
        except ControlError:
            return None

    with subprocess.Popen(command, env=environment, stderr=pipe[1]) as process:
        try:
            wait_for(reload, "the daemon")
            # Another description of the same pipe: the daemon's own stays one that waits.
            full = os.open(f"/proc/self/fd/{pipe[1]}", os.O_WRONLY | os.O_NONBLOCK)
            with suppress(BlockingIOError):
                while True:
                    os.write(full, bytes(64))
            os.close(full)
            path.write_text("bus: {nonsense: 1}\n")
            for _ in range(3):
                process.send_signal(signal.SIGHUP)
                wait_for(lambda: "nonsense" in (reload() or ""), "the refusal")
            process.send_signal(signal.SIGTERM)
            assert process.wait(60.0) == 0
        finally:
            process.kill()


def test_one_thread_writes_them_all(pipe: tuple[int, int]) -> None:
    before = {thread.ident for thread in threading.enumerate()}
    lines = JournalLines(pipe[1])
    for number in range(5):
        lines.handle(record(str(number)))
        assert lines.finish(60.0)
    begun = [thread for thread in threading.enumerate() if thread.ident not in before]
    assert [thread.name for thread in begun if thread.name == "journal-lines"] == ["journal-lines"]

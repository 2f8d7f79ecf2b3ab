"""What a service manager's environment says of the watchdog."""

from __future__ import annotations

import os
import socket
from contextlib import suppress
from pathlib import Path

import pytest

from yieldmon.service.notify import ServiceManager

OURS = str(os.getpid())


@pytest.mark.parametrize(
    ("environment", "watchdog_s"),
    [
        ({"WATCHDOG_USEC": "10000000", "WATCHDOG_PID": OURS}, 10.0),
        ({"WATCHDOG_USEC": "500000"}, 0.5),
        ({"WATCHDOG_USEC": "10000000", "WATCHDOG_PID": "1"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
        ({}, None),
    ],
    ids=["ours", "no process named", "another process's", "no number", "none"],
)
def test_the_watchdogs_time(environment: dict[str, str], watchdog_s: float | None) -> None:
    assert ServiceManager(environment).watchdog_s == watchdog_s


def test_a_manager_that_reads_nothing_blocks_no_caller_and_gets_the_rest_later(tmp_path: Path) -> None:
    """As systemd itself may hang; its socket takes some messages and no more."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "n"))
        manager.setblocking(False)
        ours = ServiceManager({"NOTIFY_SOCKET": str(tmp_path / "n"), "WATCHDOG_USEC": "1000000"})
        for _ in range(2000):
            ours.alive()
        ours.ready()
        ours.reloading()
        ours.ready()

        def read() -> list[str]:
            found = []
            with suppress(BlockingIOError):
                while True:
                    found.append(manager.recv(200).decode().split("\n")[0])
            return found

        assert set(read()) == {"WATCHDOG=1"}
        ours.alive()
        assert read() == ["READY=1", "RELOADING=1", "READY=1", "WATCHDOG=1"]

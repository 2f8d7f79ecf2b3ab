"""What a service manager's environment says of the watchdog."""

from __future__ import annotations

import os

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

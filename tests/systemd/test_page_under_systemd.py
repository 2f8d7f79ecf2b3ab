"""The page's own unit beside the daemon's: it shows what is measured, and neither its death nor its end is the daemon's."""

from __future__ import annotations

import json
import os
import signal
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from combine_service import grows, harvest, pid, service, write_log
from service_manager import PATIENCE_S, WEB_UNIT, eventually, journal, run, show

from yieldmon.cli._daemon import SYSTEM_SOCKET
from yieldmon.service.control import ask

pytestmark = [pytest.mark.systemd, pytest.mark.slow]

PAGE = "http://127.0.0.1:8090"
STARTS = 20


@pytest.fixture(scope="module", autouse=True)
def measuring(daemon_command: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Daemon and page, and a combine that harvests."""
    log = write_log(tmp_path_factory.mktemp("traffic") / "combine.log")
    with service(daemon_command, page=True), harvest(log):
        grows()
        eventually(page_listens, "the page")
        yield


def asked(path: str, body: dict[str, Any] | None = None) -> Any:
    """The page's answer, from JSON."""
    data = json.dumps(body).encode() if body is not None else None
    request = urllib.request.Request(PAGE + path, data, {"Content-Type": "application/json", "Origin": PAGE})
    with urllib.request.urlopen(request, timeout=PATIENCE_S) as answer:
        return json.load(answer)


def page_listens() -> bool:
    try:
        return bool(asked("/api/page"))
    except urllib.error.URLError:
        return False


def page_pid() -> int:
    return int(show("MainPID", WEB_UNIT))


def live_rows() -> list[list[float | None]]:
    """The first seconds that a live page is shown."""
    told: dict[str, Any] = {}
    deadline = time.monotonic() + PATIENCE_S
    with urllib.request.urlopen(PAGE + "/api/live", timeout=PATIENCE_S) as lines:
        # A line comes at least every ten seconds.
        for line in lines:
            assert time.monotonic() < deadline, f"no seconds, but {told}\n{journal()}"
            if line.startswith(b"data: "):
                told = json.loads(line.removeprefix(b"data: "))
                if told["rows"]:
                    return list(told["rows"])
    raise AssertionError(f"the page ended its live state after {told}\n{journal()}")


def test_the_page_shows_what_the_daemon_measures() -> None:
    rows = live_rows()
    assert rows[-1][0] in range(1, ask(SYSTEM_SOCKET, {"command": "status"})["windows"][-1]["number"] + 1)
    eventually(lambda: sum(day["mass_kg"] for day in asked("/api/history")["days"]) > 0.0, "grain in the history")


def test_a_button_of_the_page_reaches_the_daemon() -> None:
    load = ask(SYSTEM_SOCKET, {"command": "status"})["load"]
    asked("/api/command", {"command": "load-start", "shown_load": load["number"], "field": "north"})
    now = ask(SYSTEM_SOCKET, {"command": "status"})["load"]
    assert (now["number"], now["field"]) == (load["number"] + 1, "north")


def test_the_page_is_the_daemons_user_and_its_death_is_not_the_daemons() -> None:
    before, daemon = page_pid(), pid()
    assert Path("/proc", str(before)).stat().st_uid == Path("/proc", str(daemon)).stat().st_uid != 0
    os.kill(before, signal.SIGKILL)
    eventually(lambda: page_pid() not in (0, before) and page_listens(), "a new page")
    assert pid() == daemon


def test_each_start_of_the_page_shows_seconds_and_history() -> None:
    for _ in range(STARTS):
        run("systemctl", "restart", WEB_UNIT)
        eventually(page_listens, "the page")
        assert live_rows()
        assert asked("/api/history")["days"]


def test_the_pages_unit_is_sound_and_stops_cleanly() -> None:
    assert run("systemd-analyze", "verify", "--man=no", WEB_UNIT) == ""
    daemon = pid()
    run("systemctl", "stop", WEB_UNIT)
    assert show("Result", WEB_UNIT) == "success"
    assert pid() == daemon

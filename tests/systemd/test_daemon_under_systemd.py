"""Installed daemon and page under the shipped units: it measures, reloads or refuses, and keeps its totals through every death.

One daemon lives through the whole module, in the order of the tests: a start takes half a minute in the guest.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from page_client import asked, live_rows, page_listens, page_pid
from service_manager import (
    PATIENCE_S,
    UNIT,
    WEB_UNIT,
    add_interface,
    delete_interface,
    eventually,
    install,
    journal,
    run,
    show,
    uninstall,
)

from tests.service.bench import CODEC, traffic
from yieldmon import frames
from yieldmon.bus.opening import open_bus
from yieldmon.cli._daemon import SYSTEM_SOCKET
from yieldmon.service.operator.control_client import ask
from yieldmon.service.storage.store import Store

pytestmark = pytest.mark.systemd

CONFIGURATION = Path("/etc/yieldmon/yieldmon.yaml")
STORE = Path("/var/lib/yieldmon/yieldmon.sqlite")
EMPTY_S, GRAIN_S = 14, 50
#: The guest may take minutes for what a combine's computer does in two seconds.
SLOW_MACHINE = "[Service]\nTimeoutStartSec=600\nWatchdogSec=20\n"
#: Frames wait longer here than the half second after which the daemon would rather not send them.
PATIENT_BUS = "bus:\n  transmit_max_age_s: 30\n"
#: Mean signal of the grain, mV above the zero.
GRAIN_MV = 60.0


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A candump log of a combine that runs empty and then harvests."""
    path = tmp_path_factory.mktemp("traffic") / "combine.log"
    phases = ((0.0, EMPTY_S, 0.0), (float(EMPTY_S), GRAIN_S, GRAIN_MV))
    sent = [(frame.time_s, CODEC.encode(frame)) for phase in phases for frame in traffic(*phase)]
    lines = [f"({time_s:.6f}) can0 {message.arbitration_id:08X}#{message.data.hex()}\n" for time_s, message in sent]
    path.write_text("".join(lines), encoding="ascii")
    return path


@pytest.fixture(scope="module", autouse=True)
def harvest(daemon_command: Path, log: Path) -> Iterator[None]:
    """The service installed and started, with canplayer as the combine that goes round and round."""
    slow = Path("/run/systemd/system/yieldmon.service.d/slow.conf")
    slow.parent.mkdir(parents=True)
    slow.write_text(SLOW_MACHINE, encoding="utf-8")
    install(daemon_command, "--web")
    CONFIGURATION.write_text(PATIENT_BUS, encoding="utf-8")
    add_interface()
    run("systemctl", "start", UNIT)
    player = subprocess.Popen(["canplayer", "-l", "i", "-I", str(log)])
    yield
    player.kill()
    player.wait()
    delete_interface()
    uninstall()
    slow.unlink()


def reload_note() -> str:
    """What became of the last reload, from the daemon itself."""
    return str(ask(SYSTEM_SOCKET, {"command": "status"})["configuration"]["reload"])


def last_number() -> int:
    """Of the records in the store; cheap enough to ask again and again."""
    with Store(STORE) as store:
        last = store.last_second()
    return last.number if last is not None else 0


def records() -> list[Any]:
    """One-second records in the store, read as another process may while the daemon writes."""
    with Store(STORE) as store:
        return store.seconds()


def pid() -> int:
    return int(show("MainPID"))


def restarted(before: int) -> None:
    eventually(lambda: show("ActiveState") == "active" and pid() not in (0, before), "a new process that is ready")


def test_it_is_ready_and_publishes_each_second() -> None:
    assert show("ActiveState") == "active"
    counters = []
    # A plain can.Bus would hand out what arrived before its filters were set as well.
    with open_bus("socketcan", "can0", filters=CODEC.filters([frames.MASS_FLOW])) as bus:
        while len(counters) < EMPTY_S + 10:
            message = bus.recv(PATIENCE_S)
            assert message is not None, journal()
            frame = CODEC.decode(message)
            assert frame is not None
            counters.append(frame.signals["WindowCounter"])
    assert counters == list(range(counters[0], counters[0] + len(counters))), ask(SYSTEM_SOCKET, {"command": "status"})["bus"]


def test_status_states_what_it_measures(daemon_command: Path) -> None:
    eventually(lambda: ask(SYSTEM_SOCKET, {"command": "status"})["total"]["mass_kg"] > 0.0, "grain measured")
    reported = json.loads(run(str(daemon_command), "status", "--json"))
    assert reported["bus"]["channel"] == "can0"
    assert reported["bus"]["frames_per_s"] > 0
    assert (reported["bus"]["dropped"], reported["bus"]["kernel_drops"]) == (0, 0)
    assert reported["total"]["mass_kg"] > 0.0
    assert reported["store"]["failing"] is None
    assert reported["store"]["file"] == str(STORE)


def test_the_page_shows_what_the_daemon_measures() -> None:
    eventually(page_listens, "the page")
    assert live_rows()[-1][0] in range(1, last_number() + 1)
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


def test_the_pages_unit_is_sound_and_stops_cleanly() -> None:
    assert run("systemd-analyze", "verify", "--man=no", WEB_UNIT) == ""
    daemon = pid()
    run("systemctl", "stop", WEB_UNIT)
    assert show("Result", WEB_UNIT) == "success"
    assert pid() == daemon


def test_a_good_configuration_is_taken() -> None:
    before = pid()
    CONFIGURATION.write_text(PATIENT_BUS + "logging:\n  level: debug\n", encoding="utf-8")
    run("systemctl", "reload", UNIT)
    eventually(lambda: reload_note() == "taken", "reload")
    assert pid() == before


def test_a_bad_configuration_is_refused_and_measuring_goes_on() -> None:
    before = pid()
    good = CONFIGURATION.read_text(encoding="utf-8")
    CONFIGURATION.write_text(PATIENT_BUS + "loging:\n  level: debug\n", encoding="utf-8")
    with pytest.raises(AssertionError, match="reload"):
        run("systemctl", "reload", UNIT)
    run("systemctl", "kill", "--signal=HUP", "--kill-whom=main", UNIT)
    eventually(lambda: "loging" in reload_note(), "refusal")
    CONFIGURATION.write_text(good, encoding="utf-8")
    assert pid() == before
    assert show("ActiveState") == "active"


@pytest.mark.parametrize(("death", "result"), [(signal.SIGKILL, "signal"), (signal.SIGSTOP, "watchdog")], ids=["killed", "hung"])
def test_totals_survive(death: signal.Signals, result: str) -> None:
    before, last = pid(), records()[-1]
    os.kill(before, death)
    restarted(before)
    assert f"Failed with result '{result}'" in journal(200)
    eventually(lambda: last_number() > last.number + 3, "new records")
    rows = records()
    assert rows[last.number - 1] == last, "a record that was written stays"
    assert [row.number for row in rows] == list(range(1, len(rows) + 1))
    totals = [row.total_kg for row in rows]
    assert totals == sorted(totals)
    assert totals[-1] == pytest.approx(sum(row.mass_kg for row in rows), rel=1e-9)


def test_stop_is_clean_and_keeps_the_total() -> None:
    run("systemctl", "stop", UNIT)
    assert show("Result") == "success"
    with Store(STORE) as store:
        state = store.state()
        last = store.last_second()
    assert state is not None
    assert last is not None
    assert state["engine"]["totals"]["total_kg"] == pytest.approx(last.total_kg, rel=1e-9)

"""The installed daemon and a combine on can0, for tests that harm the machine around them."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from service_manager import UNIT, add_interface, delete_interface, eventually, install, journal, run, show, uninstall

from tests.service.bench import CODEC, traffic
from yieldmon.cli._daemon import SYSTEM_SOCKET
from yieldmon.service.operator.control_client import ask
from yieldmon.service.operator.control_protocol import ControlError
from yieldmon.service.storage.rows import SecondRow
from yieldmon.service.storage.store import Store

CONFIGURATION = Path("/etc/yieldmon/yieldmon.yaml")
STORE = Path("/var/lib/yieldmon/yieldmon.sqlite")
EMPTY_S, GRAIN_S, GRAIN_MV = 14, 50, 60.0
#: The guest may take minutes for what a combine's computer does in two seconds.
SLOW_MACHINE = "[Service]\nTimeoutStartSec=600\nWatchdogSec=60\n"
#: Frames wait longer here than the half second after which the daemon would rather not send them.
PATIENT_BUS = "bus:\n  transmit_max_age_s: 30\n"


def write_log(path: Path) -> Path:
    """A candump log of a combine that runs empty and then harvests."""
    phases = ((0.0, EMPTY_S, 0.0), (float(EMPTY_S), GRAIN_S, GRAIN_MV))
    sent = [(frame.time_s, CODEC.encode(frame)) for phase in phases for frame in traffic(*phase)]
    lines = [f"({time_s:.6f}) can0 {message.arbitration_id:08X}#{message.data.hex()}\n" for time_s, message in sent]
    path.write_text("".join(lines), encoding="ascii")
    return path


@contextmanager
def service(command: Path, configuration: str = PATIENT_BUS, *, purge: bool = True, page: bool = False) -> Iterator[None]:
    """The service (and its page) installed and started on a virtual can0; taken away at the end, with `purge` its records."""
    slow = Path("/run/systemd/system/yieldmon.service.d/slow.conf")
    slow.parent.mkdir(parents=True, exist_ok=True)
    slow.write_text(SLOW_MACHINE, encoding="utf-8")
    install(command, *(["--web"] if page else []))
    CONFIGURATION.write_text(configuration, encoding="utf-8")
    add_interface()
    try:
        run("systemctl", "start", UNIT)
        yield
    finally:
        delete_interface()
        run("systemctl", "stop", UNIT, check=False)
        uninstall(purge=purge)
        slow.unlink()


@contextmanager
def harvest(log: Path) -> Iterator[None]:
    """canplayer as the combine that goes round and round."""
    player = subprocess.Popen(["canplayer", "-l", "i", "-I", str(log)])
    try:
        yield
    finally:
        player.kill()
        player.wait()


def pid() -> int:
    return int(show("MainPID"))


def status() -> dict[str, Any]:
    """The daemon's own answer; empty while there is none."""
    try:
        return dict(ask(SYSTEM_SOCKET, {"command": "status"}))
    except ControlError:
        return {}


def total_kg() -> float:
    return float(status().get("total", {}).get("mass_kg", 0.0))


def failing() -> str:
    """What the daemon says is wrong with its store, "" where nothing is."""
    return str(status().get("store", {}).get("failing") or "")


def faults() -> dict[str, str]:
    return {fault["code"]: fault["detail"] for fault in status().get("faults", [])}


def records() -> list[SecondRow]:
    """One-second records in the store, read as another process may while the daemon writes."""
    with Store.reading(STORE) as store:
        return store.seconds()


def grows(more_kg: float = 3.0) -> None:
    """Measuring goes on."""
    eventually(lambda: total_kg() > 0.0, "a total")
    before_kg = total_kg()
    eventually(lambda: total_kg() > before_kg + more_kg, f"a total of more than {before_kg + more_kg} kg")


def kill_and_wait() -> None:
    """kill -9, and wait for the process that follows to be ready."""
    before = pid()
    run("systemctl", "kill", "--signal", signal.SIGKILL.name, "--kill-whom=main", UNIT)
    eventually(lambda: show("ActiveState") == "active" and pid() not in (0, before), "a new process that is ready")
    eventually(lambda: bool(status()), "its first answer")


def adds_up(rows: list[SecondRow]) -> None:
    """Seconds are numbered without a gap or a double, and the total is their sum and never goes back."""
    assert [row.number for row in rows] == list(range(1, len(rows) + 1)), journal()
    totals = [row.total_kg for row in rows]
    assert totals == sorted(totals)
    assert abs(totals[-1] - sum(row.mass_kg for row in rows)) <= 1e-6 * totals[-1]

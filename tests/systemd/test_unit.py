"""The unit itself: what the service manager does with it, and what its sandbox allows. A probe stands in for the daemon."""

from __future__ import annotations

import json
import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path

import can
import pytest
import sandbox_probe as probe
from service_manager import (
    PATIENCE_S,
    UNIT,
    add_interface,
    delete_interface,
    eventually,
    install,
    journal,
    run,
    show,
    uninstall,
)

pytestmark = pytest.mark.systemd

CONFIGURATION = Path("/etc/yieldmon/yieldmon.yaml")

ALLOWED = ["CAN socket", "UNIX socket", "write to state folder", "write to runtime folder"]
REFUSED = [name for name in probe.ACTIONS if name not in ALLOWED]


@pytest.fixture(scope="module", autouse=True)
def installed(interpreter: Path) -> Iterator[None]:
    command = Path("/opt/probe/yieldmon")
    command.parent.mkdir()
    source = Path(probe.__file__).read_text(encoding="utf-8")
    command.write_text(f"#!{interpreter} -IS\n{source}", encoding="utf-8")
    command.chmod(0o755)
    install(command)
    yield
    uninstall()


@pytest.fixture
def started(bus: can.BusABC) -> int:
    """Process id of the probe, started by the interface's appearance."""
    return said(bus, probe.STARTED)


def said(bus: can.BusABC, identifier: int) -> int:
    """Process id in the next frame of that identifier."""
    while True:
        message = bus.recv(PATIENCE_S)
        assert message is not None, journal()
        if message.arbitration_id == identifier:
            return int.from_bytes(message.data, "little")


def test_verify_is_clean() -> None:
    assert run("systemd-analyze", "verify", "--man=no", UNIT) == ""


def test_exposure_is_at_most_2(record_property) -> None:
    overall = run("systemd-analyze", "security", "--no-pager", UNIT).splitlines()[-1]
    found = re.search(r"exposure level for yieldmon.service: (\d+\.\d+)", overall)
    assert found is not None, overall
    record_property("exposure", found[1])
    assert float(found[1]) <= 2.0


def test_the_interface_starts_it_and_ready_makes_it_active(started: int) -> None:
    eventually(lambda: show("ActiveState") == "active", "active")
    assert int(show("MainPID")) == started
    assert Path("/proc", str(started)).stat().st_uid != 0


@pytest.fixture(scope="module")
def sandbox(interpreter: Path) -> dict[str, str]:
    """What the probe could do under the unit."""
    add_interface()
    run("systemctl", "start", UNIT)
    report: dict[str, str] = json.loads(Path("/var/lib/yieldmon/sandbox.json").read_text(encoding="utf-8"))
    delete_interface()
    return report


@pytest.mark.parametrize("attempt", ALLOWED)
def test_the_sandbox_allows(sandbox: dict[str, str], attempt: str) -> None:
    assert sandbox[attempt] == "done"


@pytest.mark.parametrize("attempt", REFUSED)
def test_the_sandbox_refuses(sandbox: dict[str, str], attempt: str) -> None:
    assert sandbox[attempt] != "done"


def test_reload_with_a_good_configuration_sends_hangup(bus: can.BusABC, started: int) -> None:
    run("systemctl", "reload", UNIT)
    assert said(bus, probe.RELOADED) == started
    assert int(show("MainPID")) == started


def test_reload_with_a_bad_configuration_fails_and_leaves_it_running(started: int) -> None:
    good = CONFIGURATION.read_text(encoding="utf-8")
    CONFIGURATION.write_text(probe.WRONG, encoding="utf-8")
    try:
        with pytest.raises(AssertionError, match="reload"):
            run("systemctl", "reload", UNIT)
    finally:
        CONFIGURATION.write_text(good, encoding="utf-8")
    assert show("ActiveState") == "active"
    assert int(show("MainPID")) == started


def test_a_configuration_refused_at_the_start_is_not_tried_again_until_it_is_corrected(started: int) -> None:
    run("systemctl", "stop", UNIT)
    good = CONFIGURATION.read_text(encoding="utf-8")
    CONFIGURATION.write_text(probe.WRONG, encoding="utf-8")
    try:
        run("systemctl", "start", UNIT, check=False)
        eventually(lambda: show("ActiveState") == "failed", "failed, not waiting to be started again")
        assert (show("ExecMainStatus"), show("NRestarts")) == ("2", "0")
    finally:
        CONFIGURATION.write_text(good, encoding="utf-8")
    run("systemctl", "start", UNIT)
    assert show("ActiveState") == "active"


def test_killed_it_starts_again_without_a_limit(bus: can.BusABC, started: int) -> None:
    pids = [started]
    for _ in range(3):
        os.kill(pids[-1], signal.SIGKILL)
        pids.append(said(bus, probe.STARTED))
    assert len(set(pids)) == 4
    assert show("NRestarts") == "3"
    assert show("StartLimitIntervalUSec") == "0"


def test_a_hung_process_is_killed_by_the_watchdog_and_started_again(bus: can.BusABC, started: int) -> None:
    os.kill(started, signal.SIGSTOP)
    assert said(bus, probe.STARTED) != started
    assert "Failed with result 'watchdog'" in journal()


def test_it_goes_with_the_interface_and_comes_back_with_it(started: int) -> None:
    delete_interface()
    eventually(lambda: show("ActiveState") == "inactive", "stopped")
    add_interface()
    eventually(lambda: show("ActiveState") == "active", "back")
    assert int(show("MainPID")) != started


def test_stop_is_clean(started: int) -> None:
    eventually(lambda: show("ActiveState") == "active", "active")
    run("systemctl", "stop", UNIT)
    assert show("Result") == "success"
    assert show("ActiveState") == "inactive"


def test_networkd_takes_the_interface_by_the_shipped_file() -> None:
    run("systemctl", "start", "systemd-networkd.service")
    try:
        run("ip", "link", "add", "dev", "can0", "type", "vcan")
        flags = Path("/sys/class/net/can0/flags")
        eventually(lambda: int(flags.read_text(encoding="ascii"), 16) & 1 == 1, "can0 brought up")
        assert "/etc/systemd/network/80-can0.network" in run("networkctl", "status", "--no-pager", "can0")
        reported = run("journalctl", "--no-pager", "-o", "cat", "-p", "warning", "-u", "systemd-networkd.service")
        assert "80-can0.network" not in reported
    finally:
        delete_interface()
        run("systemctl", "stop", "systemd-networkd.service", "systemd-networkd.socket")

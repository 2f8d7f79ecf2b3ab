"""The service manager of the machine under test, and the installed unit in it."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
UNIT = "yieldmon.service"
WEB_UNIT = "yieldmon-web.service"
#: Bound hangs; a second of the guest takes about five outside, so a longer wait would use up the whole run's limit.
PATIENCE_S = 100.0
COMMAND_S = 300.0


def run(*command: str, check: bool = True) -> str:
    """Standard output of a command; fails with its standard error."""
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=COMMAND_S)
    assert done.returncode == 0 or not check, f"{command}: {done.stderr or done.stdout}\n{journal()}"
    return done.stdout


def journal(lines: int = 30) -> str:
    """The units' last journal lines, for messages of failed assertions."""
    command = ("journalctl", "--no-pager", "-o", "cat", "-n", str(lines), "-u", UNIT, "-u", WEB_UNIT)
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout


def show(name: str, unit: str = UNIT) -> str:
    """A property of a unit."""
    return run("systemctl", "show", "--value", "-p", name, unit).strip()


def eventually(holds: Callable[[], bool], what: str) -> None:
    """Wait for what the service manager does in its own time."""
    deadline = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < deadline, f"{what}: not within {PATIENCE_S} s\n{journal()}"
        time.sleep(0.1)


def add_interface() -> None:
    run("ip", "link", "add", "dev", "can0", "type", "vcan")
    run("ip", "link", "set", "can0", "up")


def delete_interface() -> None:
    run("ip", "link", "delete", "can0")


def install(command: Path, *options: str) -> None:
    run(sys.executable, str(ROOT / "tools" / "install"), "--command", str(command), *options)


def uninstall(*, purge: bool = True) -> None:
    options = ["--purge"] if purge else []
    run(sys.executable, str(ROOT / "tools" / "install"), "--uninstall", *options)

"""The shipped unit under a real service manager, on a virtual interface that is called can0.

These tests install, kill and remove system services, so they run in the virtual machine only (tools/test --only systemd).
"""

from __future__ import annotations

import os
import sys
import sysconfig
from collections.abc import Iterator
from pathlib import Path

import pytest
from service_manager import ROOT, add_interface, delete_interface, run

from yieldmon.bus.log_files import mf4

# python-can would import asammdf, and with it pandas: a third of all imports, twenty times slower in the emulated guest.
mf4.defer()

import can  # noqa: E402


@pytest.fixture(scope="session", autouse=True)
def service_manager() -> None:
    if "VCAN_VM" not in os.environ or not Path("/run/systemd/system").is_dir():
        pytest.skip("no service manager to experiment with: tools/test --only systemd boots one in a virtual machine")


@pytest.fixture
def can0(service_manager: None) -> Iterator[str]:
    add_interface()
    yield "can0"
    if Path("/sys/class/net/can0").exists():
        delete_interface()


@pytest.fixture
def bus(can0: str) -> Iterator[can.BusABC]:
    with can.Bus(can0, interface="socketcan") as opened:
        yield opened


@pytest.fixture(scope="session")
def interpreter(service_manager: None) -> Path:
    """This Python where a service without access to home folders can start it."""
    base = visible("/opt/python", sys.base_prefix)
    return base / "bin" / f"python{sys.version_info.major}.{sys.version_info.minor}"


def visible(place: str, source: str) -> Path:
    """Mount a folder, which may well be in a home folder, where services see it."""
    Path(place).mkdir()
    run("mount", "--bind", source, place)
    return Path(place)


@pytest.fixture(scope="session")
def daemon_command(interpreter: Path) -> Path:
    """The yieldmon command of this checkout and environment."""
    packages = visible("/opt/python-packages", sysconfig.get_path("purelib"))
    project = visible("/opt/yieldmon-project", str(ROOT))
    # Not below /opt/yieldmon, which each module that uninstalls takes away.
    command = Path("/opt/yieldmon-command/bin/yieldmon")
    command.parent.mkdir(parents=True)
    script = command.with_name("start.py")
    paths = f"sys.path += [{str(project)!r}, {str(packages)!r}]"
    script.write_text(f"import sys\n{paths}\nfrom yieldmon.cli.main import main\nsys.exit(main())\n", encoding="utf-8")
    # A Python in a home folder looks there for its own library, and would be given the system's of another version.
    library = interpreter.parents[1] / "lib"
    start = f'LD_LIBRARY_PATH={library} exec {interpreter} -IS {script} "$@"'
    command.write_text(f"#!/bin/sh\n{start}\n", encoding="utf-8")
    command.chmod(0o755)
    return command

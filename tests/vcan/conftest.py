"""Tests on a real vcan interface. tools/test runs them in place or in the virtual machine; both make the interfaces."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from yieldmon.bus.log_files import mf4

# python-can would import asammdf, and with it pandas: a third of all imports, twenty times slower in the emulated guest.
mf4.defer()

import can  # noqa: E402


@pytest.fixture(scope="session")
def vcan0() -> str:
    """The channel of a real vcan interface that is up."""
    return channel("vcan0")


@pytest.fixture(scope="session")
def vcan1() -> str:
    """A second one, for tests that pull an interface while others run on the first."""
    return channel("vcan1")


def channel(name: str) -> str:
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        if "VCAN_VM" not in os.environ:
            pytest.skip("this kernel has no CAN: tools/test --only vcan runs these in a virtual machine")
        raise
    assert Path("/sys/class/net", name).exists(), f"no {name}: sudo ip link add dev {name} type vcan"
    return name


@pytest.fixture
def bus(vcan0: str) -> Iterator[can.BusABC]:
    """A python-can bus on vcan0."""
    with can.Bus(vcan0, interface="socketcan") as opened:
        yield opened

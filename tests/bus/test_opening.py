"""Opening buses: virtual ones, and the errors of those that cannot be opened. SocketCAN is in tests/vcan."""

from __future__ import annotations

import argparse

import can
import pytest

from yieldmon import frames
from yieldmon.bus.codec import Codec
from yieldmon.bus.opening import (
    BusUnavailable,
    add_bus_arguments,
    kernel_drops_of,
    open_bus,
    open_bus_from,
)
from yieldmon.errors import InputError
from yieldmon.frames import Frame

CODEC = Codec()
SPEED = CODEC.encode(Frame(0.0, frames.ELEVATOR_SPEED, {"ElevatorSpeed": 400.0}))
WAIT_S = 10.0


def parsed(*options: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_bus_arguments(parser)
    return parser.parse_args(options)


def test_virtual_bus_with_filters() -> None:
    filters = CODEC.filters(frames.INPUTS)
    with (
        open_bus("virtual", "opening-1", filters=filters) as bus,
        open_bus("virtual", "opening-1", bitrate=250_000) as peer,
    ):
        peer.send(can.Message(arbitration_id=0x123, is_extended_id=False))
        peer.send(SPEED)
        assert bus.recv(WAIT_S).arbitration_id == SPEED.arbitration_id
        assert kernel_drops_of(bus) is None


@pytest.mark.parametrize("receive_own", [False, True])
def test_own_frames(receive_own: bool) -> None:
    with open_bus("virtual", "opening-2", receive_own=receive_own) as bus:
        bus.send(SPEED)
        assert (bus.recv(0) is not None) is receive_own


def test_options_of_the_command_line() -> None:
    with (
        open_bus_from(parsed("-i", "virtual", "-c", "opening-3", "-b", "250000")) as bus,
        open_bus("virtual", "opening-3") as peer,
    ):
        peer.send(SPEED)
        assert bus.recv(WAIT_S).arbitration_id == SPEED.arbitration_id


def test_unknown_interface() -> None:
    with pytest.raises(InputError, match=r"interface: 'socketkan'; expected one of .*socketcan"):
        open_bus("socketkan", "can0")


def test_options_that_the_interface_refuses() -> None:
    with pytest.raises(InputError, match=r"socketcand channel can0: .*host"):
        open_bus("socketcand", "can0")


def test_no_interface_named(monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(can.util, "CONFIG_FILES", [])
    monkeypatch.delenv("CAN_INTERFACE", raising=False)
    with pytest.raises(InputError, match="-i INTERFACE"):
        open_bus_from(parsed())


@pytest.mark.parametrize(
    "open_it",
    [lambda: open_bus("socketcan", "nocan9"), lambda: open_bus_from(parsed("-i", "socketcan", "-c", "nocan9"))],
)
def test_absent_device_is_reported_in_one_line(open_it) -> None:
    with pytest.raises(BusUnavailable, match="socketcan channel nocan9: ") as caught:
        open_it()
    assert "\n" not in str(caught.value)

"""python-can and can-utils hear each other on a real vcan interface: the ground that the other tests here stand on."""

from __future__ import annotations

import subprocess
from pathlib import Path

import can
import pytest

pytestmark = pytest.mark.vcan

#: Inside the emulated guest everything is several times slower; this only bounds a hang.
PATIENCE_S = 60.0

STANDARD = {"is_extended_id": False}
MESSAGES = [
    pytest.param(can.Message(arbitration_id=0x123, data=[1, 2, 3], **STANDARD), "123#010203", id="11-bit"),
    pytest.param(can.Message(arbitration_id=0x0CFF0280, data=bytes(8)), "0CFF0280#" + 8 * "00", id="29-bit, zeros"),
    pytest.param(can.Message(arbitration_id=0x18FF0380, data=8 * [0xFF]), "18FF0380#" + 8 * "FF", id="29-bit, ones"),
    pytest.param(can.Message(arbitration_id=0x1FFFFFFF, data=[]), "1FFFFFFF#", id="highest id, empty"),
    pytest.param(can.Message(arbitration_id=7, is_remote_frame=True, dlc=4, **STANDARD), "007#R4", id="remote"),
]


@pytest.mark.parametrize(("message", "text"), MESSAGES)
def test_what_cansend_sends_python_can_receives(bus: can.BusABC, message: can.Message, text: str) -> None:
    subprocess.run(["cansend", bus.channel, text], check=True, timeout=PATIENCE_S)
    received = bus.recv(PATIENCE_S)
    assert received is not None
    assert received.equals(message, timestamp_delta=None, check_channel=False, check_direction=False)


@pytest.mark.parametrize(("message", "text"), MESSAGES)
def test_what_python_can_sends_candump_prints(bus: can.BusABC, message: can.Message, text: str) -> None:
    before = listeners(bus.channel)
    candump = subprocess.Popen(["candump", "-L", "-n", "1", bus.channel], stdout=subprocess.PIPE, text=True)
    try:
        while listeners(bus.channel) == before:
            assert candump.poll() is None, "candump ended before it listened"
        bus.send(message)
        line, _ = candump.communicate(timeout=PATIENCE_S)
    finally:
        candump.kill()
        candump.wait()
    assert line.split()[1:3] == [bus.channel, text]


def test_a_thousand_frames_arrive_complete_and_in_order(vcan0: str) -> None:
    with can.Bus(vcan0, interface="socketcan") as sender, can.Bus(vcan0, interface="socketcan") as receiver:
        numbers = []
        for start in range(0, 1000, 100):
            for number in range(start, start + 100):
                sender.send(can.Message(arbitration_id=0x0CFF0280, data=number.to_bytes(8, "little")))
            received = [receiver.recv(PATIENCE_S) for _ in range(100)]
            numbers += [int.from_bytes(message.data, "little") for message in received if message is not None]
    assert numbers == list(range(1000))


def listeners(channel: str) -> int:
    """Raw sockets without a filter that the kernel has on the channel."""
    lines = Path("/proc/net/can/rcvlist_all").read_text(encoding="ascii").splitlines()
    return sum(line.split()[:1] == [channel] for line in lines)

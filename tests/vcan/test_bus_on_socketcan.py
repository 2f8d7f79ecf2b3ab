"""Opening, receiving and losing a real SocketCAN interface."""

from __future__ import annotations

import socket
import subprocess
import threading

import can
import pytest

from yieldmon import frames
from yieldmon.bus.codec import Codec
from yieldmon.bus.opening import RECEIVE_BUFFER_BYTES, kernel_drops_of, open_bus
from yieldmon.bus.receiver import BusEvent, BusEventKind, Receiver
from yieldmon.frames import Frame

pytestmark = pytest.mark.vcan

CODEC = Codec()
SPEED = CODEC.encode(Frame(0.0, frames.ELEVATOR_SPEED, {"ElevatorSpeed": 400.0}))
#: Bounds a hang only; the emulated guest is several times slower than its host.
WAIT_S = 60.0


def test_socketcan_filters_and_buffer(vcan0: str) -> None:
    with (
        open_bus("socketcan", vcan0, filters=CODEC.filters(frames.INPUTS)) as bus,
        open_bus("socketcan", vcan0) as peer,
    ):
        assert bus.socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) == RECEIVE_BUFFER_BYTES
        peer.send(can.Message(arbitration_id=0x123, is_extended_id=False))
        peer.send(can.Message(arbitration_id=0x18FECA00, data=bytes(8)))
        peer.send(SPEED)
        received = bus.recv(WAIT_S)
        assert received.arbitration_id == SPEED.arbitration_id
        assert CODEC.decode(received).signals == {"ElevatorSpeed": 400.0}
        assert bus.recv(0) is None
        assert kernel_drops_of(bus) == 0


def test_socketcan_holds_three_seconds_of_a_full_bus(vcan0: str) -> None:
    full_bus_frames = 3 * 1800
    with (
        open_bus("socketcan", vcan0, filters=CODEC.filters(frames.INPUTS)) as bus,
        open_bus("socketcan", vcan0) as peer,
    ):
        for _ in range(full_bus_frames):
            peer.send(SPEED, timeout=WAIT_S)
        received = 0
        while bus.recv(0) is not None:
            received += 1
        assert (received, kernel_drops_of(bus)) == (full_bus_frames, 0)


def test_kernel_drops_are_counted_and_reported(vcan0: str) -> None:
    sent = 4000
    with open_bus("socketcan", vcan0, receive_buffer_bytes=64 * 1024) as bus, open_bus("socketcan", vcan0) as peer:
        for _ in range(sent):
            peer.send(SPEED, timeout=WAIT_S)
        drops = kernel_drops_of(bus)
        assert drops is not None
        assert 0 < drops < sent
        with Receiver(lambda: bus) as receiver:
            events = []
            while not events:
                events = [item for item in receiver.get_many(sent, WAIT_S) if isinstance(item, BusEvent)]
        assert sum(event.count for event in events) == drops
        assert receiver.counters().received + receiver.counters().kernel_drops == sent


def test_receiving_never_blocks_on_an_error_that_sending_took(vcan1: str) -> None:
    with open_bus("socketcan", vcan1) as bus:
        subprocess.run(["ip", "link", "set", vcan1, "down"], check=True)
        with pytest.raises(can.CanError):
            bus.send(can.Message(arbitration_id=1))
        with pytest.raises(OSError, match="temporarily unavailable"):
            bus.socket.recv(16)
        subprocess.run(["ip", "link", "set", vcan1, "up"], check=True)


def test_receiver_takes_full_bus_speed_without_loss(vcan0: str) -> None:
    sent = 6000
    with (
        Receiver(lambda: open_bus("socketcan", vcan0, filters=CODEC.filters(frames.INPUTS))) as receiver,
        open_bus("socketcan", vcan0) as peer,
    ):
        sender = threading.Thread(target=lambda: [peer.send(SPEED, timeout=WAIT_S) for _ in range(sent)])
        sender.start()
        received = 0
        while received < sent:
            items = receiver.get_many(sent, WAIT_S)
            assert items, f"{received} of {sent} frames came"
            received += len(items)
        sender.join()
    assert receiver.counters().kernel_drops == receiver.counters().dropped == 0


@pytest.mark.parametrize(
    ("pull", "put_back"),
    [
        (["ip link set {} down"], ["ip link set {} up"]),
        (["ip link delete {}"], ["ip link add dev {} type vcan", "ip link set {} up"]),
    ],
    ids=["down and up", "deleted and made anew"],
)
def test_interface_pulled_and_put_back(vcan1: str, pull: list[str], put_back: list[str]) -> None:
    """Five times over: reported once each way, and frames flow again."""

    def run(commands: list[str]) -> None:
        for command in commands:
            subprocess.run(command.format(vcan1).split(), check=True, timeout=WAIT_S)

    with Receiver(lambda: open_bus("socketcan", vcan1, filters=CODEC.filters(frames.INPUTS))) as receiver:
        for _ in range(5):
            run(pull)
            lost = receiver.get(WAIT_S)
            assert isinstance(lost, BusEvent)
            assert lost.kind is BusEventKind.INTERFACE_LOST
            run(put_back)
            restored = receiver.get(WAIT_S)
            assert isinstance(restored, BusEvent)
            assert restored.kind is BusEventKind.INTERFACE_RESTORED
            with open_bus("socketcan", vcan1) as peer:
                peer.send(SPEED, timeout=WAIT_S)
            received = receiver.get(WAIT_S)
            assert isinstance(received, can.Message)
            assert received.arbitration_id == SPEED.arbitration_id
    assert receiver.counters().interface_losses == 5

"""Transport protocol in both directions, table-driven, and against can-j1939 and a real bus."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import j1939
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.network.peer import split
from yieldmon.bus.log_files.logs import read_log
from yieldmon.network.fast_packet import FastPacketReceiver
from yieldmon.network.identifier import Identifier, Payload, RawFrame
from yieldmon.network.name import Name
from yieldmon.network.node import Node, NodeSettings
from yieldmon.network.reassembly import Reassembler
from yieldmon.network.receiving import T1_S, TransportReceiver
from yieldmon.network.sending import BROADCAST_GAP_S, T3_S, TransportSender

RECORDINGS = sorted((Path(__file__).parent.parent / "data" / "tractor_bus").glob("*.log"))
US, PEER = 0x83, 0x17


def feed(receiver: TransportReceiver, text: str, now_s: float = 0.0) -> tuple[list[str], bytes | None]:
    identifier, data = text.split("#")
    received = receiver.feed(Identifier.of(int(identifier, 16)), bytes.fromhex(data), now_s, US)
    return [shown(f) for f in received.frames], received.payload.data if received.payload else None


def shown(raw: RawFrame) -> str:
    return f"{raw.identifier:08X}#{raw.data.hex().upper()}"


@pytest.mark.parametrize(
    ("frame", "answers"),
    [
        pytest.param("1CEC8317#1014000303DAFE00", ["1CEC1783#110301FFFFDAFE00"], id="whole message in one go"),
        pytest.param("1CEC8317#1014000302DAFE00", ["1CEC1783#110201FFFFDAFE00"], id="sender sends two at a time"),
        pytest.param("1CEC8317#1014000403DAFE00", ["1CEC1783#FF02FFFFFFDAFE00"], id="parts do not fit the size"),
        pytest.param("1CEC8317#100008FFFFDAFE00", ["1CEC1783#FF02FFFFFFDAFE00"], id="too long"),
        pytest.param("1CEC8417#1014000303DAFE00", [], id="for another node"),
        pytest.param("1CECFF17#1014000303DAFE00", [], id="a connection to all is none"),
        pytest.param("1CECFF17#20140003FFDAFE00", [], id="broadcast"),
    ],
)
def test_opening(frame: str, answers: list[str]) -> None:
    assert feed(TransportReceiver(), frame)[0] == answers


def test_connection_with_a_lost_part() -> None:
    receiver = TransportReceiver()
    steps = [
        ("1CEC8317#1014000303DAFE00", ["1CEC1783#110301FFFFDAFE00"], None),
        ("1CEB8317#0101020304050607", [], None),
        ("1CEB8317#030F101112131415", ["1CEC1783#110202FFFFDAFE00"], None),
        ("1CEB8317#0208090A0B0C0D0E", [], None),
        ("1CEB8317#030F1011121314FF", ["1CEC1783#13140003FFDAFE00"], bytes(range(1, 21))),
    ]
    for frame, answers, payload in steps:
        assert feed(receiver, frame) == (answers, payload)
    assert len(receiver) == 0


def test_connection_that_never_gets_a_part_right_is_aborted() -> None:
    receiver = TransportReceiver()
    feed(receiver, "1CEC8317#101C000404DAFE00")
    answers = []
    for number in (2, 1, 3, 2, 4):
        answers += feed(receiver, f"1CEB8317#{number:02X}01020304050607")[0]
    assert answers == ["1CEC1783#110401FFFFDAFE00", "1CEC1783#110302FFFFDAFE00", "1CEC1783#FF07FFFFFFDAFE00"]


def test_sessions_end_in_time() -> None:
    receiver = TransportReceiver()
    feed(receiver, "1CEC8317#1014000303DAFE00")
    feed(receiver, "1CECFF18#20140003FFDAFE00")
    assert receiver.poll(T1_S - 0.01) == []
    assert receiver.poll(T1_S) == []
    assert [shown(f) for f in receiver.poll(2.0)] == ["1CEC1783#FF03FFFFFFDAFE00"]
    assert (len(receiver), receiver.abandoned) == (0, 2)


def test_sessions_are_bounded() -> None:
    receiver = TransportReceiver(max_sessions=4)
    for source in range(8):
        feed(receiver, f"1CECFF{source:02X}#20140003FFDAFE00")
    assert (len(receiver), receiver.refused) == (4, 4)
    assert feed(receiver, "1CEC8340#1014000303DAFE00")[0] == ["1CEC4083#FF01FFFFFFDAFE00"]


@settings(max_examples=60)
@given(data=st.binary(min_size=9, max_size=300), group=st.sampled_from([65226, 51968]), window=st.integers(1, 40))
def test_sender_and_receiver_agree(data: bytes, group: int, window: int) -> None:
    sender, receiver = TransportSender(), TransportReceiver()
    receiver_got = []
    to_peer = sender.submit(group, data, US, PEER, 0.0)
    to_peer = [RawFrame(f.identifier, f.data[:4] + bytes([window]) + f.data[5:]) for f in to_peer]
    for _ in range(200):
        if not to_peer:
            break
        back: list[RawFrame] = []
        for sent in to_peer:
            received = receiver.feed(Identifier.of(sent.identifier), sent.data, 0.0, PEER)
            back += received.frames
            if received.payload:
                receiver_got.append(received.payload.data)
        to_peer = [f for answer in back for f in sender.feed(Identifier.of(answer.identifier), answer.data, US, 0.0)]
    assert receiver_got == [data]
    assert (len(sender), sender.failed) == (0, 0)


def test_broadcasts_keep_their_distance_and_their_order() -> None:
    sender, listener = TransportSender(), Reassembler()
    first, second = bytes(range(20)), bytes(range(100, 130))
    sent = [(0.0, f) for f in sender.submit(65226, first, US, 255, 0.0)]
    sender.submit(65227, second, US, 255, 0.0)
    now_s = 0.0
    while sender.due_s < float("inf"):
        now_s = sender.due_s
        sent += [(now_s, f) for f in sender.poll(US, now_s)]
    times = [t for t, _ in sent]
    assert min(b - a for a, b in pairwise(times)) >= BROADCAST_GAP_S - 1e-9
    got = [p for t, f in sent for p in listener.feed(f.identifier, f.data, t)]
    assert [(p.group, p.data) for p in got] == [(65226, first), (65227, second)]


def test_receiver_that_says_nothing_is_given_up() -> None:
    sender = TransportSender()
    sender.submit(51968, bytes(20), US, PEER, 0.0)
    assert sender.poll(US, T3_S - 0.01) == []
    assert [shown(f) for f in sender.poll(US, T3_S)] == ["1CEC1783#FF03FFFFFF00CB00"]
    assert (len(sender), sender.failed) == (0, 1)


def test_receiver_that_asks_again_and_again_is_given_up() -> None:
    sender = TransportSender()
    sender.submit(51968, bytes(20), US, PEER, 0.0)
    again = Identifier.of(0x1CEC8317), bytes.fromhex("110301FFFF00CB00")
    sent = [sender.feed(*again, US, 0.0) for _ in range(1000)]
    assert sum(map(len, sent)) < 40
    assert len(sender) == 0


def test_waiting_messages_are_bounded() -> None:
    sender = TransportSender(max_waiting=3)
    for _ in range(10):
        sender.submit(65226, bytes(20), US, 255, 0.0)
    assert (len(sender), sender.refused) == (3, 7)


@settings(max_examples=60)
@given(data=st.binary(min_size=1, max_size=223), counter=st.integers(0, 7))
def test_fast_packet_round_trip(data: bytes, counter: int) -> None:
    receiver = FastPacketReceiver()
    got = [receiver.feed(Identifier.of(f.identifier), f.data, 0.0) for f in split(129029, data, 0x1C, counter=counter)]
    assert got[:-1] == [None] * (len(got) - 1)
    assert got[-1] is not None
    assert got[-1].data == data


def test_fast_packet_with_a_part_lost_or_late_is_dropped() -> None:
    frames = list(split(129029, bytes(43), 0x1C, counter=1))
    for spoilt in (frames[:2] + frames[3:], frames[:1] + frames[2:]):
        receiver = FastPacketReceiver()
        assert [receiver.feed(Identifier.of(f.identifier), f.data, 0.0) for f in spoilt] == [None] * len(spoilt)
    receiver = FastPacketReceiver()
    assert [receiver.feed(Identifier.of(f.identifier), f.data, i * 1.0) for i, f in enumerate(frames)] == [None] * len(frames)


def ours(path: Path) -> list[tuple[int, int, int, bytes]]:
    listener = Reassembler()
    payloads: list[Payload] = []
    for message in read_log(path):
        if message.is_extended_id and message.arbitration_id >> 16 & 0xFF in (0xEB, 0xEC):
            payloads += listener.feed(message.arbitration_id, bytes(message.data), message.timestamp)
    return [(p.group, p.source, p.destination, p.data) for p in payloads]


def theirs(path: Path) -> list[tuple[int, int, bytes]]:
    """What can-j1939 makes of the same frames; it has to be set up to take connections to 0x06."""
    found: list[tuple[int, int, bytes]] = []
    ecu = j1939.ElectronicControlUnit(send_message=lambda *args, **kwargs: None)
    try:
        ecu.subscribe(lambda _priority, pgn, source, _time, data: found.append((pgn, source, bytes(data))), 0x06)
        for message in read_log(path):
            if message.is_extended_id and message.arbitration_id >> 16 & 0xFF in (0xEB, 0xEC):
                ecu.notify(message.arbitration_id, message.data, message.timestamp)
    finally:
        ecu.stop()
    return found


@pytest.mark.parametrize("path", RECORDINGS, ids=lambda p: p.stem)
def test_a_real_bus_reassembles_as_in_can_j1939(path: Path) -> None:
    mine = [(group, source, data) for group, source, destination, data in ours(path) if destination in (0x06, 0xFF)]
    assert mine == theirs(path)
    assert len(mine) >= 3


def test_can_j1939_takes_our_broadcast() -> None:
    node = Node(NodeSettings(name=Name(identity_number=1)))
    node.start(0.0)
    node.poll(0.3)
    node.poll(0.6)
    assert node.address == US
    data, now_s = bytes(range(50)), 1.0
    frames = node.send(65226, data, now_s)
    while node.due_s < float("inf"):
        now_s = node.due_s
        frames += node.poll(now_s)
    found: list[tuple[int, int, bytes]] = []
    ecu = j1939.ElectronicControlUnit(send_message=lambda *args, **kwargs: None)
    try:
        ecu.subscribe(lambda _priority, pgn, source, _time, content: found.append((pgn, source, bytes(content))))
        for sent in frames:
            ecu.notify(sent.identifier, bytearray(sent.data), 0.0)
    finally:
        ecu.stop()
    assert found == [(65226, US, data)]

"""Quantities from messages of more than eight bytes: in a table, against can-j1939 and cantools, with lost frames, in a flood."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from random import Random

import can
import cantools
import j1939
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.whole_logs import load_frames
from yieldmon.bus.bulk import block_of
from yieldmon.bus.databases import MessageBits, load_messages
from yieldmon.cli.main import main
from yieldmon.network.name import NameMatch
from yieldmon.network.reassembly import LISTENING_SESSIONS
from yieldmon.physics.machine import Machine
from yieldmon.signals.binding import Binding
from yieldmon.signals.decoding import MapDecoder
from yieldmon.signals.mapping import build

GROUP, OTHER_GROUP = 0xFF20, 0xFF21
NAME = 0x2000_8000_3A20_0042
DBC = """VERSION ""
NS_ :
BS_:
BU_: N
BO_ 2566856958 Long: 20 N
 SG_ Page M : 0|8@1+ (1,0) [0|0] "" N
 SG_ Little : 67|13@1+ (0.125,0) [0|0] "rpm" N
 SG_ Big : 101|12@0+ (0.125,0) [0|0] "rpm" N
 SG_ Single : 128|32@1- (1,0) [0|0] "rpm" N
 SG_ Paged m3 : 32|16@1+ (0.125,0) [0|0] "rpm" N
BO_ 2565800702 Addressed: 20 N
 SG_ Last : 152|8@1+ (1,0) [0|0] "rpm" N
BO_ 800 Standard: 64 N
 SG_ Last : 496|16@1+ (0.125,0) [0|0] "rpm" N
BO_ 2566856789 FromOne: 64 N
 SG_ Last : 496|16@1+ (0.125,0) [0|0] "rpm" N
SIG_VALTYPE_ 2566856958 Single : 1;
"""


@pytest.fixture(scope="module")
def dbc(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("long") / "long.dbc"
    path.write_text(DBC)
    return path


@cache
def messages_in(path: Path) -> dict[str, MessageBits]:
    return load_messages(path)


def decoder(path: Path, message: str, signal: str, **more: object) -> MapDecoder:
    binding = Binding("test", "elevator_speed", "long.dbc", message, (signal,), **more)  # type: ignore[arg-type]
    return MapDecoder(build([binding], lambda _name: messages_in(path), Machine()))


def frame(identifier: int, data: bytes, at_s: float, extended: bool = True) -> can.Message:
    return can.Message(arbitration_id=identifier, data=data, timestamp=at_s, is_extended_id=extended, is_fd=len(data) > 8)


def broadcast(data: bytes, source: int, at_s: float, group: int = GROUP, gap_s: float = 0.05) -> list[can.Message]:
    return connection(data, source, 0xFF, at_s, group, gap_s)


def connection(data: bytes, source: int, to: int, at_s: float, group: int = GROUP, gap_s: float = 0.05) -> list[can.Message]:
    """The sender's frames; an overheard connection has the receiver's between them."""
    parts = -(-len(data) // 7)
    opening = bytes([32 if to == 0xFF else 16, *struct.pack("<H", len(data)), parts, 0xFF, *group.to_bytes(3, "little")])
    found = [frame(0x1CEC0000 | to << 8 | source, opening, at_s)]
    for part in range(parts):
        packet = bytes([part + 1]) + data[7 * part : 7 * part + 7].ljust(7, b"\xff")
        found.append(frame(0x1CEB0000 | to << 8 | source, packet, at_s + (part + 1) * gap_s))
    return found


def fast_packet(data: bytes, source: int, at_s: float, number: int = 0) -> list[can.Message]:
    lead, rest = (number & 7) << 5, data[6:]
    parts = [bytes([lead, len(data)]) + data[:6]]
    parts += [bytes([lead | k // 7 + 1]) + rest[k : k + 7].ljust(7, b"\xff") for k in range(0, len(rest), 7)]
    return [frame(0x18000000 | GROUP << 8 | source, part, at_s + 0.01 * k) for k, part in enumerate(parts)]


def one_by_one(taking: MapDecoder, messages: Sequence[can.Message]) -> list[tuple[float, object]]:
    found = []
    for each in messages:
        for got in taking.decode(each.timestamp, each.arbitration_id, each.is_extended_id, bytes(each.data)):
            found.append((got.time_s, got.signals["elevator_speed"]))
    return found


def in_blocks(taking: MapDecoder, messages: Sequence[can.Message], size: int = 1000) -> list[tuple[float, object]]:
    found = []
    for first in range(0, len(messages), size):
        block = block_of(messages[first : first + size])
        columns, _ = taking.decode_block(block.time_s, block.can_id, block.length, block.payload, block.long)
        for one in columns:
            found += list(zip(one.time_s.tolist(), one.signals["elevator_speed"].tolist(), strict=True))
    return found


DATA = bytes(8) + struct.pack("<I", 0x00ABCDE8) + struct.pack(">I", 0x12345678) + struct.pack("<f", 412.5)
PAGED = bytes([3, 0, 0, 0]) + struct.pack("<H", 3300) + bytes(14)
LONG64 = bytes(62) + struct.pack("<H", 3200)
CASES = {
    "broadcast, little endian": ("Long", "Little", {}, broadcast(DATA, 0x17, 1.0), 1.15, (0x00ABCDE8 >> 3 & 0x1FFF) / 8),
    "broadcast, big endian": ("Long", "Big", {}, broadcast(DATA, 0x17, 1.0), 1.15, (0x12345678 >> 18 & 0xFFF) / 8),
    "broadcast, a float": ("Long", "Single", {}, broadcast(DATA, 0x17, 1.0), 1.15, 412.5),
    "connection to another": ("Long", "Single", {}, connection(DATA, 0x17, 0x26, 1.0), 1.15, 412.5),
    "fast packet": ("Long", "Single", {}, fast_packet(DATA, 0x17, 1.0), 1.02, 412.5),
    "CAN FD": ("Long", "Single", {}, [frame(0x18FF2017, DATA, 1.0)], 1.0, 412.5),
    "CAN FD, 11 bits": ("Standard", "Last", {}, [frame(800, LONG64, 1.0, extended=False)], 1.0, 400.0),
    "multiplexed": ("Long", "Paged", {"mux": (3,)}, broadcast(PAGED, 0x17, 1.0), 1.15, 412.5),
    "longer on the bus": ("Long", "Single", {}, broadcast(DATA + bytes(30), 0x17, 1.0), 1.4, 412.5),
    "shorter on the bus": ("Long", "Little", {}, broadcast(DATA[:12], 0x17, 1.0), 1.1, (0x00ABCDE8 >> 3 & 0x1FFF) / 8),
    "the source of the DBC": ("FromOne", "Last", {}, broadcast(LONG64, 0x55, 1.0), 1.5, 400.0),
    "a group with a destination": ("Addressed", "Last", {"source": "any"}, connection(bytes(20), 1, 2, 1.0, 0xEF00), 1.15, 0.0),
}  # fmt: skip
NOTHING = {
    "another source": ("Long", "Single", {"source": 0x18}, broadcast(DATA, 0x17, 1.0)),
    "not the DBC's source": ("FromOne", "Last", {}, broadcast(LONG64, 0x56, 1.0)),
    "another group": ("Long", "Single", {}, broadcast(DATA, 0x17, 1.0, OTHER_GROUP)),
    "another page": ("Long", "Paged", {"mux": (3,)}, broadcast(bytes([2]) + PAGED[1:], 0x17, 1.0)),
    "too short": ("Long", "Single", {}, broadcast(DATA[:19], 0x17, 1.0)),
    "29 bits for 11": ("Standard", "Last", {}, [frame(800, LONG64, 1.0)]),
    "one frame of eight bytes": ("Standard", "Last", {}, [frame(800, bytes(8), 1.0, extended=False)]),
}  # fmt: skip


@pytest.mark.parametrize("way", [one_by_one, in_blocks])
@pytest.mark.parametrize("name", CASES)
def test_a_quantity_of_a_long_message(name: str, way: object, dbc: Path) -> None:
    message, signal, more, messages, at_s, value = CASES[name]
    assert way(decoder(dbc, message, signal, **more), messages) == [(pytest.approx(at_s), value)]  # type: ignore[operator]


@pytest.mark.parametrize("way", [one_by_one, in_blocks])
@pytest.mark.parametrize("name", NOTHING)
def test_what_is_not_taken(name: str, way: object, dbc: Path) -> None:
    message, signal, more, messages = NOTHING[name]
    assert way(decoder(dbc, message, signal, **more), messages) == []  # type: ignore[operator]


@pytest.mark.parametrize("way", [one_by_one, in_blocks])
def test_a_source_by_its_name(way: object, dbc: Path) -> None:
    taking = decoder(dbc, "Long", "Single", source=NameMatch(identity_number=0x42))
    claim = [frame(0x18EEFF17, NAME.to_bytes(8, "little"), 0.5)]
    moved = [frame(0x18EEFF99, NAME.to_bytes(8, "little"), 1.9)]
    other = broadcast(bytes(20), 0x18, 1.0)
    messages = [*claim, *broadcast(DATA, 0x17, 1.0), *other, *moved, *broadcast(DATA, 0x17, 2.0), *broadcast(DATA, 0x99, 3.0)]
    assert way(taking, messages) == [(pytest.approx(1.15), 412.5), (pytest.approx(3.15), 412.5)]  # type: ignore[operator]


@settings(max_examples=15)
@given(seed=st.integers(0, 2**32), sizes=st.lists(st.integers(20, 300), min_size=1, max_size=8))
def test_interleaved_senders_as_can_j1939_and_cantools_read_them(seed: int, sizes: list[int], dbc: Path) -> None:
    random = Random(seed)
    streams = [broadcast(random.randbytes(size), source, 0.0) for source, size in enumerate(sizes)]
    messages = []
    while any(streams):
        stream = random.choice([stream for stream in streams if stream])
        messages.append(stream.pop(0))
    for number, each in enumerate(messages):
        each.timestamp = 0.0005 * number
    theirs: list[tuple[int, bytes]] = []
    ecu = j1939.ElectronicControlUnit(send_message=lambda *args, **kwargs: None)
    try:
        ecu.subscribe(lambda _priority, _group, source, _time, data: theirs.append((source, bytes(data))))
        for each in messages:
            ecu.notify(each.arbitration_id, each.data, each.timestamp)
    finally:
        ecu.stop()
    assert len(theirs) == len(sizes)
    database = cantools.database.load_string(DBC, "dbc")
    wanted = [database.decode_message("Long", b"\x03" + data[1:], allow_truncated=True)["Big"] for _, data in theirs]
    assert [value for _, value in one_by_one(decoder(dbc, "Long", "Big"), messages)] == wanted
    assert sorted(value for _, value in in_blocks(decoder(dbc, "Long", "Big"), messages, 7)) == sorted(wanted)


@settings(max_examples=40)
@given(lost=st.lists(st.one_of(st.none(), st.integers(0, 3)), min_size=1, max_size=12), fast=st.booleans())
def test_whoever_lost_a_frame_is_dropped_and_counted(lost: list[int | None], fast: bool, dbc: Path) -> None:
    """At most one frame of each message, 20 bytes of one value each."""
    messages, whole = [], []
    for number, gone in enumerate(lost):
        data = bytes(16) + struct.pack("<f", float(number))
        sent = fast_packet(data, 5, 0.2 * number, number) if fast else broadcast(data, 5, 0.2 * number, gap_s=0.04)
        if gone is None or gone >= len(sent):
            whole.append(float(number))
        else:
            del sent[gone]
        messages += sent
    for way in (one_by_one, in_blocks):
        taking = decoder(dbc, "Long", "Single")
        assert [value for _, value in way(taking, messages)] == whole
        begun_without = len(lost) - len(whole) - sum(gone == 0 for gone in lost)
        assert taking.incomplete + taking.under_way == begun_without


def test_a_session_that_is_not_continued_in_time_is_dropped(dbc: Path) -> None:
    taking = decoder(dbc, "Long", "Single")
    late = [*broadcast(DATA, 5, 0.0)[:2], *(frame(each.arbitration_id, each.data, 2.0) for each in broadcast(DATA, 5, 0.0)[2:])]
    assert one_by_one(taking, late) == []
    assert (taking.incomplete, taking.under_way) == (1, 0)


def test_sessions_without_end_are_bounded_and_those_of_others_not_opened(dbc: Path) -> None:
    taking = decoder(dbc, "Long", "Single")
    of_each = broadcast(bytes(1785), 0, 0.0)[0], connection(bytes(1785), 0, 0, 0.0)[0], fast_packet(bytes(223), 0, 0.0)[0]
    flood = [frame(of_each[0].arbitration_id | k % 256, of_each[0].data, 0.0) for k in range(5000)]
    flood += [frame(of_each[1].arbitration_id | k % 250 << 8 | k // 250, of_each[1].data, 0.1) for k in range(10_000)]
    flood += [frame(of_each[2].arbitration_id | k % 256, of_each[2].data, 0.2) for k in range(5000)]
    assert len({each.arbitration_id for each in flood}) > 10_000
    assert one_by_one(taking, flood) == []
    assert taking.under_way <= 2 * LISTENING_SESSIONS
    assert taking.incomplete > 10_000
    assert one_by_one(taking, fast_packet(DATA, 3, 9.0)) == [(pytest.approx(9.02), 412.5)]
    others = decoder(dbc, "Long", "Single")
    assert one_by_one(others, [broadcast(bytes(99), k, 0.0, OTHER_GROUP)[0] for k in range(200)]) == []
    assert (others.under_way, others.incomplete) == (0, 0)


@settings(max_examples=60)
@given(seed=st.integers(0, 2**32), size=st.integers(1, 40))
def test_anything_gives_the_same_one_by_one_and_in_blocks(seed: int, size: int, dbc: Path) -> None:
    random, messages = Random(seed), []
    for number in range(300):
        kind, source = random.randrange(6), random.randrange(3)
        to = random.choice((0xFF, 0x26))
        data = random.randbytes(random.choice((8, 8, 8, 8, 12, 20, 64, random.randrange(9))))
        if kind < 2:
            opening = struct.pack("<BHBB", random.choice((16, 32, 255, 17)), random.choice((9, 20, 21)), 3, 255)
            data = opening + random.choice((GROUP, OTHER_GROUP)).to_bytes(3, "little")
        elif kind < 5 and len(data) == 8:
            data = bytes([random.choice((0, 1, 2, 3, 0x20, 0x21)), random.choice((4, 20)), *data[2:]])
        identifier = (0x1CEC0000, 0x1CEC0000, 0x1CEB0000, 0x1CEB0000, 0x18FF2000, 0x18FF2000)[kind] | source
        messages.append(frame(identifier | (to << 8 if kind < 4 else 0), data, 0.002 * number + random.choice((0.0, 0.0, 0.9))))
    first, second = decoder(dbc, "Long", "Little"), decoder(dbc, "Long", "Little")
    expected = one_by_one(first, messages)
    assert in_blocks(second, messages, size) == expected
    assert (second.incomplete, second.under_way) == (first.incomplete, first.under_way)


def test_can_fd_in_logs_and_in_what_signals_lists(dbc: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "long.log"
    messages = []
    for number in range(50):
        messages += broadcast(DATA, 0x17, 0.2 * number, gap_s=0.02)
        messages.append(frame(800, LONG64, 0.2 * number + 0.07, extended=False))
    messages += broadcast(DATA, 0x18, 20.0)[:-1]
    with can.Logger(str(log)) as logger:
        for each in messages:
            each.channel = "can0"
            logger.on_message_received(each)
    block = load_frames(log)
    assert [block.long[row] for row in np.flatnonzero(block.length > 8).tolist()] == [LONG64] * 50
    assert block.take(np.flatnonzero(block.length > 8)).long == dict.fromkeys(range(50), LONG64)
    assert main(["signals", str(log), "--dbc", str(dbc)]) == 0
    said, reported = capsys.readouterr()
    assert "Single 412.5 to 412.5 rpm" in said
    assert "Last 400 to 400 rpm" in said
    assert "1 incomplete messages of several frames are not used" in reported
    config = tmp_path / "c.yaml"
    config.write_text(f"signals:\n  elevator_speed: {{dbc: {dbc}, message: Long, signal: Single}}\n")
    assert main(["check-config", str(config), "--log", str(log)]) == 2
    said, _ = capsys.readouterr()
    (line,) = [line for line in said.splitlines() if line.startswith("elevator_speed")]
    assert line.split()[2:6] == ["5", "412.5", "412.5", "0.2"]
    assert "note: 1 incomplete messages of several frames are not used" in said

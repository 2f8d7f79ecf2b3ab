"""Standard position and speed, and the factory's monitor, beside ours: in logs one by one, in bulk and on a bus."""

from __future__ import annotations

import random
import struct
from pathlib import Path

import can
import numpy as np
import pytest

from tests.bus.decoded import frames_of
from tests.network.peer import split
from tests.service.bench import CODEC, START_S, running, traffic
from yieldmon.bus.bulk import block_of, decode_block
from yieldmon.bus.factory_monitor import FactoryMonitor
from yieldmon.bus.log_files.log_writing import writing
from yieldmon.frames import VEHICLE_DIRECTION_SPEED, VEHICLE_POSITION, Frame
from yieldmon.network.process_data import Command, ProcessData
from yieldmon.resources import shipped
from yieldmon.service.assembly import build_monitor
from yieldmon.service.config import configuration
from yieldmon.service.logs.bulk_processing import process_in_bulk
from yieldmon.service.logs.processing import process_logs
from yieldmon.service.storage.rows import SecondRow
from yieldmon.service.traffic.side_inputs import SideInputs

DURATION_S = 40


def message(time_s: float, identifier: int, data: bytes) -> can.Message:
    return can.Message(timestamp=round(time_s, 6), arbitration_id=identifier, data=data, is_extended_id=True, channel="can0")


def factory(time_s: float, flow_kg_s: float) -> can.Message:
    return message(time_s, 0x18FF6990, struct.pack("<HHHH", round(flow_kg_s * 1000), 49, 1283, 6708))


def course_speed(time_s: float, speed_m_s: float) -> can.Message:
    return message(time_s, 0x09F8021C, struct.pack("<BBHHH", 0, 0xFC, 15708, round(speed_m_s * 100), 0xFFFF))


def rapid(time_s: float, latitude: float, source: int) -> can.Message:
    return message(time_s, 0x09F80100 | source, struct.pack("<ii", round(latitude * 1e7), round(-90e7)))


def position(time_s: float, latitude: float, counter: int, method: int = 1) -> list[can.Message]:
    data = struct.pack("<BHIqqq", 0, 20000, 0, round(latitude * 1e16), round(-90e16), 0) + bytes([method << 4]) + bytes(11)
    return [message(time_s + k * 1e-4, f.identifier, f.data) for k, f in enumerate(split(129029, data, 0x1C, counter=counter))]


def native(time_s: float, latitude: float, speed_km_h: float) -> list[can.Message]:
    place = Frame(time_s, VEHICLE_POSITION, {"Latitude": latitude, "Longitude": -90.0})
    moving = Frame(time_s, VEHICLE_DIRECTION_SPEED, {"CompassBearing": 45.0, "NavigationSpeed": speed_km_h})
    return [message(time_s, m.arbitration_id, bytes(m.data)) for m in (CODEC.encode(place), CODEC.encode(moving))]


def drive() -> list[can.Message]:
    """Own traffic; J1939 position throughout, NMEA 2000 from 10 to 20 s, a factory monitor from 5 to 30 s."""
    found = [message(m.timestamp, m.arbitration_id, bytes(m.data)) for m in map(CODEC.encode, traffic(START_S, DURATION_S, 0.0))]
    for k in range(DURATION_S * 5):
        at_s = k / 5 + 0.013
        found += native(START_S + at_s, 40.0, 7.2)
        if 10.0 <= at_s < 20.0:
            found.append(course_speed(START_S + at_s + 0.05, 3.0))
            found += position(START_S + at_s + 0.06, 41.0, k % 8)
        if 5.0 <= at_s < 30.0:
            found.append(factory(START_S + at_s + 0.02, 8.0))
    return sorted(found, key=lambda m: m.timestamp)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("side") / "drive.log"
    with writing(path) as logger:
        for item in drive():
            logger.on_message_received(item)
    return path


def rows_of(process, path: Path) -> list[SecondRow]:  # type: ignore[no-untyped-def]
    loaded = configuration.load(shipped("config/yieldmon.yaml"))
    rows: list[SecondRow] = []
    process([path], build_monitor(loaded.engine, loaded.machine, loaded.parameters), CODEC, rows.append)
    return rows


def test_bulk_and_one_by_one_are_the_same(log: Path) -> None:
    one_by_one, bulk = rows_of(process_logs, log), rows_of(process_in_bulk, log)
    assert one_by_one == bulk
    assert len(bulk) >= DURATION_S - 2


def test_best_source_is_used_and_said(log: Path) -> None:
    rows = {round(row.time_s - START_S): row for row in rows_of(process_in_bulk, log)}
    reported = [
        (s, rows[s].latitude_deg, rows[s].position_group, rows[s].ground_speed_m_s, rows[s].speed_group) for s in (8, 15, 30)
    ]
    assert reported == [
        (8, pytest.approx(40.0), None, pytest.approx(2.0, abs=0.01), None),
        (15, pytest.approx(41.0), 129029, pytest.approx(3.0, abs=0.01), 129026),
        (30, pytest.approx(40.0), None, pytest.approx(2.0, abs=0.01), None),
    ]


@pytest.mark.parametrize(
    ("identifier", "form", "offset"), [(0x09F80100, "<ii", 0.0), (0x18FEF300, "<II", 210.0)], ids=["129025", "65267"]
)
def test_of_two_receivers_one_is_used_while_it_speaks(identifier: int, form: str, offset: float, tmp_path: Path) -> None:
    """Places of the two came in turn, 111 km apart here."""

    def place(time_s: float, source: int, latitude: float) -> can.Message:
        return message(time_s, identifier | source, struct.pack(form, *(round((d + offset) * 1e7) for d in (latitude, 8.0))))

    own = [message(m.timestamp, m.arbitration_id, bytes(m.data)) for m in map(CODEC.encode, traffic(START_S, 30, 0.0))]
    places = [place(START_S + k / 5 + 0.05, 0x1C, 47.0) for k in range(75)]
    places += [place(START_S + k / 5 + 0.09, 0x2A, 48.0) for k in range(150)]
    path = tmp_path / "two.log"
    with writing(path) as logger:
        for item in sorted([*own, *places], key=lambda m: m.timestamp):
            logger.on_message_received(item)
    bulk = rows_of(process_in_bulk, path)
    assert bulk == rows_of(process_logs, path)
    latitudes = {round(row.time_s - START_S): row.latitude_deg for row in bulk}
    assert [round(latitudes[s] or 0.0, 6) for s in (3, 10, 14, 20, 27)] == [47.0, 47.0, 47.0, 48.0, 48.0]


def test_factory_flow_is_recorded_and_no_input(log: Path, tmp_path: Path) -> None:
    rows = rows_of(process_in_bulk, log)
    known = [row for row in rows if row.factory_mass_flow_kg_s is not None]
    assert {row.factory_mass_flow_kg_s for row in known} == {8.0}
    assert 22 <= len(known) <= 28
    without = tmp_path / "without.log"
    with writing(without) as logger:
        for item in drive():
            if item.arbitration_id != 0x18FF6990:
                logger.on_message_received(item)
    bare = rows_of(process_in_bulk, without)
    assert [row.mass_flow_kg_s for row in rows] == [row.mass_flow_kg_s for row in bare]
    assert [row.total_kg for row in rows] == [row.total_kg for row in bare]


@pytest.mark.parametrize(
    ("item", "expected"),
    [
        (message(1.0, 0x0CCBF726, ProcessData(Command.VALUE, 2, 87, 8_500_000).data), [8.5]),
        (message(1.0, 0x0CCBF726, ProcessData(Command.VALUE, 2, 84, 8_500_000).data), []),
        (message(1.0, 0x0CCB26F7, ProcessData(Command.TIME_INTERVAL, 2, 87, 1000).data), []),
        (message(1.0, 0x10EFFFD3, bytes.fromhex("4F092003C8040102")), [8.0]),
        (message(1.0, 0x18FF6990, bytes.fromhex("FFFF31000305341A")), []),
    ],
)
def test_factory_frames(item: can.Message, expected: list[float]) -> None:
    got = [frame.signals["FactoryMassFlow"] for frame in SideInputs().frames(item, CODEC.decode(item))]
    assert got == pytest.approx(expected)
    block = block_of([item])
    extended = SideInputs().extend(decode_block(CODEC, block), block)
    assert [f.signals["FactoryMassFlow"] for c in extended.messages.values() for f in frames_of(c)] == pytest.approx(expected)


def in_blocks(items: list[can.Message], draw: random.Random) -> list[Frame]:
    side, got, at = SideInputs(), [], 0
    while at < len(items):
        size = draw.choice((1, 7, 50, 400))
        block = block_of(items[at : at + size])
        extended = side.extend(decode_block(CODEC, block), block)
        frames = [(row, f) for c in extended.messages.values() for row, f in zip(c.rows.tolist(), frames_of(c), strict=True)]
        got += [frame for _, frame in sorted(frames, key=lambda entry: (entry[0], entry[1].message))]
        at += size
    return got


def message_by_message(items: list[can.Message]) -> list[Frame]:
    side = SideInputs()
    return [frame for item in items for frame in sorted(side.frames(item, CODEC.decode(item)), key=lambda frame: frame.message)]


def random_traffic(draw: random.Random) -> list[can.Message]:
    """Every group that is read, from several nodes, with values of all kinds, pauses and steps of the clock."""
    kinds = [0x18FEF300, 0x18FEE800, 0x18FEF100, 0x18FEE600, 0x18FE4800, 0x18FE4900, 0x09F80100, 0x09F80200, 0x1DF01000]
    kinds += [0x0CCBF700, 0x0CCBFF00, 0x18EFFF00, 0x18FEF200]
    items, time_s = [], START_S
    for _ in range(1500):
        time_s += draw.choice((0.0, 0.01, 0.1, 0.1, 0.4, 1.9, 2.5, -0.3) if draw.random() < 0.2 else (0.05,))
        data = bytearray(draw.randbytes(8))
        if draw.random() < 0.5:
            data[3], data[7] = draw.choice((0x80, 0xFF, 0xFB, 0x10)), draw.choice((0x80, 0x10))
        kind = draw.choice(kinds)
        if kind >> 8 & 0xFF0000 == 0xCB0000:
            data = bytearray(ProcessData(Command.VALUE, 2, draw.choice((87, 84)), draw.randrange(-10, 9_000_000)).data)
        if draw.random() < 0.05 and kind not in (0x18FEF300, 0x18FEE800):
            data = data[: draw.randrange(8)]
        items += [message(time_s, kind | draw.choice((0x26, 0x80)), bytes(data))]
        if draw.random() < 0.05:
            frames = position(time_s, draw.uniform(-80.0, 80.0), draw.randrange(8), draw.choice((0, 1, 1)))
            items += frames[draw.randrange(5) // 4 :]
        if draw.random() < 0.2:
            items += [rapid(time_s, draw.uniform(-80.0, 80.0), draw.choice((0x1C, 0x26)))]
    return items


@pytest.mark.parametrize("seed", [None, 1, 2, 3])
def test_blocks_of_any_size_give_what_messages_give(seed: int | None) -> None:
    draw = random.Random(5 if seed is None else seed)
    items = [item for item in drive() if item.arbitration_id >> 8 & 0x3FFFF != 0xFF10] if seed is None else random_traffic(draw)
    got, expected = in_blocks(items, draw), message_by_message(items)
    assert len(got) == len(expected) > 300
    for mine, theirs in zip(got, expected, strict=True):
        usable = {k: v for k, v in mine.signals.items() if k in theirs.signals}
        assert (mine.time_s, mine.message) == (theirs.time_s, theirs.message)
        assert usable == theirs.signals
        assert all(not isinstance(v, float) for k, v in mine.signals.items() if k not in theirs.signals)


def test_a_position_that_is_repeated_without_a_fix_is_no_position() -> None:
    """129025 goes on with the last place while the same node's 129029 says that it has none."""
    items: list[can.Message] = []
    for k in range(100):
        at_s = START_S + k / 10
        if k % 10 == 0:
            items += position(at_s, 40.0 + k * 1e-4, k // 10 % 8, method=0 if 30 <= k < 70 else 1)
        items.append(rapid(at_s + 0.05, 40.0 + min(k, 29) * 1e-4 if k < 70 else 40.0 + k * 1e-4, 0x1C))
    for frames in (in_blocks(items, random.Random(3)), message_by_message(items)):
        places = [frame.time_s - START_S for frame in frames if frame.message == VEHICLE_POSITION]
        assert places
        assert not [at_s for at_s in places if 3.01 <= at_s < 7.0]
        assert [at_s for at_s in places if at_s >= 7.0]


def test_daemon_records_what_the_log_gives(tmp_path: Path, log: Path) -> None:
    with running(tmp_path, "") as bench:
        for item in drive():
            bench.peer.send(item)
        bench.now_s += DURATION_S
        bench.played()
        seconds = {round(w["time_s"] - START_S): w for w in bench.status["windows"]}
    rows = {round(row.time_s - START_S): row for row in rows_of(process_in_bulk, log)}
    assert seconds
    for second, window in seconds.items():
        assert window["latitude_deg"] == rows[second].latitude_deg
        assert window["factory_mass_flow_kg_s"] == rows[second].factory_mass_flow_kg_s


CONCERNED = {
    # identifiers with flags, and whether a frame may bring position, speed or a factory's flow
    0x89F8051C: True, 0x89F8021C: True, 0x8CFEF31C: True, 0x8CFEE81C: True, 0x8CFE491C: True, 0x98FF6990: True,
    0x8CCBFF1C: True, 0x8CCB001C: True, 0x8CCB831C: True,
    # A factory monitor's groups, sent by it and by other nodes.
    0x98FFC3A4: True, 0x98FFC3A5: False, 0x98EF26D3: True, 0x98EF2647: False,
    0x8CCAFF1C: False, 0x8CCCFF1C: False, 0x98FF6890: False, 0x89F8061C: False, 0x8CFEF21C: False, 0x8CF0041C: False,
    0x09F8051C: False, 0xC9F8051C: False, 0xA9F8051C: False, 0x00000123: False,
}  # fmt: skip


def test_the_filters_let_through_what_concerns_these_and_hardly_more() -> None:
    """By the kernel's rule: a frame passes where its identifier and a filter's are equal in the bits of the mask. Any source, any
    priority; a factory's own frames keep the address that its layout names."""
    inputs = SideInputs()
    filters = [(entry["can_id"], entry["can_mask"]) for entry in inputs.filters()]
    assert all(entry.get("extended") for entry in inputs.filters())
    rng = np.random.default_rng(5)
    known = [i for i, concerned in CONCERNED.items() if concerned]
    tried = [*known, *(int(i) | 1 << 31 for i in rng.integers(0, 1 << 29, 3000))]
    tried += [identity | int(rng.integers(8)) << 26 | 1 << 31 for identity in FactoryMonitor().identifiers for _ in range(4)]
    concerned = inputs.concerns(np.array(tried, np.uint32))
    passed = np.array([any((i ^ value) & mask & 0x1FFFFFFF == 0 for value, mask in filters) for i in tried])
    assert not np.any(concerned & ~passed), [hex(i) for i, c, p in zip(tried, concerned, passed, strict=True) if c and not p][:5]
    assert np.mean(passed[len(known) : len(known) + 3000]) < 0.02


def test_which_frames_may_concern_position_speed_and_the_factorys_flow() -> None:
    found = SideInputs().concerns(np.array(list(CONCERNED), np.uint32))
    assert dict(zip(map(hex, CONCERNED), found.tolist(), strict=True)) == {hex(i): c for i, c in CONCERNED.items()}

"""Fast packets of NMEA 2000 by their bytes, and each limit of their reassembly met exactly and missed."""

from __future__ import annotations

import pytest

from tests.network.peer import split
from yieldmon.network.fast_packet import FastPacketReceiver
from yieldmon.network.identifier import Identifier

IDENTIFIER = 0x19F8051C
"""PGN 129029 from address 28, priority 6."""
TIMEOUT_S, BEYOND_S = 0.75, 1.0 / 1024.0
CONTENT = bytes(range(1, 16))


def frames(data: bytes = CONTENT, counter: int = 0) -> list[bytes]:
    return [f.data for f in split(129029, data, 0x1C, counter=counter)]


def fed(receiver: FastPacketReceiver, data: bytes, now_s: float = 0.0, identifier: int = IDENTIFIER) -> bytes | None:
    payload = receiver.feed(Identifier.of(identifier), data, now_s)
    return None if payload is None else payload.data


@pytest.mark.parametrize("counter", range(9))
def test_a_packet_by_its_bytes(counter: int) -> None:
    """Counter in the upper three bits, the part's number in the lower five; the length; 6 bytes and then 7, filled with 0xFF."""
    lead = counter % 8 * 32
    assert frames(counter=counter) == [
        bytes([lead, 15, 1, 2, 3, 4, 5, 6]),
        bytes([lead + 1, 7, 8, 9, 10, 11, 12, 13]),
        bytes([lead + 2, 14, 15, 255, 255, 255, 255, 255]),
    ]
    assert {f.identifier for f in split(129029, CONTENT, 0x1C, counter=counter)} == {IDENTIFIER}
    assert {f.identifier for f in split(129029, CONTENT, 0x1C, counter=0, priority=3)} == {IDENTIFIER - (3 << 26)}


@pytest.mark.parametrize(("size", "count"), [(1, 1), (6, 1), (7, 2), (13, 2), (14, 3), (223, 32)])
def test_packets_of_1_to_223_bytes(size: int, count: int) -> None:
    data = bytes(k % 256 for k in range(size))
    sent, receiver = frames(data), FastPacketReceiver()
    assert len(sent) == count
    assert [fed(receiver, part) for part in sent] == [None] * (count - 1) + [data]
    assert (len(receiver), receiver.abandoned) == (0, 0)


@pytest.mark.parametrize("size", [0, 224])
def test_no_packet_is_of_another_size(size: int) -> None:
    with pytest.raises(ValueError, match=f"fast packet of {size} bytes, expected 1 to 223"):
        frames(bytes(size))
    receiver = FastPacketReceiver()
    assert fed(receiver, bytes([0, size, 1, 2, 3, 4, 5, 6])) is None
    assert len(receiver) == 0


@pytest.mark.parametrize(("late_s", "whole"), [(0.0, True), (BEYOND_S, False)])
def test_each_part_is_waited_for_so_long(late_s: float, whole: bool) -> None:
    receiver = FastPacketReceiver()
    first, second, third = frames()
    fed(receiver, first, 1.0)
    fed(receiver, second, 1.0 + TIMEOUT_S)
    found = fed(receiver, third, 1.0 + 2.0 * TIMEOUT_S + late_s)
    assert found == (CONTENT if whole else None)
    assert (len(receiver), receiver.abandoned) == (0, 0 if whole else 1)
    receiver = FastPacketReceiver()
    fed(receiver, first, 1.0)
    fed(receiver, second, 1.0 + TIMEOUT_S + late_s)
    assert len(receiver) == int(whole)


def test_packets_of_different_senders_groups_and_counters_are_kept_apart() -> None:
    receiver = FastPacketReceiver()
    keys = [(IDENTIFIER, 0), (IDENTIFIER, 1), (IDENTIFIER + 1, 0), (IDENTIFIER + (1 << 8), 0)]
    for part in range(3):
        found = [fed(receiver, frames(bytes([k]) + CONTENT[1:], counter)[part], 0.0, i) for k, (i, counter) in enumerate(keys)]
        assert found == ([bytes([k]) + CONTENT[1:] for k in range(4)] if part == 2 else [None] * 4)


def test_a_packet_begun_anew_takes_the_place_of_the_one_before() -> None:
    receiver = FastPacketReceiver()
    first, second, third = frames()
    for part in (first, second, first, second):
        assert fed(receiver, part) is None
    assert (fed(receiver, third), receiver.abandoned) == (CONTENT, 1)
    assert fed(receiver, second) is None, "a part of nothing"
    assert receiver.abandoned == 1
    assert fed(receiver, first[:7]) is None
    assert len(receiver) == 0


def test_the_oldest_of_too_many_goes() -> None:
    receiver = FastPacketReceiver()
    for source in range(33):
        fed(receiver, frames()[0], 0.0, IDENTIFIER & ~0xFF | source)
        assert (len(receiver), receiver.abandoned) == (min(source + 1, 32), int(source == 32))
    for source, whole in ((0, None), (1, CONTENT), (32, CONTENT)):
        fed(receiver, frames()[1], 0.0, IDENTIFIER & ~0xFF | source)
        assert fed(receiver, frames()[2], 0.0, IDENTIFIER & ~0xFF | source) == whole

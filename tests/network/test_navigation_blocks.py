"""Columns of a log's block say what the frames say one by one, for any bytes."""

from __future__ import annotations

import random

import numpy as np
import pytest

from yieldmon.network.identifier import Payload
from yieldmon.network.navigation import GROUPS, Quantity, read
from yieldmon.network.navigation_blocks import read_block

SINGLE = sorted(group for group in GROUPS if read_block(group, *(np.zeros(1, t) for t in (np.intp, float, np.uint64, np.uint8))))


def contents(seed: int) -> list[bytes]:
    """Bytes of every kind: any, plausible positions, and ends of each range."""
    rng = random.Random(seed)
    found = [rng.randbytes(rng.choice((8, 8, 8, 7, 3))) for _ in range(300)]
    for _ in range(300):
        data = bytearray(rng.randbytes(8))
        data[1] &= 0xFC
        at = rng.randrange(8)
        data[at] = rng.choice((0x00, 0x7F, 0x80, 0xFA, 0xFB, 0xFC, 0xFD, 0xFE, 0xFF))
        data[3] = data[7] = rng.choice((0x00, 0x0F, 0x3F, 0x7C, 0xFA, 0xFF))
        found.append(bytes(data))
    found += [bytes(8), (2_100_000_000).to_bytes(4, "little") * 2, bytes(4) + b"\x00\x01\x00\x00"]
    for low in range(0xF8, 0x100):
        found += [bytes([low] + [0xFF] * 7), bytes([0, 0, *[low, 0xFF] * 3]), bytes([0, 0, low, 0xFA, low, 0xFA, low, 0x7F])]
    return found


@pytest.mark.parametrize("group", SINGLE)
def test_a_block_says_what_its_frames_say(group: int) -> None:
    data = contents(group)
    rows = np.arange(len(data)) * 3
    times = 100.0 + 0.1 * np.arange(len(data))
    payload = np.array([int.from_bytes(one[:8].ljust(8, b"\0"), "little") for one in data], np.uint64)
    reported = read_block(group, rows, times, payload, np.array([len(one) for one in data], np.uint8))
    by_frame: dict[Quantity, list[tuple[int, float, float]]] = {}
    for row, time_s, one in zip(rows.tolist(), times.tolist(), data, strict=True):
        for reading in read(Payload(time_s, group, 0x1C, 255, 6, one)):
            if reading.quantity is not Quantity.TIME:
                by_frame.setdefault(reading.quantity, []).append((row, time_s, reading.value))
    assert by_frame
    assert {quantity for quantity, at in reported} == set(by_frame)
    for (quantity, _), column in reported.items():
        expected = by_frame[quantity]
        assert column.rows.tolist() == [row for row, _, _ in expected]
        assert column.time_s.tolist() == [time_s for _, time_s, _ in expected]
        assert column.values == pytest.approx([value for _, _, value in expected], rel=1e-12)

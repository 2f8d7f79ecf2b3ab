"""Standard position, speed, course and time: vectors from PySOBUS (FarmLogs) and worked out by hand from the standards."""

from __future__ import annotations

import math
import struct
from datetime import UTC, datetime

import pytest

from yieldmon.network.identifier import Identifier, Payload
from yieldmon.network.navigation import Navigation, Quantity, read
from yieldmon.network.reassembly import Reassembler

#: PySOBUS 0.0.3, parser.py: the frames of one 129029 in the order in which its test feeds them, and position that it reads.
PYSOBUS_129029 = (
    "61F8051C86FF015F08BC0201",
    "61F8051C840000000023000B",
    "61F8051C812B801401279131",
    "61F8051C802FCC923F73E755",
    "61F8051C85510087006BF2FF",
    "61F8051C83736BF4926E420B",
    "61F8051C82090600A1A1478C",
)
PYSOBUS_POSITION = (43.493333851236464, -83.44462596127045)


def payload(group: int, data: bytes, time_s: float = 0.0, source: int = 0x1C) -> Payload:
    return Payload(time_s, group, source, 255, 6, data)


def values(group: int, data: bytes) -> dict[str, float]:
    return {r.quantity.value: r.value for r in read(payload(group, data))}


def _gnss(height: int) -> bytes:
    """Position and height, um, without a time."""
    return struct.pack("<BHIqqq", 0, 0xFFFF, 0xFFFFFFFF, 475 * 10**15, -85 * 10**15, height)


def test_pysobus_vehicle_position() -> None:
    listener = Reassembler()
    (got,) = listener.feed(0x60FEF31C, bytes.fromhex("D1EE2397FA7C744B"), 0.0)
    assert (got.group, got.source) == (65267, 28)
    # PySOBUS: 1e-7 deg a bit, -210 deg.
    expected = (0x9723EED1 * 1e-7 - 210, 0x4B747CFA * 1e-7 - 210)
    found = {r.quantity: r.value for r in read(got)}
    assert (found[Quantity.LATITUDE], found[Quantity.LONGITUDE]) == pytest.approx(expected, abs=1e-9)
    assert 40 < expected[0] < 45


def test_pysobus_gnss_position() -> None:
    listener, got = Reassembler(), []
    for text in sorted(PYSOBUS_129029, key=lambda t: int(t[8:10], 16)):
        got += listener.feed(int(text[:8], 16), bytes.fromhex(text[8:]), 0.0)
    (whole,) = got
    found = {r.quantity: r.value for r in read(whole)}
    assert (found[Quantity.LATITUDE], found[Quantity.LONGITUDE]) == pytest.approx(PYSOBUS_POSITION, abs=1e-12)


@pytest.mark.parametrize(
    ("group", "data", "expected"),
    [
        (65256, struct.pack("<HHHH", 128 * 90, 256 * 18, 0xFFFF, 0xFFFF), {"course_deg": 90.0, "ground_speed_m_s": 5.0}),
        (65256, b"\xff" * 8, {}),
        (65265, b"\xff" + struct.pack("<H", 256 * 9) + b"\xff" * 5, {"ground_speed_m_s": 2.5}),
        (65096, struct.pack("<HIBB", 2500, 0, 0, 1), {"ground_speed_m_s": 2.5}),
        (65097, struct.pack("<HIBB", 0xFE00, 0, 0, 1), {}),
        (65097, struct.pack("<HIBB", 1234, 0, 0, 0), {"ground_speed_m_s": 1.234}),
        # Machine selected speed: from wheels, blended, simulated, of no known source.
        (61474, struct.pack("<HIBB", 2500, 0, 0, 0b111_000_01), {"ground_speed_m_s": 2.5}),
        (61474, struct.pack("<HIBB", 2500, 0, 0, 0b000_011_01), {"ground_speed_m_s": 2.5}),
        (61474, struct.pack("<HIBB", 2500, 0, 0, 0b000_100_01), {}),
        (61474, struct.pack("<HIBB", 2500, 0, 0, 0b000_111_01), {}),
        (61474, struct.pack("<HIBB", 0xFB00, 0, 0, 0b000_000_01), {}),
        (129025, struct.pack("<ii", 475000000, -85000000), {"latitude_deg": 47.5, "longitude_deg": -8.5}),
        (129025, struct.pack("<ii", 0x7FFFFFFF, 5), {}),
        (129025, struct.pack("<ii", 910000000, 5), {}),
        (
            129026,
            struct.pack("<BBHHH", 0, 0xFC, 15708, 250, 0xFFFF),
            {"course_deg": math.degrees(1.5708), "ground_speed_m_s": 2.5},
        ),
        (129026, struct.pack("<BBHHH", 0, 0xFD, 15708, 250, 0xFFFF), {"ground_speed_m_s": 2.5}),
        (129026, struct.pack("<BBHHH", 0, 0xFC, 0xFFFF, 0xFFFF, 0xFFFF), {}),
        (129029, _gnss(height=-5_000_000), {"latitude_deg": 47.5, "longitude_deg": -8.5, "altitude_m": -5.0}),
        (129029, _gnss(height=0x7FFFFFFFFFFFFFFC), {"latitude_deg": 47.5, "longitude_deg": -8.5, "altitude_m": 2**63 * 1e-6}),
        (129029, _gnss(height=0x7FFFFFFFFFFFFFFD), {"latitude_deg": 47.5, "longitude_deg": -8.5}),
        (129029, _gnss(height=0) + b"\x13", {"latitude_deg": 47.5, "longitude_deg": -8.5, "altitude_m": 0.0}),
        (129029, _gnss(height=0) + b"\x63", {"latitude_deg": 47.5, "longitude_deg": -8.5, "altitude_m": 0.0}),
        *((129029, _gnss(height=0) + bytes([method << 4 | 3]), {}) for method in (0, 7, 8)),
        (129025, struct.pack("<ii", 0, 85000000), {"latitude_deg": 0.0, "longitude_deg": 8.5}),
        (129025, bytes(8), {}),
        (65267, struct.pack("<II", 2_100_000_000, 2_100_000_000), {}),
        (129026, struct.pack("<BBHHH", 0, 0xFC, 0xFFFD, 0xFFFC, 0xFFFF), {"ground_speed_m_s": 655.32}),
        (129026, struct.pack("<BBHHH", 0, 0xFC, 0xFFFD, 0xFFFD, 0xFFFF), {}),
        (126992, struct.pack("<BBHI", 0, 0xF0, 20000, 432000000), {"time_s": 20000 * 86400 + 43200.0}),
        (126992, struct.pack("<BBHI", 0, 0xF0, 0xFFFF, 0xFFFFFFFF), {}),
        (65254, bytes([40, 30, 12, 7, 60, 40, 125, 125]), {"time_s": datetime(2025, 7, 15, 12, 30, 10, tzinfo=UTC).timestamp()}),
        (65254, bytes([40, 30, 12, 13, 60, 40, 125, 125]), {}),
        (65254, bytes(5), {}),
        (60000, bytes(8), {}),
    ],
)
def test_reading(group: int, data: bytes, expected: dict[str, float]) -> None:
    assert values(group, data) == pytest.approx(expected)


def _date_and_time(days: int, ten_thousandths: int) -> bytes:
    return struct.pack("<BBHI", 0, 0xF0, days, ten_thousandths)


def _rapid(latitude: int, longitude: int) -> bytes:
    return struct.pack("<ii", latitude, longitude)


@pytest.mark.parametrize(
    ("group", "last", "expected", "next_one"),
    [
        # A day with a leap second has 86,401 s.
        (126992, _date_and_time(10, 864_010_000), {"time_s": 10 * 86400 + 86401.0}, _date_and_time(10, 864_010_001)),
        (126992, _date_and_time(0xFFFC, 0), {"time_s": 0xFFFC * 86400.0}, _date_and_time(0xFFFD, 0)),
        (129025, _rapid(900_000_000, 0), {"latitude_deg": 90.0, "longitude_deg": 0.0}, _rapid(900_000_001, 0)),
        (129025, _rapid(-900_000_000, 0), {"latitude_deg": -90.0, "longitude_deg": 0.0}, _rapid(-900_000_001, 0)),
        (129025, _rapid(0, 1_800_000_000), {"latitude_deg": 0.0, "longitude_deg": 180.0}, _rapid(0, 1_800_000_001)),
        (129025, _rapid(0, -1_800_000_000), {"latitude_deg": 0.0, "longitude_deg": -180.0}, _rapid(0, -1_800_000_001)),
        (
            65256,
            struct.pack("<HHHH", 0xFAFF, 0xFFFF, 0, 0),
            {"course_deg": 0xFAFF / 128},
            struct.pack("<HHHH", 0xFB00, 0xFFFF, 0, 0),
        ),
        (65265, b"\xff\xff\xfa" + bytes(5), {"ground_speed_m_s": 0xFAFF / 256 / 3.6}, b"\xff\x00\xfb" + bytes(5)),
        (65097, struct.pack("<HIBB", 0xFAFF, 0, 0, 1), {"ground_speed_m_s": 64.255}, struct.pack("<HIBB", 0xFB00, 0, 0, 1)),
        # Seconds come in quarters and up to 62.5, which a leap second needs; 250 is the last code of a value.
        (65254, bytes([250, 0, 0, 1, 4, 0, 0, 0]), {"time_s": 473_385_600 + 62.5}, bytes([251, 0, 0, 1, 4, 0, 0, 0])),
        (65254, bytes([0, 59, 23, 12, 124, 124, 0, 0]), {"time_s": 4_417_977_540.0}, bytes([0, 60, 23, 12, 124, 124, 0, 0])),
    ],
)
def test_the_last_value_and_the_one_behind_it(group: int, last: bytes, expected: dict[str, float], next_one: bytes) -> None:
    assert values(group, last) == pytest.approx(expected, rel=1e-12)
    assert values(group, next_one) == {}


@pytest.mark.parametrize("length", range(8))
@pytest.mark.parametrize("group", [65267, 65256, 65265, 65254, 61474, 65096, 65097, 129025, 129026, 129029, 126992])
def test_data_that_are_cut_say_nothing(group: int, length: int) -> None:
    assert values(group, bytes(length)) == {}


def test_of_two_senders_of_a_group_the_first_counts_until_it_is_silent() -> None:
    navigation = Navigation(timeout_s=2.0)
    found = []
    for time_s, source, degrees in ((0.0, 0x1C, 47.0), (0.1, 0x2A, 48.0), (1.0, 0x1C, 47.1), (3.0, 0x2A, 48.1), (3.1, 0x2A, 48.2),
                                    (3.2, 0x1C, 47.2)):  # fmt: skip
        data = struct.pack("<ii", round(degrees * 1e7), 85000000)
        navigation.feed(payload(129025, data, time_s, source))
        best = navigation.best(Quantity.LATITUDE, time_s)
        assert best is not None
        found.append(round(best.value, 6))
    assert found == [47.0, 47.0, 47.1, 47.1, 48.2, 48.2]


def test_a_position_that_a_node_repeats_while_it_has_no_fix_does_not_count() -> None:
    """Until its 129029 has one again, or has been silent for the timeout; another node's does."""
    navigation = Navigation(timeout_s=2.0)
    rapid = struct.pack("<ii", 475000000, 85000000)
    found = []
    for time_s, method in ((0.0, 1), (1.0, 0), (1.5, 0), (2.5, 0), (3.5, 1), (4.5, 8), (7.0, None)):
        if method is not None:
            navigation.feed(payload(129029, _gnss(height=0) + bytes([method << 4 | 3]), time_s, 0x1C))
        for source in (0x1C, 0x2A):
            navigation.feed(payload(129025, rapid, time_s + 0.1, source))
        latest = navigation.latest(Quantity.LATITUDE, 129025)
        found.append(None if latest is None else (latest.source, latest.time_s))
    # The other node's counts once the first has been silent for the timeout.
    assert found == [(0x1C, 0.1), (0x1C, 0.1), (0x1C, 0.1), (0x2A, 2.6), (0x2A, 3.6), (0x2A, 4.6), (0x1C, 7.1)]


def test_best_source_and_the_next_one() -> None:
    navigation = Navigation(timeout_s=2.0)
    wheel = struct.pack("<HIBB", 2500, 0, 0, 1)
    gnss = struct.pack("<BBHHH", 0, 0xFC, 0, 240, 0xFFFF)
    for time_s, group, data, expected in (
        (-0.3, 65265, b"\xff" + struct.pack("<H", 256 * 9) + b"\xff" * 5, 65265),
        (-0.2, 65096, wheel, 65096),
        (-0.1, 61474, struct.pack("<HIBB", 2500, 0, 0, 1), 61474),
        (0.0, 65097, wheel, 65097),
        (0.5, 129026, gnss, 129026),
        (1.5, 65096, wheel, 129026),
        (2.6, 65096, wheel, 65096),
        (2.7, 129026, gnss, 129026),
    ):
        navigation.feed(payload(group, data, time_s))
        best = navigation.best(Quantity.SPEED, time_s)
        assert best is not None
        assert best.group == expected
    assert navigation.best(Quantity.SPEED, 10.0) is None
    assert navigation.best(Quantity.LATITUDE, 2.7) is None


def test_identifier_of_pysobus_has_more_than_29_bits() -> None:
    assert Identifier.of(0x61F8051C).group == 129029

"""Position, speed, course and time from the standard messages of three families, and which of several sources is used.

SAE J1939-71 (65267, 65256, 65265, 65254), ISO 11783-7 (65096, 65097) and NMEA 2000 (129025, 129026, 129029, 126992).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from enum import StrEnum
from typing import NamedTuple

from yieldmon.units import S_PER_DAY

from .identifier import Payload


class Quantity(StrEnum):
    """What these messages hold, by name and unit."""

    LATITUDE = "latitude_deg"
    LONGITUDE = "longitude_deg"
    ALTITUDE = "altitude_m"
    SPEED = "ground_speed_m_s"
    COURSE = "course_deg"
    TIME = "time_s"
    """Unix time, UTC."""


class Reading(NamedTuple):
    """One value of one quantity, with the group and node that it came from."""

    time_s: float
    quantity: Quantity
    value: float
    group: int
    source: int


VEHICLE_POSITION, DIRECTION_SPEED, CRUISE_VEHICLE_SPEED, TIME_DATE = 65267, 65256, 65265, 65254
WHEEL_SPEED, GROUND_SPEED = 65096, 65097
POSITION_RAPID, COURSE_SPEED_RAPID, GNSS_POSITION, SYSTEM_TIME = 129025, 129026, 129029, 126992

#: The best source first: satellites with full resolution, satellites through J1939, radar, wheels.
ORDER: Mapping[Quantity, tuple[int, ...]] = {
    Quantity.LATITUDE: (GNSS_POSITION, POSITION_RAPID, VEHICLE_POSITION),
    Quantity.LONGITUDE: (GNSS_POSITION, POSITION_RAPID, VEHICLE_POSITION),
    Quantity.ALTITUDE: (GNSS_POSITION,),
    Quantity.SPEED: (COURSE_SPEED_RAPID, DIRECTION_SPEED, GROUND_SPEED, WHEEL_SPEED, CRUISE_VEHICLE_SPEED),
    Quantity.COURSE: (COURSE_SPEED_RAPID, DIRECTION_SPEED),
    Quantity.TIME: (GNSS_POSITION, SYSTEM_TIME, TIME_DATE),
}
#: Longer than this without a message, and the next source is used.
TIMEOUT_S = 2.0

_KMH = 1 / 3.6
Values = dict[Quantity, float]


def _j1939(raw: int, bits: int, scale: float, offset: float = 0.0) -> float | None:
    """Physical value, None where the leading byte says not available, error or reserved."""
    return raw * scale + offset if raw >> (bits - 8) <= 0xFA else None


def _nmea(raw: int, bits: int, scale: float, *, signed: bool) -> float | None:
    """Physical value, None for the three highest values of the type."""
    highest = (1 << bits - 1) - 1 if signed else (1 << bits) - 1
    return raw * scale if raw <= highest - 3 else None


def _known(values: Mapping[Quantity, float | None]) -> Values:
    return {quantity: value for quantity, value in values.items() if value is not None}


def _position(latitude: float | None, longitude: float | None) -> Values:
    """Both or neither, on the globe."""
    if latitude is None or longitude is None or abs(latitude) > 90.0 or abs(longitude) > 180.0:
        return {}
    return {Quantity.LATITUDE: latitude, Quantity.LONGITUDE: longitude}


def _vehicle_position(data: bytes) -> Values:
    latitude, longitude = struct.unpack("<II", data[:8])
    return _position(_j1939(latitude, 32, 1e-7, -210.0), _j1939(longitude, 32, 1e-7, -210.0))


def _direction_speed(data: bytes) -> Values:
    bearing, speed = struct.unpack("<HH", data[:4])
    return _known({Quantity.COURSE: _j1939(bearing, 16, 1 / 128), Quantity.SPEED: _j1939(speed, 16, _KMH / 256)})


def _cruise_speed(data: bytes) -> Values:
    (speed,) = struct.unpack("<H", data[1:3])
    return _known({Quantity.SPEED: _j1939(speed, 16, _KMH / 256)})


def _machine_speed(data: bytes) -> Values:
    (speed,) = struct.unpack("<H", data[:2])
    return _known({Quantity.SPEED: _j1939(speed, 16, 1e-3)})


def _time_date(data: bytes) -> Values:
    second, minute, hour, month, day, year = data[:6]
    if max(data[:6]) > 0xFA:
        return {}
    try:
        moment = datetime(1985 + year, month, max(1, -(-day // 4)), hour, minute, tzinfo=UTC)
    except ValueError:
        return {}
    return {Quantity.TIME: moment.timestamp() + second / 4}


def _position_rapid(data: bytes) -> Values:
    latitude, longitude = struct.unpack("<ii", data[:8])
    return _position(_nmea(latitude, 32, 1e-7, signed=True), _nmea(longitude, 32, 1e-7, signed=True))


def _course_speed(data: bytes) -> Values:
    _sequence, reference, course, speed = struct.unpack("<BBHH", data[:6])
    true_north = reference & 3 == 0
    course_rad = _nmea(course, 16, 1e-4, signed=False) if true_north else None
    return _known(
        {
            Quantity.COURSE: math.degrees(course_rad) if course_rad is not None else None,
            Quantity.SPEED: _nmea(speed, 16, 0.01, signed=False),
        }
    )


def _gnss_position(data: bytes) -> Values:
    _sequence, days, time, latitude, longitude, altitude = struct.unpack("<BHIqqq", data[:31])
    values = _position(_nmea(latitude, 64, 1e-16, signed=True), _nmea(longitude, 64, 1e-16, signed=True))
    height_m = _nmea(altitude, 64, 1e-6, signed=True)
    return values | _date_time(days, time) | _known({Quantity.ALTITUDE: height_m})


def _system_time(data: bytes) -> Values:
    _sequence, _source, days, time = struct.unpack("<BBHI", data[:8])
    return _date_time(days, time)


def _date_time(days: int, time: int) -> Values:
    date, since_midnight_s = _nmea(days, 16, 1.0, signed=False), _nmea(time, 32, 1e-4, signed=False)
    if date is None or since_midnight_s is None or since_midnight_s > S_PER_DAY + 1.0:
        return {}
    return {Quantity.TIME: date * S_PER_DAY + since_midnight_s}


_READERS: Mapping[int, tuple[int, Callable[[bytes], Values]]] = {
    VEHICLE_POSITION: (8, _vehicle_position),
    DIRECTION_SPEED: (8, _direction_speed),
    CRUISE_VEHICLE_SPEED: (8, _cruise_speed),
    TIME_DATE: (8, _time_date),
    WHEEL_SPEED: (8, _machine_speed),
    GROUND_SPEED: (8, _machine_speed),
    POSITION_RAPID: (8, _position_rapid),
    COURSE_SPEED_RAPID: (8, _course_speed),
    GNSS_POSITION: (31, _gnss_position),
    SYSTEM_TIME: (8, _system_time),
}
GROUPS = frozenset(_READERS)
"""Parameter groups that read() takes."""


def read(payload: Payload) -> list[Reading]:
    """What a complete parameter group says of these quantities; [] for other groups, short ones and what is not available."""
    least, reader = _READERS.get(payload.group, (0, None))
    if reader is None or len(payload.data) < least:
        return []
    values = reader(payload.data)
    return [Reading(payload.time_s, quantity, value, payload.group, payload.source) for quantity, value in values.items()]


class Navigation:
    """The latest of every source, and the best of them.

    Parameters
    ----------
    order : mapping
        Parameter groups of each quantity, the best first.
    timeout_s : float
        Age beyond which a reading counts as absent.
    """

    def __init__(self, order: Mapping[Quantity, tuple[int, ...]] = ORDER, timeout_s: float = TIMEOUT_S) -> None:
        self._order = order
        self._timeout_s = timeout_s
        self._latest: dict[tuple[Quantity, int], Reading] = {}

    def feed(self, payload: Payload) -> None:
        """Take a complete parameter group."""
        for reading in read(payload):
            self.take(reading)

    def take(self, reading: Reading) -> None:
        """Take one reading."""
        self._latest[(reading.quantity, reading.group)] = reading

    def latest(self, quantity: Quantity, group: int) -> Reading | None:
        """The last reading of a source, however old."""
        return self._latest.get((quantity, group))

    def best(self, quantity: Quantity, now_s: float) -> Reading | None:
        """The reading to use at now_s: the first source in the order that has one no older than the timeout."""
        for group in self._order.get(quantity, ()):
            reading = self._latest.get((quantity, group))
            if reading is not None and 0.0 <= now_s - reading.time_s <= self._timeout_s:
                return reading
        return None

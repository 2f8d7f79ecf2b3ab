"""Position, speed, course and time from the standard messages of three families, and which of several sources is used.

SAE J1939-71 (65267, 65256, 65265, 65254), ISO 11783-7 (61474, 65096, 65097) and NMEA 2000 (129025, 129026, 129029, 126992).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable, Mapping
from datetime import UTC, datetime
from enum import StrEnum
from functools import partial
from typing import NamedTuple

from yieldmon.identifiers import CLASSIC_BYTES
from yieldmon.places import is_somewhere
from yieldmon.units import M_S_PER_KMH, S_PER_DAY

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
WHEEL_SPEED, GROUND_SPEED, SELECTED_SPEED = 65096, 65097, 61474
POSITION_RAPID, COURSE_SPEED_RAPID, GNSS_POSITION, SYSTEM_TIME = 129025, 129026, 129029, 126992

#: The best source first: satellites with full resolution, satellites through J1939, radar, what the machine itself uses, wheels.
ORDER: Mapping[Quantity, tuple[int, ...]] = {
    Quantity.LATITUDE: (GNSS_POSITION, POSITION_RAPID, VEHICLE_POSITION),
    Quantity.LONGITUDE: (GNSS_POSITION, POSITION_RAPID, VEHICLE_POSITION),
    Quantity.ALTITUDE: (GNSS_POSITION,),
    Quantity.SPEED: (
        COURSE_SPEED_RAPID,
        DIRECTION_SPEED,
        GROUND_SPEED,
        SELECTED_SPEED,
        WHEEL_SPEED,
        CRUISE_VEHICLE_SPEED,
    ),
    Quantity.COURSE: (COURSE_SPEED_RAPID, DIRECTION_SPEED),
    Quantity.TIME: (GNSS_POSITION, SYSTEM_TIME, TIME_DATE),
}
#: Longer than this without a message, and the next source is used.
TIMEOUT_S = 2.0

Values = dict[Quantity, float]


class Field(NamedTuple):
    """A quantity in a message of one frame.

    start, bits: of its raw value in the data as a little-endian number. most: largest raw value that is a measurement.
    in_radians: raw * scale is in rad and the quantity in deg. where: start, bits and value that another field must have.
    """

    quantity: Quantity
    start: int
    bits: int
    most: int
    scale: float
    offset: float = 0.0
    signed: bool = False
    in_radians: bool = False
    where: tuple[int, int, int] | None = None


def _most_j1939(bits: int) -> int:
    """Higher values of the leading byte say not available, error or reserved."""
    return (0xFB << bits - 8) - 1


def _most_nmea(bits: int, *, signed: bool) -> int:
    """The three highest values of the type are no measurement."""
    return ((1 << bits - 1) if signed else (1 << bits)) - 4


def _j1939(quantity: Quantity, start: int, bits: int, scale: float, offset: float = 0.0) -> Field:
    return Field(quantity, start, bits, _most_j1939(bits), scale, offset)


def _degrees(quantity: Quantity, start: int) -> Field:
    return Field(quantity, start, 32, _most_nmea(32, signed=True), 1e-7, signed=True)


FIELDS: Mapping[int, tuple[Field, ...]] = {
    VEHICLE_POSITION: (_j1939(Quantity.LATITUDE, 0, 32, 1e-7, -210.0), _j1939(Quantity.LONGITUDE, 32, 32, 1e-7, -210.0)),
    DIRECTION_SPEED: (_j1939(Quantity.COURSE, 0, 16, 1 / 128), _j1939(Quantity.SPEED, 16, 16, M_S_PER_KMH / 256)),
    CRUISE_VEHICLE_SPEED: (_j1939(Quantity.SPEED, 8, 16, M_S_PER_KMH / 256),),
    WHEEL_SPEED: (_j1939(Quantity.SPEED, 0, 16, 1e-3),),
    GROUND_SPEED: (_j1939(Quantity.SPEED, 0, 16, 1e-3),),
    # From wheels, ground, satellites or several of these (0 to 3), and not simulated.
    SELECTED_SPEED: (_j1939(Quantity.SPEED, 0, 16, 1e-3)._replace(where=(60, 1, 0)),),
    POSITION_RAPID: (_degrees(Quantity.LATITUDE, 0), _degrees(Quantity.LONGITUDE, 32)),
    COURSE_SPEED_RAPID: (
        # Of magnetic north there is nothing to be had.
        Field(Quantity.COURSE, 16, 16, _most_nmea(16, signed=False), 1e-4, in_radians=True, where=(8, 2, 0)),
        Field(Quantity.SPEED, 32, 16, _most_nmea(16, signed=False), 0.01),
    ),
}
"""What messages of one frame hold, without a time of day."""
_GNSS_METHOD_AT, _NOT_MEASURED = 31, frozenset({0, 7, 8})
"""Byte of 129029 with the method in its upper half, and methods that measure no position: none, entered by hand, simulated."""
LARGEST_LATITUDE_DEG, LARGEST_LONGITUDE_DEG = 90.0, 180.0


def _of_one_frame(fields: Iterable[Field], data: bytes) -> Values:
    payload = int.from_bytes(data[:CLASSIC_BYTES], "little")
    values: Values = {}
    for field in fields:
        raw = payload >> field.start & ((1 << field.bits) - 1)
        if field.signed and raw >> field.bits - 1:
            raw -= 1 << field.bits
        if raw > field.most or (field.where is not None and not _holds(payload, *field.where)):
            continue
        value = raw * field.scale + field.offset
        values[field.quantity] = math.degrees(value) if field.in_radians else value
    return _on_the_globe(values)


def _holds(payload: int, start: int, bits: int, value: int) -> bool:
    return payload >> start & ((1 << bits) - 1) == value


def _on_the_globe(values: Values) -> Values:
    """Latitude and longitude both or neither, and neither where they are 0."""
    latitude, longitude = values.get(Quantity.LATITUDE), values.get(Quantity.LONGITUDE)
    known = latitude is not None and longitude is not None
    place = latitude or 0.0, longitude or 0.0
    on_it = known and abs(place[0]) <= LARGEST_LATITUDE_DEG and abs(place[1]) <= LARGEST_LONGITUDE_DEG
    if on_it and is_somewhere(*place):
        return values
    return {name: value for name, value in values.items() if name not in (Quantity.LATITUDE, Quantity.LONGITUDE)}


def _nmea(raw: int, bits: int, scale: float, *, signed: bool) -> float | None:
    return raw * scale if raw <= _most_nmea(bits, signed=signed) else None


def _known(values: Mapping[Quantity, float | None]) -> Values:
    return {quantity: value for quantity, value in values.items() if value is not None}


def _time_date(data: bytes) -> Values:
    second, minute, hour, month, day, year = data[:6]
    if max(data[:6]) > 0xFA:
        return {}
    try:
        moment = datetime(1985 + year, month, max(1, -(-day // 4)), hour, minute, tzinfo=UTC)
    except ValueError:
        return {}
    return {Quantity.TIME: moment.timestamp() + second / 4}


def _gnss_position(data: bytes) -> Values:
    _sequence, days, time, latitude, longitude, altitude = struct.unpack("<BHIqqq", data[:31])
    if len(data) > _GNSS_METHOD_AT and data[_GNSS_METHOD_AT] >> 4 in _NOT_MEASURED:
        return _date_time(days, time)
    place = {
        Quantity.LATITUDE: _nmea(latitude, 64, 1e-16, signed=True),
        Quantity.LONGITUDE: _nmea(longitude, 64, 1e-16, signed=True),
    }
    height_m = _nmea(altitude, 64, 1e-6, signed=True)
    return _on_the_globe(_known(place)) | _date_time(days, time) | _known({Quantity.ALTITUDE: height_m})


def fix_of(payload: Payload) -> bool | None:
    """Whether a node has measured its position, as its 129029 says; None where a payload does not say."""
    if payload.group != GNSS_POSITION or len(payload.data) <= _GNSS_METHOD_AT:
        return None
    return payload.data[_GNSS_METHOD_AT] >> 4 not in _NOT_MEASURED


def _system_time(data: bytes) -> Values:
    _sequence, _source, days, time = struct.unpack("<BBHI", data[:8])
    return _date_time(days, time)


def _date_time(days: int, time: int) -> Values:
    date, since_midnight_s = _nmea(days, 16, 1.0, signed=False), _nmea(time, 32, 1e-4, signed=False)
    if date is None or since_midnight_s is None or since_midnight_s > S_PER_DAY + 1.0:
        return {}
    return {Quantity.TIME: date * S_PER_DAY + since_midnight_s}


_READERS: Mapping[int, tuple[int, Callable[[bytes], Values]]] = {
    **{group: (CLASSIC_BYTES, partial(_of_one_frame, fields)) for group, fields in FIELDS.items()},
    TIME_DATE: (8, _time_date),
    GNSS_POSITION: (31, _gnss_position),
    SYSTEM_TIME: (8, _system_time),
}
"""Fewest bytes of a group, and what reads it."""
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
    """The latest of every source, and the best of them. Where several nodes send one group, the first of them counts until it has
    been silent for the timeout: two receivers are some metres apart. While a node's 129029 says that it has no fix, the position
    of its 129025, often the last one repeated, does not count.

    Parameters
    ----------
    timeout_s : float
        Age beyond which a reading counts as absent.
    """

    def __init__(self, timeout_s: float = TIMEOUT_S) -> None:
        self.timeout_s = timeout_s
        """As given."""
        self._latest: dict[tuple[Quantity, int], Reading] = {}
        self._without_fix: dict[int, float] = {}

    @property
    def without_fix(self) -> Mapping[int, float]:
        """When each node that has no fix last said so, by its address."""
        return self._without_fix

    def note_fix(self, source: int, time_s: float, has_fix: bool) -> None:
        """A node says whether it has measured its position."""
        if has_fix:
            self._without_fix.pop(source, None)
        else:
            self._without_fix[source] = time_s

    def is_without_fix(self, source: int, time_s: float) -> bool:
        """Whether a node has said within the timeout that it has no fix."""
        said_s = self._without_fix.get(source)
        return said_s is not None and 0.0 <= time_s - said_s <= self.timeout_s

    def feed(self, payload: Payload) -> None:
        """Take a complete parameter group."""
        self.note_fix_of(payload)
        for reading in read(payload):
            self.take(reading)

    def note_fix_of(self, payload: Payload) -> None:
        """As `note_fix`, where the payload says it."""
        has_fix = fix_of(payload)
        if has_fix is not None:
            self.note_fix(payload.source, payload.time_s, has_fix)

    def take(self, reading: Reading) -> bool:
        """Take one reading; whether it counts."""
        if reading.group == POSITION_RAPID and self.is_without_fix(reading.source, reading.time_s):
            return False
        before = self.latest(reading.quantity, reading.group)
        if before is not None and before.source != reading.source and self._is_fresh(before, reading.time_s):
            return False
        self.remember(reading)
        return True

    def remember(self, reading: Reading) -> None:
        """Take one reading that is known to count."""
        self._latest[(reading.quantity, reading.group)] = reading

    def latest(self, quantity: Quantity, group: int) -> Reading | None:
        """The last reading of a source, however old."""
        return self._latest.get((quantity, group))

    def best(self, quantity: Quantity, now_s: float) -> Reading | None:
        """The reading to use at now_s: the first source in `ORDER` that has one no older than the timeout."""
        for group in ORDER.get(quantity, ()):
            reading = self._latest.get((quantity, group))
            if reading is not None and self._is_fresh(reading, now_s):
                return reading
        return None

    def _is_fresh(self, reading: Reading, now_s: float) -> bool:
        return 0.0 <= now_s - reading.time_s <= self.timeout_s

"""A binary time log of ISO 11783-10: its header (which values a record holds) and its records as columns.

Source: ISO 11783-10:2015, annex D (XML elements TIM, PTN, DLV) and the binary time log.
"""

from __future__ import annotations

import struct
import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np

from yieldmon.errors import InputError
from yieldmon.field.table import Array
from yieldmon.files import task_data
from yieldmon.units import S_PER_DAY, S_PER_H

POSITION_DEG = 1e-7
#: Attribute of PTN -> numpy type in a record, in the order of a record.
_POSITION = {
    "A": ("<i4", "north"),
    "B": ("<i4", "east"),
    "C": ("<i4", "up_mm"),
    "D": ("u1", "status"),
    "E": ("<u2", "pdop"),
    "F": ("<u2", "hdop"),
    "G": ("u1", "satellites"),
    "H": ("<u4", "gps_ms"),
    "I": ("<u2", "gps_day"),
}
_NOT_AVAILABLE = -(2**31)
_ZONES_S, _FARTHEST_ZONE_S, _CLOCK_ERROR_S = 900.0, 14.0 * S_PER_H, 300.0
"""Between zones, to the farthest one, and by how much a terminal's clock may be off."""


@dataclass(frozen=True)
class Header:
    """What a record holds: `fields` of the position (name, numpy type), `values` (DDI, element), and constants."""

    fields: tuple[tuple[str, str], ...]
    values: tuple[tuple[int, str], ...]
    constants: dict[tuple[int, str], float]


@dataclass(frozen=True)
class TimeLog:
    """Columns of a log: Unix time, position, and (DDI, element) -> raw value, carried on to the next one; what was lost."""

    time_s: Array
    longitude_deg: Array
    latitude_deg: Array
    elevation_m: Array
    values: dict[tuple[int, str], Array]
    problem: str


def xml_root(data: bytes, where: str) -> ET.Element:
    """The root of an XML document without a document type. Raises InputError."""
    if b"<!DOCTYPE" in data[:4096].upper():
        raise InputError(where, "has a document type declaration", "plain ISO 11783-10 XML")
    try:
        return ET.fromstring(data)
    except (ET.ParseError, ValueError, LookupError) as error:
        raise InputError(where, f"is not well-formed XML: {error}", "ISO 11783-10 XML") from error


def process_value(text: str) -> float:
    """A value of process data, which has 32 bits. Raises ValueError."""
    value = int(text)
    if not -(2**31) <= value < 2**32:
        raise ValueError("more than 32 bits")
    return float(value)


def header(data: bytes, where: str) -> Header:
    """The header file of a log. Raises InputError."""
    root = xml_root(data, where)
    time = root if root.tag == "TIM" else root.find(".//TIM")
    if time is None or time.get("A") != "":
        raise InputError(where, "has no TIM with its time in the records", "the header of a binary time log")
    position = time.find("PTN")
    fields: tuple[tuple[str, str], ...] = ()
    if position is not None:
        fields = tuple((name, kind) for key, (kind, name) in _POSITION.items() if position.get(key) == "")
    values, constants = [], {}
    for number, element in enumerate(time.findall("DLV")):
        try:
            key = (int(element.get("A", ""), 16), element.get("C", ""))
            preset = element.get("B", "")
            if preset:
                constants[key] = process_value(preset)
        except ValueError:
            raise InputError(
                f"{where}: DLV {number}", "has no identifier or a value that is not a number", "A hexadecimal"
            ) from None
        values.append(key)
    if len(values) > 255:
        raise InputError(where, f"lists {len(values)} values", "255 at most")
    return Header(fields, tuple(values), constants)


def read(data: bytes, head: Header) -> TimeLog:
    """All records that can be read; after a damaged stretch, from the next record that fits the one before."""
    fixed = np.dtype([("ms", "<u4"), ("day", "<u2"), *((name, kind) for name, kind in head.fields)])
    starts, problem = _starts(data, fixed, len(head.values))
    raw = np.frombuffer(data, np.uint8)
    count = len(starts)
    if not count:
        empty = np.zeros(0)
        return TimeLog(empty, empty, empty, empty, {}, problem or "holds no record")
    fixed_bytes = raw[starts[:, None] + np.arange(fixed.itemsize)[None, :]]
    records = np.ascontiguousarray(fixed_bytes).view(fixed).ravel()
    numbers = raw[starts + fixed.itemsize].astype(np.intp)
    owner = np.repeat(np.arange(count), numbers)
    place = starts[owner] + fixed.itemsize + 1 + 5 * (np.arange(len(owner)) - np.repeat(np.cumsum(numbers) - numbers, numbers))
    which = raw[place]
    value = np.ascontiguousarray(raw[place[:, None] + np.arange(1, 5)[None, :]]).view("<i4").ravel()
    values = {key: np.full(count, constant) for key, constant in head.constants.items()}
    for index, key in enumerate(head.values):
        mine = which == index
        if not mine.any():
            continue
        column = np.full(count, np.nan)
        column[owner[mine]] = np.where(value[mine] != _NOT_AVAILABLE, value[mine], np.nan)
        # A value holds until it is sent again, also as one that is not available.
        last = np.full(count, -1)
        last[owner[mine]] = owner[mine]
        last = np.maximum.accumulate(last)
        column = np.where(last >= 0, column[np.maximum(last, 0)], values.get(key, np.full(count, np.nan)))
        values[key] = column
    names = fixed.names or ()

    def field(name: str, scale: float) -> Array:
        return records[name] * scale if name in names else np.full(count, np.nan)

    time_s = task_data.EPOCH.timestamp() + records["day"] * S_PER_DAY + records["ms"] * 1e-3
    if {"gps_ms", "gps_day"} <= set(names):
        time_s += _zone_s(time_s, task_data.EPOCH.timestamp() + records["gps_day"] * S_PER_DAY + records["gps_ms"] * 1e-3)
    return TimeLog(
        time_s,
        field("east", POSITION_DEG),
        field("north", POSITION_DEG),
        field("up_mm", 1e-3),
        values,
        problem,
    )


def _zone_s(local_s: Array, gps_s: Array) -> float:
    """From the terminal's clock, which may be local, to UTC, by the receiver's; 0 where the two are not a zone apart."""
    apart_s = float(np.median(gps_s - local_s))
    zone_s = round(apart_s / _ZONES_S) * _ZONES_S
    return zone_s if abs(zone_s) <= _FARTHEST_ZONE_S and abs(apart_s - zone_s) < _CLOCK_ERROR_S else 0.0


def _starts(data: bytes, fixed: np.dtype[np.void], count_values: int) -> tuple[np.ndarray, str]:
    """Where records begin, and what could not be read."""
    starts: list[int] = []
    size, end, at = fixed.itemsize, len(data), 0
    lost, stretches, last_day = 0, 0, None
    while at + size + 1 <= end:
        length = _record(data, at, size, count_values, last_day)
        if length:
            starts.append(at)
            last_day = data[at + 4] | data[at + 5] << 8
            at += length
            continue
        again = _next_record(data, at + 1, size, count_values, last_day)
        stretches += 1
        lost += again - at
        at = again
    places = "1 place" if stretches == 1 else f"{stretches} places"
    problem = f"{lost} bytes in {places} are damaged" if lost else ""
    if at < end and not lost:
        problem = f"ends within a record, with {end - at} bytes"
    return np.array(starts, np.intp), problem


def _record(data: bytes, at: int, size: int, count_values: int, last_day: int | None) -> int:
    """Length of the record that begins here, 0 if none can."""
    if at + size + 1 > len(data):
        return 0
    (ms, day) = struct.unpack_from("<IH", data, at)
    if ms >= task_data.DAY_MS or (last_day is not None and abs(day - last_day) > 60):
        return 0
    number = data[at + size]
    stop = at + size + 1 + 5 * number
    if stop > len(data) or number > count_values or any(data[place] >= count_values for place in range(at + size + 1, stop, 5)):
        return 0
    return stop - at


def _next_record(data: bytes, at: int, size: int, count_values: int, last_day: int | None) -> int:
    """The next place where two records follow each other; the end where there is none."""
    while at + size + 1 <= len(data):
        length = _record(data, at, size, count_values, last_day)
        if length and (
            at + length == len(data) or _record(data, at + length, size, count_values, data[at + 4] | data[at + 5] << 8)
        ):
            return at
        at += 1
    return len(data)

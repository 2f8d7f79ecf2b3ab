"""Measurement tables: CSV with a header, one row a measurement, `-`, `nan` or nothing for unknown."""

from __future__ import annotations

import codecs
import csv
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from yieldmon.errors import InputError
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions
from yieldmon.physics.numerics import Array

LOADS = ("mass_flow_kg_s", "paddle_mass_kg")
READINGS = ("force_n", "momentum_kg_m_s", "response")
_GZIP = b"\x1f\x8b"
_UNKNOWN = ("", "-", "nan", "NaN", "NAN")
_LIMITS = {
    "plate_angle_deg": (0.0, 180.0, "deg"),
    "mass_flow_kg_s": (0.0, 1000.0, "kg/s"),
    "paddle_mass_kg": (0.0, 100.0, "kg"),
    "elevator_speed_rpm": (0.0, 5000.0, "rpm"),
    "moisture_pct": (0.0, 100.0, "%"),
    "sigma": (0.0, 1e12, "the reading's unit"),
}


@dataclass(frozen=True)
class Table:
    """Columns as they stand in the file (degrees, rpm, %), nan for unknown; `text` holds trial, group and unknown columns.

    load: which of LOADS the table gives, None when neither is there (open and closed loop find it). reading: which of READINGS.
    """

    path: str
    sha256: str
    load: str | None
    reading: str
    columns: Mapping[str, Array]
    text: Mapping[str, tuple[str, ...]]
    notes: tuple[str, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.columns["plate_angle_deg"])

    def speed_rad_s(self, machine: Machine) -> Array:
        """Elevator speed of each row, the machine's nominal one where the table does not say."""
        rpm = self.columns.get("elevator_speed_rpm", np.full(len(self), np.nan))
        return np.where(np.isnan(rpm), machine.nominal_elevator_speed_rad_s, rpm * RPM)

    def conditions(self, machine: Machine) -> Conditions:
        """Angle, speed, load and moisture of each row. Raises InputError when the table gives no load."""
        if self.load is None:
            raise InputError(self.path, "has no load column", f"one of {', '.join(LOADS)}")
        return Conditions(
            plate_angle_rad=np.radians(self.columns["plate_angle_deg"]),
            elevator_speed_rad_s=self.speed_rad_s(machine),
            moisture_pct=self.columns.get("moisture_pct"),
            **{self.load: self.columns[self.load]},
        )

    def momentum(self, machine: Machine) -> Array:
        """The reading as momentum per paddle, kg m/s (for `response`, in its own unit)."""
        values = self.columns[self.reading]
        if self.reading == "force_n":
            return values / machine.passes_per_s(self.speed_rad_s(machine))
        return values


def load(path: str | Path, *, need_load: bool = True) -> Table:
    """Read a table. Raises InputError naming file, row and column, the value, and what was expected.

    need_load: whether a mass flow or paddle mass column is required.
    """
    raw = _read_bytes(path)
    where = str(path)
    try:
        rows = [row for row in csv.reader(_text(raw, where).splitlines()) if row and not row[0].startswith("#")]
    except csv.Error as error:
        raise InputError(where, f"not CSV: {error}") from error
    if not rows:
        raise InputError(where, "is empty", "a header line and rows")
    header = [name.strip() for name in rows[0]]
    if len(header) == 1 and ";" in header[0]:
        raise InputError(f"{where}: header", "is separated by semicolons", "commas, and points in the numbers")
    load_name, reading = _roles(header, where, need_load)
    body = rows[1:]
    if not body:
        raise InputError(where, "has a header and no rows", "at least one row")
    columns: dict[str, Array] = {}
    texts: dict[str, tuple[str, ...]] = {}
    for i, row in enumerate(body):
        if len(row) != len(header):
            raise InputError(f"{where}: row {i + 1}", f"has {len(row)} fields", f"{len(header)}, as in the header")
    notes = []
    for j, name in enumerate(header):
        cells = tuple(row[j].strip() for row in body)
        if name in ("trial", "group"):
            texts[name] = cells
        elif name in _LIMITS or name in READINGS:
            columns[name] = _numbers(cells, name, where)
        else:
            texts[name] = cells
            notes.append(f"{where}: column {name!r} is not known and is ignored")
    missing = np.flatnonzero(np.isnan(columns["plate_angle_deg"]))
    if missing.size:
        raise InputError(f"{where}: row {missing[0] + 1}, plate_angle_deg", "is unknown", "an angle in degrees")
    return Table(where, hashlib.sha256(raw).hexdigest(), load_name, reading, columns, texts, tuple(notes))


def _read_bytes(path: str | Path) -> bytes:
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise InputError(str(path), error.strerror or str(error), "a readable CSV file") from error


def _text(raw: bytes, where: str) -> str:
    if raw.startswith(_GZIP):
        raise InputError(where, "is compressed", "a plain CSV file; gunzip it")
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise InputError(where, "is UTF-16 text", "a UTF-8 CSV file")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(where, f"byte {error.start} is not UTF-8", "a UTF-8 CSV file") from error


def _roles(header: list[str], where: str, need_load: bool) -> tuple[str | None, str]:
    if len(set(header)) != len(header):
        twice = sorted({name for name in header if header.count(name) > 1})
        raise InputError(f"{where}: header", f"has {', '.join(twice)} more than once", "each column once")
    if "plate_angle_deg" not in header:
        raise InputError(f"{where}: header", "has no plate_angle_deg", "that column")
    loads = [name for name in LOADS if name in header]
    readings = [name for name in READINGS if name in header]
    if len(loads) > 1 or (need_load and not loads):
        raise InputError(f"{where}: header", f"has {loads or 'no load column'}", f"one of {', '.join(LOADS)}")
    if len(readings) != 1:
        raise InputError(f"{where}: header", f"has {readings or 'no reading'}", f"exactly one of {', '.join(READINGS)}")
    return (loads[0] if loads else None), readings[0]


def _numbers(cells: tuple[str, ...], name: str, where: str) -> Array:
    low, high, unit = _LIMITS.get(name, (-1e12, 1e12, "the reading's unit"))
    out = np.empty(len(cells))
    for i, cell in enumerate(cells):
        if cell in _UNKNOWN:
            out[i] = np.nan
            continue
        try:
            # Python's own digit separator is no part of a number in a table.
            out[i] = float(cell if "_" not in cell else "")
        except ValueError:
            raise InputError(f"{where}: row {i + 1}, {name}", f"is {cell[:40]!r}", f"a number in {unit}") from None
        if not low <= out[i] <= high:
            raise InputError(f"{where}: row {i + 1}, {name}", f"is {cell[:40]}", f"{low:g} to {high:g} {unit}")
    return out

"""Position, speed and course of many frames at once: the values that `navigation.read` gives, as columns.

Groups of one frame only, and no time of day; a fast packet has to be put together first.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yieldmon.identifiers import CLASSIC_BYTES
from yieldmon.physics.numerics import Array
from yieldmon.places import is_somewhere

from .navigation import FIELDS, LARGEST_LATITUDE_DEG, LARGEST_LONGITUDE_DEG, ORDER, TIMEOUT_S, Field, Navigation, Quantity

Raw = NDArray[np.int64]


class Column(NamedTuple):
    """Values of one quantity out of one group: rows (n,) of the frames that have one, rising, their times, and values (n,)."""

    rows: NDArray[np.intp]
    time_s: Array
    values: Array


class FixReport(NamedTuple):
    """What a node says of its fix in the frame of a row."""

    row: int
    source: int
    time_s: float
    has_fix: bool


BlockReadings = dict[tuple[Quantity, int], Column]
"""What a block of frames says, by quantity and group."""


def _field(payload: NDArray[np.uint64], start: int, bits: int) -> Raw:
    mask = np.uint64((1 << bits) - 1)
    found: Raw = (payload >> np.uint64(start) & mask).astype(np.int64)
    return found


def _values(field: Field, payload: NDArray[np.uint64]) -> Array:
    """Of each frame, nan where it has none."""
    raw = _field(payload, field.start, field.bits)
    if field.signed:
        raw = np.where(raw >> field.bits - 1, raw - (1 << field.bits), raw)
    there = raw <= field.most
    if field.where is not None:
        start, bits, value = field.where
        there &= _field(payload, start, bits) == value
    values = np.where(there, raw * field.scale + field.offset, np.nan)
    return values * (180.0 / pi) if field.in_radians else values


def _on_the_globe(values: dict[Quantity, Array]) -> dict[Quantity, Array]:
    """Latitude and longitude both or neither, and neither where they are 0."""
    if Quantity.LATITUDE not in values:
        return values
    latitude, longitude = values[Quantity.LATITUDE], values[Quantity.LONGITUDE]
    with np.errstate(invalid="ignore"):
        usable = (np.abs(latitude) <= LARGEST_LATITUDE_DEG) & (np.abs(longitude) <= LARGEST_LONGITUDE_DEG)
        usable &= is_somewhere(latitude, longitude)
    return {name: np.where(usable, column, np.nan) for name, column in values.items()}


def read_block(
    group: int, rows: NDArray[np.intp], time_s: Array, payload: NDArray[np.uint64], length: NDArray[np.uint8]
) -> BlockReadings:
    """What frames of a parameter group say of position, speed and course.

    Parameters
    ----------
    group : int
        Of one frame; there is nothing of any other.
    rows : intp array, shape (n,)
        Names of the frames, rising.
    time_s : array, shape (n,)
    payload : uint64 array, shape (n,)
        First 8 bytes of data, first byte lowest.
    length : uint8 array, shape (n,)
        Bytes of data.

    Returns
    -------
    dict of (Quantity, int) to Column
        Without what is not available.
    """
    whole = length >= CLASSIC_BYTES
    readings = {}
    found = {field.quantity: _values(field, payload) for field in FIELDS.get(group, ())}
    for quantity, values in _on_the_globe(found).items():
        known = whole & ~np.isnan(values)
        readings[quantity, group] = Column(rows[known], time_s[known], values[known])
    return readings


def with_fix(before: Navigation, column: Column, sources: NDArray[np.uint32], reports: Sequence[FixReport]) -> NDArray[np.bool_]:
    """Which positions of 129025 count beside what their nodes say of their fix, as `Navigation.take` says it.

    Parameters
    ----------
    before : Navigation
        As it was at the block's beginning.
    column : Column
        n readings.
    sources : uint32 array, shape (n,)
        Source addresses of their frames.
    reports : sequence of FixReport
        Of the block, in order.

    Returns
    -------
    bool array, shape (n,)
    """
    counts = np.ones(column.rows.shape, bool)
    if not before.without_fix and all(report.has_fix for report in reports):
        return counts
    state = Navigation(before.timeout_s)
    for source, time_s in before.without_fix.items():
        state.note_fix(source, time_s, has_fix=False)
    told = 0
    for place, (row, time_s, source) in enumerate(
        zip(column.rows.tolist(), column.time_s.tolist(), sources.tolist(), strict=True)
    ):
        while told < len(reports) and reports[told].row < row:
            state.note_fix(*reports[told][1:])
            told += 1
        counts[place] = not state.is_without_fix(source, time_s)
    return counts


def of_first_sender(
    before: Navigation, quantity: Quantity, group: int, column: Column, sources: NDArray[np.uint32]
) -> NDArray[np.bool_]:
    """Which of a column's readings count, as `Navigation.take` says it.

    Parameters
    ----------
    before : Navigation
        As it was at the block's beginning.
    quantity : Quantity
    group : int
    column : Column
        n readings.
    sources : uint32 array, shape (n,)
        Source addresses of their frames.

    Returns
    -------
    bool array, shape (n,)
    """
    counts = np.ones(column.rows.shape, bool)
    latest = before.latest(quantity, group)
    if not column.rows.size or np.all(sources == (sources[0] if latest is None else latest.source)):
        return counts
    sender, last_s = (-1, -np.inf) if latest is None else (latest.source, latest.time_s)
    for place, (source, time_s) in enumerate(zip(sources.tolist(), column.time_s.tolist(), strict=True)):
        if source != sender and 0.0 <= time_s - last_s <= TIMEOUT_S:
            counts[place] = False
        else:
            sender, last_s = source, time_s
    return counts


def best_groups(
    before: Navigation, readings: BlockReadings, quantity: Quantity, rows: NDArray[np.intp], time_s: Array
) -> NDArray[np.intp]:
    """The group whose reading `Navigation.best` uses at each of some frames of a block.

    Parameters
    ----------
    before : Navigation
        As it was at the block's beginning.
    readings : dict of (Quantity, int) to Column
        What the block says.
    quantity : Quantity
    rows : intp array, shape (n,)
        Frames of the block; each comes after its own reading.
    time_s : array, shape (n,)
        Their times.

    Returns
    -------
    intp array, shape (n,)
        0 for none.
    """
    best = np.zeros(rows.shape, np.intp)
    for group in reversed(ORDER[quantity]):
        earlier = before.latest(quantity, group)
        times = np.array([np.nan if earlier is None else earlier.time_s])
        column = readings.get((quantity, group))
        if column is not None:
            times = np.concatenate((times, column.time_s))[np.searchsorted(column.rows, rows, side="right")]
        with np.errstate(invalid="ignore"):
            age_s = time_s - times
            best[(age_s >= 0.0) & (age_s <= TIMEOUT_S)] = group
    return best

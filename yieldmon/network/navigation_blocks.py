"""Position, speed and course of many frames at once: the values that `navigation.read` gives, as columns.

Groups of one frame only, and no time of day; a fast packet has to be put together first.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yieldmon.physics.numerics import Array

from .navigation import (
    COURSE_SPEED_RAPID,
    CRUISE_VEHICLE_SPEED,
    DIRECTION_SPEED,
    GROUND_SPEED,
    ORDER,
    POSITION_RAPID,
    TIMEOUT_S,
    VEHICLE_POSITION,
    WHEEL_SPEED,
    Navigation,
    Quantity,
)

Raw = NDArray[np.int64]
_KMH = 1 / 3.6
_FRAME_BYTES = 8


class Column(NamedTuple):
    """Values of one quantity out of one group: rows (n,) of the frames that have one, rising, their times, and values (n,)."""

    rows: NDArray[np.intp]
    time_s: Array
    values: Array


BlockReadings = dict[tuple[Quantity, int], Column]
"""What a block of frames says, by quantity and group."""


def _field(payload: NDArray[np.uint64], start: int, bits: int) -> Raw:
    mask = np.uint64((1 << bits) - 1)
    found: Raw = (payload >> np.uint64(start) & mask).astype(np.int64)
    return found


def _signed(raw: Raw, bits: int) -> Raw:
    return np.where(raw >= 1 << bits - 1, raw - (1 << bits), raw)


def _j1939(raw: Raw, bits: int, scale: float, offset: float = 0.0) -> Array:
    """Physical values, nan where the leading byte says not available, error or reserved."""
    return np.where(raw >> (bits - 8) <= 0xFA, raw * scale + offset, np.nan)


def _nmea(raw: Raw, highest: int, scale: float) -> Array:
    """Physical values, nan for the three highest of the type."""
    return np.where(raw <= highest - 3, raw * scale, np.nan)


def _position(latitude: Array, longitude: Array) -> dict[Quantity, Array]:
    """Both or neither, on the globe."""
    with np.errstate(invalid="ignore"):
        usable = (np.abs(latitude) <= 90.0) & (np.abs(longitude) <= 180.0)
    return {
        Quantity.LATITUDE: np.where(usable, latitude, np.nan),
        Quantity.LONGITUDE: np.where(usable, longitude, np.nan),
    }


def _vehicle_position(payload: NDArray[np.uint64]) -> dict[Quantity, Array]:
    return _position(*(_j1939(_field(payload, start, 32), 32, 1e-7, -210.0) for start in (0, 32)))


def _position_rapid(payload: NDArray[np.uint64]) -> dict[Quantity, Array]:
    return _position(*(_nmea(_signed(_field(payload, start, 32), 32), (1 << 31) - 1, 1e-7) for start in (0, 32)))


def _direction_speed(payload: NDArray[np.uint64]) -> dict[Quantity, Array]:
    return {
        Quantity.COURSE: _j1939(_field(payload, 0, 16), 16, 1 / 128),
        Quantity.SPEED: _j1939(_field(payload, 16, 16), 16, _KMH / 256),
    }


def _cruise_speed(payload: NDArray[np.uint64]) -> dict[Quantity, Array]:
    return {Quantity.SPEED: _j1939(_field(payload, 8, 16), 16, _KMH / 256)}


def _machine_speed(payload: NDArray[np.uint64]) -> dict[Quantity, Array]:
    return {Quantity.SPEED: _j1939(_field(payload, 0, 16), 16, 1e-3)}


def _course_speed(payload: NDArray[np.uint64]) -> dict[Quantity, Array]:
    true_north = _field(payload, 8, 2) == 0
    course_rad = np.where(true_north, _nmea(_field(payload, 16, 16), 0xFFFF, 1e-4), np.nan)
    return {
        Quantity.COURSE: course_rad * (180.0 / pi),
        Quantity.SPEED: _nmea(_field(payload, 32, 16), 0xFFFF, 0.01),
    }


_READERS: Mapping[int, Callable[[NDArray[np.uint64]], dict[Quantity, Array]]] = {
    VEHICLE_POSITION: _vehicle_position,
    DIRECTION_SPEED: _direction_speed,
    CRUISE_VEHICLE_SPEED: _cruise_speed,
    WHEEL_SPEED: _machine_speed,
    GROUND_SPEED: _machine_speed,
    POSITION_RAPID: _position_rapid,
    COURSE_SPEED_RAPID: _course_speed,
}


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
    reader = _READERS.get(group)
    if reader is None:
        return {}
    whole = length >= _FRAME_BYTES
    readings = {}
    for quantity, values in reader(payload).items():
        known = whole & ~np.isnan(values)
        readings[quantity, group] = Column(rows[known], time_s[known], values[known])
    return readings


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

"""Rows of known load and measured momentum, as a calibration takes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yieldmon.arguments import require_type
from yieldmon.physics.model import Conditions, refuse_impossible
from yieldmon.physics.numerics import Array

_COLUMNS = tuple(column.name for column in fields(Conditions))


@dataclass(frozen=True)
class Measurements:
    """Rows of known load, as `calibrate` takes them.

    Parameters
    ----------
    conditions : Conditions
        1-D arrays of n rows, or numbers.
    momentum : array_like
        (n,) per paddle, kg m/s or a response's own unit.
    sigma : array_like, optional
        (n,) standard deviation of each momentum; None where unknown: it is estimated from the rows.
    places : ndarray of int, optional
        (n,) index of each row in the table that it comes from; None where these are all of its rows.

    Raises
    ------
    ValueError
        For a momentum, angle, speed, load or plate position that is nan, a load below 0, an angle or a speed outside its range, a
        sigma that is not above 0, and columns of other lengths.

    Examples
    --------
    >>> at = api.Conditions(np.radians([50.0, 70.0]), 400.0 * api.RPM, mass_flow_kg_s=np.array([5.0, 10.0]))
    >>> rows = api.Measurements(at, np.array([4.2, 7.4]))
    >>> rows.columns()[2]
    array([ 5., 10.])
    """

    conditions: Conditions
    momentum: Array
    sigma: Array | None = None
    places: NDArray[np.intp] | None = None

    def __post_init__(self) -> None:
        require_type("measurements: conditions", self.conditions, Conditions, "Conditions")
        object.__setattr__(self, "momentum", np.asarray(self.momentum, dtype=float))
        if self.sigma is not None:
            object.__setattr__(self, "sigma", np.asarray(self.sigma, dtype=float))
        if self.momentum.ndim != 1 or not np.all(np.isfinite(self.momentum)):
            raise ValueError("measurements: momentum must be one row of finite numbers")
        if self.sigma is not None and not (self.sigma.shape == self.momentum.shape and np.all(self.sigma > 0.0)):
            raise ValueError("measurements: sigma must hold a number above 0 for each row")
        for name in _COLUMNS:
            shape = np.shape(getattr(self.conditions, name))
            if shape not in ((), self.momentum.shape):
                raise ValueError(f"measurements: {name} has the shape {shape}: expected a number or {self.momentum.shape}")
        if not np.all(np.isfinite(self._all()[[0, 1, 2, 4]])):
            raise ValueError("measurements: angle, speed, load and plate position must be finite")
        refuse_impossible("measurements", self.conditions.plate_angle_rad, self.conditions.elevator_speed_rad_s)
        if np.any(self.columns()[2] < 0.0):
            raise ValueError("measurements: load must be 0 or more")

    def columns(self) -> Array:
        """The rows as columns.

        Returns
        -------
        ndarray
            (4, n): plate angle (rad), elevator speed (rad/s), load (kg/s or kg), moisture (%, nan where unknown).
        """
        c = self.conditions
        load = c.mass_flow_kg_s if c.paddle_mass_kg is None else c.paddle_mass_kg
        moisture = np.nan if c.moisture_pct is None else c.moisture_pct
        parts = [np.asarray(v, dtype=float) for v in (c.plate_angle_rad, c.elevator_speed_rad_s, load, moisture)]
        return np.stack([np.broadcast_to(part, self.momentum.shape) for part in parts])

    def select(self, rows: NDArray[np.bool_]) -> Measurements:
        """Some of the rows.

        Parameters
        ----------
        rows : ndarray of bool
            (n,).

        Returns
        -------
        Measurements
        """
        places = np.flatnonzero(rows) if self.places is None else self.places[rows]
        return Measurements(
            self._conditions(self._all()[:, rows]),
            self.momentum[rows],
            None if self.sigma is None else self.sigma[rows],
            places,
        )

    def cells(self) -> tuple[Conditions, NDArray[np.intp]]:
        """Rows of the same conditions.

        Returns
        -------
        conditions : Conditions
            The distinct ones.
        index : ndarray of int
            (n,) of each row's own.
        """
        columns = np.nan_to_num(self._all(), nan=-1.0)
        distinct, index = np.unique(columns, axis=1, return_inverse=True)
        distinct = np.where((np.arange(5)[:, None] == 3) & (distinct < 0.0), np.nan, distinct)
        return self._conditions(distinct), index.ravel()

    def _all(self) -> Array:
        """(5, n): the columns, and the plate's position (0 where it is not given)."""
        position = 0.0 if self.conditions.plate_position_m is None else np.asarray(self.conditions.plate_position_m, dtype=float)
        return np.vstack((self.columns(), np.broadcast_to(position, self.momentum.shape)[None]))

    def _conditions(self, columns: Array) -> Conditions:
        angle, speed, load, moisture, position = columns
        by_flow = self.conditions.paddle_mass_kg is None
        known = None if self.conditions.moisture_pct is None else moisture
        place = None if self.conditions.plate_position_m is None else position
        return Conditions(angle, speed, load if by_flow else None, None if by_flow else load, known, place)


def as_copies_do(copied: int, rows: int) -> str:
    """What is said of copies among rows."""
    return f"{copied} of {rows} rows repeat another reading of the same condition in every digit, as copies do"


def rows_given_twice(reading: Array, cell: NDArray[np.integer[Any]], trial: Sequence[str]) -> int:
    """Rows that repeat another one of their condition and trial in every digit: 0, or more than two.

    Readings of a coarse resolution agree by chance, but then in different conditions too. cell: (n,) number of each row's
    condition. trial: (n,) its label; 0 if one is empty.
    """
    if not all(trial):
        return 0
    _, label = np.unique(np.array(trial), return_inverse=True)
    whole = np.unique(np.stack((cell, label.ravel(), reading)), axis=1).shape[1]
    elsewhere = np.unique(np.stack((cell, reading)), axis=1).shape[1] - np.unique(reading).size
    twice = int(reading.size) - whole
    return twice if twice > 2 and 10 * elsewhere < reading.size else 0


def copied_rows(reading: Array, cell: NDArray[np.integer[Any]]) -> int:
    """Rows that are copies of others of their condition: 0, or more than half of those that repeat a condition.

    Readings of a coarse resolution agree by chance, but then in different conditions too. cell: (n,) number of each row's
    condition.
    """
    _, number, count = np.unique(reading, return_inverse=True, return_counts=True)
    number = number.ravel()
    _, place, alike = np.unique(np.stack((cell, number)), axis=1, return_inverse=True, return_counts=True)
    twins = alike[place.ravel()] > 1
    repeated = int(np.count_nonzero(np.bincount(cell)[cell] > 1))
    elsewhere = int(np.count_nonzero(count[number] > alike[place.ravel()]))
    found = int(np.count_nonzero(twins))
    return found if 2 * found > repeated and 10 * elsewhere < reading.size else 0

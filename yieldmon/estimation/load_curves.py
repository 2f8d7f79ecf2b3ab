"""Load curves between knots of plate angle and elevator speed: where the search for a flow may begin.

A curve costs many times what a search costs that begins near its end. Knots are worked out when they are first asked for; what
follows for an angle and a speed depends on nothing else.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from yieldmon.physics.numerics import Array

_ANGLE_RAD = np.radians(1.0)
_LN_SPEED = 0.02
_MOST = 4096
"""Knots kept: far more than one machine's plate and elevator come by."""
_SPEEDS = 1 << 20
"""Numbers of knots in speed for each angle, half of them below 1 rad/s."""
_CORNERS = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])


class LoadCurves:
    """curve: (n,) plate angles, rad, and elevator speeds, rad/s -> (n, g) what is read along the load curve. Threads may share
    one: what one adds is seen whole or not at all."""

    def __init__(self, curve: Callable[[Array, Array], Array]) -> None:
        self._curve = curve
        self._known: tuple[dict[int, int], Array] = {}, np.empty((0, 0))
        """Row of each knot, and the rows."""

    def near(self, plate_angle_rad: Array, elevator_speed_rad_s: Array) -> Array:
        """(n, g): the curves at these angles and speeds (above 0), (n,), straight between the four knots around each."""
        at = np.stack((plate_angle_rad / _ANGLE_RAD, np.log(elevator_speed_rad_s) / _LN_SPEED))
        low = np.floor(at)
        share = at - low
        corners = low[:, :, None] + _CORNERS.T[:, None, :]
        keys = (corners[0] * _SPEEDS + corners[1]).astype(np.int64)
        table = self._table_of(keys)
        weights = np.where(_CORNERS.T[:, None, :] == 1, share[:, :, None], 1.0 - share[:, :, None]).prod(axis=0)
        found = weights[:, :1] * table[:, 0]
        for corner in range(1, len(_CORNERS)):
            found = found + weights[:, corner, None] * table[:, corner]
        return np.asarray(found)

    def _table_of(self, keys: NDArray[np.int64]) -> Array:
        wanted = keys.ravel().tolist()
        places, table = self._known
        if len(places) > _MOST:
            places, table = {}, np.empty((0, 0))
        new = sorted({key for key in wanted if key not in places})
        if new:
            angle, speed = np.divmod(np.array(new) + _SPEEDS // 2, _SPEEDS)
            made = self._curve(angle * _ANGLE_RAD, np.exp((speed - _SPEEDS // 2) * _LN_SPEED))
            places = places | {key: len(places) + i for i, key in enumerate(new)}
            table = np.concatenate((table, made)) if table.size else made
            self._known = places, table
        return np.asarray(table[np.array([places[key] for key in wanted]).reshape(keys.shape)])

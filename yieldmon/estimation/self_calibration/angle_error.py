"""Relative error of a model's force as a random function of the plate angle, given by its second moments at nodes.

A cause that is missing in the model changes the force at all angles together, so errors at different angles are correlated. The
standard deviation of a sum over seconds at several angles follows from the signed sum of these errors, and not from the sum of
independent ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isfinite, sqrt

import numpy as np

from yieldmon.physics.numerics import Array

NODES_RAD = np.radians(np.arange(20.0, 111.0, 10.0))
"""Angles of the nodes. The error is linear between them, and constant beyond the outer ones."""
_FIRST_RAD, _STEP_RAD, _COUNT = float(NODES_RAD[0]), float(NODES_RAD[1] - NODES_RAD[0]), NODES_RAD.size


def node_shares(plate_angle_rad: float) -> tuple[int, float]:
    """Nodes for linear interpolation at an angle.

    Parameters
    ----------
    plate_angle_rad : float
        rad.

    Returns
    -------
    first : int
        Index of the node below.
    share : float
        Weight of the node above, 0 to 1.
    """
    place = min(max((plate_angle_rad - _FIRST_RAD) / _STEP_RAD, 0.0), _COUNT - 1.0)
    first = min(int(place), _COUNT - 2)
    return first, place - first


@dataclass(frozen=True)
class AngleError:
    """Relative error of the force.

    Attributes
    ----------
    home : float
        Standard deviation at the home angle.
    moments : tuple of tuple of float
        Mean products of the errors at the nodes, (nodes, nodes), after correction by `away`; () if there is no error.
    away : tuple of float
        Correction of the flow away from home: ln(model force / measured force) at the nodes relative to home, (nodes,), 0 at
        home. () if it is not known well enough.
    expected : tuple of float
        Mean of the error after this correction, (nodes,); () if it is 0.
    """

    home: float = 0.0
    moments: tuple[tuple[float, ...], ...] = ()
    away: tuple[float, ...] = ()
    expected: tuple[float, ...] = ()

    @classmethod
    def of(cls, moments: Array, home_rad: float, away: Array | None = None, expected: Array | None = None) -> AngleError:
        """Build it from `moments`, `away` and `expected` at the nodes, as arrays, and the home angle, rad."""
        found = cls(0.0, tuple(map(tuple, moments.tolist())))
        taken, left = (() if values is None else tuple(values.tolist()) for values in (away, expected))
        return cls(found.at(home_rad), found.moments, taken, left)

    def away_at(self, plate_angle_rad: float) -> float:
        """`away` at an angle, rad; 0 if it is not known."""
        if not self.away or not isfinite(plate_angle_rad):
            return 0.0
        first, share = node_shares(plate_angle_rad)
        return (1.0 - share) * self.away[first] + share * self.away[first + 1]

    def at(self, plate_angle_rad: float) -> float:
        """Standard deviation at an angle, rad; that at home if the angle or the moments are not known."""
        if not self.moments or not isfinite(plate_angle_rad):
            return self.home
        k, share = node_shares(plate_angle_rad)
        a, b, both = self.moments[k][k], self.moments[k + 1][k + 1], self.moments[k][k + 1]
        return sqrt(max((1.0 - share) ** 2 * a + share**2 * b + 2.0 * share * (1.0 - share) * both, 0.0))

    def of_sum(self, at_nodes: Sequence[float], left: float = 0.0) -> float:
        """Standard deviation of a sum of errors at the nodes with weights at_nodes, (nodes,), plus a known error `left`."""
        if not self.moments:
            return abs(left)
        row = np.array(at_nodes)
        expected = float(row @ self._expected) if self.expected else 0.0
        return sqrt(max(float(row @ self._matrix @ row) + left * (left + 2.0 * expected), 0.0))

    def with_home(self, home: float, home_rad: float) -> AngleError:
        """The error with a smaller standard deviation at home; differences between angles stay the same.

        home: the new standard deviation; a larger one than the present one is ignored. home_rad: the home angle, rad.
        """
        if not self.moments or home >= self.home:
            return self
        first, share = node_shares(home_rad)
        at_home = np.zeros(NODES_RAD.size)
        at_home[first : first + 2] = 1.0 - share, share
        change = np.eye(NODES_RAD.size) + (home / self.home - 1.0) * at_home
        moments = tuple(map(tuple, (change @ self._matrix @ change.T).tolist()))
        expected = tuple((change @ self.expected).tolist()) if self.expected else ()
        return AngleError(home, moments, self.away, expected)

    @cached_property
    def _matrix(self) -> Array:
        return np.array(self.moments)

    @cached_property
    def _expected(self) -> Array:
        return np.array(self.expected)


NO_ERROR = AngleError()

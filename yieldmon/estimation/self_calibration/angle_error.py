"""The relative error of a model's force over the plate's angle, as one random quantity: its mean squares and products at nodes.

One cause that the model lacks changes the force at all angles together, so that errors at two angles are of one draw. What many
seconds at several angles add up to then has the standard deviation of the sum, with its signs, and not that of errors which are
independent of each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isfinite, sqrt

import numpy as np

from yieldmon.physics.numerics import Array

NODES_RAD = np.radians(np.arange(20.0, 111.0, 10.0))
"""Between them the error is taken to be straight over the angle, beyond them as at the last."""
_FIRST_RAD, _STEP_RAD = float(NODES_RAD[0]), float(NODES_RAD[1] - NODES_RAD[0])


def node_shares(plate_angle_rad: float) -> tuple[int, float]:
    """Of the nodes on both sides of an angle the first one's number, and the share of the second one.

    Parameters
    ----------
    plate_angle_rad : float
        rad.

    Returns
    -------
    first : int
    share : float
        0 to 1.
    """
    place = min(max((plate_angle_rad - _FIRST_RAD) / _STEP_RAD, 0.0), NODES_RAD.size - 1.0)
    first = min(int(place), NODES_RAD.size - 2)
    return first, place - first


@dataclass(frozen=True)
class AngleError:
    """Relative error of the force.

    Attributes
    ----------
    home : float
        Standard deviation at the home angle.
    moments : tuple of tuple of float
        Mean products of the errors at the nodes, (nodes, nodes), once `away` is taken off; () where there is no error.
    away : tuple of float
        ln of the model's force over the measured one at the nodes against that at home, (nodes,), where it is known well enough
        to be taken off the flow; () where it is not. 0 at home.
    expected : tuple of float
        Mean of the error that is left then, (nodes,); () where it is 0.
    """

    home: float = 0.0
    moments: tuple[tuple[float, ...], ...] = ()
    away: tuple[float, ...] = ()
    expected: tuple[float, ...] = ()

    @classmethod
    def of(cls, moments: Array, home_rad: float, away: Array | None = None, expected: Array | None = None) -> AngleError:
        """From mean products at the nodes, (nodes, nodes), the angle at home, rad, what is to be taken off, (nodes,), and the
        mean of what is left then."""
        found = cls(0.0, tuple(map(tuple, moments.tolist())))
        taken, left = (() if values is None else tuple(values.tolist()) for values in (away, expected))
        return cls(found.at(home_rad), found.moments, taken, left)

    def away_at(self, plate_angle_rad: float) -> float:
        """Of `away` at an angle, rad; not known: 0."""
        if not self.away or not isfinite(plate_angle_rad):
            return 0.0
        first, share = node_shares(plate_angle_rad)
        return (1.0 - share) * self.away[first] + share * self.away[first + 1]

    def at(self, plate_angle_rad: float) -> float:
        """Standard deviation at an angle, rad; not known: as at home."""
        if not self.moments or not isfinite(plate_angle_rad):
            return self.home
        k, share = node_shares(plate_angle_rad)
        a, b, both = self.moments[k][k], self.moments[k + 1][k + 1], self.moments[k][k + 1]
        return sqrt(max((1.0 - share) ** 2 * a + share**2 * b + 2.0 * share * (1.0 - share) * both, 0.0))

    def of_sum(self, at_nodes: Sequence[float], left: float = 0.0) -> float:
        """Standard deviation of a sum of errors at the nodes, each times a number (nodes,), beside a known error that is left."""
        if not self.moments:
            return abs(left)
        row = np.array(at_nodes)
        expected = float(row @ self.expected) if self.expected else 0.0
        return sqrt(max(float(row @ self._matrix @ row) + left * (left + 2.0 * expected), 0.0))

    def with_home(self, home: float, home_rad: float) -> AngleError:
        """The same where the error at home, rad, is known to have another standard deviation, at most its own; the differences
        between the angles stay."""
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


NO_ERROR = AngleError()

"""Whether a table's plate angles are measured from another line than the model's.

The model's plate angle is clockwise from the horizontal in which the grain flies: 90 deg is an upright plate, which meets the
stream square. A table may count from the vertical, or counter-clockwise; no grain fits that, and no effect explains the misfit.
"""

from __future__ import annotations

from collections.abc import Callable
from math import pi

import numpy as np

from yieldmon.physics.numerics import Array

_LINES: tuple[tuple[str, Callable[[Array], Array]], ...] = (
    ("90 deg less", lambda angle: 0.5 * pi - angle),
    ("180 deg less", lambda angle: pi - angle),
)
_LEAST_MISFIT = 0.05
"""Rms residual over the largest reading from which it is asked: within it the model explains the table."""
_CLOSER = 3.0
"""Times by which the residual has to fall. Both limits are assumptions (docs/internals/calibration.md)."""
_LEAST_ANGLES = 3


def question(plate_angle_rad: Array, misfit: float, refit: Callable[[Array], float]) -> str:
    """A sentence where the model explains the rows far better with angles from another line.

    Parameters
    ----------
    plate_angle_rad : ndarray (n,)
        Of the rows, rad.
    misfit : float
        Rms residual of the fit over the largest reading.
    refit : callable
        The same of a fit with other angles, (n,) rad; a ValueError where there is none.

    Returns
    -------
    str
        "" where no other line does better, the misfit is small, or fewer than three angles do not show it.

    Examples
    --------
    >>> question(np.radians([10.0, 30.0, 50.0]), 0.4, lambda angle: 0.03 if angle[0] > 1.0 else 0.5)[:61]
    'with 90 deg less each plate angle the model would miss by 3 %'
    """
    if misfit < _LEAST_MISFIT or np.unique(np.round(plate_angle_rad, 6)).size < _LEAST_ANGLES:
        return ""
    found = []
    for name, turned in _LINES:
        try:
            found.append((refit(turned(plate_angle_rad)), name))
        except ValueError:
            continue
    best, name = min(found, default=(np.inf, ""))
    if not _CLOSER * best < misfit:
        return ""
    return (
        f"with {name} each plate angle the model would miss by {100.0 * best:.2g} % of the largest reading in place of "
        f"{100.0 * misfit:.2g} %: are the angles clockwise from the horizontal in which the grain flies (90: upright)?"
    )

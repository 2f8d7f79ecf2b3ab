"""Prediction of conditions that a fit has not seen, with a whole angle, load or speed left out at a time."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from yieldmon.physics.numerics import Array

from .fit import Fit

_UNSEEN = 1e-3
"""Share below which the remaining cells say nothing of a direction that the left-out group alone determines."""


def left_out_residual(fit: Fit, group: NDArray[np.int64]) -> Array:
    """Whitened residual of each cell when its group is left out of the fit, in the tangent plane, shape (cells,).

    (I - T_g T_g')^-1 r_g with T the tangent's orthonormal basis; directions that only the group itself determines are left at
    their fitted residual.
    """
    tangent = fit.tangent()
    out = fit.residual.copy()
    for number in range(int(group.max()) + 1):
        inside = group == number
        own = tangent[inside]
        kept, axes = np.linalg.eigh(np.eye(own.shape[0]) - own @ own.T)
        kept = np.where(kept < _UNSEEN, 1.0, kept)
        out[inside] = axes @ ((axes.T @ fit.residual[inside]) / kept)
    return out


def grouped_error(fit: Fit, groups: Mapping[str, NDArray[np.int64]]) -> dict[str, float]:
    """Mean square of the left-out residuals for each way of grouping (1: to the noise)."""
    return {name: float(np.mean(left_out_residual(fit, numbers) ** 2)) for name, numbers in groups.items()}

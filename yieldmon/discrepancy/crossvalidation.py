"""Cross-validation with a whole angle, load or speed left out at a time."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from yieldmon.estimation import model_error
from yieldmon.physics.numerics import Array

from .fit import Fit


def left_out_residual(fit: Fit, group: NDArray[np.int64]) -> Array:
    """Whitened residual of each cell when its group is left out of the fit, in the tangent plane, shape (cells,).

    See `estimation.model_error.left_out`.
    """
    return model_error.left_out(fit.residual, fit.tangent(), group)


def grouped_error(fit: Fit, groups: Mapping[str, NDArray[np.int64]]) -> dict[str, float]:
    """Mean square of the left-out residuals for each way of grouping; 1 corresponds to the noise."""
    return {name: float(np.mean(left_out_residual(fit, numbers) ** 2)) for name, numbers in groups.items()}

"""Errors of the measured and weighed masses of loads, apart from those of the parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from yieldmon.physics.grain import FLOW_PER_MOISTURE_PCT
from yieldmon.physics.numerics import Array

from .load_inputs import LoadSettings, WeighedLoad


@dataclass(frozen=True)
class MassErrors:
    """Errors of ln(measured / weighed mass) of n loads.

    Attributes
    ----------
    own : ndarray (n,)
        Relative standard deviation of each measured mass, given the true parameters.
    sd : ndarray (n,)
        That of the measured and the weighed mass together.
    common : ndarray (n,)
        The part of `sd` that comes from another combine's monitor, whose error is common to all loads.
    apart : ndarray (n,)
        The rest of `sd`, independent between loads.
    moist : ndarray (n,)
        One standard deviation of the error that is proportional to the moisture's deviation from the loads' mean; 0 if the model
        contains moisture, or it is not known of a load.
    shared : ndarray (n, 2)
        `common` and `moist`, each fully correlated between loads.
    law : ndarray (n, n)
        Covariance from the model's curve of force (`LoadSettings.law_error`) and `shared`.
    """

    own: Array
    sd: Array
    common: Array
    apart: Array
    moist: Array
    shared: Array
    law: Array

    @classmethod
    def of(cls, loads: Sequence[WeighedLoad], settings: LoadSettings, *, moisture_in_model: bool) -> MassErrors:
        """The errors of these loads."""
        own = np.array([load.measured_sd(settings.load_error) for load in loads])
        sd = np.hypot([load.relative_sd for load in loads], own)
        common = np.array([load.common_kg / load.weighed_kg for load in loads])
        apart = np.where(common > 0.0, np.sqrt(np.maximum(sd**2 - common**2, 0.0)), sd)
        moist = np.zeros(len(loads)) if moisture_in_model else _by_moisture(loads)
        shared = np.column_stack((common, moist))
        at = np.log(np.array([load.weighed_kg for load in loads]) / [load.duration_s.sum() for load in loads])
        away = (at[:, None] - at) / settings.law_reach
        law = settings.law_error**2 * np.exp(-0.5 * away**2) + shared @ shared.T
        return cls(own, sd, common, apart, moist, shared, np.asarray(law))

    def informed(self, columns: Array, weight: Array) -> Array:
        """Inverse covariance of the errors without `law` times columns (n, k), each load with a weight (n,)."""
        return _by_inverse(weight / self.apart**2, self.shared, columns)


def _by_inverse(information: Array, shared: Array, columns: Array) -> Array:
    """Inverse of (diag(1 / information) + shared @ shared.T) times columns (n, k); shared: (n, m). Rows of no information are
    0."""
    weighted = columns * information[:, None]
    shared = shared[:, np.any(shared, axis=0)]
    if not shared.shape[1]:
        return weighted
    along = shared * information[:, None]
    inner = np.linalg.solve(np.eye(shared.shape[1]) + shared.T @ along, along.T @ columns)
    return np.asarray(weighted - along @ inner)


def _by_moisture(loads: Sequence[WeighedLoad]) -> Array:
    """See `MassErrors.moist`."""
    found = [load.mean_moisture_pct for load in loads]
    if not np.all(np.isfinite(found)):
        return np.zeros(len(loads))
    return np.asarray(FLOW_PER_MOISTURE_PCT * (np.array(found) - np.mean(found)))

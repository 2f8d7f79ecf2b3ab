"""The model's own error, as a quantity beside the measurement's noise.

A relative error of the predicted reading, smooth over plate angle, load and elevator speed, with mean 0 and a size that is at
least `FLOOR`; what recalibration can absorb is taken out where the error is used (by projection off the fit's tangent plane).
Sources: Kennedy and O'Hagan, J. R. Stat. Soc. B 63 (2001); Plumlee, J. Am. Stat. Assoc. 112 (2017), on orthogonality;
Brynjarsdottir and O'Hagan, Inverse Problems 30 (2014), on why its size needs a prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from yieldmon.physics.machine import SAME_ANGLE_RAD
from yieldmon.physics.numerics import Array

from .clusters import SAME_LOAD, cluster

FLOOR = 0.002
"""Relative standard deviation of the model's error where it is right: two codes of the same physics differ by this much."""
UNKNOWN = 0.05
"""Relative standard deviation where nobody has looked: both published tables, fitted over all their angles, are missed by 2.1 and
6.2 % of the largest reading."""
LARGEST = 0.5
"""Relative standard deviation beyond which a file's number is in another unit, or its calibration useless."""
_DEGREES = (3, 3, 2)
LEAST_LEVEL = 0.05
"""Readings below this share of the largest have the error of that share."""
_UNSEEN = 1e-3
"""Share of a direction below which the rows outside a group do not determine it."""


def level(predicted: Array) -> Array:
    """The reading that a relative error is relative to, (n,)."""
    top = float(np.max(np.abs(predicted), initial=0.0))
    return np.maximum(np.abs(predicted), LEAST_LEVEL * top)


def basis(plate_angle_rad: Array, load: Array, elevator_speed_rad_s: Array, *, most: int = 4) -> Array:
    """Columns over which the relative error is spread with independent unit normal weights, shape (n, m).

    Products of Legendre polynomials up to a total degree `most`, the higher the less, without the constant, which any impact gain
    absorbs; scaled so that the error's mean variance is 1.
    """
    axes = []
    for values, degree in zip((plate_angle_rad, np.sqrt(np.maximum(load, 0.0)), elevator_speed_rad_s), _DEGREES, strict=True):
        span = float(np.ptp(values)) if values.size else 0.0
        varied = span > 1e-3 * max(float(np.max(np.abs(values), initial=0.0)), 1e-300)
        at = 2.0 * (values - values.min()) / span - 1.0 if varied else np.zeros(values.shape)
        highest = degree if varied else 0
        axes.append([np.polynomial.legendre.legval(at, np.eye(highest + 1)[k]) for k in range(highest + 1)])
    columns = [
        np.prod([axis[k] for axis, k in zip(axes, powers, strict=True)], axis=0) / (1.0 + sum(powers))
        for powers in product(*(range(len(axis)) for axis in axes))
        if 0 < sum(powers) <= most
    ]
    if not columns:
        return np.zeros((len(load), 0))
    out = np.stack(columns, axis=-1)
    return np.asarray(out / np.sqrt(max(float(np.mean(np.sum(out**2, axis=-1))), 1e-300)))


def off(columns: Array, tangent: Array) -> Array:
    """Columns less what lies in the span of orthonormal tangent columns."""
    return np.asarray(columns - tangent @ (tangent.T @ columns))


def orthonormal(columns: Array) -> Array:
    """Orthonormal basis of the columns' span."""
    norms = np.linalg.norm(columns, axis=0)
    u, s, _ = np.linalg.svd(columns / np.where(norms > 0.0, norms, 1.0), full_matrices=False)
    return u[:, s > 1e-9 * s[0]] if s.size and s[0] > 0.0 else u[:, :0]


def left_out(residual: Array, tangent: Array, group: NDArray[np.int64]) -> Array:
    """Whitened residual of each row when its group is left out of the fit, in the tangent plane, shape (n,).

    (I - T_g T_g')^-1 r_g with T the tangent's orthonormal basis; directions that only the group itself determines (the
    other rows hold less than the share `_UNSEEN` of it) keep their fitted residual.
    """
    out = residual.copy()
    for number in range(int(group.max()) + 1):
        inside = group == number
        own = tangent[inside]
        kept, axes = np.linalg.eigh(np.eye(own.shape[0]) - own @ own.T)
        kept = np.where(kept < _UNSEEN, 1.0, kept)
        out[inside] = axes @ ((axes.T @ residual[inside]) / kept)
    return out


def expected_left_out(tangent: Array, group: NDArray[np.int64]) -> float:
    """Mean square of `left_out` residuals when there is noise alone: above 1, as each group is predicted from the others."""
    total = 0.0
    for number in range(int(group.max()) + 1):
        own = tangent[group == number]
        kept = np.linalg.eigvalsh(np.eye(own.shape[0]) - own @ own.T)
        total += float(np.sum(np.where(kept < _UNSEEN, kept, 1.0 / np.where(kept < _UNSEEN, 1.0, kept))))
    return total / len(tangent)


def estimated(residual: Array, tangent: Array, relative_sd: Array, groups: Sequence[NDArray[np.int64]]) -> float | None:
    """Size of the model's error, from how far angles and loads are missed that a fit has not seen; at least `FLOOR`, None where
    no way of leaving out says anything.

    residual: whitened, (n,). relative_sd: sd of each row over its level, (n,). groups: for each way of leaving out, the number of
    each row's group; ways that leave fewer than three groups say nothing.
    """
    replicated = [g for g in groups if int(g.max(initial=0)) >= 2]
    if not replicated:
        return None
    excess = np.mean([np.mean(left_out(residual, tangent, g) ** 2) - expected_left_out(tangent, g) for g in replicated])
    return float(max(FLOOR, np.sqrt(max(excess, 0.0) / np.mean(relative_sd**-2.0))))


def stated(size: float | None) -> float | None:
    """What `estimated` has found as a parameter set holds it: 0 at FLOOR."""
    return size if size is None or size > FLOOR else 0.0


def groups_of(plate_angle_rad: Array, load: Array) -> list[NDArray[np.int64]]:
    """Angles and loads as groups to leave out."""
    return [cluster(plate_angle_rad, SAME_ANGLE_RAD), cluster(np.log(np.maximum(load, 1e-9)), SAME_LOAD)]


def widened(covariance: Array, jacobian: Array, error: Array) -> Array:
    """A least-squares covariance with the model's error in it.

    covariance: (p, p) from noise. jacobian: (n, p), whitened. error: (n, m), whitened columns of the error with unit weights.
    """
    moved = covariance @ (jacobian.T @ error)
    return np.asarray(covariance + moved @ moved.T)

"""The map of confidence: learnt from cases with known answers, written as the product reads it, and how far it errs."""

from __future__ import annotations

import numpy as np

from yieldmon.discrepancy.confidence import FEATURES, Calibration, Logistic
from yieldmon.physics.numerics import Array


def learnt(rows: Array, right: Array, ridge: float = 2.0) -> Logistic:
    """The map by penalised likelihood.

    Parameters
    ----------
    rows
        Features, (n, features).
    right
        1 where the name was right, else 0, (n,).
    ridge
        Of the squared weights of standardised features; it stands for the few cases, and keeps the map away from 0 and 1.
    """
    centre, scale = rows.mean(axis=0), np.maximum(rows.std(axis=0), 1e-6)
    z = np.column_stack((np.ones(len(rows)), (rows - centre) / scale))
    penalty = np.diag([0.0, *([ridge] * rows.shape[1])])
    # Targets a little inside 0 and 1 (Platt): a finite number of cases proves neither.
    ones = float(right.sum())
    target = np.where(right > 0.5, (ones + 1.0) / (ones + 2.0), 1.0 / (len(right) - ones + 2.0))
    weights = np.zeros(z.shape[1])
    for _ in range(50):
        p = 1.0 / (1.0 + np.exp(-(z @ weights)))
        step = np.linalg.solve((z * (p * (1.0 - p))[:, None]).T @ z + penalty + 1e-9 * np.eye(len(weights)),
                               z.T @ (target - p) - penalty @ weights)  # fmt: skip
        weights = weights + np.clip(step, -2.0, 2.0)
        if np.max(np.abs(step)) < 1e-9:
            break
    return Logistic(centre, scale, weights[1:], float(weights[0]))


def expected_calibration_error(stated: Array, right: Array, bins: int = 10) -> float:
    """Mean distance of the share of right ones from the mean stated probability, over equal-width bins, by their counts."""
    number = np.minimum((np.asarray(stated) * bins).astype(int), bins - 1)
    inside = [number == b for b in range(bins)]
    return float(sum(abs(float(np.sum(right[i] - stated[i]))) for i in inside if i.any()) / max(len(stated), 1))


def to_document(found: Calibration) -> dict[str, object]:
    """As the shipped file has it."""

    def one(m: Logistic) -> dict[str, object]:
        return {
            "bias": m.bias,
            "features": {
                name: {"centre": float(c), "scale": float(s), "weight": float(w)}
                for name, c, s, w in zip(FEATURES, m.centre, m.scale, m.weights, strict=True)
            },
        }

    return {"provenance": dict(found.provenance), "within": one(found.within), "name": one(found.name)}

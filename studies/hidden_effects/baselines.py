"""What simpler ways of choosing would have said of the same rows."""

from __future__ import annotations

import numpy as np

from yieldmon.discrepancy.candidates import signature
from yieldmon.discrepancy.choice import Choice
from yieldmon.discrepancy.fit import Fit


def by_criterion(choice: Choice, criterion: str) -> str:
    """Effect with the least AICc or BIC among the published model and each single effect ("" for the published model)."""
    fits = {"": choice.base} | {c.effect: c.fit for c in choice.looked_at}
    return min(fits, key=lambda name: _criterion(fits[name], criterion))


def _criterion(fitted: Fit, name: str) -> float:
    n, k = len(fitted.residual), len(fitted.parameters) + 1
    fit_term = n * np.log(fitted.chi2 / n)
    if name == "bic":
        return float(fit_term + k * np.log(n))
    return float(fit_term + 2.0 * k + 2.0 * k * (k + 1.0) / max(n - k - 1.0, 1.0))


def by_sparse_regression(base: Fit, effects: tuple[str, ...]) -> str:
    """Lasso of the published model's residuals on each effect's change at its typical size, penalty by BIC; largest coefficient.

    Coordinate descent on unit columns ("" when no column stays).
    """
    columns, names = [], []
    for effect in effects:
        drawn = signature(base, effect)
        i = int(np.argmin(np.abs(drawn.size - 1.0)))
        norm = float(np.linalg.norm(drawn.change[i]))
        if norm > 1e-6:
            columns.append(drawn.change[i] / norm)
            names.append(effect)
    x, y = np.stack(columns, axis=-1), -base.residual
    top = float(np.max(np.abs(x.T @ y)))
    beta = np.zeros(len(names))
    best, winner = len(y) * np.log(float(y @ y) / len(y)), ""
    for penalty in top * np.geomspace(1.0, 0.02, 15):
        for _ in range(60):
            for j in range(len(names)):
                rho = float(x[:, j] @ (y - x @ beta)) + beta[j]
                beta[j] = np.sign(rho) * max(abs(rho) - penalty, 0.0)
        used = np.count_nonzero(beta)
        rss = float(np.sum((y - x @ beta) ** 2))
        value = len(y) * np.log(rss / len(y)) + used * np.log(len(y))
        if value < best and used:
            best, winner = value, names[int(np.argmax(np.abs(beta)))]
    return winner

"""Our flow beside that of the factory's own monitor, over the seconds in which both measured."""

from __future__ import annotations

from math import sqrt

from yieldmon.documents.process import FactoryComparisonSummary
from yieldmon.service.storage.rows import SecondRow


class FactoryComparison:
    """Sums over seconds; `document` is what `process --json` says, None where no second had both."""

    def __init__(self) -> None:
        self._count = 0
        self._ours = self._theirs = self._ours_squared = self._theirs_squared = self._products = 0.0

    def take(self, row: SecondRow) -> None:
        """A second."""
        ours, theirs = row.mass_flow_kg_s, row.factory_mass_flow_kg_s
        if ours is None or theirs is None:
            return
        self._count += 1
        self._ours += ours
        self._theirs += theirs
        self._ours_squared += ours * ours
        self._theirs_squared += theirs * theirs
        self._products += ours * theirs

    @property
    def document(self) -> FactoryComparisonSummary | None:
        """Seconds, mean flows (kg/s), how much more the factory's says (%), and the correlation (None: one does not vary)."""
        n = self._count
        if not n:
            return None
        ours, theirs = self._ours / n, self._theirs / n
        spread = (self._ours_squared / n - ours * ours) * (self._theirs_squared / n - theirs * theirs)
        correlation = (self._products / n - ours * theirs) / sqrt(spread) if spread > 1e-18 else None
        return {
            "seconds": n,
            "our_mean_kg_s": ours,
            "factory_mean_kg_s": theirs,
            "factory_over_ours_pct": 100.0 * (theirs / ours - 1.0) if ours > 0.0 else None,
            "correlation": correlation,
        }

"""Mass since the plate was last seen empty, by load: what a wrong zero has made of it."""

from __future__ import annotations

from dataclasses import dataclass, field

from yieldmon.engine.mass.budget import FlowBudget


@dataclass(slots=True)
class SinceEmpty:
    """Sums over seconds, by load number.

    Attributes
    ----------
    kg_per_n : dict of int to float
        Change of the mass by a change of the force of all seconds, kg/N.
    zero_kg : dict of int to float
        Standard deviation of the mass by the zero, as it was counted.
    """

    kg_per_n: dict[int, float] = field(default_factory=dict)
    zero_kg: dict[int, float] = field(default_factory=dict)

    def add(self, number: int, budget: FlowBudget, force_n: float, seconds: float) -> None:
        """Further seconds of a load."""
        if force_n > 0.0:
            self.kg_per_n[number] = self.kg_per_n.get(number, 0.0) + budget.per_error_kg_s / force_n * seconds
            self.zero_kg[number] = self.zero_kg.get(number, 0.0) + budget.zero_kg_s * seconds

    def recomputed(self, number: int) -> None:
        """The mass of a load was recomputed by another zero: its standard deviation is not that counted second by second."""
        if number in self.zero_kg:
            self.zero_kg[number] = 0.0

    def seen_empty(self, force_n: float) -> dict[int, float]:
        """The plate is seen empty, force_n from the zero; returns what the standard deviations by the zero lack, by load, kg."""
        lack_kg = {number: abs(force_n) * kg_per_n - self.zero_kg[number] for number, kg_per_n in self.kg_per_n.items()}
        self.kg_per_n, self.zero_kg = {}, {}
        return {number: kg for number, kg in lack_kg.items() if kg > 0.0}

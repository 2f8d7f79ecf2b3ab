"""Mass since the plate was last seen empty, by load: what a wrong zero has made of it."""

from __future__ import annotations

from collections.abc import Container, Iterable
from dataclasses import dataclass, field
from math import isfinite

from yieldmon.engine.mass.budget import FlowBudget
from yieldmon.engine.mass.missed_mass import NO_LOAD


@dataclass(frozen=True, slots=True)
class LoadSinceEmpty:
    """What a load has since the plate was last seen empty; as in `SinceEmpty`, which keeps it over a restart."""

    number: int
    kg_per_n: float
    zero_kg: float


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

    def totals_reset(self) -> None:
        """The totals begin anew: mass without a load is in none that is still counted."""
        self.kg_per_n.pop(NO_LOAD, None)
        self.zero_kg.pop(NO_LOAD, None)

    def states(self, known: Container[int], first_load: int) -> tuple[LoadSinceEmpty, ...]:
        """The sums for a restart. known: loads that are known after it; others from first_load on are in the total alone."""
        sums = dict[int, tuple[float, float]]()
        for number, kg_per_n in sorted(self.kg_per_n.items()):
            key = number if number in known else NO_LOAD
            if key != NO_LOAD or number == NO_LOAD or number >= first_load:
                before_per_n, before_kg = sums.get(key, (0.0, 0.0))
                sums[key] = before_per_n + kg_per_n, before_kg + self.zero_kg[number]
        return tuple(LoadSinceEmpty(number, *both) for number, both in sums.items() if all(map(isfinite, both)))

    def resume(self, states: Iterable[LoadSinceEmpty]) -> None:
        """Inverse of `states`."""
        self.kg_per_n = {state.number: state.kg_per_n for state in states}
        self.zero_kg = {state.number: state.zero_kg for state in states}

    def recomputed(self, number: int) -> None:
        """The mass of a load was recomputed by another zero: its standard deviation is not that counted second by second."""
        if number in self.zero_kg:
            self.zero_kg[number] = 0.0

    def seen_empty(self, force_n: float) -> dict[int, float]:
        """The plate is seen empty, force_n from the zero; returns what the standard deviations by the zero lack, by load, kg."""
        lack_kg = {number: abs(force_n) * kg_per_n - self.zero_kg[number] for number, kg_per_n in self.kg_per_n.items()}
        self.kg_per_n, self.zero_kg = {}, {}
        return {number: kg for number, kg in lack_kg.items() if kg > 0.0}

"""Load and total mass. They never run backwards, and only a new load sets the load's mass to 0."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite

from yieldmon.engine.budget import EMPTY, NO_BUDGET, FlowBudget, MassBudget
from yieldmon.engine.settings import TotalsSettings


@dataclass(frozen=True, slots=True)
class Totals:
    """Masses in kg, wet and dry. unknown_moisture_kg: wet mass missing from the dry figures, its moisture not being known.
    contested_kg: mass of seconds that more than one node sent samples for; it is in none of the others.
    total_budget, load_budget: standard deviations of the wet masses."""

    total_kg: float = 0.0
    total_dry_kg: float = 0.0
    total_unknown_moisture_kg: float = 0.0
    load_kg: float = 0.0
    load_dry_kg: float = 0.0
    load_unknown_moisture_kg: float = 0.0
    load_number: int = 1
    load_open: bool = True
    total_contested_kg: float = 0.0
    load_contested_kg: float = 0.0
    total_budget: MassBudget = EMPTY
    load_budget: MassBudget = EMPTY

    def with_contested(self, mass_kg: float) -> Totals:
        """Mass of a window that more than one node sent samples for: counted here and nowhere else."""
        share = 1.0 if self.load_open else 0.0
        return replace(
            self,
            total_contested_kg=self.total_contested_kg + mass_kg,
            load_contested_kg=self.load_contested_kg + share * mass_kg,
        )

    def with_mass(
        self, mass_kg: float, dry_kg: float | None, budget: FlowBudget = NO_BUDGET, seconds: float = 0.0
    ) -> Totals:
        """Totals after mass_kg more. Mass measured with no load open counts in the total alone.

        Parameters
        ----------
        mass_kg : float
            Wet mass, at least 0.
        dry_kg : float or None
            Dry mass; None where it is not known.
        budget : FlowBudget
            Of the flow whose mass it is.
        seconds : float
            How long the flow lasted.

        Returns
        -------
        Totals

        Raises
        ------
        ValueError
            mass_kg is negative or no number.
        """
        if not (isfinite(mass_kg) and mass_kg >= 0.0):
            raise ValueError(f"mass to add is {mass_kg} kg; expected a number of at least 0")
        dry = 0.0 if dry_kg is None else dry_kg
        unknown = mass_kg if dry_kg is None else 0.0
        share = 1.0 if self.load_open else 0.0
        return replace(
            self,
            total_kg=self.total_kg + mass_kg,
            total_dry_kg=self.total_dry_kg + dry,
            total_unknown_moisture_kg=self.total_unknown_moisture_kg + unknown,
            load_kg=self.load_kg + share * mass_kg,
            load_dry_kg=self.load_dry_kg + share * dry,
            load_unknown_moisture_kg=self.load_unknown_moisture_kg + share * unknown,
            total_budget=self.total_budget.plus(budget, seconds),
            load_budget=self.load_budget.plus(budget, seconds) if self.load_open else self.load_budget,
        )

    def start_load(self) -> Totals:
        """A new load, empty, with the next number."""
        return replace(
            self,
            load_kg=0.0,
            load_dry_kg=0.0,
            load_unknown_moisture_kg=0.0,
            load_contested_kg=0.0,
            load_number=self.load_number + 1,
            load_open=True,
            load_budget=EMPTY,
        )

    def stop_load(self) -> Totals:
        """The load is complete; its figures stay until the next one starts."""
        return replace(self, load_open=False)


def dry_mass(wet_kg: float, moisture_pct: float, settings: TotalsSettings) -> float | None:
    """Mass at the reference moisture (same dry matter), kg; None where the moisture is not known."""
    if not isfinite(moisture_pct):
        return None
    factor = (100.0 - moisture_pct) / (100.0 - settings.moisture_reference_pct)
    if not settings.credit_below_reference:
        factor = min(1.0, factor)
    return wet_kg * factor

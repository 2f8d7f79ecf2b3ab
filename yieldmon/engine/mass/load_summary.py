"""The summary of a load, and the events of loads."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import nan

from yieldmon.engine.mass.budget import EMPTY, MassBudget
from yieldmon.engine.mass.missed_mass import MissedMass


@dataclass(frozen=True, slots=True)
class LoadSummary:
    """One load: bus times of its start and end (nan while open), masses in kg. complete: every second of it was measured.
    std_dev_kg: of measured_kg, nan where it is not known; budget: the same by cause. area_m2: harvested for it; unknown_area_kg:
    mass whose area is not known."""

    number: int
    start_s: float
    end_s: float
    measured_kg: float
    dry_kg: float
    unknown_moisture_kg: float
    complete: bool
    std_dev_kg: float = nan
    budget: MassBudget = EMPTY
    area_m2: float = 0.0
    unknown_area_kg: float = 0.0

    def with_missed(self, missed: MissedMass) -> LoadSummary:
        """The summary corrected by mass that was missed."""
        measured_kg = max(self.measured_kg + missed.kg, 0.0)
        budget = self.budget.with_missed(missed.kg, self.measured_kg, measured_kg, missed.budget, missed.unseen, missed.again_kg)
        return replace(
            self,
            measured_kg=measured_kg,
            dry_kg=max(self.dry_kg + missed.dry_kg, 0.0),
            unknown_moisture_kg=max(self.unknown_moisture_kg + missed.unknown_moisture_kg, 0.0),
            std_dev_kg=budget.std_dev_kg,
            budget=budget,
            unknown_area_kg=max(self.unknown_area_kg + missed.unknown_area_kg, 0.0),
        )


@dataclass(frozen=True, slots=True)
class LoadOpened:
    """A load began."""

    load: LoadSummary


@dataclass(frozen=True, slots=True)
class LoadClosed:
    """A load is complete."""

    load: LoadSummary


@dataclass(frozen=True, slots=True)
class LoadRestated:
    """The error budget of a load that closed in an earlier run has changed."""

    number: int
    budget: MassBudget

    @property
    def std_dev_kg(self) -> float:
        """Standard deviation of its mass, all causes together, kg."""
        return self.budget.std_dev_kg


LoadEvents = tuple[LoadOpened | LoadClosed | LoadRestated, ...]

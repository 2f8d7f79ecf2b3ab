"""Mass that was not counted although it came."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import nan

from yieldmon.engine.mass.budget import MassBudget
from yieldmon.engine.mass.unseen import SAME, UnseenChange

NO_LOAD = 0
"""In place of a load's number: no load was open."""


@dataclass(frozen=True, slots=True)
class MissedMass:
    """Mass of one load that was missed, kg; negative where too much was counted.

    dry_kg: of the part with a known moisture. unknown_moisture_kg, unknown_area_kg: the parts of kg without a known moisture or
    area. budget: of the mass that was measured again, used where nothing was counted before; None: not known. unseen: change of
    the mass that may have come unmeasured. again_kg: mass of the load that was measured again; nan where that is not all since
    the wrong zero.
    """

    kg: float = 0.0
    dry_kg: float = 0.0
    unknown_moisture_kg: float = 0.0
    unknown_area_kg: float = 0.0
    budget: MassBudget | None = None
    unseen: UnseenChange = SAME
    again_kg: float = nan

    def plus(self, kg: float, dry_kg: float | None, *, area_known: bool, budget: MassBudget | None = None) -> MissedMass:
        """The sum with kg more. dry_kg: None where it is not known. budget: of the mass measured again, None: not known."""
        return replace(
            self,
            kg=self.kg + kg,
            dry_kg=self.dry_kg + (0.0 if dry_kg is None else dry_kg),
            unknown_moisture_kg=self.unknown_moisture_kg + (kg if dry_kg is None else 0.0),
            unknown_area_kg=self.unknown_area_kg + (0.0 if area_known else kg),
            budget=None if self.budget is None or budget is None else self.budget.with_more(budget),
        )

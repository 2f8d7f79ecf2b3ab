"""Load and total mass. They never run backwards, and only a new load sets the load's mass to 0."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from math import isfinite
from operator import attrgetter

from yieldmon.engine.fast_dataclasses import changer_of, maker_of
from yieldmon.engine.mass.budget import EMPTY, NO_BUDGET, FlowBudget, MassBudget
from yieldmon.engine.mass.missed_mass import MissedMass
from yieldmon.engine.mass.unseen import UnseenMass
from yieldmon.engine.settings import TotalsSettings
from yieldmon.physics.grain import DRIEST_PCT, WETTEST_PCT

CORN_MARKET_MOISTURE_PCT = 15.5
"""Used where neither the configuration nor a crop gives another."""
DRY_KNOWN_KG = 1e-6
"""Mass of unknown moisture up to which a dry mass counts as known: rounding left by a correction."""


@dataclass(frozen=True, slots=True)
class Totals:
    """Masses of the load and in total, kg.

    total_kg, load_kg: wet mass. total_dry_kg, load_dry_kg: dry mass, without total_unknown_moisture_kg and
    load_unknown_moisture_kg, the wet mass of unknown moisture. total_contested_kg, load_contested_kg: mass of seconds for which
    more than one node sent samples; it is in none of the others. total_budget, load_budget: standard deviations of the wet
    masses. load_area_m2: harvested for the load; load_unknown_area_kg: mass of the load whose area is not known.
    market_moisture_pct: of the dry masses counted from now on. first_load: number of the load with which the totals began.
    """

    total_kg: float = 0.0
    total_dry_kg: float = 0.0
    total_unknown_moisture_kg: float = 0.0
    load_kg: float = 0.0
    load_dry_kg: float = 0.0
    load_unknown_moisture_kg: float = 0.0
    load_number: int = 1
    load_open: bool = True
    first_load: int = 1
    total_contested_kg: float = 0.0
    load_contested_kg: float = 0.0
    total_budget: MassBudget = EMPTY
    load_budget: MassBudget = EMPTY
    load_area_m2: float = 0.0
    load_unknown_area_kg: float = 0.0
    market_moisture_pct: float = CORN_MARKET_MOISTURE_PCT

    @property
    def known_total_dry_kg(self) -> float | None:
        """Dry mass of the total; None where the moisture of some of it is not known."""
        return self.total_dry_kg if self.total_unknown_moisture_kg <= DRY_KNOWN_KG else None

    @property
    def known_load_dry_kg(self) -> float | None:
        """The same of the load."""
        return self.load_dry_kg if self.load_unknown_moisture_kg <= DRY_KNOWN_KG else None

    def with_contested(self, mass_kg: float) -> Totals:
        """Mass of a window that more than one node sent samples for: counted here and nowhere else."""
        share = 1.0 if self.load_open else 0.0
        return replace(
            self,
            total_contested_kg=self.total_contested_kg + mass_kg,
            load_contested_kg=self.load_contested_kg + share * mass_kg,
        )

    def with_mass(
        self,
        mass_kg: float,
        dry_kg: float | None,
        budget: FlowBudget = NO_BUDGET,
        seconds: float = 0.0,
        area_m2: float = 0.0,
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
        area_m2 : float
            Harvested for it, m2; nan: not known.

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
        # Once a second: dataclasses.replace() takes several times as long.
        return _made(
            self.total_kg + mass_kg,
            self.total_dry_kg + dry,
            self.total_unknown_moisture_kg + unknown,
            self.load_kg + share * mass_kg,
            self.load_dry_kg + share * dry,
            self.load_unknown_moisture_kg + share * unknown,
            self.load_number,
            self.load_open,
            self.first_load,
            self.total_contested_kg,
            self.load_contested_kg,
            self.total_budget.plus(budget, seconds),
            self.load_budget.plus(budget, seconds) if self.load_open else self.load_budget,
            *self._area_with(area_m2, mass_kg),
            self.market_moisture_pct,
        )

    def with_area(self, area_m2: float, mass_kg: float) -> Totals:
        """Totals after a second's area, m2 (nan: not known), whose grain weighs mass_kg."""
        area = self._area_with(area_m2, mass_kg)
        if area == (self.load_area_m2, self.load_unknown_area_kg):
            return self
        return _made(*_before_area(self), *area, self.market_moisture_pct)

    def _area_with(self, area_m2: float, mass_kg: float) -> tuple[float, float]:
        """The load's area, and its mass of unknown area, with a second's more."""
        if not self.load_open:
            return self.load_area_m2, self.load_unknown_area_kg
        if isfinite(area_m2):
            return self.load_area_m2 + area_m2, self.load_unknown_area_kg
        return self.load_area_m2, self.load_unknown_area_kg + mass_kg

    def with_budgets(self, *, load: MassBudget, total: MassBudget) -> Totals:
        """Totals of which load and total are as unsure as these budgets say."""
        changed: Totals = _with(self, load_budget=load, total_budget=total)
        return changed

    def with_missed(self, missed: MissedMass, *, in_load: bool, before: UnseenMass | None = None) -> Totals:
        """Totals after a correction. in_load: it is the open load's as well. Nothing falls below 0. before: what may have come
        unseen until then; None: of no seconds but those that were measured again."""
        share = 1.0 if in_load else 0.0
        of_load, of_total = (missed.unseen, missed.unseen) if before is None else before.changed_by(missed.unseen)
        total_kg, load_kg = max(self.total_kg + missed.kg, 0.0), max(self.load_kg + share * missed.kg, 0.0)
        load_budget = self.load_budget
        if in_load:
            load_budget = load_budget.with_missed(missed.kg, self.load_kg, load_kg, missed.budget, of_load, missed.again_kg)
        return replace(
            self,
            total_kg=total_kg,
            total_dry_kg=max(self.total_dry_kg + missed.dry_kg, 0.0),
            total_unknown_moisture_kg=max(self.total_unknown_moisture_kg + missed.unknown_moisture_kg, 0.0),
            load_kg=load_kg,
            load_dry_kg=max(self.load_dry_kg + share * missed.dry_kg, 0.0),
            load_unknown_moisture_kg=max(self.load_unknown_moisture_kg + share * missed.unknown_moisture_kg, 0.0),
            total_budget=self.total_budget.with_missed(missed.kg, self.total_kg, total_kg, missed.budget, of_total),
            load_budget=load_budget,
            load_unknown_area_kg=max(self.load_unknown_area_kg + share * missed.unknown_area_kg, 0.0),
        )

    def with_more(self, more: Totals) -> Totals:
        """The sum with separately accumulated totals, whatever their loads; an open load takes all of their mass."""
        share = 1.0 if self.load_open else 0.0
        return replace(
            self,
            total_kg=self.total_kg + more.total_kg,
            total_dry_kg=self.total_dry_kg + more.total_dry_kg,
            total_unknown_moisture_kg=self.total_unknown_moisture_kg + more.total_unknown_moisture_kg,
            load_kg=self.load_kg + share * more.total_kg,
            load_dry_kg=self.load_dry_kg + share * more.total_dry_kg,
            load_unknown_moisture_kg=self.load_unknown_moisture_kg + share * more.total_unknown_moisture_kg,
            total_contested_kg=self.total_contested_kg + more.total_contested_kg,
            load_contested_kg=self.load_contested_kg + share * more.total_contested_kg,
            total_budget=self.total_budget.with_more(more.total_budget),
            load_budget=self.load_budget.with_more(more.total_budget) if self.load_open else self.load_budget,
            # Only the area of its last load is known.
            load_unknown_area_kg=self.load_unknown_area_kg + share * more.total_kg,
        )

    def with_unseen(self, unseen_kg: float, *, before: UnseenMass) -> Totals:
        """Totals of which another unseen_kg may be missing. before: what may have been missing already."""
        load = self.load_budget.with_unseen(unseen_kg, before.load_kg) if self.load_open else self.load_budget
        return replace(self, total_budget=self.total_budget.with_unseen(unseen_kg, before.total_kg), load_budget=load)

    def with_hidden(self, hidden_kg: float) -> Totals:
        """Totals of which another hidden_kg may be missing because of a wrong zero."""
        load = self.load_budget.with_zero(hidden_kg) if self.load_open else self.load_budget
        return replace(self, total_budget=self.total_budget.with_zero(hidden_kg), load_budget=load)

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
            load_area_m2=0.0,
            load_unknown_area_kg=0.0,
        )

    def start_totals(self) -> Totals:
        """All masses 0, with a new load of the next number."""
        number = self.load_number + 1
        return Totals(load_number=number, first_load=number, market_moisture_pct=self.market_moisture_pct)

    def stop_load(self) -> Totals:
        """The load is complete; its figures stay until the next one starts."""
        return replace(self, load_open=False)


_made, _with = maker_of(Totals), changer_of(Totals)
_before_area = attrgetter(*(field.name for field in fields(Totals)[:-3]))


def dry_mass(
    wet_kg: float, moisture_pct: float, settings: TotalsSettings, market_moisture_pct: float = CORN_MARKET_MOISTURE_PCT
) -> float | None:
    """Mass at market moisture (same dry matter), kg; None where the moisture is not known, or is none that grain has.

    market_moisture_pct: where the settings name none.
    """
    if not DRIEST_PCT <= moisture_pct <= WETTEST_PCT:
        return None
    given = settings.moisture_reference_pct
    factor = (100.0 - moisture_pct) / (100.0 - (market_moisture_pct if given is None else given))
    if not settings.credit_below_reference:
        factor = min(1.0, factor)
    return wet_kg * factor

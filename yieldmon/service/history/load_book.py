"""Loads as measured, each with the field and crop that it began with."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import isfinite

from yieldmon.engine.mass.budget import MassBudget
from yieldmon.engine.mass.load_summary import LoadSummary
from yieldmon.engine.mass.missed_mass import MissedMass
from yieldmon.engine.mass.totals import DRY_KNOWN_KG
from yieldmon.finite import finite
from yieldmon.service.storage.batch import Load

_UNKNOWN_AREA_SHARE = 0.02
"""Share of a load's mass without a known area above which the load's area counts as not known."""


class LoadBook:
    """All loads, and those that no batch has brought to the store yet."""

    def __init__(self, loads: Sequence[Load]) -> None:
        """loads: as the store has them."""
        self._loads = {load.number: load for load in loads}
        self._new: dict[int, Load] = {}
        self._dried: dict[int, tuple[float | None, float | None]] = {}
        """Dry mass as measured and at another market moisture, kg, by load."""

    def __iter__(self) -> Iterator[Load]:
        """In order of their numbers."""
        return iter([self._loads[number] for number in sorted(self._loads)])

    def among(self, numbers: range) -> list[Load]:
        """Those of the loads with these numbers that are known, in order."""
        return [load for load in self if load.number in numbers]

    def names(self, number: int) -> tuple[str, str] | None:
        """Field and crop of a load; None where it is not known."""
        known = self._loads.get(number)
        return None if known is None else (known.field, known.crop)

    def measured(self, summary: LoadSummary, field: str, crop: str) -> None:
        """A load as the monitor has it now. field, crop: for one that is not known yet."""
        known = self._loads.get(summary.number)
        started_s = known.started_s if known is not None else None
        dry_known = summary.unknown_moisture_kg <= DRY_KNOWN_KG
        area_known = summary.area_m2 > 0.0 and summary.unknown_area_kg <= _UNKNOWN_AREA_SHARE * summary.measured_kg
        load = Load(
            number=summary.number,
            field=known.field if known is not None else field,
            crop=known.crop if known is not None else crop,
            started_s=started_s if started_s is not None else finite(summary.start_s),
            ended_s=finite(summary.end_s),
            mass_kg=summary.measured_kg,
            dry_mass_kg=self._dry_kg(summary.number, summary.dry_kg if dry_known else None),
            area_m2=summary.area_m2 if area_known else None,
            std_dev_kg=finite(summary.std_dev_kg),
            budget=_known(summary.budget) if isfinite(summary.std_dev_kg) else None,
        )
        if load != known:
            self._loads[load.number] = self._new[load.number] = load

    def corrected(self, number: int, missed: MissedMass) -> None:
        """A load of this or an earlier run had missed so much; one that is not known stays so."""
        known = self._loads.get(number)
        if known is None:
            return
        mass_kg = max(0.0, known.mass_kg + missed.kg)
        budget = known.budget
        if budget is not None:
            budget = _known(budget.with_missed(missed.kg, known.mass_kg, mass_kg, missed.budget, missed.unseen, missed.again_kg))
        std_dev_kg = known.std_dev_kg * mass_kg / known.mass_kg if known.std_dev_kg and known.mass_kg > 0.0 else None
        dry_known = known.dry_mass_kg is not None and missed.unknown_moisture_kg <= DRY_KNOWN_KG
        area_known = missed.unknown_area_kg <= _UNKNOWN_AREA_SHARE * mass_kg
        self._loads[number] = self._new[number] = replace(
            known,
            mass_kg=mass_kg,
            dry_mass_kg=max(0.0, (known.dry_mass_kg or 0.0) + missed.dry_kg) if dry_known else None,
            area_m2=known.area_m2 if area_known else None,
            std_dev_kg=std_dev_kg if budget is None else budget.std_dev_kg,
            budget=budget,
        )

    def restated(self, number: int, budget: MassBudget) -> None:
        """A load of an earlier run is known otherwise than it was stated; one that is not known stays so."""
        known = self._loads.get(number)
        if known is not None:
            self._loads[number] = self._new[number] = replace(known, std_dev_kg=finite(budget.std_dev_kg), budget=_known(budget))

    def named(self, number: int, field: str | None, crop: str | None) -> None:
        """Other names for a load; None leaves one as it is."""
        known = self._loads[number]
        field, crop = known.field if field is None else field, known.crop if crop is None else crop
        self._loads[number] = self._new[number] = replace(known, field=field, crop=crop)

    def dried(self, number: int, dry_mass_kg: float | None) -> None:
        """The dry mass of a load, at another market moisture; it stays so when the load is restated."""
        measured_kg = self._dried[number][0] if number in self._dried else self._loads[number].dry_mass_kg
        self._dried[number] = measured_kg, dry_mass_kg
        self._loads[number] = self._new[number] = replace(self._loads[number], dry_mass_kg=dry_mass_kg)

    def _dry_kg(self, number: int, measured_kg: float | None) -> float | None:
        before_kg, dried_kg = self._dried.get(number, (measured_kg, measured_kg))
        if measured_kg == before_kg or dried_kg is None:
            return dried_kg
        return dried_kg * measured_kg / before_kg if measured_kg is not None and before_kg else None

    def take(self) -> tuple[Load, ...]:
        """Those that no batch has brought yet; they count as brought."""
        new, self._new = tuple(self._new.values()), {}
        return new

    def report_all(self) -> None:
        """The next batch brings them all."""
        self._new = dict(self._loads) | self._new


def _known(budget: MassBudget) -> MassBudget | None:
    """None where a part of the mass has none."""
    return budget if isfinite(budget.std_dev_kg) else None

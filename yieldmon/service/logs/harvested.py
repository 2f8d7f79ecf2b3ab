"""Area and yields of the open load, for documents."""

from __future__ import annotations

from yieldmon.documents.common import Harvested
from yieldmon.engine.mass.totals import Totals
from yieldmon.units import crop_yield_kg_m2


def harvested(totals: Totals) -> Harvested:
    """Area of the open load, and the yields of the mass whose area is known; None where nothing is."""
    placed_kg = totals.load_kg - totals.load_unknown_area_kg
    share = placed_kg / totals.load_kg if totals.load_kg > 0.0 else 0.0
    dry_kg = totals.known_load_dry_kg
    area_m2 = totals.load_area_m2 if totals.load_area_m2 > 0.0 else None
    return {
        "area_m2": area_m2,
        "mass_of_unknown_area_kg": totals.load_unknown_area_kg,
        "yield_kg_m2": crop_yield_kg_m2(placed_kg, area_m2),
        "dry_yield_kg_m2": crop_yield_kg_m2(None if dry_kg is None else dry_kg * share, area_m2),
    }

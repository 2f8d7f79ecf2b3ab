"""Parts of several documents."""

from __future__ import annotations

from typing import Literal, TypedDict

Number = float | None


class Harvested(TypedDict):
    """Area of the open load, and the yields of the mass whose area is known."""

    area_m2: Number
    mass_of_unknown_area_kg: float
    yield_kg_m2: Number
    dry_yield_kg_m2: Number


class Answered(TypedDict):
    """An answer of the daemon. units: in which people are shown masses; documents are in SI."""

    units: Literal["metric", "us"]

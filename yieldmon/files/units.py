"""The units that a setting and a crop's name give."""

from __future__ import annotations

from yieldmon.units import Units, UnitSystem


def units_of(chosen: str | None, configured: str = "metric", crop: str = "") -> Units:
    """The units chosen, else those configured. crop: whose bushels; pounds stand for those of a crop that is not known."""
    system = UnitSystem(chosen or configured)
    if system is UnitSystem.METRIC or not crop:
        return Units(system)
    # A third of a second, which metric units do without.
    from yieldmon.files.crops import find_crop

    known = find_crop(crop)
    return Units(system, known.bushel_kg if known is not None else None)

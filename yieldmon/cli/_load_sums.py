"""A store's loads summed up by field and crop."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import hypot

from yieldmon.cli._records import when
from yieldmon.documents.loads import ListedLoad, LoadSum
from yieldmon.files.units import units_of
from yieldmon.units import S_PER_DAY, UNKNOWN, crop_yield_kg_m2

PAUSE_DAYS = 90
"""Without a load of a field and crop, behind which it is another harvest of them."""


def load_sums(loads: Iterable[ListedLoad]) -> list[LoadSum]:
    """Loads with grain summed up by field, crop and harvest, in the order of their first loads."""
    groups: list[list[ListedLoad]] = []
    newest: dict[tuple[str, str], list[ListedLoad]] = {}
    for load in loads:
        if not load["mass_kg"] > 0.0:
            continue
        key = load["field"], load["crop"]
        if key in newest and not _another_harvest(newest[key][-1], load):
            newest[key].append(load)
        else:
            newest[key] = [load]
            groups.append(newest[key])
    return [_sum(group) for group in groups]


def sum_rows(sums: Iterable[LoadSum], system: str) -> tuple[list[str], list[list[str]]]:
    """Heads and rows."""
    heads = ["field", "crop", "from", "to", "loads", "weighed", "measured", "corrected", "±", "corrected dry", "area", "yield"]
    rows = []
    for one in sums:
        units = units_of(system, crop=one["crop"])
        rows.append([
            one["field"] or UNKNOWN, one["crop"] or UNKNOWN, when(one["started_s"]).partition(" ")[0],
            when(one["ended_s"]).partition(" ")[0], str(one["loads"]), str(one["weighed"]), units.mass(one["mass_kg"]),
            units.mass(one["corrected_mass_kg"]), units.mass(one["corrected_std_dev_kg"]),
            units.mass_with_bushels(one["corrected_dry_mass_kg"]),
            units.area(one["area_m2"]), units.crop_yield(crop_yield_kg_m2(one["corrected_mass_kg"], one["area_m2"])),
        ])  # fmt: skip
    return heads, rows


def _another_harvest(last: ListedLoad, load: ListedLoad) -> bool:
    ended_s = last["ended_s"] if last["ended_s"] is not None else last["started_s"]
    return bool(ended_s and load["started_s"] and load["started_s"] - ended_s > PAUSE_DAYS * S_PER_DAY)


def _sum(group: Sequence[ListedLoad]) -> LoadSum:
    return {
        "field": group[0]["field"],
        "crop": group[0]["crop"],
        "started_s": group[0]["started_s"],
        "ended_s": group[-1]["ended_s"],
        "loads": len(group),
        "weighed": sum(load["ticket_id"] is not None for load in group),
        "mass_kg": sum(load["mass_kg"] for load in group),
        "corrected_mass_kg": sum(load["corrected_mass_kg"] for load in group),
        "corrected_std_dev_kg": _std_dev(group),
        "corrected_dry_mass_kg": _all(load["corrected_dry_mass_kg"] for load in group),
        "area_m2": _all(load["area_m2"] for load in group),
    }


def _std_dev(group: Sequence[ListedLoad]) -> float | None:
    """Of the corrected masses together: loads of one ticket, and those without any, are taken to be off alike."""
    apart: dict[int | None, list[float | None]] = {}
    for load in group:
        apart.setdefault(load["ticket_id"], []).append(load["corrected_std_dev_kg"])
    found = [_all(std_devs_kg) for std_devs_kg in apart.values()]
    known = [std_dev_kg for std_dev_kg in found if std_dev_kg is not None]
    return hypot(*known) if len(known) == len(found) else None


def _all(values: Iterable[float | None]) -> float | None:
    """Their sum, None where one is not known."""
    found = list(values)
    known = [value for value in found if value is not None]
    return sum(known) if len(known) == len(found) else None

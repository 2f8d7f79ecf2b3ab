"""Units as the page shows them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from yieldmon.files.units import units_of
from yieldmon.units import KG_PER_LB, KG_PER_T, S_PER_H, Unit, Units, UnitSystem

#: What a daemon says to people, by its names in documents.
SENTENCES = frozenset(
    {"detail", "question", "why_no_reference", "why", "reason", "last_update", "update_kept_because", "zero_waits_for"}
)


def in_units(document: Any, units: Units) -> Any:
    """A document for a page, with the masses and flows of the daemon's sentences in these units.

    Parameters
    ----------
    document : object
        Fit for JSON.
    units : Units

    Returns
    -------
    object
        As it was where the units are metric.
    """
    if units.system is UnitSystem.METRIC:
        return document
    if isinstance(document, Mapping):
        return {
            name: units.in_text(value) if name in SENTENCES and isinstance(value, str) else in_units(value, units)
            for name, value in document.items()
        }
    return [in_units(value, units) for value in document] if isinstance(document, list) else document


#: Digits behind the point that the page shows; none of a unit that is not here.
_DECIMALS = {"kg/s": 2, "lb/s": 1, "t/h": 1, "t": 2, "t/ha": 2, "ha": 2, "ac": 2, "km/h": 1, "mph": 1}


def units_of_status(status: Mapping[str, Any]) -> dict[str, Any]:
    """The units of a daemon's status document: of the crop that it measures, named by its load or its parameters.

    Parameters
    ----------
    status : mapping

    Returns
    -------
    dict
        As `page_units`.

    Raises
    ------
    KeyError, TypeError
        The document lacks the load.
    """
    return page_units(*_system_and_crop(status))


def texts_of_status(status: Mapping[str, Any]) -> Units:
    """The same for `in_units`.

    Parameters
    ----------
    status : mapping

    Returns
    -------
    Units

    Raises
    ------
    KeyError, TypeError
        The document lacks the load.
    """
    system, crop = _system_and_crop(status)
    return units_of(system, crop=crop)


def _system_and_crop(status: Mapping[str, Any]) -> tuple[str, str]:
    crop = status.get("crop") or {}
    return status.get("units", UnitSystem.METRIC.value), crop.get("name") or status["load"]["crop"]


@lru_cache(maxsize=64)
def page_units(system: str = "metric", crop: str = "") -> dict[str, Any]:
    """Name and worth in SI of each unit.

    Parameters
    ----------
    system : str
        "metric" or "us".
    crop : str
        Whose bushels; "" for none.

    Returns
    -------
    dict
        ``mass``, ``total`` (of days and more), ``flow``, ``hourly`` (None where ``flow`` is one by the hour), ``yield``, ``area``
        and ``speed``, each with ``name``, ``si`` and ``decimals``.
    """
    units = units_of(system, crop=crop)
    us = units.system is UnitSystem.US
    shown: dict[str, Unit | None] = {
        "mass": units.mass_unit,
        "total": Unit("lb", KG_PER_LB) if us else Unit("t", KG_PER_T),
        "flow": units.flow_unit,
        "hourly": None if us else Unit("t/h", KG_PER_T / S_PER_H),
        "yield": units.yield_unit,
        "area": units.area_unit,
        "speed": units.speed_unit,
    }
    return {
        name: None if unit is None else {"name": unit.name, "si": unit.si, "decimals": _DECIMALS.get(unit.name, 0)}
        for name, unit in shown.items()
    }

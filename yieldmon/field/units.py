"""Units as harvest files write them, by factor to SI.

A unit is looked up, never guessed: a spelling that is not here is an error that names it.

Source: NIST Special Publication 811, appendix B (pound, foot, acre).
"""

from __future__ import annotations

from math import pi

from yieldmon.errors import InputError
from yieldmon.units import (
    KG_PER_DT,
    KG_PER_LB,
    KG_PER_SHORT_TON,
    M2_PER_ACRE,
    M2_PER_HA,
    M_PER_FT,
    M_PER_IN,
    M_PER_MI,
    M_PER_YD,
    M_S_PER_KMH,
    M_S_PER_KNOT,
    M_S_PER_MPH,
    S_PER_DAY,
    S_PER_H,
)

from .crop_figures import crop, known_crops

_MASS = {"kg": 1.0, "g": 1e-3, "t": 1e3, "lb": KG_PER_LB, "lbs": KG_PER_LB, "mg": 1e-6, "ton": KG_PER_SHORT_TON, "tonne": 1e3}
# Decitonne and double hundredweight (German), quintal (French, Italian, Spanish), hectokilogram (Danish), all 100 kg.
_MASS |= dict.fromkeys(("dt", "dz", "q", "hkg"), KG_PER_DT)
_MASS |= {"sc": 60.0}  # saca of grain (Brazil)
_MASS |= {"tonnes": 1e3, "cwt": 100.0 * KG_PER_LB, "short_ton": KG_PER_SHORT_TON, "metric_ton": 1e3}
_LENGTH = {"m": 1.0, "cm": 0.01, "mm": 1e-3, "ft": M_PER_FT, "in": M_PER_IN, "km": 1e3, "mi": M_PER_MI, "inch": M_PER_IN}
_LENGTH |= dict.fromkeys(("yd", "yds", "yard", "yards"), M_PER_YD)
_TIME = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "min": 60.0, "h": S_PER_H, "hr": S_PER_H, "d": S_PER_DAY}
_AREA = {"m2": 1.0, "ha": M2_PER_HA, "ac": M2_PER_ACRE, "acre": M2_PER_ACRE}
_PERCENT = {"%": 1.0, "pct": 1.0, "prcnt": 1.0, "percent": 1.0, "ppm": 1e-4, "fraction": 100.0}
_ANGLE = {"deg": 1.0, "arcdeg": 1.0, "degrees": 1.0, "rad": 180.0 / pi, "1e-6deg": 1e-6, "1e-7deg": 1e-7}


def _ratios(top: dict[str, float], bottom: dict[str, float]) -> dict[str, float]:
    return {f"{a}/{b}": top[a] / bottom[b] for a in top for b in bottom}


#: Where only one reading makes sense: per hectare a ton is the metric one, and Mg is a megagram where no case tells it from mg.
_PER_LARGE_AREA = {"ton/ha": 1e3 / M2_PER_HA, "mg/ha": 1e3 / M2_PER_HA, "mg/ac": 1e3 / M2_PER_ACRE, "mg/acre": 1e3 / M2_PER_ACRE}

#: Kind of quantity -> unit -> factor to the kind's SI unit (in the comment).
FACTORS: dict[str, dict[str, float]] = {
    "mass": _MASS,  # kg
    "length": _LENGTH,  # m
    "time": _TIME,  # s
    "area": _AREA,  # m2
    # A ton over time may be short or metric.
    "mass_flow": _ratios({unit: kg for unit, kg in _MASS.items() if unit != "ton"}, _TIME),  # kg/s
    "mass_per_area": _ratios(_MASS, _AREA) | _PER_LARGE_AREA,  # kg/m2
    "speed": _ratios(_LENGTH, _TIME)
    | {"km/h": M_S_PER_KMH, "kmh": M_S_PER_KMH, "mph": M_S_PER_MPH}
    | {"km/t": M_S_PER_KMH}  # per "time", Danish and Norwegian for an hour
    | dict.fromkeys(("kn", "kt", "kts", "knot", "knots"), M_S_PER_KNOT),  # m/s
    "percent": _PERCENT,  # %
    "angle": _ANGLE,  # deg
    "none": {"": 1.0},
}
BUSHELS = ("bu/ac", "bu/acre", "bu/ha", "bu/h", "bu/hr", "bu/s")
_OF_BUSHELS = ("mass_per_area", "mass_flow")


#: Other spellings of parts of a unit.
_WORDS = {
    "bushels": "bu", "bushel": "bu", "tons": "ton", "pounds": "lb", "kilograms": "kg", "acres": "acre", "hectare": "ha",
    "feet": "ft", "foot": "ft", "inches": "in", "metres": "m", "meters": "m", "meter": "m", "metre": "m", "seconds": "s",
    "second": "s", "sec.": "s", "hour": "h", "hours": "h", "qx": "q", "qq": "q", "quintals": "q", "quintal": "q",
    "quintaux": "q", "metrictons": "metric_ton", "metricton": "metric_ton", "shorttons": "short_ton", "shortton": "short_ton",
    "uston": "short_ton", "ustons": "short_ton", "sacas": "sc", "saca": "sc",
}  # fmt: skip
_BELOW = ("ac", "acre", "ha", "hr", "sec", "m2", "s", "h")


def plain_unit(text: str) -> str:
    """A unit in one spelling: lower case, no blanks, `bu1ac-1` and `bu ac-1` as `bu/ac`, `m^2` as `m2`, `Mg` as `t`.

    >>> plain_unit("lb1ac-1"), plain_unit("T / ha"), plain_unit("Mg ha^-1"), plain_unit("bushels per acre")
    ('lb/ac', 't/ha', 't/ha', 'bu/acre')
    """
    megagram = text.strip().startswith("Mg")
    unit = "".join(text.lower().replace("⁻¹", "-1").replace("−", "-").split()).replace("^", "").replace("²", "2")
    unit = unit.replace("°", "deg").replace("per", "/")
    if unit == "/cent":
        return "percent"
    for below in _BELOW:
        if unit.endswith(f"{below}-1"):
            unit = f"{unit.removesuffix(f'{below}-1').rstrip('1.·*')}/{below}"
            break
    over = "/".join(_WORDS.get(part, part) for part in unit.split("/"))
    return f"t{over.removeprefix('mg')}" if megagram and over.startswith("mg") else over


def is_unit_of(unit: str, kind: str) -> bool:
    """Whether a unit, as plain_unit spells it, is one of a kind of quantity; any is of what has none.

    >>> is_unit_of("bu/ac", "mass_per_area"), is_unit_of("m", "mass_flow")
    (True, False)
    """
    return kind not in FACTORS or unit in FACTORS[kind] or (unit in BUSHELS and kind in _OF_BUSHELS)


def is_bushels(unit: str, kind: str) -> bool:
    """Whether a unit is one of bushels, of a kind of quantity that has such."""
    return plain_unit(unit) in BUSHELS and kind in _OF_BUSHELS


def factor(unit: str, kind: str, where: str, crop_name: str = "") -> float:
    """SI per unit.

    Parameters
    ----------
    unit : str
        As a file or a person writes it.
    kind : str
        A key of FACTORS.
    where : str
        Place for the error.
    crop_name : str
        Needed for bushels only.

    Raises
    ------
    InputError
        For a unit that is not of this kind, or a bushel of a crop whose bushel is not known.
    """
    plain = plain_unit(unit)
    known = FACTORS[kind]
    if plain in known:
        return known[plain]
    if plain in BUSHELS and kind in _OF_BUSHELS:
        of = crop(crop_name)
        if of is None:
            names = ", ".join(known_crops())
            raise InputError(where, f"is in {unit} of {crop_name or 'an unknown crop'}", f"--crop, one of {names}")
        below = plain.removeprefix("bu/")
        per = (_AREA | _TIME).get(below)
        if per is not None and (below in _AREA) == (kind == "mass_per_area"):
            return of.bushel_lb * KG_PER_LB / per
    raise InputError(where, f"has the unit {unit!r}", f"one of {', '.join(list(known)[:12])}")

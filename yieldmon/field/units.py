"""Units as harvest files write them, by factor to SI.

A unit is looked up, never guessed: a spelling that is not here is an error that names it.

Sources: NIST Special Publication 811, appendix B (pound, foot, acre); USDA test weights of a bushel (lb), 7 CFR 810.
"""

from __future__ import annotations

from dataclasses import dataclass

from yieldmon.errors import InputError

KG_PER_LB = 0.45359237
M_PER_IN = 0.0254
M_PER_FT = 0.3048
M2_PER_ACRE = 4046.8564224
M2_PER_HA = 10_000.0
KG_PER_T = 1000.0


@dataclass(frozen=True)
class Crop:
    """What a crop's name stands for.

    Parameters
    ----------
    name : str
        Common name in English.
    bushel_lb : float
        Weight of a standard bushel, lb.
    market_moisture_pct : float
        Moisture of dry mass, %.
    """

    name: str
    bushel_lb: float
    market_moisture_pct: float


#: Name -> crop. Aliases are in other languages and spellings that monitors write.
CROPS = {
    crop.name: crop
    for crop in (
        Crop("corn", 56.0, 15.5),
        Crop("soybeans", 60.0, 13.0),
        Crop("wheat", 60.0, 13.5),
        Crop("barley", 48.0, 14.5),
        Crop("oats", 32.0, 14.0),
        Crop("rye", 56.0, 14.0),
        Crop("sorghum", 56.0, 14.0),
        Crop("canola", 50.0, 9.0),
        Crop("rice", 45.0, 13.5),
        Crop("sunflower", 25.0, 10.0),
        Crop("peas", 60.0, 14.0),
    )
}
_ALIASES = {
    "maize": "corn",
    "mais": "corn",
    "yellow corn": "corn",
    "soybean": "soybeans",
    "soya": "soybeans",
    "soy": "soybeans",
    "sb": "soybeans",
    "winter wheat": "wheat",
    "spring wheat": "wheat",
    "weizen": "wheat",
    "winterweizen": "wheat",
    "trigo": "wheat",
    "gerste": "barley",
    "wintergerste": "barley",
    "milo": "sorghum",
    "rape": "canola",
    "raps": "canola",
    "rapeseed": "canola",
    "roggen": "rye",
    "hafer": "oats",
    "soja": "soybeans",
    "maiz": "corn",
    "milho": "corn",
}


def crop(name: str) -> Crop | None:
    """The crop that a file's name means, None for one that is not known (its bushel is then not known either)."""
    plain = " ".join(name.lower().replace("_", " ").split())
    return CROPS.get(_ALIASES.get(plain, plain))


_MASS = {"kg": 1.0, "g": 1e-3, "t": 1e3, "lb": KG_PER_LB, "lbs": KG_PER_LB, "mg": 1e-6, "ton": 2000 * KG_PER_LB, "tonne": 1e3}
_LENGTH = {"m": 1.0, "cm": 0.01, "mm": 1e-3, "ft": M_PER_FT, "in": M_PER_IN, "km": 1e3, "mi": 1609.344, "inch": M_PER_IN}
_TIME = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0, "hr": 3600.0}
_AREA = {"m2": 1.0, "ha": M2_PER_HA, "ac": M2_PER_ACRE, "acre": M2_PER_ACRE}
_PERCENT = {"%": 1.0, "pct": 1.0, "prcnt": 1.0, "percent": 1.0, "ppm": 1e-4, "fraction": 100.0}
_ANGLE = {"deg": 1.0, "arcdeg": 1.0, "degrees": 1.0}


def _ratios(top: dict[str, float], bottom: dict[str, float]) -> dict[str, float]:
    return {f"{a}/{b}": top[a] / bottom[b] for a in top for b in bottom}


#: Kind of quantity -> unit -> factor to the kind's SI unit (in the comment).
FACTORS: dict[str, dict[str, float]] = {
    "mass": _MASS,  # kg
    "length": _LENGTH,  # m
    "time": _TIME,  # s
    "area": _AREA,  # m2
    "mass_flow": _ratios(_MASS, _TIME),  # kg/s
    "mass_per_area": _ratios(_MASS, _AREA),  # kg/m2
    "speed": _ratios(_LENGTH, _TIME) | {"km/h": 1 / 3.6, "kmh": 1 / 3.6, "mph": 0.44704},  # m/s
    "percent": _PERCENT,  # %
    "angle": _ANGLE,  # deg
    "none": {"": 1.0},
}
_BUSHELS = ("bu/ac", "bu/acre", "bu/ha", "bu/h", "bu/s")


def plain_unit(text: str) -> str:
    """A unit in one spelling: lower case, no blanks, `bu1ac-1` as `bu/ac`, `m^2` as `m2`.

    >>> plain_unit("lb1ac-1"), plain_unit("T / ha")
    ('lb/ac', 't/ha')
    """
    unit = "".join(text.lower().split()).replace("^", "").replace("²", "2").replace("°", "deg").replace("per", "/")
    for below in ("ac", "ha", "hr", "sec", "m2", "s", "h"):
        if unit.endswith(f"1{below}-1"):
            return f"{unit.removesuffix(f'1{below}-1')}/{below}"
    return unit if unit != "/cent" else "percent"


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
    if plain in _BUSHELS and kind in ("mass_per_area", "mass_flow"):
        of = crop(crop_name)
        if of is None:
            raise InputError(where, f"is in {unit} of {crop_name or 'an unknown crop'}", f"--crop, one of {', '.join(CROPS)}")
        below = plain.removeprefix("bu/")
        per = (_AREA | _TIME).get(below)
        if per is not None and (below in _AREA) == (kind == "mass_per_area"):
            return of.bushel_lb * KG_PER_LB / per
    raise InputError(where, f"has the unit {unit!r}", f"one of {', '.join(list(known)[:12])}")

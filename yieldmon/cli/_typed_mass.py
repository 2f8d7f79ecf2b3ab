"""Masses as people type them on the command line or in the cab: with units, and with marks between thousands."""

from __future__ import annotations

import re
from math import inf, nan

from yieldmon.errors import InputError
from yieldmon.service.operator.control_protocol import TICKET_KG
from yieldmon.units import KG_PER_DT, KG_PER_LB, KG_PER_SHORT_TON, KG_PER_T

_MASS_UNITS = {
    "kg": 1.0, "kilograms": 1.0, "kilogram": 1.0, "kilos": 1.0, "kilo": 1.0,
    "lbs": KG_PER_LB, "lb": KG_PER_LB, "pounds": KG_PER_LB, "pound": KG_PER_LB,
    "shorttons": KG_PER_SHORT_TON, "shortton": KG_PER_SHORT_TON, "metrictons": KG_PER_T, "metricton": KG_PER_T, "mt": KG_PER_T,
    "quintals": KG_PER_DT, "quintal": KG_PER_DT, "q": KG_PER_DT,
    "tonnes": KG_PER_T, "tonne": KG_PER_T, "dt": KG_PER_DT, "t": KG_PER_T,
}  # fmt: skip
"""A unit that is the end of another one comes after it."""
_SMALL_UNITS = tuple(unit for unit, kg in _MASS_UNITS.items() if kg <= 1.0)
_IN_THOUSANDS = re.compile(r"[1-9][0-9]{0,2}(?P<mark>[,'’])[0-9]{3}((?P=mark)[0-9]{3})*(\.[0-9]+)?")
"""A number as `status` shows masses, 41,222, or as Swiss slips do, 41'222."""
_POINTED = re.compile(r"[1-9][0-9]{0,2}(\.[0-9]{3})+")
"""A number as German slips do, 9.120; it may be one with three decimals."""
_APART = re.compile(r"[0-9]\s+[0-9]")
_SPACED = re.compile(r"\s*[1-9][0-9]{0,2}(\s[0-9]{3})+(\.[0-9]+)?\s*[a-z]*(\s[a-z]+)?\s*$", re.IGNORECASE)
"""A number with spaces between thousands, 9 120 kg."""


def in_thousands(text: str) -> str:
    """The mass that a text such as 9.120kg is where its point parts thousands, 9120kg; "" where it cannot."""
    number, unit = _number_and_unit(text)
    return number.replace(".", "") + unit if unit in ("", *_SMALL_UNITS) and _POINTED.fullmatch(number) else ""


def _number_and_unit(text: str) -> tuple[str, str]:
    """The unit is "" where there is none that is known."""
    # Slips are copied with spaces that do not break.
    number = "".join(text.split()).lower()
    unit = next((unit for unit in _MASS_UNITS if number.endswith(unit)), "")
    return number.removesuffix(unit), unit


def mass(text: str, where: str = "mass") -> float:
    """A mass in kg from the command line: a number above 0, with or without its unit, in letters of any size, of kilograms or
    pounds also with commas between thousands. Raises InputError."""
    if _APART.search(text) and not _SPACED.match(text):
        raise InputError(where, repr(text), "one number, such as 9120, 9 120 kg or 9.12t")
    number, unit = _number_and_unit(text)
    scale = _MASS_UNITS.get(unit, 1.0)
    if unit in _SMALL_UNITS and _IN_THOUSANDS.fullmatch(number):
        # 9,120t may be 9.12 t; nobody weighs a load to the gram.
        number = re.sub("[,'’]", "", number)
    if number.count(".") > 1 and _POINTED.fullmatch(number):
        raise InputError(where, f"{text!r} has points between thousands", f"{number.replace('.', '')}{unit}")
    try:
        mass_kg = float(number) * scale
    except ValueError:
        mass_kg = nan
    if not 0.0 < mass_kg < inf:
        point = ", with a point, not a comma" if "," in text else ""
        count = number.rstrip("abcdefghijklmnopqrstuvwxyz")
        if number.endswith(("ton", "tons")):
            point += f"; is a ton {count}t (1000 kg each) or {count} short tons (2000 lb each)?"
        if number.endswith(("bu", "bushel", "bushels")):
            point += "; bushels are reckoned from the mass, often less shrink: enter the pounds or kilograms of the slip"
        raise InputError(where, repr(text), f"kilograms above 0, such as 9120, 9120kg, 9.12t or 20106lb{point}")
    if mass_kg < TICKET_KG[0]:
        raise InputError(where, repr(text), f"at least {1000.0 * TICKET_KG[0]:g} g; look at the unit")
    if mass_kg > TICKET_KG[1]:
        raise InputError(where, repr(text), f"at most {TICKET_KG[1] / KG_PER_T:,.0f} t; look at the unit")
    return mass_kg

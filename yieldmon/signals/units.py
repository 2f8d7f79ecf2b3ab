"""Units in which a bus may give a quantity, and their factors into the quantity's own."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi

from yieldmon.units import KG_PER_LB, N_PER_KGF

FACTORS: Mapping[str, Mapping[str, float]] = {
    "rpm": {"rpm": 1.0, "1/min": 1.0, "min-1": 1.0, "r/min": 1.0, "rad/s": 30.0 / pi, "Hz": 60.0, "1/s": 60.0, "rev/s": 60.0},
    "deg": {"deg": 1.0, "°": 1.0, "degree": 1.0, "degrees": 1.0, "rad": 180.0 / pi, "mrad": 0.18 / pi},
    "%": {"%": 1.0, "percent": 1.0, "1": 100.0, "ppm": 1e-4},
    "kg/m3": {"kg/m3": 1.0, "kg/m^3": 1.0, "kg/m³": 1.0, "g/l": 1.0, "g/L": 1.0, "kg/hl": 10.0, "lb/bu": 12.8718},
    "g": {"g": 1.0, "kg": 1000.0, "mg": 1e-3},
    "kg": {"kg": 1.0, "t": 1000.0, "g": 1e-3, "lb": KG_PER_LB},
    "km/h": {"km/h": 1.0, "kph": 1.0, "m/s": 3.6, "mph": 1.609344, "kn": 1.852},
    "kg/s": {"kg/s": 1.0, "g/s": 1e-3, "mg/s": 1e-6, "t/h": 1 / 3.6, "kg/h": 1 / 3600, "lb/s": KG_PER_LB},
    "degC": {"degC": 1.0, "°C": 1.0, "C": 1.0},
    "mV": {"mV": 1.0, "V": 1000.0, "uV": 1e-3, "mV/V": 1.0, "counts": 1.0},
    "N": {"N": 1.0, "kN": 1000.0, "daN": 10.0, "mN": 1e-3, "kgf": N_PER_KGF, "lbf": 4.4482216},
    "min": {"min": 1.0, "s": 1 / 60, "h": 60.0, "d": 1440.0},
    "": {"": 1.0},
}
"""Unit of a quantity -> unit on the bus -> factor."""


_IN_ANY_CASE = ("rpm", "deg", "degree", "degrees", "percent", "kph", "mph", "km/h", "degC")
"""Those of which no other case means anything else, as mg and Mg do."""
_SPELLINGS = {unit.lower(): unit for unit in _IN_ANY_CASE} | {"u/min": "rpm", "km/hr": "km/h", "kmh": "km/h"}


def factor(quantity_unit: str, unit: str) -> float | None:
    """What a value in `unit` is multiplied with; None for a unit that is none of this quantity."""
    known, plain = FACTORS[quantity_unit], unit.strip()
    return known.get(plain, known.get(_SPELLINGS.get(plain.lower(), plain)))


def accepted(quantity_unit: str) -> str:
    """The units that are understood, for a message."""
    return ", ".join(FACTORS[quantity_unit]) or "no unit"

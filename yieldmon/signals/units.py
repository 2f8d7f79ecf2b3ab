"""Units in which a bus may give a quantity, and their factors into the quantity's own."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi

from yieldmon.units import KG_PER_LB, KMH_PER_M_S, M3_PER_BUSHEL, M_PER_FT, M_S_PER_KNOT, M_S_PER_MPH, N_PER_KGF

FACTORS: Mapping[str, Mapping[str, float]] = {
    "rpm": {
        "rpm": 1.0,
        "1/min": 1.0,
        "min-1": 1.0,
        "r/min": 1.0,
        "rad/s": 30.0 / pi,
        "Hz": 60.0,
        "1/s": 60.0,
        "rev/s": 60.0,
        "deg/s": 1.0 / 6.0,
    },
    "deg": {
        **dict.fromkeys(("deg", "°", "degree", "degrees"), 1.0),
        "rad": 180.0 / pi,
        "mrad": 0.18 / pi,
        "arcmin": 1 / 60,
        "arcsec": 1 / 3600,
        "mas": 1e-3 / 3600,
    },
    "%": {"%": 1.0, "percent": 1.0, "1": 100.0, "‰": 0.1, "ppm": 1e-4},
    "kg/m3": {
        "kg/m3": 1.0,
        "kg/m^3": 1.0,
        "kg/m³": 1.0,
        "g/l": 1.0,
        "g/L": 1.0,
        "kg/hl": 10.0,
        "kg/l": 1000.0,
        "kg/L": 1000.0,
        "kg/dm3": 1000.0,
        "g/cm3": 1000.0,
        "t/m3": 1000.0,
        "lb/bu": KG_PER_LB / M3_PER_BUSHEL,
    },
    "g": {"g": 1.0, "kg": 1000.0, "mg": 1e-3},
    "kg": {"kg": 1.0, "t": 1000.0, "g": 1e-3, "lb": KG_PER_LB},
    "km/h": {
        "km/h": 1.0,
        "kph": 1.0,
        "m/s": KMH_PER_M_S,
        "mph": M_S_PER_MPH * KMH_PER_M_S,
        "kn": M_S_PER_KNOT * KMH_PER_M_S,
        "ft/s": M_PER_FT * KMH_PER_M_S,
    },
    "kg/s": {"kg/s": 1.0, "g/s": 1e-3, "mg/s": 1e-6, "t/h": 1 / 3.6, "kg/h": 1 / 3600, "lb/s": KG_PER_LB},
    "degC": {"degC": 1.0, "°C": 1.0, "C": 1.0, "K": 1.0} | dict.fromkeys(("degF", "°F", "F"), 5.0 / 9.0),
    "mV": {"mV": 1.0, "V": 1000.0, "uV": 1e-3, "mV/V": 1.0, "counts": 1.0},
    "N": {"N": 1.0, "kN": 1000.0, "daN": 10.0, "mN": 1e-3, "kgf": N_PER_KGF, "lbf": KG_PER_LB * N_PER_KGF},
    "min": {"min": 1.0, "s": 1 / 60, "h": 60.0, "d": 1440.0},
    "": {"": 1.0},
}
"""Unit of a quantity -> unit on the bus -> factor."""


ZEROS: Mapping[str, Mapping[str, float]] = {
    "degC": dict.fromkeys(("degF", "°F", "F"), -32.0 * 5.0 / 9.0) | {"K": -273.15},
}
"""Unit of a quantity -> unit on the bus -> what its 0 is in the quantity's own; 0 for those that are not here."""

_PERIODS_S = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "usec": 1e-6}

_IN_ANY_CASE = ("rpm", "deg", "degree", "degrees", "percent", "kph", "mph", "km/h", "degC", "degF", "deg/s", "ft/s")
"""Those of which no other case means anything else, as mg and Mg do."""
_SPELT = {
    "rpm": "r/min min^-1 u/min umin upm rev/min revs/min turns/min unit_minutinver unit_revpermin "
    "umdr/min umdrehungen/min tr/min trs/min giri/min obr/min ot/min varv/min omw/min omdr/min",
    "1/s": "s-1 s^-1 u/s umdr/s tr/s",
    "deg": "degs winkelgrad degré degrés unit_degreofarc unit_degreeofarc",
    "rad": "radian radians unit_radian",
    "arcmin": "arcminute arcminutes",
    "arcsec": "arcsecond arcseconds",
    "mas": "marcsec milliarcsec milliarcsecond milliarcseconds",
    "deg/s": "deg/sec degree/s degrees/s degrees/sec degrees/second",
    "%": "pct prozent unit_percent",
    "‰": "permille promille",
    "km/h": "km/hr kmh kilometer/hour unit_kilometerperhour",
    "m/s": "m/sec meter/s meters/s meters/sec unit_meterpersecond unit_meterpersecon unit_meterpersec",
    "mph": "miles/h mi/h miles/hour",
    "kn": "knot knots kt kts",
    "degC": "celsius cel degreec degreesc degreescelsius degreecelsius unit_degrecelsi unit_degreecelsius",
    "degF": "fahrenheit degreef degreesf degreesfahrenheit unit_degrefahre",
    "K": "kelvin degk",
    "kg": "kilogram kilograms unit_kilogram",
    "lb": "lbs pound pounds",
    "V": "volt volts vdc unit_volt",
    "mV": "millivolt millivolts unit_millivolt",
    "kN": "kilonewton unit_kilonewto unit_kilonewton",
    "N": "newton newtons unit_newto unit_newton",
    "Hz": "hertz unit_hertz",
    "lb/s": "lbs/s lb/sec lbs/sec",
    "kg/s": "kg/sec",
    "t/h": "t/hr",
}
_AMBIGUOUS = {"grad": ("deg", "degrees in some languages and gradians of 0.9 degrees in others")}
"""Words for two units, which have no factor: the likelier of the two, and both."""
_SPELLINGS = {unit.lower(): unit for unit in _IN_ANY_CASE} | {
    word: unit for unit, words in _SPELT.items() for word in words.split()
}


def _plain(unit: str) -> str:
    """A unit with one sign each for degrees and micro."""
    # Either in UTF-8 that a program read as Latin-1 has a letter before it; some take the sign of Spanish ordinals.
    return unit.strip().replace("Â", "").replace("º", "°").replace("μ", "u").replace("µ", "u")


def _known(quantity_unit: str, unit: str) -> str | None:
    """A unit of a quantity as the tables spell it; None for one that is none."""
    known, plain = FACTORS[quantity_unit], _plain(unit)
    if plain in known:
        return plain
    word = "".join(plain.lower().split())
    spelt = _SPELLINGS.get(word, _SPELLINGS.get(word.replace("°", "deg"), plain))
    return spelt if spelt in known else None


def factor(quantity_unit: str, unit: str) -> float | None:
    """What a value in `unit` is multiplied with; None for a unit that is none of this quantity."""
    known = _known(quantity_unit, unit)
    return None if known is None else FACTORS[quantity_unit][known]


def zero(quantity_unit: str, unit: str) -> float:
    """What is added then: the quantity at 0 of the unit. 0 for a unit that is none of this quantity.

    >>> [round(212.0 * factor("degC", name) + zero("degC", name), 6) for name in ("°F", "degF", "deg C")]
    [100.0, 100.0, 212.0]
    """
    known = _known(quantity_unit, unit)
    return 0.0 if known is None else ZEROS.get(quantity_unit, {}).get(known, 0.0)


def period_s(unit: str) -> float | None:
    """Seconds of a unit of the time between two pulses; None for one that is none.

    >>> [period_s(unit) for unit in ("ms", "µs", "rpm")]
    [0.001, 1e-06, None]
    """
    return _PERIODS_S.get(_plain(unit))


def may_be(unit: str) -> str:
    """What an ambiguous unit may be, in brackets for a message; "" for any other.

    >>> may_be("Grad"), may_be("deg")
    (' (degrees in some languages and gradians of 0.9 degrees in others)', '')
    """
    found = _AMBIGUOUS.get(_plain(unit).lower())
    return f" ({found[1]})" if found else ""


def likely(unit: str) -> str:
    """The likelier meaning of an ambiguous unit; any other as it is.

    >>> likely("Grad"), likely("rad")
    ('deg', 'rad')
    """
    return _AMBIGUOUS.get(_plain(unit).lower(), (unit,))[0]


def accepted(quantity_unit: str) -> str:
    """The units that are understood, for a message."""
    return ", ".join(FACTORS[quantity_unit]) or "no unit"

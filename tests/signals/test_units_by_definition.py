"""Every unit that a bus may give a quantity in, against its definition (SI Brochure; NIST Special Publication 811)."""

from __future__ import annotations

from fractions import Fraction as Exact
from math import pi

import pytest

from yieldmon.signals.units import FACTORS, accepted, factor, zero

LB_KG, G_N, MILE_M, NAUTICAL_MILE_M = Exact("0.45359237"), Exact("9.80665"), Exact("1609.344"), Exact(1852)
#: 231 cubic inches to a gallon; the US bushel has 2150.42 cubic inches.
BUSHEL_M3 = Exact("2150.42") * Exact("0.0254") ** 3
TURN = 2.0 * pi

DEFINED: dict[str, dict[str, float | Exact]] = {
    "rpm": {**dict.fromkeys(("rpm", "1/min", "min-1", "r/min"), 1), "rad/s": 60.0 / TURN, "Hz": 60, "1/s": 60, "rev/s": 60,
        "deg/s": Exact(60, 360)},
    "deg": {
        **dict.fromkeys(("deg", "°", "degree", "degrees"), 1), "rad": 360.0 / TURN, "mrad": 0.36 / TURN,
        "arcmin": Exact(1, 60), "arcsec": Exact(1, 60**2), "mas": Exact(1, 1000 * 60**2),
    },
    "%": {"%": 1, "percent": 1, "1": 100, "‰": Exact(1, 10), "ppm": Exact(100, 10**6)},
    "kg/m3": {
        **dict.fromkeys(("kg/m3", "kg/m^3", "kg/m³", "g/l", "g/L"), 1), "kg/hl": Exact(1000, 100), "lb/bu": LB_KG / BUSHEL_M3,
        **dict.fromkeys(("kg/l", "kg/L", "kg/dm3"), 1000), "g/cm3": Exact(1, 1000) * 100**3, "t/m3": 1000,
    },
    "g": {"g": 1, "kg": 1000, "mg": Exact(1, 1000)},
    "kg": {"kg": 1, "t": 1000, "g": Exact(1, 1000), "lb": LB_KG},
    "km/h": {"km/h": 1, "kph": 1, "m/s": Exact(3600, 1000), "mph": MILE_M / 1000, "kn": NAUTICAL_MILE_M / 1000,
        "ft/s": Exact("0.3048") * 3600 / 1000},
    "kg/s": {
        "kg/s": 1, "g/s": Exact(1, 10**3), "mg/s": Exact(1, 10**6), "t/h": Exact(1000, 3600), "kg/h": Exact(1, 3600),
        "lb/s": LB_KG,
    },
    "degC": {"degC": 1, "°C": 1, "C": 1, **dict.fromkeys(("degF", "°F", "F"), Exact(100, 180)), "K": 1},
    "mV": {"mV": 1, "V": 1000, "uV": Exact(1, 1000), "mV/V": 1, "counts": 1},
    "N": {"N": 1, "kN": 1000, "daN": 10, "mN": Exact(1, 1000), "kgf": G_N, "lbf": LB_KG * G_N},
    "min": {"min": 1, "s": Exact(1, 60), "h": 60, "d": 24 * 60},
    "": {"": 1},
}  # fmt: skip


@pytest.mark.parametrize("quantity", FACTORS)
def test_each_unit_is_what_it_is_defined_as(quantity: str) -> None:
    assert {unit: factor(quantity, unit) for unit in FACTORS[quantity]} == pytest.approx(
        {unit: float(value) for unit, value in DEFINED[quantity].items()}, rel=1e-5
    )


def test_a_unit_of_another_quantity_is_none() -> None:
    """What two quantities share is a unit of both; anything else is refused."""
    for quantity in FACTORS:
        for other in FACTORS:
            for unit in DEFINED[other].keys() - DEFINED[quantity].keys():
                assert factor(quantity, unit) is None, (quantity, unit)
    assert (factor("kg", " lb "), factor("kg", "LB"), accepted("kg"), accepted("")) == (
        0.45359237,
        None,
        "kg, t, g, lb",
        "no unit",
    )


@pytest.mark.parametrize(("unit", "water_freezes", "water_boils"), [
    ("°F", 32.0, 212.0), ("degF", 32.0, 212.0), ("deg F", 32.0, 212.0), ("fahrenheit", 32.0, 212.0), ("F", 32.0, 212.0),
    ("K", 273.15, 373.15), ("kelvin", 273.15, 373.15), ("degK", 273.15, 373.15), ("°C", 0.0, 100.0), ("Â°C", 0.0, 100.0),
    ("Degrees C", 0.0, 100.0), ("Unit_DegreCelsi", 0.0, 100.0),
])  # fmt: skip
def test_temperatures_have_a_zero_of_their_own(unit: str, water_freezes: float, water_boils: float) -> None:
    per_unit = factor("degC", unit)
    assert per_unit is not None
    assert [at * per_unit + zero("degC", unit) for at in (water_freezes, water_boils)] == pytest.approx([0.0, 100.0], abs=1e-9)


@pytest.mark.parametrize(("quantity", "spelt", "as_defined"), [
    ("rpm", "rev/min", "rpm"), ("rpm", "R/min", "rpm"), ("rpm", "Unit_MinutInver", "rpm"), ("km/h", "km / h", "km/h"),
    ("km/h", "m/sec", "m/s"), ("km/h", "knots", "kn"), ("km/h", "Unit_KiloMeterPerHour", "km/h"), ("deg", "radians", "rad"),
    ("mV", "Volts", "V"), ("N", "Unit_KiloNewto", "kN"), ("kg", "LBS", "lb"), ("%", "Unit_PerCent", "%"),
    ("mV", "µV", "uV"), ("mV", "\u03bcV", "uV"), ("mV", "ÂµV", "uV"), ("deg", "Winkelgrad", "deg"), ("%", "Prozent", "%"),
    ("rpm", "Umdr/min", "rpm"), ("rpm", "U/s", "1/s"), ("rpm", "tr/min", "rpm"), ("rpm", "s-1", "1/s"), ("deg", "degrés", "deg"),
    ("deg", "milliarcseconds", "mas"), ("deg", "arcminutes", "arcmin"), ("%", "Promille", "‰"),
])  # fmt: skip
def test_spellings_of_published_databases(quantity: str, spelt: str, as_defined: str) -> None:
    assert factor(quantity, spelt) == factor(quantity, as_defined)

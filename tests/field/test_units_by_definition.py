"""Every unit of harvest files against its definition (NIST Special Publication 811; USDA weights of a bushel)."""

from __future__ import annotations

import math
from fractions import Fraction as Exact

import pytest

from yieldmon.errors import InputError
from yieldmon.field.crop_figures import crop, known_crops
from yieldmon.field.sources.columns.naming import split_unit
from yieldmon.field.units import FACTORS, factor

LB, FT, INCH, MILE = Exact("0.45359237"), Exact("0.3048"), Exact("0.0254"), Exact("1609.344")
ACRE = 43560 * FT**2
MASS = {
    "kg": Exact(1), "g": Exact(1, 1000), "mg": Exact(1, 10**6), "t": Exact(1000), "tonne": Exact(1000), "lb": LB, "lbs": LB,
    "ton": 2000 * LB, "dt": Exact(100), "q": Exact(100), "dz": Exact(100),
    "hkg": Exact(100), "tonnes": Exact(1000), "cwt": 100 * LB, "short_ton": 2000 * LB,
    "metric_ton": Exact(1000), "sc": Exact(60),
}  # fmt: skip
LENGTH = {
    "m": Exact(1), "cm": Exact(1, 100), "mm": Exact(1, 1000), "km": Exact(1000), "ft": FT, "in": INCH, "inch": INCH, "mi": MILE,
    **dict.fromkeys(("yd", "yds", "yard", "yards"), 3 * FT),
}  # fmt: skip
TIME = {
    "s": Exact(1), "sec": Exact(1), "ms": Exact(1, 1000), "min": Exact(60), "h": Exact(3600), "hr": Exact(3600),
    "d": Exact(86400),
}  # fmt: skip
AREA = {"m2": Exact(1), "ha": Exact(10000), "ac": ACRE, "acre": ACRE}


def over(top: dict[str, Exact], bottom: dict[str, Exact]) -> dict[str, Exact]:
    return {f"{a}/{b}": top[a] / bottom[b] for a in top for b in bottom}


DEFINED: dict[str, dict[str, Exact]] = {
    "mass": MASS,
    "length": LENGTH,
    "time": TIME,
    "area": AREA,
    "mass_flow": over({unit: kg for unit, kg in MASS.items() if unit != "ton"}, TIME),
    "mass_per_area": over(MASS, AREA)
    # Per hectare a ton is the metric one, and mg a megagram in small letters.
    | {"ton/ha": Exact(1000, 10000), "mg/ha": Exact(1000, 10000), "mg/ac": 1000 / ACRE, "mg/acre": 1000 / ACRE},
    "speed": over(LENGTH, TIME)
    | {"km/h": Exact(1000, 3600), "kmh": Exact(1000, 3600), "mph": MILE / 3600, "km/t": Exact(1000, 3600)}
    | dict.fromkeys(("kn", "kt", "kts", "knot", "knots"), Exact(1852, 3600)),
    "percent": dict.fromkeys(("%", "pct", "prcnt", "percent"), Exact(1)) | {"ppm": Exact(100, 10**6), "fraction": Exact(100)},
    "angle": dict.fromkeys(("deg", "arcdeg", "degrees"), Exact(1))
    | {"rad": Exact(180 / math.pi), "1e-6deg": Exact(1, 10**6), "1e-7deg": Exact(1, 10**7)},
    "none": {"": Exact(1)},
}
BUSHEL_LB = {
    "corn": 56, "soybeans": 60, "wheat": 60, "barley": 48, "sorghum": 56, "canola": 50, "rice": 45, "oats": 32, "rye": 56,
    "peas": 60,
}  # fmt: skip


@pytest.mark.parametrize("kind", FACTORS)
def test_each_unit_is_what_it_is_defined_as(kind: str) -> None:
    expected = {unit: float(value) for unit, value in DEFINED[kind].items()}
    assert {unit: factor(unit, kind, "f.csv") for unit in FACTORS[kind]} == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("name", BUSHEL_LB)
def test_bushels_are_a_crops_weight(name: str) -> None:
    bushel = BUSHEL_LB[name] * LB
    areas = {f"bu/{unit}": float(bushel / AREA[unit]) for unit in ("ac", "acre", "ha")}
    flows = {f"bu/{unit}": float(bushel / TIME[unit]) for unit in ("h", "hr", "s")}
    for kind, units, others in (("mass_per_area", areas, flows), ("mass_flow", flows, areas)):
        assert {unit: factor(unit, kind, "f.csv", name) for unit in units} == pytest.approx(units, rel=1e-12)
        for unit in others:
            with pytest.raises(InputError, match=f"has the unit '{unit}'"):
                factor(unit, kind, "f.csv", name)


def test_a_bushel_needs_a_crop_and_no_other_quantity_has_one() -> None:
    with pytest.raises(InputError, match="is in bu/ac of an unknown crop; expected --crop, one of "):
        factor("bu/ac", "mass_per_area", "f.csv")
    for kind in FACTORS.keys() - {"mass_per_area", "mass_flow"}:
        with pytest.raises(InputError, match="has the unit 'bu/ac'"):
            factor("bu/ac", kind, "f.csv", "corn")


@pytest.mark.parametrize(
    ("name", "unit"),
    [("yield_Mg_ha", "t/ha"), ("yield_mg_ha", "mg/ha"), ("flow_Mg_h", "t/h"), ("Yield (Mg/ha)", "t/ha"),
     ("Yield [t ha-1]", "t/ha"), ("Yield (t.ha-1)", "t/ha"),
     ("Yield t/ha", "t/ha"), ("Yield, kg/ha", "kg/ha"), ("Yield (bushels/acre)", "bu/acre"), ("Yield (cwt/ac)", "cwt/ac"),
     ("Yield kg ha\u207b\u00b9", "kg/ha"), ("Speed mph", "mph"), ("Swath ft", "ft"), ("Moisture %", "%"), ("Flow (ton/h)", ""),
     ("Yld Mass(Dry)", ""), ("Load T", ""), ("Yield (short ton/acre)", "short_ton/acre"), ("Yield (US tons/ac)", "short_ton/ac"),
     ("Yield (quintals/ha)", "q/ha"), ("Yield (dz/ha)", "dz/ha"), ("Udbytte (hkg/ha)", "hkg/ha"), ("Hastighed (km/t)", "km/t")],
)  # fmt: skip
def test_units_as_people_write_them_behind_a_name(name: str, unit: str) -> None:
    assert split_unit(name)[1] == unit


def test_crops_without_parameters() -> None:
    assert known_crops().keys() - BUSHEL_LB.keys() == {"sunflower"}
    assert [known_crops()[name].market_moisture_pct for name in ("oats", "rye", "peas")] == [14.0] * 3
    names = ("Winter  Wheat", "HAFER", "roggen", "quinoa")
    assert [found and found.name for found in map(crop, names)] == ["wheat", "oats", "rye", None]

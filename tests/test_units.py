"""What people read: factors from NIST SP 811 written out here once more, rounding, and bushels only where the crop is known."""

from __future__ import annotations

from math import nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from yieldmon.units import UNKNOWN, Units, UnitSystem, crop_yield_kg_m2, moisture, rounded

METRIC, US = Units(UnitSystem.METRIC), Units(UnitSystem.US)
CORN = Units(UnitSystem.US, 56 * 0.45359237)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (METRIC.mass(8432.4), "8,432 kg"),
        (METRIC.mass(27_432.0), "27.43 t"),
        (METRIC.flow(12.34), "12.3 kg/s"),
        (METRIC.crop_yield(1.0), "10.0 t/ha"),
        (METRIC.area(12_345.0), "1.23 ha"),
        (METRIC.speed(1.5), "5.4 km/h"),
        (METRIC.mass_with_bushels(1000.0), "1,000 kg"),
        (US.mass(453.59237), "1,000 lb"),
        (US.flow(0.45359237), "1.00 lb/s"),
        (US.crop_yield(1.0), "8,922 lb/ac"),
        (US.area(4046.8564224), "1.00 ac"),
        (US.speed(0.44704 * 3.6), "3.6 mph"),
        (CORN.flow(12.0), "1,701 bu/h"),
        (CORN.crop_yield(1.0), "159 bu/ac"),
        (CORN.mass_with_bushels(2540.117), "5,600 lb (100 bu)"),
        (METRIC.flow(None), UNKNOWN),
        (CORN.crop_yield(nan), UNKNOWN),
        (moisture(17.24), "17.2 %"),
        (moisture(None), UNKNOWN),
    ],
)
def test_a_quantity_reads(text: str, expected: str) -> None:
    assert text == expected


@given(value=st.floats(0.01, 1e6))
def test_a_rounded_number_is_within_half_of_its_third_digit(value: float) -> None:
    shown = float(rounded(value).replace(",", ""))
    assert abs(shown - value) <= max(0.005, min(0.5, 0.006 * value)) * (1.0 + 1e-9)


@given(kg=st.floats(1.0, 1e5), m2=st.floats(1.0, 1e6))
def test_yields_of_both_systems_are_one(kg: float, m2: float) -> None:
    amount = crop_yield_kg_m2(kg, m2)
    assert amount is not None
    bushels, acres = kg / (56 * 0.45359237), m2 / 4046.8564224
    assert CORN.yield_unit.of(amount) == pytest.approx(bushels / acres, rel=1e-12)
    assert METRIC.yield_unit.of(amount) == pytest.approx(kg / 1000 / (m2 / 10_000), rel=1e-12)


@pytest.mark.parametrize(("kg", "m2"), [(None, 1.0), (1.0, None), (1.0, 0.0), (nan, 1.0)])
def test_no_yield_without_mass_or_area(kg: float | None, m2: float | None) -> None:
    assert crop_yield_kg_m2(kg, m2) is None


@pytest.mark.parametrize(
    ("said", "metric", "us"),
    [
        ("weighed 9072 kg, measured 1,840.4 kg", "weighed 9072 kg, measured 1,840.4 kg", "weighed 20,000 lb, measured 4,057 lb"),
        ("9,072 kg (20,000 lb) is a lot", "9,072 kg (20,000 lb) is a lot", "20,000 lb (9,072 kg) is a lot"),
        ("25.3 kg/s", "25.3 kg/s", "3,586 bu/h"),
        ("a gap of +0.4536 kg", "a gap of +0.4536 kg", "a gap of +1.00 lb"),
        ("from 1 to 1e+06 kg", "from 1 to 1e+06 kg", "from 2.20 to 2,204,623 lb"),
        (
            "leaves -454 +- 27 kg of the 1,000 kg",
            "leaves -454 +- 27 kg of the 1,000 kg",
            "leaves -1,001 +- 59.5 lb of the 2,205 lb",
        ),
        ("1.2 +- 0.3 kg/s", "1.2 +- 0.3 kg/s", "170 +- 42.5 bu/h"),
        ("loads 3 to 5, 9072 kg", "loads 3 to 5, 9072 kg", "loads 3 to 5, 20,000 lb"),
        ("720 kg/m3, 9.8 m/s2, load 7, 12kg, 3 kgf", "720 kg/m3, 9.8 m/s2, load 7, 12kg, 3 kgf", None),
    ],
)
def test_what_a_daemon_says_is_shown_in_the_units_chosen(said: str, metric: str, us: str | None) -> None:
    assert METRIC.in_text(said) == metric
    assert CORN.in_text(said) == (said if us is None else us)


def test_a_little_less_than_nothing_has_no_sign() -> None:
    assert [rounded(value) for value in (-0.0, -0.004, -0.04, 0.004)] == ["0.0", "0.0", "-0.04", "0.0"]

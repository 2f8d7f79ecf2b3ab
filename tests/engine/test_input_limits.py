"""Which values of each slow input are used: the limits of what it can be, met exactly and missed by a little."""

from __future__ import annotations

import math

import numpy as np
import pytest

from yieldmon.engine.sources import QUANTITIES

#: Of each quantity the smallest and the largest value that is used, and what lies just beyond; None: it has no limit there.
LIMITS: dict[str, tuple[float | None, float | None]] = {
    "elevator_speed": (0.0, 3000.0), "plate_angle": (0.0, 180.0), "course": (0.0, 360.0), "latitude": (-90.0, 90.0),
    "longitude": (-180.0, 180.0), "ground_speed": (0.0, 300.0), "factory_mass_flow": (0.0, 200.0), "moisture": (0.0, None),
    "grain_temperature": (-50.0, 100.0), "thousand_kernel_weight": (1.0, 2000.0),
    "tank_mass": (None, None), "tank_scale_status": (None, None), "position_group": (None, None), "speed_group": (None, None),
}  # fmt: skip
CODES = {"actuator_state": 4, "header_down": 2, "work_state": 2, "unloading": 2}


def used(name: str, value: float) -> bool:
    alone = bool(QUANTITIES[name].usable(value))
    [in_column] = QUANTITIES[name].usable(np.array([value]))
    assert alone == bool(in_column), "one value and a column of them are judged alike"
    return alone


@pytest.mark.parametrize("name", LIMITS)
def test_a_value_at_its_limit_is_used_and_one_beyond_is_not(name: str) -> None:
    for limit, beyond in zip(LIMITS[name], (-math.inf, math.inf), strict=True):
        if limit is not None:
            assert used(name, limit)
            assert not used(name, math.nextafter(limit, beyond))
            assert used(name, math.nextafter(limit, -beyond))
    assert not used(name, math.nan)


@pytest.mark.parametrize("name", CODES)
def test_the_codes_of_a_state_are_used_and_nothing_between_or_beyond(name: str) -> None:
    assert [used(name, float(code)) for code in range(-1, 6)] == [0 <= code < CODES[name] for code in range(-1, 6)]
    assert not any(used(name, code + 0.5) for code in range(-1, 6))
    assert not used(name, math.nan)


def test_grain_is_wetter_than_nothing_and_drier_than_water() -> None:
    assert used("moisture", math.nextafter(100.0, 0.0))
    assert not used("moisture", 100.0)
    assert used("test_weight", math.nextafter(0.0, 1.0))
    assert not used("test_weight", 0.0)
    assert not used("test_weight", math.nan)


def test_every_quantity_is_looked_at() -> None:
    assert {*LIMITS, *CODES, "test_weight"} == {*QUANTITIES}


@pytest.mark.parametrize("name", QUANTITIES)
def test_what_is_no_finite_number_is_no_value_of_any_quantity(name: str) -> None:
    """Floating-point signals can carry them; one by one and in columns."""
    usable = QUANTITIES[name].usable
    column = np.array([math.inf, -math.inf, math.nan])
    assert not np.any(usable(column))
    assert not any(usable(value) for value in column.tolist())

"""A load's mass by other parameters: where it is known, and what it is then."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.service.test_remeasuring import MACHINE, known, rows
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.effects import get_effect, registry
from yieldmon.service.history.load_factor import load_factor
from yieldmon.service.logs.measured_loads import MeasuredLoad
from yieldmon.service.storage.rows import SecondRow


def load(seconds: list[SecondRow]) -> MeasuredLoad:
    return MeasuredLoad("1", "", tuple(seconds), {1: known()})


def with_effect(name: str) -> ParameterSet:
    own = {f"{name}.{parameter.name}": parameter.typical for parameter in get_effect(name).parameters}
    return replace(known(2), values={**known().values, **own})


MOIST = with_effect("moisture_dependence")


@pytest.mark.parametrize(("unknown", "is_known"), [(0, True), (1, True), (2, False), (3, False), (20, False)])
def test_parameters_that_depend_on_moisture_need_it_over_nine_tenths_of_a_load(unknown: int, is_known: bool) -> None:
    """A corrected crop's parameters may ask for what those that measured did not; on the engine's thread nothing may raise."""
    seconds = [replace(row, moisture_pct=None if i < unknown else 15.0) for i, row in enumerate(rows(1, 0.0, seconds=20))]
    found = load_factor(load(seconds), MOIST, MACHINE)
    assert (found is not None) == is_known
    if found is not None:
        whole = load_factor(load([replace(row, moisture_pct=15.0) for row in seconds]), MOIST, MACHINE)
        assert found == pytest.approx(whole, rel=1e-12), "of the seconds that are known, in mass and in time"


@pytest.mark.parametrize("effect", sorted(registry()))
def test_whatever_is_missing_there_is_a_factor_or_none(effect: str) -> None:
    rng = np.random.default_rng(7)
    parameters = with_effect(effect)
    choices = (None, 0.0, -5.0, 1e-12, 1e6, 15.0)
    factors = []
    for share in (0.3, 0.02, 0.02, 0.02, 0.02, 0.02):
        seconds = []
        for row in rows(1, 0.0):
            odd = {
                name: choices[rng.integers(len(choices))]
                if rng.random() < share
                else 15.0
                if name == "moisture_pct"
                else getattr(row, name)
                for name in ("force_n", "plate_angle_deg", "elevator_speed_rpm", "moisture_pct")
            }
            seconds.append(replace(row, **odd))
        with np.errstate(all="ignore"):
            factors.append(load_factor(load(seconds), parameters, MACHINE))
    known = [factor for factor in factors if factor is not None]
    assert factors[0] is None, "a third of the readings missing"
    assert known, "a few missing"
    assert np.all(np.isfinite(known))
    assert min(known) > 0.0


def test_parameters_of_the_load_itself_give_its_own_mass_and_double_the_density_more() -> None:
    assert load_factor(load(rows(1, 0.0)), known(2), MACHINE) == pytest.approx(1.0, rel=1e-9)
    assert load_factor(load(rows(1, 0.0)), known(2, 1600.0), MACHINE) != pytest.approx(1.0, rel=0.1)
    assert load_factor(load(rows(1, 0.0, version=3)), known(2), MACHINE) is None
    assert load_factor(load([]), known(2), MACHINE) is None

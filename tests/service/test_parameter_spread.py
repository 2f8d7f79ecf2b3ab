"""By how much a load may be off through the parameters that measure it again."""

from __future__ import annotations

from dataclasses import replace
from math import hypot

import numpy as np
import pytest

from tests.service.test_load_factor import load
from tests.service.test_remeasuring import HOUR_S, MACHINE, known, rows, update
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.service.history.load_factor import load_factor
from yieldmon.service.history.parameter_spread import parameter_spread
from yieldmon.service.history.parameter_timeline import timeline
from yieldmon.service.history.remeasuring import remeasured
from yieldmon.service.logs.measured_loads import measured_loads
from yieldmon.service.storage.load_spread import ParameterSpread

WEIGHED = {"scale": "weighed"}


def total(spread: ParameterSpread | None) -> float:
    assert spread is not None
    return hypot(*spread.shared, spread.own)


@pytest.mark.parametrize("seconds", [1, 5, 730])
def test_it_is_what_a_standard_deviation_of_the_parameters_changes(seconds: int) -> None:
    measured, parameters = load(rows(1, 0.0, seconds=seconds)), known(2)
    moved = replace(parameters, values={**parameters.values, "density": parameters.values["density"] + 0.3})
    factor = load_factor(measured, moved, MACHINE)
    assert factor is not None
    assert total(parameter_spread(measured, parameters, MACHINE)) == pytest.approx(100.0 * abs(factor - 1.0), rel=0.01)


@pytest.mark.parametrize(
    ("parameters", "least", "most"),
    [
        (replace(known(2), model_error=0.05), 0.05, 0.09),
        (replace(known(2), provenance={"scale": "not calibrated"}), 0.45, 0.8),
        (replace(known(2), covariance_names=(), covariance=np.zeros((0, 0))), 0.0, 0.0),
    ],
)
def test_it_holds_the_models_own_error_and_that_of_the_scale(parameters: ParameterSet, least: float, most: float) -> None:
    assert least <= total(parameter_spread(load(rows(1, 0.0)), parameters, MACHINE)) <= most


def test_seconds_without_a_force_do_not_count_and_nothing_is_known_of_none() -> None:
    seconds = rows(1, 0.0, seconds=20)
    some = [replace(row, force_n=None if i < 5 else row.force_n) for i, row in enumerate(seconds)]
    assert total(parameter_spread(load(some), known(2), MACHINE)) == pytest.approx(
        total(parameter_spread(load(seconds), known(2), MACHINE))
    )
    assert parameter_spread(load([replace(row, force_n=None) for row in seconds]), known(2), MACHINE) is None


@pytest.mark.parametrize("wandering", [0.0, 0.02])
def test_an_update_leaves_a_load_before_it_the_less_certain_the_more_there_is_between(wandering: float) -> None:
    learnt = replace(known(2, 840.0), covariance=np.array([[4.0]]), provenance=WEIGHED)
    line = timeline([update(4.0, wandering, learnt)], learnt)
    seconds = [row for n in range(5) for row in rows(n + 1, n * HOUR_S)]
    found = remeasured(measured_loads(seconds, {1: known(), 2: learnt}), line, MACHINE)
    spreads = [total(found[n].spread) for n in range(1, 6)]
    if wandering:
        assert spreads[3] > 3.0 * spreads[4], "on the way it may have been elsewhere"
        assert min(spreads[:3]) > spreads[3]
        first = line.covariance_at(0.0)[0, 0]
        # What was known before, 30 kg/m3, and what the way adds leave this of it.
        walk = (0.02 * 800.0) ** 2 * 4.0
        gain = 30.0**2 / (30.0**2 + walk)
        assert first == pytest.approx(30.0**2 + gain**2 * (4.0 - 30.0**2 - walk))
    else:
        assert spreads == pytest.approx([spreads[-1]] * 5, rel=1e-3)


def test_parameters_whose_scale_no_load_has_set_say_nothing_better_than_what_was_measured() -> None:
    learnt = known(2, 840.0)
    line = timeline([update(4.0, 0.0, learnt)], learnt)
    (found,) = remeasured(measured_loads(rows(1, 100.0), {1: known(), 2: learnt}), line, MACHINE).values()
    assert found.spread is None

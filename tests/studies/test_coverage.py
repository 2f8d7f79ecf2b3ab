"""What the coverage study shows of loads under hidden plate friction, by how many machines, and by cause."""

import numpy as np
import pytest

from studies.coverage.__main__ import CASES, Case, Sizes, one, sd_range
from studies.coverage.causes import causes


def test_a_load_before_the_first_sweep_is_covered_as_it_closes_and_once_the_sweep_has_shown_the_error() -> None:
    (sweeps,) = [case for case in CASES if case.name == "sweeps"]
    found = one(sweeps, 130.0, 41999, fixed=True)
    assert abs(found.load[0]) < 2.0, "as it closes, it is stated with what the sweep may show"
    assert abs(found.load_posted[0]) < 2.0


def test_an_error_so_large_that_it_ends_every_sweep_is_seen_when_the_plate_is_home_again() -> None:
    large = Sizes(plate_friction=0.33, sweep_every_s=30.0, swings=False)
    found = one(Case("large", lambda rng: large, large), 130.0, 41999, fixed=True)
    assert abs(found.load_posted[0]) < 2.0


def test_eight_machines_leave_a_quarter_of_a_standard_deviation_open_and_many_do_not() -> None:
    rng = np.random.default_rng(3)

    def runs(machines: int) -> list[np.ndarray]:
        return [shared + rng.normal(0.0, 0.7, 3) for shared in rng.normal(0.0, 0.7, machines)]

    few, many = sd_range(runs(8)), sd_range(runs(200))
    assert few[1] - few[0] > 0.3
    assert many[1] - many[0] < 0.2
    assert many[0] < np.hypot(0.7, 0.7) < many[1]


def test_the_causes_of_an_error_make_the_whole() -> None:
    (ordinary,) = [case for case in CASES if case.name == "ordinary"]
    (stated, errors), *_ = causes(ordinary, 80.0, 41998)
    assert stated[-1] == pytest.approx(float(np.hypot.reduce(stated[:-1])), rel=1e-6)
    assert errors[-1] == pytest.approx(sum(errors[:-1]), abs=1e-9)
    assert 0.1 < stated[0] < 0.8, "noise"
    assert stated[3] < 0.08, "moisture that stands still"

"""When a sweep's update is admitted: not at the end of a physical range, and with the model error that a calibration found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from yieldmon.estimation.admission import allowing_for, refusal, sweep_refusal
from yieldmon.estimation.closed_loop_settings import ClosedLoopSettings
from yieldmon.estimation.parameters import CARRIED, METHOD, POOLED, PUBLISHED, SCALE, WEIGHED, ParameterSet

GIVEN = ParameterSet(
    {"friction": 0.2, "restitution": 0.6, "density": 1100.0, "shape_ratio": 2.0},
    ("friction", "restitution", "density"),
    np.diag([0.04**2, 0.06**2, 110.0**2]),
)


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({}, ()),
        ({"friction": 0.0}, ("friction",)),
        ({"friction": 0.019}, ("friction",)),
        ({"friction": 0.03}, ()),
        ({"density": 752.0}, ("density",)),
        ({"friction": 0.0, "density": 1990.0}, ("friction", "density")),
        ({"restitution": 1.0}, ("restitution",)),
        ({"density": 536.0}, ()),  # Sunflower: far outside what fits search, so nobody's fit ended there.
        ({"shape_ratio": 6.0}, ()),  # Without a variance: held by a person.
    ],
)
def test_sweeps_are_refused_where_a_parameter_lies_at_an_end_of_its_range(
    values: dict[str, float], named: tuple[str, ...]
) -> None:
    sentence = refusal(replace(GIVEN, values={**GIVEN.values, **values}))
    assert bool(sentence) is bool(named)
    assert sentence.startswith(" and ".join(named))


@pytest.mark.parametrize(("found", "refused"), [(0.0, False), (0.019, False), (0.05, True)])
def test_sweeps_are_refused_where_the_calibration_missed_what_it_left_out(found: float, refused: bool) -> None:
    assert ("by 5 %" in refusal(replace(GIVEN, model_error=found))) is refused


@pytest.mark.parametrize(("found", "expected"), [(0.0, 0.01), (0.005, 0.01), (0.05, 0.05)])
def test_the_calibrations_model_error_counts_where_it_is_the_larger(found: float, expected: float) -> None:
    assert allowing_for(ClosedLoopSettings(model_error=0.01), replace(GIVEN, model_error=found)).model_error == expected


@pytest.mark.parametrize(
    ("provenance", "refused"),
    [
        ({METHOD: POOLED}, True),
        ({METHOD: POOLED, SCALE: CARRIED}, True),
        ({METHOD: POOLED, SCALE: WEIGHED}, False),
        ({METHOD: PUBLISHED}, False),
        ({}, False),
    ],
)
def test_sweeps_are_refused_where_only_other_machines_loads_are_known(provenance: dict[str, str], refused: bool) -> None:
    known = replace(GIVEN, provenance=provenance)
    assert ("until a load is weighed" in sweep_refusal(known)) is refused
    assert refusal(known) == "", "kernel noise and drift do not ask for the plate's angle"


def test_sweeps_are_refused_wherever_the_model_is_known_to_be_wrong() -> None:
    wrong = replace(GIVEN, model_error=0.05)
    assert sweep_refusal(wrong) == refusal(wrong) != ""

"""For how long each second of a weighed load stands, and which second stands for none."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.service.test_posting import MACHINE, known, rows
from yieldmon.physics.model import ForwardModel
from yieldmon.service.weighed_loads import force_columns

OF_MOISTURE = ForwardModel(MACHINE, ("moisture_dependence",)).effect_parameters


@pytest.mark.parametrize(("effect_parameters", "stands"), [((), True), (OF_MOISTURE, False)])
def test_a_second_without_moisture_stands_for_no_time_only_where_the_model_needs_the_moisture(
    effect_parameters: tuple[str, ...], stands: bool
) -> None:
    plain = known()
    parameters = replace(plain, values=plain.values | dict.fromkeys(effect_parameters, 0.0))
    seconds = [replace(row, moisture_pct=pct) for row, pct in zip(rows(1, 0.0, seconds=3), (15.0, None, 20.0), strict=True)]
    duration_s = force_columns(seconds, parameters, MACHINE)[0]
    np.testing.assert_allclose(duration_s, [1.0, 1.0 if stands else np.nan, 1.0], rtol=1e-6)


UNKNOWN = [{"force_n": None}, {"force_n": 0.0}, {"plate_angle_deg": None}, {"elevator_speed_rpm": None}]


@pytest.mark.parametrize("unknown", UNKNOWN)
def test_a_second_without_force_angle_or_speed_stands_for_no_time(unknown: dict[str, Any]) -> None:
    first, second = rows(1, 0.0, seconds=2)
    duration_s = force_columns([replace(first, **unknown), second], known(), MACHINE)[0]
    np.testing.assert_allclose(duration_s, [np.nan, 1.0], rtol=1e-6)

"""For how long each second of a weighed load stands, and which second stands for none."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.service.test_posting import MACHINE, known, rows
from yieldmon.files.ticket_file import WeighedTicket
from yieldmon.physics.model import ForwardModel
from yieldmon.service.weighed_loads import force_columns, loads_of, match

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


@pytest.mark.parametrize(("scatter_kg_s", "noise_sd"), [((0.3, 0.4), 0.025), ((0.3, None), 0.015), ((None, None), 0.0)])
def test_the_scatter_of_a_loads_seconds_is_its_own(scatter_kg_s: tuple[float | None, ...], noise_sd: float) -> None:
    """Two seconds of 10 kg each."""
    seconds = [replace(r, noise_std_dev_kg_s=kg_s) for r, kg_s in zip(rows(1, 0.0, seconds=2), scatter_kg_s, strict=True)]
    (load,) = match(loads_of(seconds, {1: known()}), [WeighedTicket("1", "1", 20.0, 0.1, "line 2")], MACHINE)
    assert load.noise_sd == pytest.approx(noise_sd)

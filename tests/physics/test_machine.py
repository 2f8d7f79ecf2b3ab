"""A machine given in other units than its arguments name is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from yieldmon.physics.machine import Machine


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"plate_length_m": 188.7}, "plate_length_m is 188.7, expected a length above 0 m, up to 10 m"),
        ({"paddle_width_m": 0.0}, "paddle_width_m is 0.0, expected a length above 0 m, up to 10 m"),
        ({"plate_pivot_y_m": -160.0}, "plate_pivot_y_m is -160.0, expected m, -10 to 10"),
        ({"plate_pivot_x_m": np.nan}, "plate_pivot_x_m is nan, expected m"),
        ({"paddle_spacings_m": (0.1656, np.nan)}, "paddle_spacings_m is .* expected lengths above 0 m"),
        ({"home_plate_angle_rad": 70.0}, "home_plate_angle_rad is 70.0, expected radians, 0 to pi"),
        ({"max_plate_angle_rad": 90.0}, "max_plate_angle_rad is 90.0, expected radians, 0 to pi"),
        (
            {"nominal_elevator_speed_rad_s": 400.0},
            r"nominal_elevator_speed_rad_s is 400.0, expected rad/s, .* up to 199 \(1900 rpm\)",
        ),
        ({"min_elevator_speed_rad_s": -3.0}, "min_elevator_speed_rad_s is -3.0, expected rad/s, above 0"),
    ],
)
def test_values_in_other_units_are_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Machine(**values)

"""Pulse-shape files: what is shipped, round trips, and what is wrong with a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from yieldmon.errors import InputError
from yieldmon.files import pulse_shape_file
from yieldmon.physics.machine import RPM
from yieldmon.resources import shipped
from yieldmon.service.config import configuration


def document() -> dict:
    return yaml.safe_load(shipped(pulse_shape_file.SHIPPED).read_text(encoding="utf-8"))


def test_the_shipped_range_is_that_of_the_discrete_element_campaign() -> None:
    """Loads of 0.2 to 1.8 kg on paddles that hold 0.5 h_f density w l^2 = 0.5 x 2.9 x 710 x 0.21 x 0.16^2 kg; 40 to 90 deg."""
    law, full_kg = pulse_shape_file.load(), 0.5 * 2.9 * 710.0 * 0.21 * 0.16**2
    assert law.fills == pytest.approx((0.2 / full_kg, 1.8 / full_kg), rel=1e-6)
    assert np.rad2deg(law.plate_angles_rad) == pytest.approx((40.0, 90.0))
    assert np.array(law.elevator_speeds_rad_s) / RPM == pytest.approx((400.0, 500.0))


def test_the_shipped_terms_are_near_what_the_campaign_s_pulses_show() -> None:
    """At home, 0.9 kg: stretch 1.05 to 1.18, tail 3 to 8 ms (docs/internals/waveform.md)."""
    law = pulse_shape_file.load()
    where = law.conditions(np.deg2rad(70.0), 400.0 * RPM, 0.3)
    assert 1.05 < np.exp(law.log_stretch(np.array([0.163]), where)[0]) < 1.18
    assert 0.003 < law.tail_s(np.array([0.163]), where)[0] < 0.008


def test_what_is_saved_is_read_back(tmp_path: Path) -> None:
    law = pulse_shape_file.load()
    pulse_shape_file.save(law, tmp_path / "a.yaml", source="here")
    again = pulse_shape_file.load(tmp_path / "a.yaml")
    assert (again.stretch, again.tail, again.covariance) == (law.stretch, law.tail, law.covariance)
    assert again.fills == law.fills
    assert again.plate_angles_rad == pytest.approx(law.plate_angles_rad)
    assert again.elevator_speeds_rad_s == pytest.approx(law.elevator_speeds_rad_s)


WRONG = [
    ({"log_stretch": []}, "log_stretch: is []; expected a list of 1 to 15 numbers"),
    ({"log_tail": [1.0] * 16}, "expected a list of 1 to 15 numbers"),
    ({"log_tail": ["a"]}, "log_tail[0]: is 'a'; expected a number"),
    ({"covariance": [0.01, 0.01, 0.02]}, "expected [variance, variance, covariance] of ln stretch and ln tail"),
    ({"covariance": [0.01]}, "expected a list of 3 numbers"),
    ({"reference": {"friction": 0.3}}, "expected a mapping with elevator_speed_rpm and friction"),
    ({"calibrated_range": {}}, "expected a mapping with load_share, plate_angle_deg, elevator_speed_rpm"),
    ({"stretch": 1.0}, "stretch: unknown key"),
    ({"calibrated_range": None}, "calibrated_range: missing"),
]


@pytest.mark.parametrize(("change", "said"), WRONG)
def test_a_wrong_file_is_one_line_that_names_key_and_value(tmp_path: Path, change: dict, said: str) -> None:
    content = {key: value for key, value in (document() | change).items() if value is not None}
    path = tmp_path / "shape.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        pulse_shape_file.load(path)
    assert said in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("load_share", [0.3, 0.1], "expected the lowest first"),
        ("load_share", 0.3, "expected [lowest, highest] in 1"),
        ("plate_angle_deg", [40.0, 400.0], "expected a number from 0 to 180 deg"),
    ],
)
def test_a_wrong_range_is_named(tmp_path: Path, key: str, value: object, said: str) -> None:
    content = document()
    content["calibrated_range"][key] = value
    path = tmp_path / "shape.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        pulse_shape_file.load(path)
    assert f"calibrated_range.{key}" in str(caught.value)
    assert said in str(caught.value)


def test_the_configuration_takes_its_own_file_and_else_the_shipped_one(tmp_path: Path) -> None:
    content = document()
    content["calibrated_range"]["load_share"] = [0.1, 0.2]
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    (tmp_path / "c.yaml").write_text("pulse_shape_file: mine.yaml\n", encoding="utf-8")
    (tmp_path / "d.yaml").write_text("{}\n", encoding="utf-8")
    own = configuration.load(tmp_path / "c.yaml").engine.waveform.shape
    usual = configuration.load(tmp_path / "d.yaml").engine.waveform.shape
    assert own is not None
    assert own.fills == (0.1, 0.2)
    assert usual == pulse_shape_file.load()

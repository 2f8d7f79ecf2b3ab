"""Machine files: the shipped ones, the round trip, and one line for each way to get them wrong."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
import yaml

from yieldmon.errors import InputError
from yieldmon.files import machine_file
from yieldmon.physics.machine import Implement, Machine
from yieldmon.resources import shipped


def test_the_default_is_the_production_machine():
    assert machine_file.load() == Machine()


def test_the_ten_tooth_machine_differs_in_its_sprocket_only():
    ten = machine_file.to_document(machine_file.load(shipped("config/machines/sprocket-10.yaml")))
    eight = machine_file.to_document(machine_file.load())
    assert {key for key in ten if ten[key] != eight[key]} == {"name", "sprocket_pitch_radius_m"}
    assert ten["sprocket_pitch_radius_m"] == 0.067


def test_round_trip(tmp_path):
    path = tmp_path / "machine.yaml"
    path.write_text(yaml.safe_dump(machine_file.to_document(Machine())), encoding="utf-8")
    assert machine_file.load(path) == Machine()


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("paddle_length_m", -0.1, "paddle_length_m: is -0.1; expected a number from 0.02 to 1 m"),
        ("paddle_length_m", "long", "paddle_length_m: is 'long'"),
        ("paddle_length_m", True, "paddle_length_m: is True"),
        ("paddle_spacings_m", [], "paddle_spacings_m: is []; expected a list of numbers in m"),
        ("paddle_spacings_m", [0.1, 0], "paddle_spacings_m[1]: is 0"),
        ("home_plate_angle_deg", 95, "home plate angle lies outside"),
        ("sensor", {"gain_n_per_mv": 1}, "sensor: is"),
        ("colour", "green", "colour: unknown key"),
        ("name", 8, "name: is 8; expected a text"),
    ],
)
def test_bad_values_are_named(tmp_path, key, value, expected):
    document = machine_file.to_document(Machine()) | {key: value}
    path = tmp_path / "machine.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        machine_file.load(path)
    assert expected in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(("text", "problem"), [("", "is empty"), ("# later\n", "is empty"), ("[1]", "holds list at the top")])
def test_a_file_that_is_no_mapping_says_what_it_is(tmp_path, text, problem):
    path = tmp_path / "machine.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        machine_file.load(path)
    assert str(caught.value) == f"{path}: {problem}; expected a mapping of keys to values"


def test_a_missing_key_is_named(tmp_path):
    document = machine_file.to_document(Machine())
    del document["plate_length_m"]
    path = tmp_path / "machine.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    with pytest.raises(InputError, match="plate_length_m: missing"):
        machine_file.load(path)


def test_what_a_task_controller_gets_makes_the_round_trip(tmp_path):
    machine = replace(Machine(), implement=Implement(working_width_m=9.1, connector_type=2, grain_delay_s=12.0))
    path = tmp_path / "machine.yaml"
    path.write_text(yaml.safe_dump(machine_file.to_document(machine)), encoding="utf-8")
    assert machine_file.load(path) == machine


@pytest.mark.parametrize(
    ("implement", "expected"),
    [
        (5, "implement: is 5; expected a mapping with any of working_width_m"),
        ({"width": 9}, "implement.width: unknown key; expected one of working_width_m"),
        ({"working_width_m": 0}, "implement.working_width_m: is 0; expected a number from 0.1 to 30 m"),
        ({"connector_type": 1.5}, "implement.connector_type: is 1.5; expected a whole number"),
    ],
)
def test_wrong_implements(tmp_path, implement, expected):
    path = tmp_path / "machine.yaml"
    path.write_text(yaml.safe_dump(machine_file.to_document(Machine()) | {"implement": implement}), encoding="utf-8")
    with pytest.raises(InputError, match=re.escape(expected)):
        machine_file.load(path)

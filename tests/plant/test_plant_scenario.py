"""Scenario files: the shipped ones load, wrong ones get one line."""

from __future__ import annotations

import pytest

from yieldmon.errors import InputError
from yieldmon.plant import scenario as scenarios
from yieldmon.plant.scenario import from_mapping
from yieldmon.resources import shipped

SHIPPED = sorted(path.name for path in shipped("config/scenarios").glob("*.yaml"))


def test_the_named_scenarios_are_shipped():
    assert {"demo.yaml", "steady.yaml", "harvest-day.yaml", "sweep.yaml"} <= set(SHIPPED)


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_scenarios_load(name):
    assert scenarios.load(shipped(f"config/scenarios/{name}")).duration_s >= 120.0


def test_an_empty_file_is_the_default(tmp_path):
    path = tmp_path / "empty.yaml"
    path.write_text("# nothing\n")
    assert scenarios.load(path) == scenarios.Scenario()


@pytest.mark.parametrize("switch", [True, "on", {}])
def test_an_effect_is_switched_on(switch):
    assert from_mapping({"effects": {"air_drag": switch}}, "x").effects.air_drag.terminal_speed_m_s == 11.0


@pytest.mark.parametrize("switch", [False, "off", None])
def test_gravity_is_on_unless_switched_off(switch):
    assert from_mapping({}, "x").effects.gravity is not None
    assert from_mapping({"effects": {"gravity": switch}}, "x").effects.gravity is None


STEADY = {"kind": "steady", "duration_s": 5, "flow_kg_s": 3}


@pytest.mark.parametrize(
    ("values", "parts"),
    [
        ({"duraton_s": 5}, ["duraton_s", "not a key"]),
        ({"duration_s": "long"}, ["duration_s", "'long'", "number"]),
        ({"duration_s": -1}, ["duration_s", "-1", "greater than or equal to 1"]),
        ({"duration_s": float("nan")}, ["duration_s", "finite"]),
        ({"crop": {"friction": 1.5}}, ["crop.friction", "1.5", "less than or equal to 1"]),
        ({"effects": {"ari_drag": "on"}}, ["effects.ari_drag", "not a key"]),
        ({"effects": {"air_drag": {"terminal_speed_m_s": 0}}}, ["effects.air_drag.terminal_speed_m_s", "0"]),
        ({"effects": {"air_drag": "yes"}}, ["effects.air_drag", "'yes'"]),
        ({"flow": {"pieces": []}}, ["flow.pieces"]),
        ({"flow": {"pieces": [{"kind": "burst"}]}}, ["flow.pieces.0", "steady"]),
        ({"flow": {"pieces": [STEADY | {"flow_kg_s": 44}]}}, ["flow.pieces.0", "flow_kg_s", "44", "30"]),
        ({"flow": {"pieces": [{"kind": "steady", "duration_s": 5}]}}, ["flow_kg_s", "missing"]),
        ({"elevator": {"speed_rpm": 900}}, ["elevator.speed_rpm", "900", "599"]),
        ({"faults": {"actuator": [{"kind": "stuck", "start_s": 5, "end_s": 4}]}}, ["faults.actuator.0", "not after"]),
        ({"faults": {"sensor": [{"kind": "wet", "start_s": 1, "end_s": 4}]}}, ["faults.sensor.0.kind", "'wet'"]),
        (["a", "list"], ["not a mapping"]),
    ],
)
def test_a_wrong_key_gets_one_line_with_file_key_value_and_expected(values, parts):
    with pytest.raises(InputError) as caught:
        from_mapping(values, "my.yaml")
    text = str(caught.value)
    assert text.startswith("my.yaml")
    assert "\n" not in text
    for part in parts:
        assert part in text


@pytest.mark.parametrize("content", [b"flow: [1, 2", b"\xff\xfe\x00", b"a: 1\na: 2\n"])
def test_an_unreadable_file_is_named(tmp_path, content):
    path = tmp_path / "bad.yaml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"bad\.yaml"):
        scenarios.load(path)

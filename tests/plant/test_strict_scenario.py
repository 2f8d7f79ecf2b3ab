"""A scenario's numbers are numbers: true, a text or a list in the place of any of them is refused with its key."""

from __future__ import annotations

from collections.abc import Iterator
from copy import deepcopy
from typing import Any

import pytest

from yieldmon.errors import InputError
from yieldmon.files import strict_yaml
from yieldmon.plant import scenario
from yieldmon.plant.scenario import Scenario
from yieldmon.resources import shipped

_WHOLE = {
    **Scenario().model_dump(mode="json"),
    "kernels": {"contact_ms": 0.2},
    "faults": {
        "actuator": [{"kind": "stuck", "start_s": 1.0, "end_s": 2.0}],
        "sensor": [{"kind": "stuck", "start_s": 1.0, "end_s": 2.0}],
        "messages": [{"message": "tank_scale", "start_s": 1.0, "end_s": 2.0}],
    },
}


def _numbers(node: Any, way: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    if isinstance(node, dict | list):
        for key, value in node.items() if isinstance(node, dict) else enumerate(node):
            yield from _numbers(value, (*way, key))
    elif isinstance(node, int | float) and not isinstance(node, bool):
        yield way


def _with(way: tuple[Any, ...], value: Any) -> dict[str, Any]:
    document: Any = deepcopy(_WHOLE)
    node = document
    for key in way[:-1]:
        node = node[key]
    node[way[-1]] = value
    return document


def test_the_whole_is_a_scenario():
    assert scenario.from_mapping(_WHOLE, "s.yaml").faults.messages[0].message == "tank_scale"
    assert len(list(_numbers(_WHOLE))) > 40


@pytest.mark.parametrize("value", [True, "5", [1.0]], ids=["true", "text", "list"])
def test_what_is_no_number_is_refused(value):
    for way in _numbers(_WHOLE):
        with pytest.raises(InputError, match=r"^s\.yaml: "):
            scenario.from_mapping(_with(way, value), "s.yaml")


def test_a_number_is_no_switch():
    with pytest.raises(InputError, match=r"^s\.yaml: frames\.position: is 1; expected a valid boolean$"):
        scenario.from_mapping(_with(("frames", "position"), 1), "s.yaml")


@pytest.mark.parametrize("path", sorted(shipped("config/scenarios").iterdir()), ids=lambda path: path.stem)
def test_shipped_scenarios_are_read(path):
    assert scenario.from_mapping(strict_yaml.load(path), path.name).duration_s >= 1.0

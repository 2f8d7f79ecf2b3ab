"""Every key of the configuration, of its mappings and of the files that it names, each with values that it must not have.

The keys and what they may hold come from the schema, so a key that is added is tried as well.
"""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from yieldmon.errors import InputError
from yieldmon.files import flow_curve_file, machine_file, moisture_file, parameter_file, pulse_shape_file, strict_yaml
from yieldmon.resources import shipped
from yieldmon.service.config import configuration
from yieldmon.service.config.configuration import ConfigurationError
from yieldmon.service.config.document import Document
from yieldmon.service.config.output_section import OutputEntry
from yieldmon.service.config.signal_section import NodeName, SignalEntry

HOSTILE = (
    None, True, False, 0, 1, -1, 0.5, -0.0, 10**10, 10**18, 1e308, -1e308, 5e-324, float("nan"), float("inf"), -float("inf"),
    "", "a\n", "1", "yes", "null", "a\x07b", "\u202e", "\U0001f33d", "x" * 5000, [], [0], ["a"], [None], [[[[1]]]], [1] * 1000,
    {}, {"a": 1}, {1: 2}, {"a": {"a": {}}}, {"x" * 5000: 1},
)  # fmt: skip
#: Where a try costs more: one of each kind.
FEWER = (None, True, -1, 10**18, 1e308, float("nan"), float("inf"), "", "a\x07b", "x" * 3000, [], [[[[1]]]], {}, {"a": 1})
LONGEST_LINE = 2500


def is_valid(value: Any, schema: dict[str, Any]) -> bool:  # noqa: PLR0911 - a return a kind
    """Whether a value is what a schema says, with no conversion: JSON Schema in so far as the configuration uses it."""
    if "anyOf" in schema:
        return any(is_valid(value, one) for one in schema["anyOf"])
    if "enum" in schema or "const" in schema:
        return type(value) is str and value in schema.get("enum", [schema.get("const")])
    kinds: dict[str, Any] = {
        "boolean": bool, "integer": int, "number": (int, float), "string": str, "array": list, "object": dict,
    }  # fmt: skip
    if "type" not in schema or schema["type"] == "null":
        return "type" not in schema or value is None
    if not isinstance(value, kinds[schema["type"]]) or (schema["type"] != "boolean" and isinstance(value, bool)):
        return False
    if schema["type"] in ("integer", "number"):
        low, high = schema.get("minimum", -1.8e308), schema.get("maximum", 1.8e308)
        return low <= value <= high and abs(value) < float("inf")
    if schema["type"] == "string":
        pattern = schema.get("pattern", "").replace("$", r"\Z")
        return len(value) <= schema.get("maxLength", len(value)) and bool(re.search(pattern, value))
    if schema["type"] == "array":
        fits = schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", len(value))
        return fits and all(is_valid(item, schema["items"]) for item in value)
    if schema["type"] == "boolean":
        return True
    others = schema.get("additionalProperties", False)
    return others is True or all(isinstance(key, str) and is_valid(item, others) for key, item in value.items())


def keys() -> Iterator[tuple[str, str, dict[str, Any]]]:
    """(section, key, what it may hold); section "": a key at the top."""
    whole = Document.model_json_schema()
    for section, described in whole["properties"].items():
        if "$ref" in described:
            inner = whole["$defs"][described["$ref"].rpartition("/")[2]]
            yield from ((section, key, schema) for key, schema in inner["properties"].items())
        else:
            yield "", section, described


def line_of(error: InputError) -> str:
    """An error's text, which is one line of bounded length that shows no bare control character."""
    text = str(error)
    assert text.isprintable()
    assert len(text) < LONGEST_LINE
    return text


KEYS = tuple(keys())
SECTIONS = {section: [(key, schema) for other, key, schema in KEYS if other == section] for section, *_ in KEYS}


@pytest.mark.parametrize("section", SECTIONS)
def test_keys_take_what_their_schema_says_and_refuse_the_rest_by_name(tmp_path, section):
    for key, schema in SECTIONS[section]:
        attack(tmp_path / "c.yaml", section, key, schema)


def attack(path: Path, section: str, key: str, schema: dict[str, Any]) -> None:
    """Loads the configuration with each hostile value under a key."""
    refused = 0
    for value in HOSTILE:
        content = {section: {key: value}} if section else {key: value}
        try:
            loaded = configuration.build(content, path, {"STATE_DIRECTORY": str(path.parent)})
        except ConfigurationError as error:
            assert all(f"{path}: {section or key}" in line_of(p) for p in error.problems)  # noqa: PT017 - one of three outcomes
            refused += 1
        except InputError as error:
            # What the key names is read: a file that is not there, a quantity that does not exist.
            assert is_valid(value, schema), value
            line_of(error)
            refused += 1
        else:
            assert is_valid(value, schema), value
            holder = getattr(loaded.document, section) if section else loaded.document
            assert getattr(holder, key) == value
    assert refused > len(HOSTILE) // 3


STRUCTURE = {
    "twice": "{key}: 1\n{key}: 1\n",
    "anchor": "{key}: &a 1\n",
    "alias": "{key}: *a\n",
    "tag": "{key}: !!python/name:os.system\n",
    "merge": "{key}: 1\n<<: {{a: 1}}\n",
    "tab": "{key}:\n\t- 1\n",
    "open": "{key}: [1, {{\n",
    "second document": "{key}: 1\n---\n{key}: 2\n",
    "digits": "{key}: " + "9" * 5000 + "\n",
    "deep": "{key}: " + "[" * 30 + "]" * 30 + "\n",
    "null byte": "{key}: a\0b\n",
    "half a surrogate": '{key}: "\\ud800"\n',
}


@pytest.mark.parametrize("fault", STRUCTURE)
def test_what_is_not_plain_yaml_is_refused_in_any_section_with_its_line(tmp_path, fault):
    path = tmp_path / "c.yaml"
    seen: set[str] = set()
    for section, key, _ in KEYS:
        if section in seen:
            continue
        seen.add(section)
        text = STRUCTURE[fault].format(key=key)
        lines = [f"  {line}" if section else line for line in text.splitlines()]
        path.write_text("\n".join([f"{section}:", *lines] if section else lines) + "\n", encoding="utf-8")
        with pytest.raises(InputError, match=re.escape(str(path))) as raised:
            configuration.load(path, {})
        line_of(raised.value)


ENTRIES = [("signals.impact_force", SignalEntry), ("outputs.signals.mass_flow", OutputEntry)]


@pytest.mark.parametrize(("place", "model"), ENTRIES, ids=[place for place, _ in ENTRIES])
def test_a_key_of_a_mapping_gives_one_line(tmp_path, place, model):
    """None of these names a signal that exists, so each is refused, by its place or that of the DBC."""
    path = tmp_path / "c.yaml"
    entries = [{key: value} for key in model.model_fields for value in FEWER]
    named = {"message": "M", "signal": "S"}
    entries += [{**named, "source": {key: value}} for key in NodeName.model_fields for value in FEWER]
    for entry in entries:
        content: Any = {**named, **entry}
        for part in reversed(place.split(".")):
            content = {part: content}
        with pytest.raises(InputError, match=re.escape(str(tmp_path))) as raised:
            configuration.build(content, path, {})
        line_of(raised.value)


MOISTURE = "moisture_pct: [14, 20]\nvalues: {friction: [0.2, 0.3]}\ndoubt: 0.5\n"
CURVE = (
    "format: 1\nestimator: table\nelevator_speed_rpm: 400\nrelative_std_dev: 0.05\ncalibrated_range: {mass_flow_kg_s: [1, 9]}\n"
    "columns: [{plate_angle_deg: 70, force_n: [4, 40], mass_flow_kg_s: [1, 9]}]\nprovenance: {date: '2026-01-01'}\n"
)
IMPLEMENT = {"working_width_m": 9.1, "header_offset_m": 3.2, "connector_type": 0, "grain_delay_s": 12}
FILES = {
    "machine": (machine_file.load, shipped("config/machines/sprocket-8.yaml").read_text(), {"implement": IMPLEMENT}),
    "parameters": (parameter_file.load, shipped("config/parameters/corn.yaml").read_text(), {"model_error": 0.1}),
    "moisture": (moisture_file.load, MOISTURE, {}),
    "pulse shape": (pulse_shape_file.load, shipped("config/pulse-shape.yaml").read_text(), {}),
    "curve": (flow_curve_file.load, CURVE, {}),
}
#: Words for people, of which any will do.
FREE = ("provenance", "source")


def written(content: Any) -> str:
    """As YAML in the manner of JSON, which is quick to write and to read."""
    return re.sub(r"\bNaN\b", ".nan", json.dumps(content)).replace("Infinity", ".inf") + "\n"


def leaves(content: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """Each place in a document and what is there; of a list the first and the last item."""
    yield place, content
    if isinstance(content, dict):
        for key, value in content.items():
            yield from leaves(value, (*place, key))
    elif isinstance(content, list) and content:
        for number in sorted({0, len(content) - 1}):
            yield from leaves(content[number], (*place, number))


def with_value(content: Any, place: tuple[Any, ...], value: Any) -> Any:
    """The document with another value there."""
    changed = copy.deepcopy(content)
    holder = changed
    for part in place[:-1]:
        holder = holder[part]
    holder[place[-1]] = value
    return changed


@pytest.mark.parametrize("kind", FILES)
def test_a_number_in_any_file_is_a_number_in_its_range(tmp_path, kind):
    load, text, more = FILES[kind]
    path = tmp_path / "f.yaml"
    content = {**strict_yaml.parse(text, "f"), **more}
    path.write_text(written(content), encoding="utf-8")
    load(path)
    tried = 0
    for place, value in leaves(content):
        if not place or place[0] in FREE:
            continue
        for hostile in FEWER:
            path.write_text(written(with_value(content, place, hostile)), encoding="utf-8")
            try:
                load(path)
            except InputError as error:
                assert str(path) in line_of(error)  # noqa: PT017 - one of two outcomes
                continue
            is_number = type(hostile) in (int, float) and abs(hostile) < 1e300
            assert not isinstance(value, int | float) or is_number or hostile is None, (place, hostile)
            assert not isinstance(value, dict | list) or hostile is None or type(hostile) is type(value), (place, hostile)
            assert not isinstance(value, str) or isinstance(hostile, str), (place, hostile)
        tried += 1
    assert tried > 3


NONSENSE = [
    ("parameters", ("effects", "gravity", "acceleration_m_s2"), 99.0, "effects.gravity.acceleration_m_s2: is 99; expected"),
    ("parameters", ("calibrated_range", "elevator_speed_rpm", 0), -1.0, "calibrated_range.elevator_speed_rpm: is -1.0"),
    ("parameters", ("format",), True, "format: is True; expected 1"),
    ("parameters", ("effects",), 0, "effects: is 0; expected a mapping"),
    ("curve", ("format",), True, "format: is True; expected 1"),
    ("curve", ("calibrated_range",), [], "calibrated_range: is []; expected a mapping"),
    ("machine", ("name",), "", "name: is ''; expected a text of 1 to 200 printable characters"),
    ("machine", ("name",), "a\x07b", r"name: is 'a\x07b'; expected a text of 1 to 200 printable characters"),
]


@pytest.mark.parametrize(("kind", "place", "value", "line"), NONSENSE)
def test_nonsense_of_the_right_type_is_refused(tmp_path, kind, place, value, line):
    load, text, _ = FILES[kind]
    path = tmp_path / "f.yaml"
    path.write_text(written(with_value(strict_yaml.parse(text, "f"), place, value)), encoding="utf-8")
    with pytest.raises(InputError, match=re.escape(f"{path}: {line}")):
        load(path)


def test_a_correlation_beyond_one_is_refused(tmp_path):
    text = shipped("config/parameters/corn.yaml").read_text()
    path = Path(tmp_path / "f.yaml")
    content = strict_yaml.parse(text, "f")
    for place in ((0, 1), (1, 0)):
        content = with_value(content, ("covariance", "matrix", *place), 0.3)
    path.write_text(written(content), encoding="utf-8")
    with pytest.raises(InputError, match=r"covariance\.matrix: friction and density: 0\.3 with .* a correlation from -1 to 1"):
        parameter_file.load(path)

"""Whether a JSON document is what a published schema says; of JSON Schema as much as those schemas use."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

SCHEMAS = Path(__file__).resolve().parents[1] / "docs" / "reference" / "schemas"
_KINDS = {
    "object": dict, "array": list, "string": str, "boolean": bool, "integer": int, "number": (int, float), "null": type(None),
}  # fmt: skip


def problems(document: Any, name: str) -> list[str]:
    """Where a document departs from docs/reference/schemas/NAME.json."""
    schema = json.loads((SCHEMAS / f"{name}.json").read_text(encoding="utf-8"))
    return list(_problems(document, schema, schema, "document"))


def _is(value: Any, kind: str) -> bool:
    return isinstance(value, _KINDS[kind]) and (kind == "boolean" or not isinstance(value, bool))


def _problems(value: Any, schema: dict[str, Any], whole: dict[str, Any], place: str) -> Iterator[str]:
    unknown = set(schema) - {
        "$ref", "$defs", "$schema", "type", "description", "properties", "required", "additionalProperties", "items", "anyOf",
        "enum",
    }  # fmt: skip
    assert not unknown, f"the check does not know {unknown}"
    if "$ref" in schema:
        yield from _problems(value, whole["$defs"][schema["$ref"].removeprefix("#/$defs/")], whole, place)
    if "enum" in schema and value not in schema["enum"]:
        yield f"{place} is {value!r}, not one of {schema['enum']}"
    if "anyOf" in schema and all(list(_problems(value, one, whole, place)) for one in schema["anyOf"]):
        yield f"{place} is {value!r}, none of what is allowed"
    kinds = schema.get("type", [])
    kinds = [kinds] if isinstance(kinds, str) else kinds
    if kinds and not any(_is(value, kind) for kind in kinds):
        yield f"{place} is {value!r}, not {' or '.join(kinds)}"
    elif isinstance(value, list) and "items" in schema:
        for number, one in enumerate(value):
            yield from _problems(one, schema["items"], whole, f"{place}[{number}]")
    elif isinstance(value, dict):
        yield from _keys(value, schema, whole, place)


def _keys(value: dict[str, Any], schema: dict[str, Any], whole: dict[str, Any], place: str) -> Iterator[str]:
    known, others = schema.get("properties", {}), schema.get("additionalProperties", {})
    yield from (f"{place} has no {key}" for key in schema.get("required", []) if key not in value)
    for key, inner in value.items():
        if key in known or others is not False:
            yield from _problems(inner, known.get(key, others), whole, f"{place}.{key}")
        else:
            yield f"{place} has {key}, which the schema does not name"

"""Table of the configuration's keys, from the configuration's own types."""

from __future__ import annotations

from typing import Any

from pydantic.fields import FieldInfo

from yieldmon.service.config.document import Document
from yieldmon.service.config.section import Section

_HEAD = ["|key|default|range|meaning|", "|---|---|---|---|"]


def markdown() -> str:
    """A table of the keys outside sections, then one for each section."""
    single, sections = [], []
    for name, field in Document.model_fields.items():
        value = getattr(Document(), name)
        if isinstance(value, Section):
            about = (type(value).__doc__ or name).strip().splitlines()[0]
            rows = [_row(key, getattr(value, key), inner) for key, inner in type(value).model_fields.items()]
            sections += ["", f"## {name}", "", about, "", *_HEAD, *rows]
        else:
            single.append(_row(name, value, field))
    return "\n".join([*_HEAD, *single, *sections])


def _row(key: str, default: Any, field: FieldInfo) -> str:
    extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
    limits = {name: getattr(item, name) for item in field.metadata for name in ("ge", "le") if hasattr(item, name)}
    extent = f"{limits['ge']:.12g} to {limits['le']:.12g}" if {"ge", "le"} <= limits.keys() else ""
    unit = str(extra.get("unit", ""))
    shown = f"{extent} {unit if unit != '1' else ''}".strip()
    meaning = (field.description or "").replace("|", "\\|")
    return f"|`{key}`|{_value(default)}|{shown}|{meaning}|"


def _value(value: Any) -> str:
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.12g}"
    if isinstance(value, list | tuple):
        return ", ".join(_value(each) for each in value) or "none"
    return "none" if value == {} else str(value)

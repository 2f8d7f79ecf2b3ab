"""The configuration in words: its keys with their meaning, and a line for each key that is wrong."""

from __future__ import annotations

import difflib
import types
from typing import Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from yieldmon.errors import InputError
from yieldmon.files import machine_file, parameter_file
from yieldmon.files.yaml_slips import of_a_number
from yieldmon.service.config.document import Document
from yieldmon.service.config.section import Section


def commented_defaults() -> str:
    """The default configuration as YAML, with the meaning, range and unit of every key."""
    lines = [
        "# Configuration of yieldmon, with its defaults. All keys are optional; file names are relative to this file.",
        "# Check changes with `yieldmon check-config FILE`, apply them to the running service with `systemctl reload yieldmon`.",
        "",
    ]
    for name, field in Document.model_fields.items():
        value = getattr(Document(), name)
        if isinstance(value, Section):
            lines += ["", f"# {_first_line(type(value))}", f"{name}:"]
            for key, inner in type(value).model_fields.items():
                lines += [f"  # {_meaning(inner)}", f"  {key}: {_yaml(getattr(value, key))}"]
        else:
            lines += [f"# {_meaning(field)}", f"{name}: {_yaml(value)}"]
    return "\n".join(lines) + "\n"


def problems_of(error: ValidationError, path: str) -> list[InputError]:
    """A line for each key that is wrong; a union that fails in several ways counts once."""
    problems: dict[str, InputError] = {}
    for detail in error.errors(include_url=False):
        keys, model, field = _place(detail["loc"])
        place = "".join(f"[{k}]" if isinstance(k, int) else f".{k}" for k in keys).lstrip(".")
        where = f"{path}: {place}" if place else path
        if detail["type"] == "extra_forbidden":
            problems.setdefault(where, InputError(where, "unknown key", _instead_of(str(keys[-1]), model)))
        else:
            expected = _expected(model, field)
            if field is None and isinstance(detail["input"], str):
                expected = "lines of key: value, with a space after the colon"
            if detail["type"] == "string_type" and isinstance(detail["input"], int | float):
                expected += " (a number in quotes)"
            elif field is not None and {int, float} & set(_kinds(field.annotation)):
                expected += of_a_number(detail["input"])
            problems.setdefault(where, InputError(where, _shown(detail["input"]), expected))
    return list(problems.values())


def _instead_of(key: str, model: type[BaseModel]) -> str:
    """What was expected in the place of a key that the section `model` does not have."""
    plain = "".join(c for c in key if c.isascii() and c.isprintable()).strip()
    if plain in model.model_fields:
        return f"{plain}, in plain letters (it has characters that look alike or are invisible)"
    near = difflib.get_close_matches(key, list(model.model_fields), n=1)
    if near:
        return near[0]
    sections = {name: field.annotation for name, field in Document.model_fields.items()}
    elsewhere = [name for name, kind in sections.items() if isinstance(kind, type) and key in getattr(kind, "model_fields", {})]
    if key in sections:
        return f"{key} at the left margin, outside of any section"
    for kind, keys in (("machine", machine_file.KEYS), ("parameter", parameter_file.KEYS)):
        if key in keys:
            return f"it in the {kind} file, which {kind}_file names"
    if elsewhere:
        return " or ".join(f"{name}.{key}" for name in elsewhere) + f": the line `{elsewhere[0]}:` above it, and spaces before it"
    return "one of " + ", ".join(model.model_fields)


def _place(location: tuple[int | str, ...]) -> tuple[list[int | str], type[BaseModel], FieldInfo | None]:
    """The keys of an error's place, the section it lies in, and the key's description (None: the section itself)."""
    model: type[BaseModel] = Document
    field: FieldInfo | None = None
    keys: list[int | str] = []
    for part in location:
        if field is not None and not isinstance(part, int) and _origin(field.annotation) is not dict:
            break  # pydantic names the member of a union here
        keys.append(part)
        if field is not None:
            if not isinstance(part, int):
                break
            continue
        found = model.model_fields.get(str(part))
        if found is None:
            break
        if isinstance(found.annotation, type) and issubclass(found.annotation, BaseModel):
            model = found.annotation
        else:
            field = found
    return keys, model, field


def _origin(annotation: Any) -> Any:
    return get_origin(annotation) or annotation


def _kinds(annotation: Any) -> tuple[Any, ...]:
    return get_args(annotation) if get_origin(annotation) in (Union, types.UnionType) else (annotation,)


def _limits(field: FieldInfo) -> tuple[Any, Any]:
    low = next((m.ge for m in field.metadata if hasattr(m, "ge")), None)
    high = next((m.le for m in field.metadata if hasattr(m, "le")), None)
    return low, high


def _unit(field: FieldInfo) -> str:
    extra = field.json_schema_extra
    unit = extra.get("unit", "") if isinstance(extra, dict) else ""
    return "" if unit in ("", "1") else f" {unit}"


def _expected(model: type[BaseModel], field: FieldInfo | None) -> str:
    if field is None:
        return "keys " + ", ".join(model.model_fields)
    return " or ".join(_kind(kind, field) for kind in _kinds(field.annotation))


def _kind(kind: Any, field: FieldInfo) -> str:
    if kind in (int, float):
        low, high = _limits(field)
        span = "" if low is None else f" from {low:.10g} to {high:.10g}"
        return f"a {'whole ' if kind is int else ''}number{span}{_unit(field)}"
    if get_origin(kind) is Literal:
        return "one of " + ", ".join(get_args(kind))
    if _origin(kind) is list:
        return "a list of words" if str in get_args(kind) else f"a list of numbers, {_unit(field).strip()}"
    words = {bool: "true or false", str: "a word", types.NoneType: "null", dict: "keys with plain values"}
    return words[_origin(kind)]


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _first_line(model: type[BaseModel]) -> str:
    return (model.__doc__ or "").splitlines()[0]


def _meaning(field: FieldInfo) -> str:
    low, high = _limits(field)
    span = f"{low:.10g} to {high:.10g}{_unit(field)}" if low is not None else _unit(field).strip()
    return f"{field.description} [{span}]" if span else str(field.description)


def _yaml(value: Any) -> str:
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, list):
        return "[" + ", ".join(_yaml(item) for item in value) + "]"
    if isinstance(value, float):
        return f"{value:.10g}"
    return "{}" if value == {} else str(value)

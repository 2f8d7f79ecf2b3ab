"""What all sections of the configuration file share: strict types, and keys with range, unit and meaning.

A key's unit is in its name; `quantity` repeats it for messages and for the comments of the shipped file.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Annotated, Any, get_origin, get_type_hints

from pydantic import Field

from yieldmon.setting_keys import Key
from yieldmon.strict_model import StrictModel


def quantity(default: Any, low: float, high: float, unit: str, meaning: str) -> Any:
    """A number from `low` to `high`."""
    return Field(default, ge=low, le=high, description=meaning, json_schema_extra={"unit": unit})


def text(default: str | None, meaning: str, max_length: int = 200) -> Any:
    """A word or path."""
    return Field(default, max_length=max_length, pattern=r"^[^\x00-\x1f]*$", description=meaning)


def choice(default: Any, meaning: str) -> Any:
    """True or false, or one of a few words."""
    return Field(default, description=meaning)


def keys_of(settings: Any) -> dict[str, Any]:
    """The keys that an object of settings declares: their types and descriptions by name."""
    kinds = get_type_hints(type(settings))
    declared = {each.name: Key.of(each.metadata) for each in dataclasses.fields(settings)}
    return {name: _as_yaml(kinds[name], getattr(settings, name), key) for name, key in declared.items() if key is not None}


def _as_yaml(kind: Any, default: Any, key: Key) -> tuple[Any, Any]:
    """Type and description of a key. YAML has lists and mappings of plain values alone."""
    about: dict[str, Any] = {"description": key.meaning}
    if key.unit:
        about["json_schema_extra"] = {"unit": key.unit}
    if get_origin(kind) is tuple:
        return list[float], Field(list(default), min_length=1, max_length=key.most, **about)
    if get_origin(kind) is Mapping:
        return dict[str, Annotated[float, Field(ge=key.low, le=key.high)]], Field(default_factory=dict, **about)
    return kind, Field(default, ge=key.low, le=key.high, **about)


class Section(StrictModel):
    """Common rules: no unknown keys, no silent conversion, no infinities."""

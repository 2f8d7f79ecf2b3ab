"""Checks that the readers of YAML documents share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from yieldmon.errors import InputError

from . import strict_yaml


def load_mapping(path: str | Path) -> dict[str, Any]:
    """The mapping in a YAML file. Raises InputError as strict_yaml.load, and where the top is not a mapping."""
    document = strict_yaml.load(path)
    if not isinstance(document, dict):
        problem = "is empty" if document is None else f"holds {type(document).__name__} at the top"
        raise InputError(str(path), problem, "a mapping of keys to values")
    return document


def number(value: Any, where: str, unit: str, low: float, high: float) -> float:
    """A finite number within [low, high]. Raises InputError with the place, the value, unit and range."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise InputError(where, f"is {value!r}", f"a number from {low:g} to {high:g} {unit}".rstrip())
    return float(value)

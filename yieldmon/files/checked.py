"""Checks that the readers of YAML documents share."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

from yieldmon.errors import InputError

from . import strict_yaml

_log = logging.getLogger(__name__)


def load_mapping(path: str | Path) -> dict[str, Any]:
    """The mapping in a YAML file. Raises InputError as strict_yaml.load, and where the top is not a mapping.

    Warns of a last line without its end: that of a file that was cut off may still be a number, and another one.
    """
    text = strict_yaml.read(path)
    document = strict_yaml.parse(text, str(path))
    if text and not text.endswith("\n"):
        _log.warning("%s: its last line has no end; a file that was cut off ends like that", path)
    if not isinstance(document, dict):
        problem = "is empty" if document is None else f"holds {type(document).__name__} at the top"
        raise InputError(str(path), problem, "a mapping of keys to values")
    return document


def number(value: Any, where: str, unit: str, low: float, high: float) -> float:
    """A finite number within [low, high]. Raises InputError with the place, the value, unit and range."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise InputError(where, f"is {value!r}", f"a number from {low:g} to {high:g} {unit}".rstrip())
    return float(value)

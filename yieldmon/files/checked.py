"""Checks that the readers of YAML documents share."""

from __future__ import annotations

import difflib
import logging
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from yieldmon.errors import InputError

from . import strict_yaml
from .yaml_slips import of_a_number

_log = logging.getLogger(__name__)
_LONGEST_NAME = 200


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
        expected = f"a number from {low:g} to {high:g} {unit}".rstrip() + of_a_number(value)
        raise InputError(where, f"is {value!r}", expected)
    return float(value)


def numbers(
    value: Any, where: str, unit: str, low: float, high: float, *, least: int = 1, most: int | None = None
) -> tuple[float, ...]:
    """A list of `least` to `most` finite numbers (None: any more), each within [low, high]. Raises InputError as `number`."""
    if not isinstance(value, list) or not least <= len(value) <= (len(value) if most is None else most):
        count = "" if most is None else f"{most} " if least == most else f"{least} to {most} "
        raise InputError(where, f"is {value!r}", f"a list of {count}numbers" + (f" in {unit}" if unit else ""))
    return tuple(number(item, f"{where}[{i}]", unit, low, high) for i, item in enumerate(value))


def span(value: Any, where: str, unit: str, low: float, high: float) -> tuple[float, float]:
    """The two ends of a range, each within [low, high]. Raises InputError."""
    if not isinstance(value, list) or len(value) != 2:
        raise InputError(where, f"is {value!r}", f"[lowest, highest] in {unit}")
    lowest, highest = (number(item, where, unit, low, high) for item in value)
    if lowest > highest:
        raise InputError(where, f"is {value!r}", "the lowest first")
    return lowest, highest


def known_keys(document: Mapping[str, Any], before: str, known: Collection[str]) -> None:
    """Raises InputError for a key that is none of these. before: what stands before the key in the place that it names."""
    for key in document:
        if key not in known:
            near = difflib.get_close_matches(str(key), known, n=1)
            raise InputError(f"{before}{key}", "unknown key", near[0] if near else f"one of {', '.join(known)}")


def known_format(document: Mapping[str, Any], known: int, where: str) -> None:
    """Raises InputError for a document of another format; one that names none is of this."""
    found = document.get("format", known)
    if isinstance(found, bool) or found != known:
        raise InputError(f"{where}: format", f"is {found!r}", f"{known}")


def mapping(document: Mapping[str, Any], key: str, where: str) -> dict[str, Any]:
    """What a key holds, empty where it is missing or null. Raises InputError for anything but a mapping."""
    found = document.get(key)
    if found is not None and not isinstance(found, dict):
        raise InputError(f"{where}: {key}", f"is {found!r}", "a mapping of names to values")
    return found or {}


def name(value: Any, where: str) -> str:
    """A text that is shown to people: not empty, one line of at most 200 characters. Raises InputError."""
    if not isinstance(value, str) or not 0 < len(value) <= _LONGEST_NAME or not value.isprintable():
        raise InputError(where, f"is {value!r}", f"a text of 1 to {_LONGEST_NAME} printable characters")
    return value


def texts(value: Any, where: str) -> dict[str, str]:
    """A mapping of texts, numbers and the like as texts; nothing is an empty one. Raises InputError."""
    if value is None:
        return {}
    if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
        raise InputError(where, f"is {value!r}", "a mapping of texts")
    return {key: str(item) for key, item in value.items()}

"""Numbers for JSON and SQL, which have neither nan nor infinity."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from typing import Any


def finite(value: float) -> float | None:
    """The number; None for nan and infinity."""
    return value if isfinite(value) else None


def finite_document(value: Any) -> Any:
    """The same for a document of mappings, lists and tuples; tuples come out as lists."""
    if isinstance(value, float):
        return finite(value)
    if isinstance(value, Mapping):
        return {key: finite_document(item) for key, item in value.items()}
    return [finite_document(item) for item in value] if isinstance(value, list | tuple) else value

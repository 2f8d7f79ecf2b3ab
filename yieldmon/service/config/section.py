"""What all sections of the configuration file share: strict types, and keys with range, unit and meaning.

A key's unit is in its name; `quantity` repeats it for messages and for the comments of the shipped file.
"""

from __future__ import annotations

from typing import Any

from pydantic import Field

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


class Section(StrictModel):
    """Common rules: no unknown keys, no silent conversion, no infinities."""

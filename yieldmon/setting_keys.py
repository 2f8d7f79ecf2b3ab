"""How a class of settings declares its keys, once for code, configuration file and reference: default, range, unit, meaning."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Key:
    """A setting that users may change.

    Attributes
    ----------
    meaning : str
        For people.
    low, high : float or None
        Range of the number, or of each number of a mapping; None where any may stand.
    unit : str
        Of these; "1" for a ratio, "" where it has none.
    most : int or None
        Numbers that a list may have.
    """

    meaning: str
    low: float | None = None
    high: float | None = None
    unit: str = ""
    most: int | None = None

    @staticmethod
    def of(metadata: Mapping[Any, Any]) -> Key | None:
        """From a field's metadata; None for a field that is no key of a file."""
        return metadata.get(Key)


def quantity(default: float | None, low: float, high: float, unit: str, meaning: str) -> Any:
    """A number from `low` to `high`."""
    return field(default=default, metadata={Key: Key(meaning, low, high, unit)})


def choice(default: bool | str, meaning: str) -> Any:
    """True or false, or one of a few words."""
    return field(default=default, metadata={Key: Key(meaning)})


def quantities(default: tuple[float, ...], most: int, unit: str, meaning: str) -> Any:
    """From one to `most` numbers."""
    return field(default=default, metadata={Key: Key(meaning, unit=unit, most=most)})


def by_name(low: float, high: float, unit: str, meaning: str) -> Any:
    """A mapping of names to numbers from `low` to `high`; by default an empty one."""
    return field(default_factory=dict, metadata={Key: Key(meaning, low, high, unit)})

"""An operator's request, read key by key and checked."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

from yieldmon.errors import InputError, brief

_MAX_NAME = 80
_SHOWN = 100


@dataclass(frozen=True, slots=True)
class Request:
    """What came over the control socket. Each method raises InputError, which names the key, for a value that is none."""

    values: Mapping[str, Any]

    @property
    def who(self) -> str:
        """The user at the other end of the control socket."""
        return str(self.values.get("who", ""))

    def given(self, key: str) -> bool:
        """Whether there is a value."""
        return self.values.get(key) is not None

    def flag(self, key: str) -> bool:
        """Whether the value is true; no value is false. Raises InputError."""
        value = self.values.get(key)
        if value is not None and not isinstance(value, bool):
            raise InputError(key, brief(repr(value), _SHOWN), "true or false")
        return value is True

    def only(self, command: str, keys: Collection[str]) -> None:
        """Raises InputError for an argument that the command does not have: a misspelt one would count as not given."""
        strange = next((key for key in self.values if key not in keys and key not in ("command", "who")), None)
        if strange is not None:
            raise InputError(command, f"takes no {brief(strange, _SHOWN)!r}", ", ".join(keys) or "no argument")

    def name(self, key: str) -> str | None:
        """A printable text on one line, without blanks around it; None where the key is missing or null. Raises InputError, also
        for an empty text, which would take a name away unnoticed."""
        value = self.values.get(key)
        if value is None:
            return None
        if not isinstance(value, str) or len(value) > _MAX_NAME or not value.isprintable():
            raise InputError(key, brief(repr(value), _SHOWN), f"a name of at most {_MAX_NAME} printable characters")
        if not value.strip():
            raise InputError(key, "is empty", f"a name of at most {_MAX_NAME} printable characters")
        return value.strip()

    def number_of(self, key: str, what: str) -> int:
        """The number of a load, ticket or version; what: names it in an error. Raises InputError."""
        value = self.values.get(key)
        if not isinstance(value, int) or isinstance(value, bool) or value < 0:
            raise InputError(key, brief(repr(value), _SHOWN), f"the number of a {what}")
        return value

    def load_numbers(self) -> tuple[int, int]:
        """First and last load that the request is about; the same where it names one only. Raises InputError."""
        first = self.number_of("first_load", "load")
        return first, self.number_of("last_load", "load") if self.given("last_load") else first

    def mass_or_none(self, key: str, low: float, high: float, unit: str) -> float | None:
        """A mass from low to high, None where there is none. Raises InputError."""
        return self.mass(key, low, high, unit) if self.given(key) else None

    def mass(self, key: str, low: float, high: float, unit: str) -> float:
        """A mass from low to high, which must be there. Raises InputError."""
        value = self.values.get(key)
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            raise InputError(key, brief(repr(value), _SHOWN), f"a mass from {low:g} to {high:g} {unit}")
        return float(value)

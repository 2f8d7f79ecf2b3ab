"""Conditions that only the service sees, and for how long each counts as present."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class _Condition:
    until_s: float
    detail: str


class Conditions:
    """Named conditions with an end. Times are monotonic seconds."""

    def __init__(self) -> None:
        self._conditions: dict[str, _Condition] = {}

    def present(self, name: str, until_s: float, detail: str) -> None:
        """The condition holds until then, unless it is seen again or ended."""
        self._conditions[name] = _Condition(until_s, detail)

    def ended(self, name: str) -> None:
        """The condition is gone."""
        self._conditions.pop(name, None)

    def details(self, now_s: float, names: tuple[str, ...]) -> list[str]:
        """What is said of those of the named conditions that still hold; those that do not are forgotten."""
        if not self._conditions:
            return []
        for name in names:
            condition = self._conditions.get(name)
            if condition is not None and condition.until_s <= now_s:
                del self._conditions[name]
        return [self._conditions[name].detail for name in names if name in self._conditions]

"""What `yieldmon check-config --json` prints."""

from __future__ import annotations

from typing import Any, TypedDict

from .common import Number


class ProblemDocument(TypedDict):
    """Why the daemon would not start: the key, what is wrong, what was expected."""

    where: str
    problem: str
    expected: str


class SeenDocument(TypedDict):
    """A mapped quantity in a recording, in its unit. values: samples or values; usable: those that are numbers in range, with
    low, high, largest_gap_s and the first ones; decoded: range of all, usable or not."""

    unit: str
    values: int
    usable: int
    rate_hz: Number
    low: Number
    high: Number
    largest_gap_s: Number
    first: list[float]
    decoded: list[float] | None


class CheckDocument(TypedDict):
    """`yieldmon check-config --json`. signals: quantities of --log, by name, null without it. configuration: every key with its
    value, null for a file that is not valid."""

    file: str
    valid: bool
    problems: list[ProblemDocument]
    notes: list[str]
    signals: dict[str, SeenDocument] | None
    configuration: dict[str, Any] | None

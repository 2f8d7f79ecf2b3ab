"""Numbers of options, held against what they may be."""

from __future__ import annotations

from math import inf, isfinite

from yieldmon.errors import InputError


def within(option: str, value: float, low: float, high: float = inf, unit: str = "") -> float:
    """A number from low to high. Raises InputError that names the option."""
    if not (isfinite(value) and low <= value <= high):
        span = f"a number of at least {low:g}" if high == inf else f"{low:.10g} to {high:.10g} {unit}".rstrip()
        raise InputError(option, f"is {value:g}", span)
    return value


def within_if_given(option: str, value: float | None, low: float, high: float = inf) -> float | None:
    """The same for an option that need not be given."""
    return None if value is None else within(option, value, low, high)


def whole_number(option: str, value: int, low: int, high: int | None = None) -> int:
    """A whole number from low to high, if there is a highest one. Raises InputError that names the option."""
    if value < low or (high is not None and value > high):
        raise InputError(option, f"is {value}", f"a whole number from {low}" + ("" if high is None else f" to {high}"))
    return value


def above_0(option: str, value: float) -> float:
    """A number above 0. Raises InputError that names the option."""
    if not 0.0 < value < inf:
        raise InputError(option, f"is {value:g}", "a number above 0")
    return value

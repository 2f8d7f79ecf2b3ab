"""Arguments of the public interface: one of another type is refused by its name, where Python would speak of an attribute."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from os import PathLike
from typing import Any

from yieldmon.errors import InputError, refuse_nul


def require_type(name: str, given: object, wanted: type | tuple[type, ...], expected: str) -> None:
    """Refuse an argument of another type.

    Parameters
    ----------
    name : str
        Of the argument.
    given : object
    wanted : type or tuple of type
    expected : str
        What would be right.

    Raises
    ------
    InputError

    Examples
    --------
    >>> require_type("data", 3, str, "a text")
    Traceback (most recent call last):
        ...
    yieldmon.errors.InputError: data: is of type int; expected a text
    """
    if not isinstance(given, wanted):
        raise of_other_type(name, given, expected)


def of_other_type(name: str, given: object, expected: str) -> InputError:
    """What `require_type` raises."""
    return InputError(name, f"is of type {type(given).__name__}", expected)


def require_path(given: object) -> None:
    """Refuse a `path` that is none. Raises InputError."""
    require_type("path", given, (str, PathLike), "a path")
    if given == "":
        raise InputError("path", "is ''", "a path")
    refuse_nul(given)


def require_within(name: str, given: float, low: float, high: float, unit: str) -> None:
    """Refuse a number outside its range, and nan. Raises InputError."""
    if not low <= given <= high:
        raise InputError(name, f"is {given}", f"a number from {low:g} to {high:g} {unit}")


def all_of_type(name: str, given: Iterable[Any], wanted: type, expected: str) -> Sequence[Any]:
    """The elements of an argument that is to hold some of one type.

    Parameters
    ----------
    name : str
        Of the argument.
    given : iterable
    wanted : type
        Of each element.
    expected : str
        What would be right.

    Returns
    -------
    sequence

    Raises
    ------
    InputError
        For a single element that stands alone, for what is no iterable, and for elements of another type.
    """
    require_type(name, given, Iterable, expected)
    elements = tuple(given)
    for number, element in enumerate(elements):
        require_type(f"{name}[{number}]", element, wanted, expected)
    return elements

"""Fast construction and replacement of frozen dataclasses with many fields, for those made once a second of a log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, make_dataclass
from operator import attrgetter
from typing import Any, TypeVar

T = TypeVar("T")


def maker_of(kind: type[T]) -> Callable[..., T]:
    """A constructor that takes the values of all fields, in order.

    A frozen dataclass sets each field by a call of `object.__setattr__`. Here a class with the same slots, which is not frozen,
    takes the values, and its instance becomes one of `kind`.

    Parameters
    ----------
    kind : type
        Frozen dataclass with slots, without `__post_init__`.

    Returns
    -------
    callable
    """

    def become(made: Any) -> None:
        made.__class__ = kind

    names = [field.name for field in fields(kind)]  # type: ignore[arg-type]
    unfrozen: Callable[..., T] = make_dataclass(f"_{kind.__name__}", names, slots=True, namespace={"__post_init__": become})
    return unfrozen


def changer_of(kind: type[T]) -> Callable[..., T]:
    """`dataclasses.replace` for one class.

    Parameters
    ----------
    kind : type
        As for `maker_of`, with two fields or more.

    Returns
    -------
    callable
        Takes an instance, and the new values by field name.
    """
    names = [field.name for field in fields(kind)]  # type: ignore[arg-type]
    places = {name: place for place, name in enumerate(names)}
    values, made = attrgetter(*names), maker_of(kind)

    def changed(one: T, **changes: Any) -> T:
        row = list(values(one))
        for name, value in changes.items():
            row[places[name]] = value
        return made(*row)

    return changed

"""Other columns of a quantity that is taken from one, and whether their numbers contradict it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from yieldmon.field.table import Array

_SAME, _MOST_DRIED = 0.02, 0.35
"""Largest share by which columns of one quantity may differ, and by which dried grain is lighter than wet."""


def contradiction(
    quantity: str, used: tuple[str, float], others: Sequence[tuple[str, float, bool]], numbers_of: Callable[[str], Array]
) -> tuple[str, ...]:
    """A note for each other column whose numbers are not those of the used one.

    Parameters
    ----------
    quantity : str
        As `--column` names it.
    used : (str, float)
        Name of the column, and SI per unit.
    others : sequence of (str, float, bool)
        The same of the others, and whether one of the two is of dried grain and the other is not.
    numbers_of : callable
        A column's numbers in some of its rows, by its name.

    Returns
    -------
    tuple of str
    """
    name, scale = used
    values = numbers_of(name) * scale
    notes = []
    for other, other_scale, dried in others:
        ratio = _middle_ratio(numbers_of(other) * other_scale, values)
        if ratio is not None and abs(np.log(ratio)) > -np.log(1.0 - (_MOST_DRIED if dried else _SAME)):
            notes.append(
                f"{other} contradicts {name}, which is used: its numbers are {ratio:.3g} times as large "
                f"(--column {quantity}=NAME:UNIT chooses)"
            )
    return tuple(notes)


def _middle_ratio(values: Array, to: Array) -> float | None:
    """The median ratio of the rows that have both above 0, None where none has."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        ratio = (values / to)[(values > 0.0) & (to > 0.0)]
    ratio = ratio[np.isfinite(ratio)]
    return float(np.median(ratio)) if len(ratio) else None

"""Rows that a table holds more than once: each counts once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.field.plane import places_m
from yieldmon.field.table import Array, Skipped
from yieldmon.units import counted

from .driven import LEAST_M
from .raw_table import Raw
from .row_times import ColumnTimes

_WHOLE = 0.7
"""Of the step to the next other row, that a row's own interval or distance is where it is no part of a faster log."""


def without_repeats(raw: Raw, values: dict[str, Array], clock: ColumnTimes) -> tuple[Raw, dict[str, Array], ColumnTimes]:
    """The same without rows of which the time, the place and all else that is read are those of a row before, which is said.

    Rows of a log that is faster than its clock and its receiver may look the same; their intervals or distances are parts of the
    step to the next other row, and they stay.

    Parameters
    ----------
    raw : Raw
    values : dict of str to array, shape (n,)
        Quantity -> values in SI.
    clock : ColumnTimes
        What the file's columns say of times; without times rows that look the same may be a machine that stands.
    """
    if clock.time_s is None or not {"longitude", "latitude"} <= values.keys():
        return raw, values, clock
    columns = [np.nan_to_num(column, nan=-1e300) for column in values.values()]
    columns += [label.codes for label in raw.texts.values()]
    order = np.lexsort([*columns, np.nan_to_num(clock.time_s, nan=-1e300)])
    same = np.isfinite(clock.time_s[order[1:]])
    for column in (*columns, np.nan_to_num(clock.time_s, nan=-1e300)):
        same &= column[order[1:]] == column[order[:-1]]
    again = np.zeros(raw.count, bool)
    again[order[1:]] = same
    number = int(again.sum())
    # lexsort is stable: the first of the same rows in the file stays.
    if not number or _are_parts(values, clock.time_s, ~again):
        return raw, values, clock
    kept = ~again
    left = Skipped(counted(number, "row"), "the same as a row before: each counts once")
    return (
        replace(
            raw,
            numbers={name: column[kept] for name, column in raw.numbers.items()},
            texts={name: label.take(kept) for name, label in raw.texts.items()},
            count=raw.count - number,
            skipped=(*raw.skipped, left),
        ),
        {quantity: column[kept] for quantity, column in values.items()},
        replace(clock, time_s=clock.time_s[kept]),
    )


def _are_parts(values: dict[str, Array], time_s: Array, kept: np.ndarray) -> bool:
    """Whether the kept rows' own intervals or distances are too short for what lies between them."""
    order = np.flatnonzero(kept)[np.argsort(time_s[kept], kind="stable")]
    longitude, latitude = values["longitude"][order], values["latitude"][order]
    x, y = places_m(longitude, latitude)
    steps = {"interval": np.diff(time_s[order]), "distance": np.hypot(np.diff(x), np.diff(y))}
    for quantity, step in steps.items():
        if quantity not in values:
            continue
        own = values[quantity][order][1:]
        with np.errstate(invalid="ignore", over="ignore"):
            known = (own > 0) & (step > (LEAST_M if quantity == "distance" else 0.0))
            if known.any() and float(np.median(own[known] / step[known])) < _WHOLE:
                return True
    return False

"""Rows of a table in groups, such as those of one time or one second: order, numbers, first and last rows, sums and means."""

from __future__ import annotations

import numpy as np

from .table import Array, Flags, Index


def by_time(time_s: Array, stream: Index) -> Index:
    """Order of the rows by stream, then time, then place in the table.

    >>> by_time(np.array([3.0, 1.0, 2.0]), np.array([0, 1, 0])).tolist()
    [2, 0, 1]
    """
    order: Index = np.lexsort((np.arange(len(time_s)), time_s, stream))
    return order


def step_begins(time_s: Array, stream: Index) -> Flags:
    """Where another time or stream begins, of rows in the order of `by_time`. Each row of unknown time begins a step of its own.

    >>> step_begins(np.array([1.0, 1.0, 2.0, 2.0]), np.array([0, 0, 0, 1])).tolist()
    [True, False, True, True]
    """
    begins: Flags = np.r_[True, (np.diff(time_s) != 0) | (np.diff(stream) != 0)][: len(time_s)]
    return begins


def in_order_of_rows(group: Index) -> Index:
    """Numbers from 0 for the groups of rows, in the order of the groups' first rows.

    >>> in_order_of_rows(np.array([7, 7, 2, 7])).tolist()
    [0, 0, 1, 0]
    """
    _, first, number = np.unique(group, return_index=True, return_inverse=True)
    place = np.empty(len(first), np.intp)
    place[np.argsort(first)] = np.arange(len(first))
    return place[number.reshape(-1)]


def first_rows(group: Index, count: int) -> Index:
    """First row of each group, shape (count,). group: number of each row's group, from 0."""
    first = np.zeros(count, np.intp)
    first[group[::-1]] = np.arange(len(group))[::-1]
    return first


def last_rows(group: Index, count: int) -> Index:
    """Last row of each group, shape (count,). group: number of each row's group, from 0."""
    last = np.zeros(count, np.intp)
    last[group] = np.arange(len(group))
    return last


def total_known(values: Array, group: Index, count: int) -> Array:
    """Sum of each group's known values, shape (count,); NaN where none is known.

    >>> total_known(np.array([1.0, np.nan, 2.0, np.nan]), np.array([0, 0, 0, 1]), 2).tolist()
    [3.0, nan]
    """
    known = np.isfinite(values)
    total = np.bincount(group, np.where(known, values, 0.0), count)
    return np.where(np.bincount(group, known, count) > 0, total, np.nan)


def mean_known(values: Array, group: Index, count: int) -> Array:
    """Mean of each group's known values, shape (count,); NaN where none is known."""
    known = np.isfinite(values)
    number = np.bincount(group, known, count)
    with np.errstate(invalid="ignore"):
        return np.bincount(group, np.where(known, values, 0.0), count) / np.where(number > 0, number, np.nan)

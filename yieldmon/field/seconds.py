"""Logs faster than one row a second, merged to one row a second, for which the map's rules from point to point are made."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from yieldmon.field.groups import in_order_of_rows, last_rows, total_known
from yieldmon.field.table import Array, HarvestTable

_FAST_S = 0.75
"""Median interval below which rows are merged."""
_WEIGHTS = {"flow_kg_s": "interval_s", "flow_sd_kg_s": "interval_s", "moisture_pct": "interval_s", "width_m": "distance_m"}
"""Averaged columns and their weights; of the other columns the last row of a second counts."""
_SUMS = ("interval_s", "distance_m")


def per_second(table: HarvestTable) -> HarvestTable:
    """The rows of each second of a fast log as one row, at the place and time of the last; mass and distance are kept.

    Where the flow of some rows of a second is unknown, it is taken as that of the others.

    Parameters
    ----------
    table : HarvestTable
        Of one source.

    Returns
    -------
    HarvestTable
        The same where rows are a second apart or more. Rows of different sections, labels, passes or header states stay apart,
        and so do rows without a time.
    """
    usual_s = _usual_interval_s(table)
    if not 0.0 < usual_s < _FAST_S:
        return table
    group, count = _seconds(table)
    last = last_rows(group, count)
    columns = {name: values[last] for name, values in table.columns.items()}
    for name in _SUMS:
        columns[name] = total_known(table[name], group, count)
    for name, by in _WEIGHTS.items():
        columns[name] = _mean(table[name], np.nan_to_num(table[by]), group, count)
    note = f"{len(table)} rows {usual_s:.2g} s apart are taken together to {count} of a second"
    found = replace(table.take(last), columns=columns)
    return found.noting(notes=(note,)) if len(table.sources) == 1 else found


def _usual_interval_s(table: HarvestTable) -> float:
    positive = table["interval_s"][table["interval_s"] > 0]
    return float(np.median(positive)) if positive.size else 0.0


def _seconds(table: HarvestTable) -> tuple[NDArray[np.intp], int]:
    """The second that each row belongs to, by number in the order of the file, and how many there are."""
    time = table["time_s"]
    keys = [np.floor(time), *(table[name] for name in ("section", "pass_number", "header_down"))]
    keys += [label.codes.astype(float) for label in table.labels.values()] + [table.source_of_row.astype(float)]
    keys.append(np.where(np.isfinite(time), -1.0, np.arange(len(time))))
    rows = np.column_stack([np.nan_to_num(key, nan=-1e9) for key in keys])
    _, number = np.unique(rows, axis=0, return_inverse=True)
    group = in_order_of_rows(number.reshape(-1))
    return group, int(group.max()) + 1


def _mean(values: Array, weights: Array, group: NDArray[np.intp], count: int) -> Array:
    """Weighted, of what is known; plain where nothing has a weight."""
    known = np.isfinite(values)
    plain = np.where(known, 1.0, 0.0)
    weighted = plain * np.maximum(weights, 0.0)
    heavy = np.bincount(group, weighted, count)
    use = np.where(heavy[group] > 0, weighted, plain)
    total = np.bincount(group, use, count)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.bincount(group, use * np.where(known, values, 0.0), count) / np.where(total > 0, total, np.nan)

"""Sections of a header of which the rows of one time all have the machine's place: they are taken together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .table import HarvestTable

_SAME_DEG = 2e-7
"""Two centimetres."""
_MOST = 0.9
"""Share of steps that have one place."""


def together(table: HarvestTable) -> HarvestTable:
    """The table with one row a step where its sections have one place: flow and width are the sum, all else is the first's.

    Parameters
    ----------
    table : HarvestTable
        Of one source.

    Returns
    -------
    HarvestTable
        The same where sections have places of their own, or there are none.
    """
    section, time = table["section"], table["time_s"]
    if len(table.sources) != 1 or np.unique(section[np.isfinite(section)]).size < 2:
        return table
    stream = table.labels["machine"].codes
    order = np.lexsort((np.arange(len(table)), time, stream))
    with np.errstate(invalid="ignore"):
        new = np.r_[True, (np.diff(time[order]) != 0) | (np.diff(stream[order]) != 0) | ~np.isfinite(time[order][1:])]
    step = np.empty(len(table), np.intp)
    step[order] = np.cumsum(new) - 1
    count = int(step.max()) + 1
    size = np.bincount(step, minlength=count)
    spread = np.zeros(count)
    for name in ("longitude_deg", "latitude_deg"):
        high, low, known = np.full(count, -np.inf), np.full(count, np.inf), np.isfinite(table[name])
        np.maximum.at(high, step[known], table[name][known])
        np.minimum.at(low, step[known], table[name][known])
        spread = np.maximum(spread, np.where(high >= low, high - low, 0.0))
    several = size > 1
    if not several.any() or np.mean(spread[several] <= _SAME_DEG) < _MOST:
        return table
    first = order[new]
    of_first = np.empty(count, np.intp)
    of_first[step[first]] = first
    rows = np.sort(of_first)
    place = step[rows]
    columns = {name: values[rows] for name, values in table.columns.items()}
    for name in ("flow_kg_s", "width_m"):
        known = np.isfinite(table[name])
        total = np.bincount(step, np.where(known, table[name], 0.0), count)
        columns[name] = np.where(np.bincount(step, known, count) > 0, total, np.nan)[place]
    columns["section"] = np.full(len(rows), np.nan)
    note = f"sections of one time have one place: {len(table)} rows are taken together to {len(rows)}"
    source = replace(table.sources[0], notes=(*table.sources[0].notes, note))
    return replace(table.take(rows), columns=columns, sources=(source,))

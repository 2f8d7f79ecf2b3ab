"""Rows of a header's sections that all have the machine's place: the rows of one time are merged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .groups import by_time, first_rows, step_begins, total_known
from .table import HarvestTable

_SAME_DEG = 2e-7
"""Two centimetres: places that differ by less are one."""
_LEAST_SHARE = 0.9
"""Share of the steps of several rows that have one place, from which all are merged."""


def merge_sections(table: HarvestTable) -> HarvestTable:
    """One row for each time where the sections have one place: flow and width are summed, all else is the first row's.

    Parameters
    ----------
    table : HarvestTable
        Of one source.

    Returns
    -------
    HarvestTable
        The same table where sections have places of their own, or there are no sections.
    """
    section, time = table["section"], table["time_s"]
    if len(table.sources) != 1 or np.unique(section[np.isfinite(section)]).size < 2:
        return table
    stream = table.labels["machine"].codes
    order = by_time(time, stream)
    step = np.empty(len(table), np.intp)
    step[order] = np.cumsum(step_begins(time[order], stream[order])) - 1
    count = int(step.max()) + 1
    size = np.bincount(step, minlength=count)
    spread = np.zeros(count)
    for name in ("longitude_deg", "latitude_deg"):
        high, low, known = np.full(count, -np.inf), np.full(count, np.inf), np.isfinite(table[name])
        np.maximum.at(high, step[known], table[name][known])
        np.minimum.at(low, step[known], table[name][known])
        spread = np.maximum(spread, np.where(high >= low, high - low, 0.0))
    several = size > 1
    if not several.any() or np.mean(spread[several] <= _SAME_DEG) < _LEAST_SHARE:
        return table
    rows = np.sort(first_rows(step, count))
    place = step[rows]
    columns = {name: values[rows] for name, values in table.columns.items()}
    for name in ("flow_kg_s", "width_m"):
        columns[name] = total_known(table[name], step, count)[place]
    columns["section"] = np.full(len(rows), np.nan)
    note = f"sections of one time have one place: {len(table)} rows are taken together to {len(rows)}"
    return replace(table.take(rows), columns=columns).noting(notes=(note,))

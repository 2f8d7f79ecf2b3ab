"""Rows of a map for a text that has one row a second and machine: sections of a header and steps of one second are added."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import numpy as np

from yieldmon.field.groups import first_rows, in_order_of_rows, last_rows
from yieldmon.field.harvest import HarvestMap
from yieldmon.field.table import LABELS, Array, Index
from yieldmon.files.whole_seconds import whole_seconds


@dataclass(frozen=True)
class TextRows:
    """Columns of a text; masses and distances are those of the rows that they were made from.

    Parameters
    ----------
    row : array of int, shape (n,)
        The first of the table's rows in each, of which labels and header state are.
    time_s : array of int, shape (n,)
        Whole seconds.
    longitude_deg, latitude_deg, elevation_m, flow_kg_s, interval_s, distance_m, width_m, moisture_pct : array, shape (n,)
        0 for what is not known.
    """

    row: Index
    time_s: Array
    longitude_deg: Array
    latitude_deg: Array
    elevation_m: Array
    flow_kg_s: Array
    interval_s: Array
    distance_m: Array
    width_m: Array
    moisture_pct: Array


def text_rows(result: HarvestMap, rows: Index, *, flow: Array, moisture: Array, width: Array) -> TextRows:
    """Rows of a map as a text has them.

    Parameters
    ----------
    result : HarvestMap
    rows : array of int
        Of the table, in its order, each with a time and a place.
    flow, moisture, width : array, shape (n,)
        Of all the table's rows: kg/s, %, m.
    """
    table, steps = result.table, result.steps
    stream = steps.stream[steps.step_of_row]
    time = np.zeros(len(table), np.int64)
    known = np.isfinite(table["time_s"])
    for one in np.unique(stream):
        mine = known & (stream == one)
        time[mine] = whole_seconds(table["time_s"][mine])
    plain = TextRows(
        rows,
        time[rows],
        *(table[name][rows] for name in ("longitude_deg", "latitude_deg")),
        *(
            np.nan_to_num(values[rows])
            for values in (table["elevation_m"], flow, table["interval_s"], table["distance_m"], width, moisture)
        ),
    )
    beside = _joined(plain, _numbered(steps.step_of_row[rows]), sections=True)
    names = [table.labels[name].codes[beside.row] for name in LABELS]
    step = steps.step_of_row[beside.row]
    of_one = _numbered(stream[beside.row], beside.time_s, steps.down[step], steps.pass_number[step], *names)
    # Rows with one and the same time in the source, which is not known to be a fine one, stay as they are.
    return _joined(beside, _unless_at_once(of_one, steps.time_s[step]), sections=False)


def _numbered(*keys: Array) -> Index:
    """Number of each row's group of equal keys, in the order of their first rows."""

    def together(one: Index, key: Array) -> Index:
        _, code = np.unique(key, return_inverse=True)
        _, out = np.unique(one * (int(code.max(initial=0)) + 1) + code.reshape(-1), return_inverse=True)
        return np.asarray(out.reshape(-1))

    group = reduce(together, keys, np.zeros(len(keys[0]), np.int64))
    return in_order_of_rows(group)


def _unless_at_once(group: Index, time_s: Array) -> Index:
    """The groups, with each of which rows have one time taken apart."""
    alone = np.arange(len(group))
    order = np.lexsort((time_s, group))
    same = (np.diff(group[order]) == 0) & (np.diff(time_s[order]) == 0)
    apart = np.zeros(int(group.max(initial=-1)) + 1, bool)
    apart[group[order[1:]][same]] = True
    return _numbered(group, np.where(apart[group], alone, -1)) if len(group) else group


def _joined(rows: TextRows, group: Index, *, sections: bool) -> TextRows:
    """Each group as one row, in order. sections: rows of one step, beside each other; else one after another."""
    count = int(group.max(initial=-1)) + 1
    if count == len(group):
        return rows
    number = np.bincount(group, minlength=count)

    def total(values: Array) -> Array:
        return np.bincount(group, values, count)

    def mean(values: Array, weights: Array) -> Array:
        weight = total(weights)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(weight > 0, total(weights * values) / weight, total(values) / number)

    mass = rows.flow_kg_s * rows.interval_s
    even = np.ones(len(group))
    interval = total(rows.interval_s) / (number if sections else 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        flow = np.where(interval > 0, total(mass) / interval, 0.0)
    first, last = first_rows(group, count), last_rows(group, count)
    # A row lies where its distance ends.
    longitude, latitude, elevation = (
        mean(values, even) if sections else values[last] for values in (rows.longitude_deg, rows.latitude_deg, rows.elevation_m)
    )
    # A moisture of 0 is one that is not known.
    return TextRows(
        rows.row[first],
        rows.time_s[first],
        longitude,
        latitude,
        elevation,
        flow,
        interval,
        total(rows.distance_m) / (number if sections else 1),
        total(rows.width_m) if sections else mean(rows.width_m, rows.distance_m),
        mean(rows.moisture_pct, np.where(rows.moisture_pct > 0, np.maximum(mass, 1e-9), 0.0)),
    )

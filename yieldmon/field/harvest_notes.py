"""Notes on a harvest as a whole: what could not be estimated or measured, and what cannot be as it was read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from yieldmon.units import S_PER_DAY, T_HA_PER_KG_M2, counted

from .cleaning import Cleaned
from .crop_figures import crop
from .delay import Decision
from .machines import Machine
from .table import HarvestTable
from .totals import Totals
from .tracks import Tracks

_LEAST_KG_M2, _MOST_GRAIN_KG_M2, _MOST_KG_M2 = 0.005, 4.0, 20.0
"""Mean yields beyond which units are wrong: 40 t/ha of grain is a record, 200 t/ha one of cane and beets."""
_LEAST_UNMEASURED = 0.005
"""Share of the ground without a flow above which there is a note."""
_SLOWEST_M_S, _FASTEST_M_S, _LEAST_ROWS = 0.1, 12.0, 10
"""Median speeds of a harvest, and the rows with grain from which the median is judged."""
_SEASONS_APART_DAYS, _SAME_GROUND = 60, 0.1
"""Days without a row between seasons, and the share of rows on ground already cut above which there is a note on seasons."""


def delays_and_crops(table: HarvestTable, machines: Sequence[Machine], *, transport_left: bool) -> tuple[str, ...]:
    """Notes on delays that cannot be estimated, and on several crops. transport_left: the transport was to be taken back but was
    not looked at."""
    out = [
        f"{machine.name + ': ' if machine.name else ''}the flow delay cannot be estimated from these data ({machine.flow.why}); "
        f"{machine.flow.value_s:g} s is used"
        for machine in machines
        if machine.flow.decision is Decision.CANNOT_TELL
    ]
    if transport_left and len(machines) > 1:
        out.append("the transport is not estimated: the machines' delays differ or are not known")
    crops = crops_of(table)
    if len(crops) > 1:
        out.append(f"the harvest has {len(crops)} crops ({', '.join(crops)}): yield and total are of all together")
    return tuple(out)


def unmeasured(table: HarvestTable, steps: Tracks) -> list[str]:
    """A note on ground that was cut without a known flow, where it is a considerable share."""
    cutting = steps.down[steps.step_of_row] & (table["distance_m"] > 0) & ~(table["header_down"] == 0)
    lacking = cutting & np.isnan(table["flow_kg_s"])
    area_m2 = np.nan_to_num(table["distance_m"] * table["width_m"])
    share = float(area_m2[lacking].sum() / area_m2[cutting].sum()) if lacking.any() else 0.0
    if share < _LEAST_UNMEASURED:
        return []
    said = f"{counted(int(lacking.sum()), 'row')} of passes without a flow, {100.0 * share:.2g} % of the ground"
    return [f"{said}: their grain is not in the mass"]


def doubts(table: HarvestTable, totals: Totals, cleaned: Cleaned) -> tuple[str, ...]:
    """Notes on a harvest that cannot be as it is read: a yield that no crop has, seasons on the same ground.

    Parameters
    ----------
    table : HarvestTable
    totals : Totals
        Of its map.
    cleaned : Cleaned
        Why its rows are left out.
    """
    out = []
    mean = totals.measured_kg / totals.area_m2 if totals.area_m2 > 0 else 0.0
    grain = all(crop(name) is not None for name in crops_of(table)) and bool(crops_of(table))
    if totals.measured_kg > 0 and not _LEAST_KG_M2 < mean < (_MOST_GRAIN_KG_M2 if grain else _MOST_KG_M2):
        out.append(f"no crop yields {mean * T_HA_PER_KG_M2:.3g} t/ha: expected other units of yield, flow or width (--column)")
    out += _speed_doubts(table)
    days = np.unique(np.floor(table["time_s"][np.isfinite(table["time_s"])] / S_PER_DAY)) if table.unix_time else np.zeros(0)
    pauses = int((np.diff(days) > _SEASONS_APART_DAYS).sum())
    twice = [cleaned.names.index(reason) for reason in ("overlap", "duplicate")]
    if pauses and np.isin(cleaned.reason, twice).sum() >= _SAME_GROUND * len(table):
        first, last = (str(np.datetime64(int(day), "D")) for day in (days[0], days[-1]))
        out.append(
            f"the harvest has {pauses + 1} seasons from {first} to {last} on the same ground, which counts as cut in the first "
            "only; expected a map for each"
        )
    return tuple(out)


def _speed_doubts(table: HarvestTable) -> list[str]:
    """A note on a harvest at a speed at which no combine harvests."""
    with np.errstate(invalid="ignore", divide="ignore"):
        speed = (table["distance_m"] / table["interval_s"])[(table["flow_kg_s"] > 0) & (table["interval_s"] > 0)]
    speed = speed[np.isfinite(speed)]
    usual = float(np.median(speed)) if speed.size >= _LEAST_ROWS else 1.0
    if _SLOWEST_M_S <= usual <= _FASTEST_M_S:
        return []
    return [f"no harvest is driven at {usual:.2g} m/s: expected other units of time, place, distance or speed (--column)"]


def crops_of(table: HarvestTable) -> tuple[str, ...]:
    """Names of the crops that rows have, one spelling of each."""
    label = table.labels["crop"]
    there = np.bincount(label.codes, minlength=len(label.names))
    names: dict[str, str] = {}
    for name, number in zip(label.names, there.tolist(), strict=False):
        facts = crop(name)
        if number and name:
            names.setdefault(name.lower() if facts is None else facts.name, name)
    return tuple(names.values())

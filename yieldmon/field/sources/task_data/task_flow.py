"""Mass flow of a log of task data: as it is sent, else from yield by area, dried grain or a counter of mass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from yieldmon.data_dictionary import (
    DRY_PER_AREA,
    DRY_PER_TIME,
    DRY_TOTAL,
    MASS_PER_AREA,
    MASS_PER_TIME,
    MOISTURE,
    REFERENCE_MOISTURE,
    TOTAL_MASS,
    TOTAL_VOLUME,
    VOLUME_PER_AREA,
    VOLUME_PER_TIME,
)
from yieldmon.errors import InputError
from yieldmon.field.table import Array

from .task_values import Values

_VOLUMES = (VOLUME_PER_AREA, VOLUME_PER_TIME, TOTAL_VOLUME)

_LONGEST_SPREAD = 3.0
"""Times the usual time from one change of a counter to the next, over which at most an increase is spread."""


@dataclass(frozen=True)
class Driven:
    """Time, s, and distance, m, of each record since the one before, and its working width, m."""

    interval_s: Array
    distance_m: Array
    width_m: Array


def flow_kg_s(of: Values, driven: Driven, where: str) -> tuple[Array, tuple[str, ...]]:
    """Mass flow of wet grain, and notes on it. Raises InputError where the log has no yield as a mass."""
    for per_time, per_area, total, dry in (
        (MASS_PER_TIME, MASS_PER_AREA, TOTAL_MASS, False),
        (DRY_PER_TIME, DRY_PER_AREA, DRY_TOTAL, True),
    ):
        flow, notes = _as_sent(of, per_time, per_area, total, driven)
        if flow is not None:
            return _wet(of, flow, notes) if dry else (flow, notes)
    wet, dried = f"{MASS_PER_TIME}, {MASS_PER_AREA} or {TOTAL_MASS}", f"{DRY_PER_TIME}, {DRY_PER_AREA} or {DRY_TOTAL}"
    expected = f"mass in the log (DDI {wet}; dried {dried})"
    volumes = [str(ddi) for ddi in _VOLUMES if of.of(ddi)]
    if volumes:
        raise InputError(where, f"has yield as a volume (DDI {', '.join(volumes)}), whose density it does not state", expected)
    raise InputError(where, "has no yield", expected)


def _as_sent(of: Values, per_time: int, per_area: int, total: int, driven: Driven) -> tuple[Array | None, tuple[str, ...]]:
    """Flow by the first of these that is not 0 throughout."""
    flow, amount, counter = of.one(per_time, 1e-6), of.one(per_area, 1e-6), of.one(total, 1.0)
    if _some(flow) or (flow is not None and not _some(amount) and not of.risen(total)):
        return flow, ()
    if amount is not None and (_some(amount) or not of.risen(total)):
        with np.errstate(invalid="ignore", divide="ignore"):
            flow = np.where(driven.interval_s > 0, amount * driven.distance_m * driven.width_m / driven.interval_s, np.nan)
        lost = int((np.isnan(driven.distance_m) & (amount > 0)).sum())
        note = f"flow is yield by area (DDI {per_area}) times distance and width"
        return flow, (note + (f"; {lost} records have no distance" if lost else ""),)
    if counter is None:
        return None, ()
    return _of_counter(counter, driven.interval_s), (f"flow is the increase of the total (DDI {total})",)


def _some(values: Array | None) -> bool:
    return values is not None and bool((values > 0).any())


def _of_counter(counter: Array, interval_s: Array) -> Array:
    """Flow from a counter of kg: each increase over the time since the change before, a pause left out."""
    end_s = np.cumsum(np.nan_to_num(interval_s))
    known = np.flatnonzero(np.isfinite(counter))
    grown = np.diff(counter[known], prepend=counter[known[:1]])
    # Where it falls it began again.
    grown = np.where(grown < 0, counter[known], grown)
    changes = grown > 0
    at, kg = known[changes], grown[changes]
    if not at.size:
        return np.where(np.isfinite(counter), 0.0, np.nan)
    begin_s = np.r_[end_s[at[0]] - interval_s[at[0]], end_s[at[:-1]]]
    usual_s = float(np.median(end_s[at] - begin_s))
    begin_s = np.maximum(begin_s, end_s[at] - _LONGEST_SPREAD * usual_s)
    # A record's mass is what the evened counter grew over its interval.
    times = np.column_stack((begin_s, end_s[at])).ravel()
    sums = np.column_stack((np.cumsum(kg) - kg, np.cumsum(kg))).ravel()
    mass = np.diff(np.interp(end_s, times, sums), prepend=0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(interval_s > 0, mass / interval_s, 0.0)


def _wet(of: Values, dry: Array, notes: tuple[str, ...]) -> tuple[Array, tuple[str, ...]]:
    """Flow of grain as it was cut from that of dried grain; as it is where the moistures are not known."""
    moisture, reference = of.one(MOISTURE, 1e-6), of.single(REFERENCE_MOISTURE)
    if moisture is None or reference is None or not (moisture > 0).any():
        return dry, (*notes, "its yield is of dried grain: so are the masses")
    # Without a moisture of its own a record has the usual one.
    moisture = np.where((moisture > 0) & (moisture < 1.0), moisture, np.median(moisture[moisture > 0]))
    said = f"its yield is of grain dried to {1e-4 * reference:.3g} %: flow is that of wet grain by the moistures (DDI {MOISTURE})"
    return dry * (1.0 - 1e-6 * reference) / (1.0 - moisture), (*notes, said)

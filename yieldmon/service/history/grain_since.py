"""How much grain has passed since parameters that come from outside were measured, as far as the store's loads say."""

from __future__ import annotations

from collections.abc import Iterable

from yieldmon import utc
from yieldmon.engine.mass.totals import Totals
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.service.storage.batch import Load


def grain_since_kg(parameters: ParameterSet, loads: Iterable[Load], totals: Totals, now_s: float) -> float:
    """Mass of the loads after the time that the provenance gives, by the share of their time; 0 where it gives none.

    Parameters
    ----------
    parameters : ParameterSet
        With `loads_until` or `date` in its provenance.
    loads : iterable of Load
        All that the store knows.
    totals : Totals
        With the mass of the open load, kg.
    now_s : float
        Unix time, s.

    Returns
    -------
    float
        kg. What was harvested before the store's first load, or in no load, is not in it.
    """
    since_s = _measured_at_s(parameters)
    if since_s is None:
        return 0.0
    found = 0.0
    for load in loads:
        is_open = totals.load_open and load.number == totals.load_number
        mass_kg, end_s = (totals.load_kg, now_s) if is_open else (load.mass_kg, load.ended_s)
        if load.started_s is None or end_s is None or not utc.EARLIEST_BUS_TIME_S < load.started_s <= end_s:
            continue
        if load.started_s >= since_s:
            found += mass_kg
        elif end_s > since_s:
            found += mass_kg * (end_s - since_s) / (end_s - load.started_s)
    return found


def _measured_at_s(parameters: ParameterSet) -> float | None:
    for key in ("loads_until", "date"):
        try:
            return utc.read(parameters.provenance[key]).timestamp()
        except (KeyError, ValueError, OverflowError):
            continue
    return None

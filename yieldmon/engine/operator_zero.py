"""The operator's zero calibration and its undo, with the effect of both on the other parts."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from yieldmon.engine.mass.budget import EMPTY
from yieldmon.engine.mass.load_summary import LoadEvents
from yieldmon.engine.mass.missed_mass import NO_LOAD, MissedMass
from yieldmon.engine.parts import Parts
from yieldmon.engine.remeasured_budgets import remeasured_budgets


def calibrate(parts: Parts, *, despite_signs: bool) -> bool:
    """See `Monitor.calibrate_zero`."""
    zero, against = parts.measurement.zero, bool(parts.measurement.signs_against_zero)
    goes_on = zero.calibrate(against_signs=against, despite_signs=despite_signs)
    if not goes_on:
        parts.since_zero.clear()
    return goes_on


def undo(parts: Parts) -> tuple[dict[int, MissedMass], LoadEvents]:
    """See `Monitor.undo_zero`."""
    before, estimator, totals = parts.measurement.zero.before, parts.updater.estimator, parts.loads.totals
    if before is None:
        raise ValueError("there is no zero calibration by an operator that could be undone")
    missed = parts.since_zero.missed(before.zero_mv, estimator, parts.loads.dry_kg, partial(remeasured_budgets, parts))
    open_load = totals.load_number if totals.load_open else NO_LOAD
    unseen, since = parts.since_zero.remeasured_unseen(before.zero_mv, estimator, open_load)
    nothing = MissedMass(budget=EMPTY)
    missed |= {number: replace(missed.get(number, nothing), unseen=change) for number, change in unseen.items()}
    parts.since_zero.clear()
    parts.measurement.undo_zero()
    parts.updater.masses.zero_undone()
    return missed, parts.loads.correct(missed, since)

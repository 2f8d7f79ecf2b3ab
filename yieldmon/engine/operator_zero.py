"""The operator's zero calibration across the parts: what is kept for an undo, and the mass that an undo gives back."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from yieldmon.engine.budget_again import budgets
from yieldmon.engine.mass.budget import EMPTY
from yieldmon.engine.mass.load_summary import LoadEvents
from yieldmon.engine.mass.missed_mass import NO_LOAD, MissedMass
from yieldmon.engine.parts import Parts
from yieldmon.physics.machine import RPM


def calibrate(parts: Parts, *, despite_signs: bool) -> bool:
    """See `Monitor.calibrate_zero`."""
    zero, against = parts.measurement.zero, bool(parts.measurement.signs_against_zero)
    goes_on = zero.calibrate(against_signs=against, despite_signs=despite_signs)
    if not goes_on:
        parts.since_zero.clear()
    return goes_on


def undo(parts: Parts) -> tuple[dict[int, MissedMass], LoadEvents]:
    """See `Monitor.undo_zero`."""
    zero, settings = parts.measurement.zero, parts.settings
    known = zero.before
    if known is None:
        raise ValueError("there is no zero calibration by an operator that could be undone")
    gain, on_n, least = parts.machine.sensor.gain_n_per_mv, settings.gate.grain_on_n, settings.windows.min_coverage
    found = parts.since_zero.missed(
        known.zero_mv, parts.updater.estimator, gain, on_n, least, parts.loads.dry_kg, partial(budgets, parts)
    )
    totals, turning_rad_s = parts.loads.totals, settings.gate.min_turning_rpm * RPM
    open_load = totals.load_number if totals.load_open else NO_LOAD
    unseen, since = parts.since_zero.unseen_again(
        known.zero_mv, parts.updater.estimator, gain, on_n, least, turning_rad_s, open_load
    )
    nothing = MissedMass(budget=EMPTY)
    found |= {number: replace(found.get(number, nothing), unseen=change) for number, change in unseen.items()}
    parts.since_zero.clear()
    parts.measurement.undo_zero()
    parts.updater.masses.zero_undone()
    return found, parts.loads.correct(found, since)

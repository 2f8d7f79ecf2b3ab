"""A monitor that goes on from another one: after a start from what the store remembers, after a reload from the one before."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.monitor import Monitor
from yieldmon.estimation.parameter_origin import ParameterOrigin
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.service.assembly import calibration_age_s, monitor_of
from yieldmon.service.config.configuration import Configuration
from yieldmon.service.history.grain_since import grain_since_kg
from yieldmon.service.history.memory import Memory
from yieldmon.service.history.reference_loads import reference
from yieldmon.service.storage.batch import Load
from yieldmon.utc import EARLIEST_BUS_TIME_S


def resume(monitor: Monitor, memory: Memory, origin: ParameterOrigin, configured: ParameterSet, now_s: float) -> None:
    """Let a new monitor go on from what the store remembers.

    origin: of its parameters, FILE or STORE. configured: the parameters as their file has them. now_s: Unix
    time.
    """
    if memory.engine is None:
        monitor.set_estimator(monitor.estimator, calibration_age_s(configured, now_s))
        return
    age_s = memory.engine.calibration_age_s
    if origin is ParameterOrigin.FILE:
        age_s = calibration_age_s(configured, now_s)
    elif age_s is not None and memory.saved_s >= EARLIEST_BUS_TIME_S:
        # How long the computer was off is not known where its clock was not set.
        age_s += max(0.0, now_s - memory.saved_s)
    monitor.restore(replace(memory.engine, calibration_age_s=age_s))
    if origin is ParameterOrigin.FILE:
        since_kg = grain_since_kg(configured, memory.loads, memory.engine.totals, now_s)
        monitor.set_estimator(monitor.estimator, age_s, since_kg)
    monitor.remember_since_zero(memory.since_zero)
    for stored in memory.ticketed if origin is ParameterOrigin.STORE else ():
        found = reference(stored, monitor.machine, monitor.settings)
        monitor.know_load(found.summary, found.seconds)
    monitor.remember_tickets(memory.engine.tickets)


def successor(
    before: Monitor,
    configuration: Configuration,
    fresh: ParameterSet | None,
    now_s: float,
    more: Totals | None = None,
    loads: Iterable[Load] = (),
) -> Monitor:
    """A monitor with another configuration that goes on from the one before. fresh: parameters of a file read anew; None: those
    in use stay. now_s: Unix time. more: masses that another monitor measured, which join its own. loads: all that are known."""
    state = before.snapshot()
    if more is not None:
        state = replace(state, totals=state.totals.with_more(more))
    if fresh is not None:
        state = replace(state, calibration_age_s=calibration_age_s(fresh, now_s))
    monitor = monitor_of(configuration, fresh or before.estimator.parameters, waveform_later=True)
    monitor.restore(state)
    if fresh is not None:
        since_kg = grain_since_kg(fresh, loads, state.totals, now_s)
        monitor.set_estimator(monitor.estimator, state.calibration_age_s, since_kg)
    monitor.take_over(before, tickets=fresh is None)
    if before.sweep.schedule.requested or before.sweep.visiting:
        monitor.request_sweep()
    return monitor

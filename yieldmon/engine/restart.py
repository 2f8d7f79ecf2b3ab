"""The state of the parts over a restart, as an `EngineState` and back, and what a reload takes over beyond it."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

from yieldmon.engine.mass.unseen import FlowAtStop
from yieldmon.engine.parts import Parts
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass, Weighing
from yieldmon.engine.state import EngineState, TicketState, ZeroUndo


def snapshot(parts: Parts, windows: int) -> EngineState:
    """The state after this many windows."""
    updater, sweep, totals = parts.updater, parts.plate.sweep, parts.loads.totals
    calibrator = updater.calibrator
    return EngineState(
        totals=totals,
        zero=parts.measurement.zero.state,
        windows=windows,
        sweep_id=sweep.sweep_id,
        sweep_due_in_s=sweep.schedule.remaining_s(parts.clock.now_s or 0.0),
        calibration_age_s=updater.calibration_age_s,
        parameter_version=updater.estimator.parameters.version,
        disagreement=updater.disagreement.state,
        scale_alarm=updater.scale_alarm.state,
        calibrator=calibrator.snapshot(parts.bus_now, totals.total_kg) if calibrator is not None else None,
        zero_undo=_zero_undo(parts),
        tickets=updater.masses.tickets.states,
        moisture=parts.flow_meter.moisture.state,
        closed=parts.loads.closed_states,
        at_stop=_at_stop(parts),
        since_empty=parts.loads.since_empty_states,
    )


def restore(parts: Parts, state: EngineState) -> None:
    """Continue from a state; to be called before the first frame."""
    if state.zero_undo is not None:
        parts.measurement.zero.resume(state.zero_undo.before, suspect=state.zero_undo.suspect)
        for number, kg in state.zero_undo.by_scale:
            parts.since_zero.add_scale(number, kg)
    parts.loads.restore(state.totals, state.at_stop, state.since_empty)
    parts.measurement.zero.restore(state.zero)
    parts.plate.restore(state.sweep_id, state.sweep_due_in_s, parts.settings.sweep.first_after_s)
    updater, parameters = parts.updater, parts.updater.estimator.parameters
    updater.restore_age(state.calibration_age_s)
    # The rest of the state belongs to the parameters in use then; others may have come from outside meanwhile.
    if state.parameter_version == parameters.version:
        updater.disagreement.restore(state.disagreement, parameters)
        updater.judge_model(weighed=state.calibrator is not None and bool(state.calibrator.weighed))
        parts.loads.resume_closed(state.closed, parameters.version)
        parts.loads.resume_share(updater.load_error, parameters.version, parts.machine.home_plate_angle_rad)
        if state.moisture is not None:
            parts.flow_meter.moisture.restore(state.moisture)
        updater.scale_alarm.restore(state.scale_alarm)
        if state.calibrator is not None and updater.calibrator is not None:
            updater.calibrator.restore(state.calibrator, parameters, state.totals.total_kg)


def remember_tickets(parts: Parts, tickets: Sequence[TicketState]) -> None:
    """Take the tickets of the state, once the state is restored and their loads are known; see `Monitor.remember_tickets`."""
    updater = parts.updater
    of_crop: dict[str | None, list[tuple[ReferenceMass, bool]]] = {None: []}
    for ticket in tickets:
        weighing = Weighing(ticket.load_number, ticket.weighed_kg, ticket.std_dev_kg, ticket.common_kg)
        known = updater.masses.tickets.of_earlier_load(weighing)
        if known is not None:
            of_crop.setdefault(ticket.crop, []).append((known, ticket.waits))
    for crop, pairs in of_crop.items():
        masses, waiting = [a for a, _ in pairs], [a for a, waits in pairs if waits]
        if crop is None:
            updater.remember_tickets(masses, waiting)
        else:
            updater.masses.tickets.remember(masses, waiting, crop)


def take_over(parts: Parts, before: Parts, *, tickets: bool) -> None:
    """Take over from the parts in use until now what the state does not contain; see `Monitor.take_over`."""
    parts.since_zero.add(before.since_zero.seconds)
    parts.measurement.go_on_with(before.measurement)
    if parts.waveform is not None and before.waveform is not None:
        parts.waveform.go_on_with(before.waveform)
    if tickets:
        parts.updater.take_tickets_of(before.updater)


def _at_stop(parts: Parts) -> FlowAtStop | None:
    until_s = parts.loads.counted_until_s
    return parts.loads.at_stop(parts.clock.bus_time(until_s) if isfinite(until_s) else until_s)


def _zero_undo(parts: Parts) -> ZeroUndo | None:
    zero = parts.measurement.zero
    if zero.before is None:
        return None
    return ZeroUndo(zero.before, zero.suspect, tuple(sorted(parts.since_zero.by_scale.items())))

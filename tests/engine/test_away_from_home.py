"""What sweeps measure away from home is taken off the flow there, and off the forces that a weighed mass is held against."""

from __future__ import annotations

from dataclasses import replace
from math import exp, radians

import numpy as np
import pytest

from yieldmon.engine.mass.budget import EMPTY
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.results import frames_in, records_in
from yieldmon.engine.self_calibration.load_forces import LoadForces
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass, ReferenceSource
from yieldmon.engine.self_calibration.reference_mass_inputs import weighed_mass
from yieldmon.engine.self_calibration.ticket_check import departure_of
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.self_calibration.angle_error import NO_ERROR, NODES_RAD, AngleError
from yieldmon.physics.machine import RPM
from yieldmon.physics.model import ForwardModel
from yieldmon.plant.combine import VirtualCombine
from yieldmon.plant.effects import Effects, PlateFriction
from yieldmon.plant.profiles import FlowProfile, Steady
from yieldmon.plant.scenario import Scenario
from yieldmon.resources import shipped
from yieldmon.service.assembly import build_monitor
from yieldmon.service.config import configuration

LOADED = configuration.load(shipped("config/yieldmon.yaml"))
HOME_RAD = LOADED.machine.home_plate_angle_rad


def harvested(friction: float, duration_s: float) -> tuple[list[WindowRecord], VirtualCombine]:
    """Seconds of steady grain with a sweep every 30 s, of a combine with friction on its plate."""
    sweep = replace(LOADED.engine.sweep, enabled=True, first_after_s=20.0, interval_s=30.0)
    monitor = build_monitor(replace(LOADED.engine, sweep=sweep), LOADED.machine, LOADED.parameters, LOADED.calibrator)
    pieces = [Steady(kind="steady", duration_s=8.0, flow_kg_s=0.0), Steady(kind="steady", duration_s=duration_s, flow_kg_s=11.0)]
    effects = Effects().model_copy(update={"plate_friction": PlateFriction(friction=friction)} if friction else {})
    flow = FlowProfile(pieces=pieces, variation_pct=1.5, variation_time_s=20.0, smoothing_s=0.7)
    combine = VirtualCombine(Scenario(duration_s=duration_s, effects=effects, flow=flow), LOADED.machine, 4)
    records: list[WindowRecord] = []
    for frame in combine.frames_until(duration_s):
        found = monitor.feed(frame)
        for answer in frames_in(found):
            combine.handle(answer)
        records += records_in(found)
    return records, combine


def against_home(records: list[WindowRecord], combine: VirtualCombine, begin_s: float, end_s: float) -> float:
    """Mean error of the flow of a plate at rest away from home, less that at home, relative."""
    errors: dict[bool, list[float]] = {True: [], False: []}
    for record in records:
        if begin_s < record.time_s < end_s and record.plate_still and record.mass_flow_kg_s > 4.0:
            (before, after) = combine.delivered_kg(np.array([record.time_s - 1.06, record.time_s - 0.06]))
            errors[abs(record.plate_angle_rad - HOME_RAD) < 0.02].append(record.mass_flow_kg_s / (after - before) - 1.0)
    assert min(map(len, errors.values())) > 5
    return float(np.mean(errors[False]) - np.mean(errors[True]))


def test_flow_away_from_home_agrees_with_that_at_home_once_sweeps_have_measured_there() -> None:
    records, combine = harvested(0.2, 260.0)
    first, last = against_home(records, combine, 25.0, 75.0), against_home(records, combine, 170.0, 260.0)
    assert first > 0.08
    assert abs(last) < 0.25 * first
    swept = {record.sweep_id: max(r.sweep_step for r in records if r.sweep_id == record.sweep_id) for record in records}
    assert len(set(swept.values()) - {-1}) <= 2, "what is taken off ends no sweep"


ERROR = AngleError.of(np.zeros((NODES_RAD.size,) * 2), HOME_RAD, np.interp(NODES_RAD, [radians(40.0), HOME_RAD], [-0.2, 0.0]))


def ticket(forces_n: tuple[float, float]) -> ReferenceMass:
    """Of a load of 100 s at home and as many at 40 deg."""
    column = np.ones(2)
    forces = LoadForces(
        100.0 * column, np.array(forces_n), np.array([HOME_RAD, radians(40.0)]), 400.0 * RPM * column, 15.0 * column
    )
    return ReferenceMass(ReferenceSource.TICKET, 0.0, 200.0, 2000.0, 4.0, 2000.0, True, 1, EMPTY, forces=forces)


def test_a_ticket_is_held_against_forces_without_what_sweeps_have_measured() -> None:
    parameters = LOADED.parameters
    model = ForwardModel(LOADED.machine, parameters.effects)
    loop = OpenLoop(model, parameters)
    at = np.array([HOME_RAD, radians(40.0)]), np.full(2, 400.0 * RPM)
    low, high = np.ones(2), np.full(2, 400.0)
    for _ in range(60):
        middle = 0.5 * (low + high)
        flow = loop.invert(middle, *at)
        low, high = np.where(flow < 10.0, middle, low), np.where(flow < 10.0, high, middle)
    seen = ticket((float(low[0]), float(low[1]) * exp(0.2)))
    spans = [(float("inf"), parameters)]
    assert weighed_mass(seen, model, spans, 0.0).force_n == pytest.approx(seen.forces.force_n, rel=1e-12)
    assert weighed_mass(seen, model, spans, 0.0, ERROR).force_n == pytest.approx(low, rel=1e-9)
    off, _ = departure_of(seen, loop, 0.0, NO_ERROR)
    right, _ = departure_of(seen, loop, 0.0, ERROR)
    assert off < -0.05
    assert right == pytest.approx(0.0, abs=1e-3)

"""Profiles, elevator, actuator, sensor, tank and field, each by itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from yieldmon.frames import PLATE_ACTUATOR_COMMAND, ActuatorState, CommandMode, Frame, ScaleStatus, SensorStatus
from yieldmon.physics.machine import RPM, ImpactSensor, Machine
from yieldmon.plant import elevator, profiles
from yieldmon.plant.actuator import ActuatorFault, ActuatorSettings, PlateActuator
from yieldmon.plant.elevator import ElevatorSettings
from yieldmon.plant.field import FieldSettings, Track
from yieldmon.plant.profiles import SAMPLE_INTERVAL_S, FlowProfile, Harvest
from yieldmon.plant.sensor import ImpactCell, SensorFault, SensorSettings
from yieldmon.plant.tank import Tank, TankSettings

SEED = 7
MACHINE = Machine()


def profile(*pieces, **keys):
    return FlowProfile.model_validate({"pieces": list(pieces), "variation_pct": 0.0, "smoothing_s": 0.0} | keys)


def sampled(*pieces, duration_s=60.0, **keys):
    return profiles.harvest(profile(*pieces, **keys), duration_s, np.random.default_rng(SEED))


def at(harvest, time_s):
    return harvest.flow_kg_s[round(time_s / SAMPLE_INTERVAL_S)]


@pytest.mark.parametrize(
    ("piece", "expected"),
    [
        ({"kind": "steady", "duration_s": 60, "flow_kg_s": 7}, {0: 7, 30: 7, 59: 7}),
        ({"kind": "ramp", "duration_s": 60, "from_kg_s": 0, "to_kg_s": 12}, {15: 3, 30: 6, 45: 9}),
        ({"kind": "step", "duration_s": 60, "flows_kg_s": [2, 0, 5]}, {10: 2, 30: 0, 50: 5}),
        (
            {"kind": "oscillating", "duration_s": 60, "mean_kg_s": 4, "amplitude_kg_s": 6, "period_s": 40},
            {10: 10, 30: 0, 40: 4},
        ),
        ({"kind": "off", "duration_s": 60}, {1: 0, 59: 0}),
    ],
    ids=lambda value: value.get("kind") if isinstance(value, dict) else None,
)
def test_pieces_of_flow(piece, expected):
    harvest = sampled(piece)
    for time, flow in expected.items():
        assert at(harvest, time) == pytest.approx(flow, abs=0.01)


def test_pieces_follow_each_other_and_begin_again():
    harvest = sampled({"kind": "steady", "duration_s": 10, "flow_kg_s": 5}, {"kind": "off", "duration_s": 5}, duration_s=40.0)
    assert [at(harvest, t) for t in (5, 12, 20, 27)] == [5.0, 0.0, 5.0, 0.0]
    assert not harvest.driven[1200]
    assert harvest.driven[500]


def test_a_smoothed_step_rises_with_its_time_constant_and_a_stop_ends():
    harvest = sampled(
        {"kind": "steady", "duration_s": 10, "flow_kg_s": 0},
        {"kind": "steady", "duration_s": 20, "flow_kg_s": 10},
        {"kind": "steady", "duration_s": 30, "flow_kg_s": 0},
        smoothing_s=2.0,
    )
    assert at(harvest, 12.0) == pytest.approx(10.0 * (1.0 - np.exp(-1.0)), rel=0.01)
    assert at(harvest, 58.0) == 0.0


def test_a_harvest_day_has_passes_headlands_and_stops():
    harvest = sampled(
        {
            "kind": "stop-and-go",
            "duration_s": 3600,
            "flow_kg_s": 10,
            "pass_s": 100,
            "headland_s": 20,
            "unload_every": 3,
            "unload_s": 80,
        },
        duration_s=3600.0,
    )
    edges = np.flatnonzero(np.diff(harvest.working.astype(int)))
    pauses = np.diff(edges)[1::2] * SAMPLE_INTERVAL_S if harvest.working[0] else np.diff(edges[1:])[::2] * SAMPLE_INTERVAL_S
    assert 15 < len(pauses) < 35
    assert pauses.min() >= 15.0
    assert sum(pauses > 60.0) == pytest.approx(len(pauses) / 3, abs=2)


def test_slow_variation_has_its_size():
    harvest = sampled({"kind": "steady", "duration_s": 10, "flow_kg_s": 10}, duration_s=5000.0, variation_pct=4.0)
    assert np.std(harvest.flow_kg_s) == pytest.approx(0.4, rel=0.15)


def steady_harvest(flow, seconds=60.0):
    count = round(seconds / SAMPLE_INTERVAL_S) + 1
    return Harvest(np.full(count, float(flow)), np.full(count, flow > 0), np.ones(count, dtype=bool))


QUIET = ElevatorSettings(noise_pct=0.0)


def test_speed_droops_with_load():
    run = elevator.run(QUIET, MACHINE, steady_harvest(25.0), 0.0, np.random.default_rng(SEED))
    assert run.speed_rad_s[-1] == pytest.approx(400.0 * RPM * 0.97, rel=1e-9)


def loaded(flow, slip=0.0, full_kg=5.0, seconds=60.0):
    harvest = steady_harvest(flow, seconds)
    run = elevator.run(QUIET, MACHINE, harvest, slip, np.random.default_rng(SEED))
    return run, elevator.paddles(run, harvest, MACHINE, slip_share=slip, lag_s=0.08, first_gap=0.3, full_paddle_kg=full_kg)


def test_paddles_come_at_the_pattern_of_the_chain_and_share_the_flow_by_their_gaps():
    run, paddles = loaded(10.0)
    gaps = np.diff(paddles.time_s) * run.speed_rad_s[-1] * MACHINE.sprocket_pitch_radius_m
    np.testing.assert_allclose(sorted(set(np.round(gaps[3:], 6))), MACHINE.paddle_spacings_m, atol=1e-4)
    np.testing.assert_allclose(
        paddles.mass_kg[5:-5] / gaps[4:-5], 10.0 / (run.speed_rad_s[-1] * MACHINE.sprocket_pitch_radius_m), rtol=2e-3
    )


def test_slip_slows_the_paddles_and_loads_them_more():
    _, straight = loaded(10.0)
    _, slipping = loaded(10.0, slip=0.1)
    assert len(slipping.time_s) == pytest.approx(0.9 * len(straight.time_s), abs=1.5)
    assert slipping.mass_kg[20:-5].mean() == pytest.approx(straight.mass_kg[20:-5].mean() / 0.9, rel=0.01)


@given(st.floats(0.5, 1.2))
@settings(max_examples=10)
def test_what_a_paddle_cannot_hold_waits_and_is_not_lost(full_kg):
    _, free = loaded(10.0)
    harvest = steady_harvest(10.0)
    harvest.flow_kg_s[2000:] = 0.0
    run = elevator.run(QUIET, MACHINE, harvest, 0.0, np.random.default_rng(SEED))
    held, unlimited = (
        elevator.paddles(run, harvest, MACHINE, slip_share=0.0, lag_s=0.08, first_gap=0.3, full_paddle_kg=kg)
        for kg in (full_kg, 99.0)
    )
    assert held.mass_kg.max() <= full_kg
    assert held.mass_kg.sum() == pytest.approx(unlimited.mass_kg.sum(), rel=1e-9)
    assert free.mass_kg.max() > 0.8


def actuator(fault=None, **keys):
    plate = PlateActuator(ActuatorSettings(feedback_noise_deg=0.0, **keys), MACHINE, np.random.default_rng(SEED))
    plate.fault = fault
    return plate


def command(angle, mode=CommandMode.GO_TO_ANGLE):
    return Frame(0.0, PLATE_ACTUATOR_COMMAND, {"TargetPlateAngle": angle, "CommandMode": int(mode), "CommandCounter": 0})


def drive(plate, frame, seconds=5.0, step=0.02, repeat=True):
    angles = []
    for k in range(round(seconds / step)):
        if repeat or k == 0:
            plate.command(frame, k * step)
        angles.append(plate.step((k + 1) * step, step))
    return np.array(angles)


def test_the_plate_reaches_its_target_within_the_rate():
    angles = drive(actuator(rate_deg_s=10.0, lag_s=0.1), command(50.0))
    assert angles[-1] == pytest.approx(50.0, abs=0.05)
    assert np.abs(np.diff(angles, prepend=70.0)).max() <= 10.0 * 0.02 + 1e-12
    assert angles[round(1.0 / 0.02) - 1] == pytest.approx(60.0, abs=0.3)


@pytest.mark.parametrize("target", [39.0, 91.0, -5.0, 300.0])
def test_a_target_outside_the_range_is_not_followed(target):
    assert drive(actuator(), command(target))[-1] == 70.0


def test_home_and_release():
    plate = actuator()
    drive(plate, command(50.0))
    assert drive(plate, command(0.0, CommandMode.GO_HOME))[-1] == pytest.approx(70.0, abs=0.05)
    halfway = drive(plate, command(40.0), seconds=1.0)[-1]
    assert drive(plate, command(40.0, CommandMode.RELEASE))[-1] == pytest.approx(halfway)


def test_the_plate_stops_when_commands_stop():
    angles = drive(actuator(command_timeout_s=1.0), command(40.0), repeat=False)
    assert angles[-1] == pytest.approx(60.0, abs=0.5)


@pytest.mark.parametrize(
    ("fault", "plate_deg", "shown_deg", "state"),
    [
        (None, 60.0, 60.0, ActuatorState.MOVING),
        (ActuatorFault.STUCK, 70.0, 70.0, ActuatorState.MOVING),
        (ActuatorFault.SLOW, 69.0, 69.0, ActuatorState.MOVING),
        (ActuatorFault.LYING, 70.0, 40.0, ActuatorState.IDLE),
        (ActuatorFault.FAULT, 70.0, 70.0, ActuatorState.FAULT),
        (ActuatorFault.MANUAL, 70.0, 70.0, ActuatorState.MANUAL),
    ],
)
def test_actuator_faults_one_second_after_a_command(fault, plate_deg, shown_deg, state):
    plate = actuator(fault, lag_s=0.01)
    assert drive(plate, command(40.0), seconds=1.0)[-1] == pytest.approx(plate_deg, abs=0.3)
    shown, reported = plate.feedback()
    assert shown == pytest.approx(shown_deg, abs=0.3)
    assert reported == state


def test_a_silent_actuator_moves_and_says_nothing_and_a_noisy_one_scatters():
    silent = actuator(ActuatorFault.SILENT)
    assert drive(silent, command(60.0))[-1] == pytest.approx(60.0, abs=0.1)
    assert silent.feedback() is None
    noisy = actuator(ActuatorFault.NOISY)
    assert np.std([noisy.feedback()[0] for _ in range(400)]) == pytest.approx(1.0, rel=0.15)


def cell(nonlinearity=0.0, **keys):
    return ImpactCell(SensorSettings(**keys), ImpactSensor(), nonlinearity)


def test_the_cell_shows_all_of_an_impulse_at_4448_n_per_10_volts():
    force = np.zeros(400)
    force[50] = 1000.0
    shown = cell().samples_mv(force, np.full(400, 500.0), None)
    assert (shown - 500.0).sum() * 0.4448 == pytest.approx(1000.0, rel=1e-9)
    assert shown.argmax() > 50


def test_blocks_join_without_a_seam():
    force = np.random.default_rng(SEED).uniform(0, 500, 200)
    whole, parts = cell(), cell()
    background = np.full(200, 500.0)
    joined = [parts.samples_mv(f, b, None) for f, b in zip(np.split(force, 10), np.split(background, 10), strict=True)]
    np.testing.assert_allclose(np.concatenate(joined), whole.samples_mv(force, background, None), rtol=1e-12)


def test_saturation_and_sensor_faults():
    sensor = cell(response_s=0.0)
    force, background = np.linspace(0.0, 3000.0, 20), np.full(20, 500.0)
    assert sensor.samples_mv(force, background, None).max() == 4000.0
    assert sensor.status(4000.0, None) == SensorStatus.OVER_RANGE
    assert sensor.status(3999.5, None) == SensorStatus.OK
    stuck = [sensor.samples_mv(force, background, SensorFault.STUCK) for _ in range(2)]
    assert np.ptp(np.concatenate(stuck)) == 0.0
    assert sensor.samples_mv(force, background, SensorFault.SATURATED).min() == 4000.0
    assert sensor.status(0.0, SensorFault.FAULT) == SensorStatus.FAULT


def test_a_nonlinear_cell_shows_less_at_high_force():
    straight, bent = cell(response_s=0.0), cell(0.1, response_s=0.0)
    force, background = np.array([0.0, 100.0, 1000.0]), np.zeros(3)
    ratio = bent.samples_mv(force, background, None)[1:] / straight.samples_mv(force, background, None)[1:]
    np.testing.assert_allclose(ratio, 1.0 - 0.1 * force[1:] / (4000.0 * 0.4448), rtol=1e-12)


def test_the_tank_fills_and_empties_at_a_stop():
    tank = Tank(TankSettings(unload_from_kg=500.0, unload_kg_s=100.0))
    for second in range(60):
        tank.step(second, 10.0, working=True)
    assert tank.mass_kg == pytest.approx(600.0)
    for second in range(60, 80):
        tank.step(second, 0.0, working=False)
    assert tank.mass_kg == 0.0
    assert [(load.time_s, load.mass_kg) for load in tank.loads] == [(65, pytest.approx(600.0))]


def test_the_scale_is_unstable_while_working():
    tank, rng = (
        Tank(TankSettings(scale_moving_noise_kg=50.0, scale_noise_kg=2.0, scale_span_error_pct=1.0)),
        np.random.default_rng(SEED),
    )
    tank.step(1.0, 1000.0, working=True)
    moving = [tank.reading(True, rng) for _ in range(300)]
    still = [tank.reading(False, rng) for _ in range(300)]
    assert {status for _, status in moving} == {ScaleStatus.UNSTABLE}
    assert {status for _, status in still} == {ScaleStatus.STABLE}
    assert np.std([mass for mass, _ in moving]) == pytest.approx(50.0, rel=0.15)
    assert np.mean([mass for mass, _ in still]) == pytest.approx(1010.0, abs=0.5)


def test_passes_run_north_and_south_one_swath_apart():
    track = Track(FieldSettings(latitude_deg=0.0, longitude_deg=0.0, ground_speed_km_h=7.2, swath_m=9.0))
    north = [track.step(1.0, True) for _ in range(100)]
    for _ in range(30):
        turned = track.step(1.0, False)
    south = [track.step(1.0, True) for _ in range(100)]
    assert north[-1].latitude_deg * 111_195.0 == pytest.approx(200.0)
    assert turned.longitude_deg * 111_195.0 == pytest.approx(9.0)
    assert turned.ground_speed_km_h == 0.0
    assert (north[0].bearing_deg, south[0].bearing_deg) == (0.0, 180.0)
    assert south[-1].latitude_deg == pytest.approx(0.0, abs=1e-9)

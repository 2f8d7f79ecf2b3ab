"""The virtual combine as the bus sees it."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from studies.facility.mean_force import shown_force_n
from yieldmon import frames
from yieldmon.bus.codec import Codec
from yieldmon.frames import ActuatorState, CommandMode, Frame, SensorStatus
from yieldmon.physics.machine import RPM, Machine
from yieldmon.plant.combine import TRUTH_COLUMNS, VirtualCombine
from yieldmon.plant.scenario import from_mapping

MACHINE = Machine()
STEP = {"kind": "step", "duration_s": 20, "flows_kg_s": [0, 12, 4, 20]}
QUIET = {
    "paddle_scatter_pct": 0,
    "sensor": {"noise_mv": 0, "drift_mv_per_sqrt_h": 0, "vibration_sprocket_n": 0, "vibration_paddle_n": 0},
    "elevator": {"noise_pct": 0},
    "actuator": {"feedback_noise_deg": 0},
}


def steady(flow):
    return {"pieces": [{"kind": "steady", "duration_s": 1000, "flow_kg_s": flow}], "variation_pct": 0}


def scenario(**values):
    return from_mapping({"duration_s": 20, "flow": {"pieces": [STEP]}} | values, "test")


@pytest.fixture
def combine(default_table):
    def make(seed=1, **values):
        return VirtualCombine(scenario(**values), MACHINE, seed, default_table)

    return make


def all_frames(vehicle):
    return list(vehicle.frames_until(1e9))


def samples_of(stream):
    return np.array([f.signals[f"Sample{k}"] for f in stream if f.message == frames.IMPACT_SENSOR_SAMPLES for k in range(4)])


def test_frames_come_at_their_rates_in_time_order_with_a_counter(combine):
    stream = all_frames(combine(frames={"position": True, "harvest_state": True}))
    assert Counter(f.message for f in stream) == {
        "ImpactSensorSamples": 5000,
        "ElevatorSpeed": 200,
        "PlateActuatorFeedback": 400,
        "HarvestState": 200,
        "GrainCondition": 20,
        "TankScale": 20,
        "VehiclePosition": 20,
        "VehicleDirectionSpeed": 20,
    }
    times = [f.time_s for f in stream]
    assert times == sorted(times)
    sensor = [f for f in stream if f.message == "ImpactSensorSamples"]
    assert [f.signals["SampleCounter"] for f in sensor] == [k % 256 for k in range(5000)]
    np.testing.assert_allclose(np.diff([f.time_s for f in sensor]), 0.004, atol=1e-9)


def test_every_frame_packs_into_the_dbc_and_back(combine):
    codec, sent = Codec(), all_frames(combine(frames={"position": True, "harvest_state": True}, duration_s=4))
    assert {"ImpactSensorSamples", "VehiclePosition", "HarvestState"} <= {frame.message for frame in sent}
    for frame in sent:
        again = codec.decode(codec.encode(frame))
        assert again.message == frame.message
        for name, value in frame.signals.items():
            assert again.signals[name] == pytest.approx(value, abs=0.26, rel=1e-3)


def test_the_same_seed_gives_the_same_frames_and_another_does_not(combine):
    first, again, other = (all_frames(combine(seed=s)) for s in (3, 3, 4))
    assert first == again
    assert first != other


@given(st.lists(st.floats(0.001, 3.0), min_size=1, max_size=25))
@settings(max_examples=10)
def test_how_it_is_advanced_does_not_matter(default_table, steps):
    whole = VirtualCombine(scenario(duration_s=6), MACHINE, 5, default_table)
    pieces = VirtualCombine(scenario(duration_s=6), MACHINE, 5, default_table)
    stream = []
    for time in [*np.cumsum(steps), 1e9]:
        stream += pieces.frames_until(float(time))
    assert stream == all_frames(whole)


def test_block_path_gives_the_same_samples(combine):
    block = combine().samples_until(1e9)
    np.testing.assert_array_equal(block.sample_mv, samples_of(all_frames(combine())))
    np.testing.assert_allclose(block.time_s, np.arange(1, 20001) * 1e-3, atol=1e-9)


def test_nothing_is_given_before_its_time(combine):
    vehicle = combine()
    assert max(f.time_s for f in vehicle.frames_until(3.0)) == pytest.approx(3.0)
    assert vehicle.time_s == pytest.approx(3.0)
    assert min(f.time_s for f in vehicle.frames_until(4.0)) > 3.0


def test_truth_columns_are_whole_and_flow_adds_up_to_mass_and_tank(combine):
    vehicle = combine(tank={"unload_from_kg": 101, "capacity_kg": 101, "unload_kg_s": 60})
    all_frames(vehicle)
    truth = vehicle.truth
    columns = truth.columns
    assert set(columns) == set(TRUTH_COLUMNS)
    assert {len(c) for c in columns.values()} == {20}
    np.testing.assert_allclose(np.cumsum(columns["mass_flow_kg_s"]), columns["total_mass_kg"], rtol=1e-12)
    emptied = sum(load.mass_kg for load in truth.loads)
    assert len(truth.loads) == 1
    assert columns["tank_mass_kg"][-1] + emptied == pytest.approx(columns["total_mass_kg"][-1], rel=1e-12)


def test_paddles_carry_what_flowed(combine):
    vehicle = combine(flow=steady(9.0), **QUIET)
    all_frames(vehicle)
    carried, total = vehicle.truth.paddles["mass_kg"].sum(), vehicle.truth.columns["total_mass_kg"][-1]
    assert carried == pytest.approx(total, abs=9.0 * 0.25)
    assert total == pytest.approx(9.0 * 20.0, abs=0.01)


def test_the_samples_hold_every_paddles_impulse(combine):
    pieces = [{"kind": "step", "duration_s": 20, "flows_kg_s": [0, 12, 4, 0]}]
    vehicle = combine(flow={"pieces": pieces}, **(QUIET | {"paddle_scatter_pct": 7}))
    voltage = vehicle.samples_until(1e9).sample_mv
    in_samples = (voltage - 500.0).sum() * MACHINE.sensor.gain_n_per_mv * 1e-3
    assert in_samples == pytest.approx(vehicle.truth.paddles["impulse_n_s"].sum(), rel=1e-9)
    assert vehicle.truth.columns["force_n"].sum() == pytest.approx(in_samples, rel=1e-9)


def test_steady_flow_shows_the_mean_force_of_its_throws(combine, default_table):
    vehicle = combine(flow=steady(14.0), **QUIET)
    run = vehicle.samples_until(1e9)
    speed = run.speed_rad_s[-1]
    period_ms = MACHINE.pattern_length_m / (speed * MACHINE.sprocket_pitch_radius_m) * 1e3
    first, last = 5000.0, 5000.0 + 80 * period_ms
    gathered = np.concatenate([[0.0], np.cumsum(run.sample_mv - 500.0)])
    mean = np.diff(np.interp([first, last], np.arange(len(gathered)), gathered))[0] / (last - first)
    expected = shown_force_n(
        default_table, vehicle.scenario.effects, np.float64(14.0), MACHINE.home_plate_angle_rad, speed, 0.008
    )
    assert mean * MACHINE.sensor.gain_n_per_mv == pytest.approx(float(expected), rel=5e-4)


def test_scatter_is_on_the_pulse_and_not_on_the_mass(combine):
    vehicle = combine(flow=steady(10.0), duration_s=120, **(QUIET | {"paddle_scatter_pct": 7}))
    vehicle.samples_until(1e9)
    paddles = vehicle.truth.paddles
    late = paddles["time_s"] > 5.0
    per_kg = paddles["impulse_n_s"][late] / paddles["mass_kg"][late]
    odd, even = per_kg[::2], per_kg[1::2]
    assert np.mean([odd.std() / odd.mean(), even.std() / even.mean()]) == pytest.approx(0.07, rel=0.1)
    assert paddles["mass_kg"][late][::2].std() < 0.002 * paddles["mass_kg"][late].mean()


def spectrum(voltage, frequency_hz):
    time = np.arange(len(voltage)) * 1e-3
    return 2.0 * abs(np.mean((voltage - voltage.mean()) * np.exp(-2j * np.pi * frequency_hz * time)))


def test_an_empty_elevator_shows_zero_noise_and_vibration(combine):
    sensor = {
        "zero_mv": 510,
        "noise_mv": 2,
        "drift_mv_per_sqrt_h": 0,
        "vibration_sprocket_n": 4,
        "vibration_paddle_n": 2,
    }
    vehicle = combine(flow=steady(0.0), sensor=sensor, elevator={"noise_pct": 0})
    voltage = vehicle.samples_until(1e9).sample_mv
    turn_hz = 400.0 / 60.0
    passing_hz = turn_hz * 2 * np.pi * MACHINE.sprocket_pitch_radius_m / MACHINE.paddle_spacing_m
    assert voltage.mean() == pytest.approx(510.0, abs=0.2)
    assert spectrum(voltage, turn_hz) * 0.4448 == pytest.approx(4.0, rel=0.05)
    assert spectrum(voltage, passing_hz) * 0.4448 == pytest.approx(2.0, rel=0.05)
    assert np.std(np.diff(voltage)) == pytest.approx(2.0 * np.sqrt(2.0), rel=0.1)


def command(target, time_s=0.0, mode=CommandMode.GO_TO_ANGLE):
    signals = {"TargetPlateAngle": target, "CommandMode": int(mode), "CommandCounter": 0}
    return Frame(time_s, frames.PLATE_ACTUATOR_COMMAND, signals)


def drive(vehicle, target, until_s):
    """Command at 10 Hz; the frames it answers with."""
    stream = []
    while vehicle.time_s < until_s - 1e-9:
        vehicle.handle(command(target, vehicle.time_s))
        stream += vehicle.frames_until(vehicle.time_s + 0.1)
    return stream


def shown_angles(stream):
    return [f.signals["PlateAngle"] for f in stream if f.message == frames.PLATE_ACTUATOR_FEEDBACK]


def test_a_commanded_plate_moves_and_the_force_follows(combine):
    vehicle = combine(flow=steady(14.0), **QUIET)
    list(vehicle.frames_until(5.0))
    stream = drive(vehicle, 50.0, 15.0)
    assert shown_angles(stream)[-1] == pytest.approx(50.0, abs=0.1)
    truth = vehicle.truth.columns
    assert truth["plate_angle_deg"][-1] == pytest.approx(50.0, abs=0.1)
    assert truth["force_n"][13] < 0.7 * truth["force_n"][4]


def test_other_messages_are_none_of_its_business(combine):
    vehicle = combine()
    vehicle.handle(Frame(0.0, frames.MASS_FLOW, {"MassFlowRate": 3.0}))
    assert all_frames(vehicle) == all_frames(combine())


def timed(kind, start_s=5.0, end_s=10.0):
    return [{"kind": kind, "start_s": start_s, "end_s": end_s}]


@pytest.mark.parametrize(
    ("kind", "true_deg", "shown_deg"),
    [("stuck", 70.0, 70.0), ("lying", 70.0, 50.0), ("slow", 66.0, 66.0), ("manual", 70.0, 70.0)],
)
def test_actuator_faults_under_command(combine, kind, true_deg, shown_deg):
    vehicle = combine(faults={"actuator": timed(kind)}, **QUIET)
    list(vehicle.frames_until(6.0))
    shown = shown_angles(drive(vehicle, 50.0, 10.0))
    assert shown[-1] == pytest.approx(shown_deg, abs=0.6)
    assert vehicle.truth.columns["plate_angle_deg"][-1] == pytest.approx(true_deg, abs=0.8)


def between(stream, message, start_s=5.0, end_s=10.0):
    return [f for f in stream if f.message == message and start_s + 0.021 < f.time_s < end_s]


def test_silent_and_faulty_actuators_in_frames(combine):
    assert between(all_frames(combine(faults={"actuator": timed("silent")})), frames.PLATE_ACTUATOR_FEEDBACK) == []
    faulty = between(all_frames(combine(faults={"actuator": timed("fault")})), frames.PLATE_ACTUATOR_FEEDBACK)
    assert {f.signals["ActuatorState"] for f in faulty} == {ActuatorState.FAULT}


def test_sensor_faults_in_frames(combine):
    name = frames.IMPACT_SENSOR_SAMPLES
    assert between(all_frames(combine(faults={"sensor": timed("silent")})), name) == []
    stuck = samples_of(between(all_frames(combine(faults={"sensor": timed("stuck")})), name))
    assert np.ptp(stuck) == 0.0
    saturated = between(all_frames(combine(faults={"sensor": timed("saturated")})), name)
    assert {f.signals["SensorStatus"] for f in saturated} == {SensorStatus.OVER_RANGE}
    broken = between(all_frames(combine(faults={"sensor": timed("fault")})), name)
    assert {f.signals["SensorStatus"] for f in broken} == {SensorStatus.FAULT}


def test_the_counter_goes_on_through_a_silence(combine):
    sensor = [f for f in all_frames(combine(faults={"sensor": timed("silent")})) if f.message == frames.IMPACT_SENSOR_SAMPLES]
    after = next(f for f in sensor if f.time_s > 9.9)
    assert after.signals["SampleCounter"] == (round(after.time_s / 0.004) - 1) % 256


@pytest.mark.parametrize(
    ("source", "message"),
    [("elevator_speed", "ElevatorSpeed"), ("grain_condition", "GrainCondition"), ("tank_scale", "TankScale")],
)
def test_messages_that_fall_silent_or_say_error(combine, source, message):
    silence = {"message": source, "start_s": 5.0, "end_s": 10.0}
    assert between(all_frames(combine(faults={"messages": [silence]})), message) == []
    spoken = between(all_frames(combine(faults={"messages": [silence | {"error": True}]})), message)
    assert spoken
    assert {value for f in spoken for value in f.signals.values()} == {frames.ERROR}


def test_zero_drifts_with_temperature(combine):
    warm = {
        "crop": {"temperature_degc": 10, "end_temperature_degc": 30},
        "sensor": {"temperature_mv_per_degc": 2.0, "drift_mv_per_sqrt_h": 0},
    }
    vehicle = combine(flow=steady(0.0), **warm)
    voltage = vehicle.samples_until(1e9).sample_mv
    assert voltage[-1000:].mean() - voltage[:1000].mean() == pytest.approx(2.0 * 19.0, rel=0.03)
    np.testing.assert_allclose(vehicle.truth.columns["zero_mv"][[9, 19]], [520.0, 540.0])


def test_drift_wanders_with_the_root_of_time(combine):
    ends = []
    for seed in range(60):
        vehicle = combine(seed=seed, flow=steady(0.0), sensor={"drift_mv_per_sqrt_h": 60.0}, duration_s=5)
        vehicle.samples_until(1e9)
        ends.append(vehicle.truth.columns["zero_mv"][-1] - 500.0)
    assert np.std(ends) == pytest.approx(60.0 * np.sqrt(6.0 / 3600.0), rel=0.25)


def test_a_stopped_elevator_has_no_pulses_and_no_speed(combine):
    pieces = [{"kind": "steady", "duration_s": 8, "flow_kg_s": 10}, {"kind": "off", "duration_s": 15}]
    vehicle = combine(flow={"pieces": pieces}, **QUIET)
    all_frames(vehicle)
    assert vehicle.truth.columns["elevator_speed_rpm"][-1] == 0.0
    assert vehicle.truth.columns["force_n"][-1] == 0.0
    assert vehicle.truth.columns["force_n"][5] > 50.0


@pytest.mark.parametrize(
    ("effects", "extra_n"),
    [
        ({"zero_offset": {"force_n": 3.0}}, 3.0),
        ({"plate_buildup": {"mass_kg": 1.0}}, 9.81 * np.sin(np.deg2rad(70)) * np.cos(np.deg2rad(70))),
    ],
)
def test_still_forces_add_to_the_samples(combine, effects, extra_n):
    plain = combine(flow=steady(5.0), **QUIET).samples_until(1e9).sample_mv
    more = combine(flow=steady(5.0), effects=effects, **QUIET).samples_until(1e9).sample_mv
    assert (more - plain)[1000:].mean() * 0.4448 == pytest.approx(extra_n, rel=1e-6)


def test_plate_angle_offset_is_in_the_truth_and_not_in_the_feedback(combine):
    vehicle = combine(effects={"plate_angle_offset": {"angle_deg": 3.0}}, **QUIET)
    assert shown_angles(all_frames(vehicle))[-1] == pytest.approx(70.0)
    assert vehicle.truth.columns["plate_angle_deg"][-1] == pytest.approx(73.0)


def test_chain_slip_brings_fewer_heavier_paddles_at_the_same_reported_speed(combine):
    plain, slipping = (
        combine(flow=steady(10.0), **QUIET),
        combine(flow=steady(10.0), effects={"chain_slip": {"share": 0.1}}, **QUIET),
    )
    for vehicle in (plain, slipping):
        vehicle.samples_until(1e9)
    assert len(slipping.truth.paddles["time_s"]) == pytest.approx(0.9 * len(plain.truth.paddles["time_s"]), abs=2)
    assert slipping.truth.columns["elevator_speed_rpm"][-1] == pytest.approx(plain.truth.columns["elevator_speed_rpm"][-1])
    assert slipping.truth.columns["force_n"][10] < plain.truth.columns["force_n"][10]


def test_moisture_runs_to_its_end(combine):
    vehicle = combine(crop={"moisture_pct": 20, "end_moisture_pct": 16, "moisture_noise_pct": 0})
    reported = [f.signals["Moisture"] for f in all_frames(vehicle) if f.message == frames.GRAIN_CONDITION]
    assert (reported[9], reported[-1]) == (pytest.approx(18.0), pytest.approx(16.0))
    assert vehicle.truth.columns["moisture_pct"][-1] == pytest.approx(16.0)


def test_the_plates_sensor_sees_pulses_at_the_reported_speed(combine):
    vehicle = combine(flow=steady(10.0), elevator={"speed_rpm": 480, "noise_pct": 0, "droop_pct_at_25_kg_s": 0})
    voltage = vehicle.samples_until(1e9).sample_mv[2000:18000]
    reported = vehicle.truth.columns["elevator_speed_rpm"][-1]
    pattern_hz = reported * RPM * MACHINE.sprocket_pitch_radius_m / MACHINE.pattern_length_m
    assert spectrum(voltage, 2 * pattern_hz) > 20.0 * spectrum(voltage, 2.3 * pattern_hz)

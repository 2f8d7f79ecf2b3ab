"""The fast paths against the 1 kHz path, and the season's account of itself."""

from __future__ import annotations

import csv
from dataclasses import replace

import numpy as np
import pytest

from studies.facility import facility
from studies.facility.mean_force import shown_force_n
from studies.season import season
from studies.season.season import SeasonSettings
from yieldmon.physics.machine import RPM, Machine
from yieldmon.plant.combine import VirtualCombine
from yieldmon.plant.pulse_table import Condition, PulseTable
from yieldmon.plant.scenario import Scenario, from_mapping
from yieldmon.plant.throw import throw

MACHINE = Machine()
SEED = 11
SHORT = SeasonSettings(hours=3.0)


@pytest.fixture(scope="module")
def short():
    return season.simulate(SHORT, MACHINE, seed=SEED)


def whole_pattern_means_n(vehicle):
    """Mean force over the whole paddle patterns that fit each second, from samples, as a careful reader would take it."""
    run = vehicle.samples_until(1e9)
    gathered = np.concatenate([[0.0], np.cumsum(run.sample_mv - 500.0)])
    means = []
    for second in range(5, len(run.sample_mv) // 1000):
        speed = run.speed_rad_s[second * 1000 : second * 1000 + 1000].mean()
        period = 1e3 * MACHINE.pattern_length_m / (speed * MACHINE.sprocket_pitch_radius_m)
        length = period * int(1000 / period)
        ends = second * 1000 + np.array([0.0, length])
        means.append(np.diff(np.interp(ends, np.arange(len(gathered)), gathered))[0] / length)
    return np.array(means) * MACHINE.sensor.gain_n_per_mv


@pytest.mark.parametrize("flow", [3.0, 12.0])
def test_window_noise_is_that_of_the_samples(default_table, flow):
    pieces = {"pieces": [{"kind": "steady", "duration_s": 1000, "flow_kg_s": flow}], "variation_pct": 0}
    values = {"duration_s": 400, "flow": pieces, "elevator": {"noise_pct": 0}, "sensor": {"drift_mv_per_sqrt_h": 0}}
    scenario = from_mapping(values, "test")
    means = whole_pattern_means_n(VirtualCombine(scenario, MACHINE, SEED, default_table))
    speed = np.float64(400.0 * RPM * (1.0 - 0.03 * flow / 25.0))
    sigma = facility.window_sigma_n(default_table, scenario, np.float64(flow), MACHINE.home_plate_angle_rad, speed, 1.0)
    assert np.std(means) == pytest.approx(float(sigma), rel=0.12)
    expected = shown_force_n(default_table, scenario.effects, np.float64(flow), MACHINE.home_plate_angle_rad, speed, 0.008)
    assert np.mean(means) == pytest.approx(float(expected), abs=4.0 * float(sigma) / np.sqrt(len(means)))


def test_mean_of_a_nonlinear_cell_is_that_of_the_samples(default_table):
    pieces = {"pieces": [{"kind": "steady", "duration_s": 1000, "flow_kg_s": 15}], "variation_pct": 0}
    quiet = {"noise_mv": 0, "drift_mv_per_sqrt_h": 0, "vibration_sprocket_n": 0, "vibration_paddle_n": 0}
    values = {"duration_s": 30, "flow": pieces, "elevator": {"noise_pct": 0}, "sensor": quiet, "paddle_scatter_pct": 0}
    bent = from_mapping(values | {"effects": {"cell_nonlinearity": {"share": 0.3}}}, "test")
    means = whole_pattern_means_n(VirtualCombine(bent, MACHINE, SEED, default_table))
    speed = np.float64(400.0 * RPM * (1.0 - 0.03 * 15.0 / 25.0))
    home = MACHINE.home_plate_angle_rad
    shown, straight = (
        float(shown_force_n(default_table, e, np.float64(15.0), home, speed, 0.008))
        for e in (bent.effects, from_mapping(values, "test").effects)
    )
    assert shown < 0.97 * straight
    assert np.mean(means[:20]) == pytest.approx(shown, rel=2e-3)


def test_facility_rows_are_throws_per_second_with_the_stated_scatter(default_table):
    scenario = from_mapping({}, "test")
    flows, angles, speeds = [2.0, 10.0, 20.0], [45.0, 70.0, 90.0], [350.0, 400.0]
    rows = facility.measure(scenario, MACHINE, flows, angles, speeds, trials=20, seed=SEED, table=default_table)
    assert {len(c) for c in rows.values()} == {3 * 3 * 2 * 20}
    for i in range(0, len(rows["trial"]), 61):
        speed = rows["elevator_speed_rpm"][i] * RPM
        chain = speed * MACHINE.sprocket_pitch_radius_m
        loads = rows["mass_flow_kg_s"][i] * np.array(MACHINE.paddle_spacings_m) / chain
        angle_rad = np.deg2rad(rows["plate_angle_deg"][i])
        pulses = throw(MACHINE, scenario.crop.grain, scenario.effects, loads, angle_rad, speed, cells=400)
        mean = pulses.impulse_n_s.sum() * chain / MACHINE.pattern_length_m
        assert rows["force_n"][i] == pytest.approx(mean, rel=1e-3, abs=4.0 * rows["sigma"][i])
    normal = (rows["force_n"].reshape(-1, 20) - rows["force_n"].reshape(-1, 20).mean(axis=1, keepdims=True)) / rows[
        "sigma"
    ].reshape(-1, 20)
    assert np.std(normal) == pytest.approx(np.sqrt(19 / 20), rel=0.1)


def test_facility_without_grain_reads_nothing(default_table):
    rows = facility.measure(from_mapping({}, "test"), MACHINE, [0.0], [40.0, 90.0], seed=SEED, table=default_table)
    assert np.abs(rows["force_n"]).max() < 4.0 * rows["sigma"].max()


def test_facility_is_repeatable_and_writes_its_table(default_table, tmp_path):
    measured = [
        facility.measure(from_mapping({}, "test"), MACHINE, [5.0], [70.0], seed=s, table=default_table)["force_n"][0]
        for s in (1, 1, 2)
    ]
    assert measured[0] == measured[1] != measured[2]
    rows = facility.measure(from_mapping({}, "test"), MACHINE, [5.0, 9.0], [70.0], table=default_table)
    facility.write_csv(tmp_path / "t.csv", rows)
    with open(tmp_path / "t.csv", newline="") as file:
        back = list(csv.DictReader(file))
    assert [float(row["force_n"]) for row in back] == pytest.approx(list(rows["force_n"]), rel=1e-5)
    assert list(back[0]) == ["plate_angle_deg", "mass_flow_kg_s", "elevator_speed_rpm", "trial", "force_n", "sigma"]


def test_the_season_is_as_long_and_as_varied_as_asked(short):
    working = short.mass_flow_kg_s > 0.0
    assert len(short.time_s) == 3 * 3600
    assert 0.8 < working.mean() < 0.99
    assert short.mass_flow_kg_s[working].min() >= 2.0
    assert short.mass_flow_kg_s.max() <= 22.0
    assert np.ptp(short.mass_flow_kg_s[working]) > 15.0
    assert short.moisture_pct[[0, len(short.time_s) // 2, -1]] == pytest.approx([14.0, 26.0, 16.0], abs=0.01)
    assert short.restitution[-1] < short.restitution[0]
    assert short.paddle_length_m[0] - short.paddle_length_m[-1] == pytest.approx(0.003, rel=1e-3)


def test_loads_share_the_season_out(short):
    loads = short.loads
    assert loads.start[0] == 0
    assert loads.end[-1] == len(short.time_s)
    np.testing.assert_array_equal(loads.start[1:], loads.end[:-1])
    assert loads.mass_kg.sum() == pytest.approx(short.mass_flow_kg_s.sum(), rel=1e-12)
    assert loads.mass_kg[:-1].min() >= 4000.0
    assert loads.mass_kg[:-1].max() <= 9025.0
    for number in (0, len(loads.start) - 1):
        window = short.load == number
        assert short.mass_flow_kg_s[window].sum() == pytest.approx(loads.mass_kg[number], rel=1e-12)


@pytest.mark.parametrize("window", [100, 4000, 9000])
def test_a_window_shows_the_throw_of_its_own_grain(short, window):
    window = int(np.flatnonzero(short.mass_flow_kg_s > 8.0)[np.searchsorted(np.flatnonzero(short.mass_flow_kg_s > 8.0), window)])
    condition = season.condition_at(SHORT, short.scenario, float(short.time_s[window] / short.time_s[-1]))
    speed = np.array([short.elevator_speed_rpm[window] * RPM])
    table = PulseTable(MACHINE, [Condition(0.0, condition.grain, condition.effects)])
    force = shown_force_n(table, short.effects, short.mass_flow_kg_s[[window]], np.deg2rad(60.0), speed, 0.008)
    shown, sigma = short.measure([window], 60.0)
    exact = force + sigma * short.noise[window] + short.zero_error_n[window]
    assert shown == pytest.approx(exact, rel=3e-3)


def test_the_same_window_has_the_same_noise_at_every_angle_and_each_call(short):
    windows = np.flatnonzero(short.mass_flow_kg_s > 5.0)[:50]
    first, again = short.measure(windows, 70.0)[0], short.measure(windows, np.full(50, 70.0))[0]
    np.testing.assert_array_equal(first, again)
    flat, sigma = short.measure(windows, 45.0)
    assert (flat < first).all()
    assert (sigma > 0.0).all()


def test_seasons_with_one_seed_are_one_season(short):
    first, again, other = (season.simulate(SHORT, MACHINE, seed=s, table=short.table) for s in (1, 1, 2))
    np.testing.assert_array_equal(first.mass_flow_kg_s, again.mass_flow_kg_s)
    np.testing.assert_array_equal(first.measure([7, 8], 70.0)[0], again.measure([7, 8], 70.0)[0])
    assert not np.array_equal(first.mass_flow_kg_s, other.mass_flow_kg_s)


@pytest.mark.parametrize(("exponent", "share"), [(1.0, 0.25), (2.0, 0.0625), (0.5, 0.5)])
def test_drift_follows_the_power_asked_for(exponent: float, share: float) -> None:
    settings = replace(SHORT, drift_exponent=exponent, moisture_pct=(14.0, 14.0, 14.0))
    begun, later = (season.condition_at(settings, Scenario(), progress) for progress in (0.0, 0.25))
    assert later.grain.friction / begun.grain.friction - 1.0 == pytest.approx(share * settings.friction_drift)
    assert later.grain.restitution / begun.grain.restitution - 1.0 == pytest.approx(share * settings.restitution_drift)
    assert later.effects.paddle_wear.length_mm == pytest.approx(share * settings.wear_mm)

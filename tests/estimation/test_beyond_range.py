"""Flows and forces outside the calibrated range: standard deviations that cover laws which are not the model's."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from yieldmon import api
from yieldmon.cli.main import main
from yieldmon.estimation.beyond_range import error_beyond
from yieldmon.estimation.parameters import CalibratedRange
from yieldmon.estimation.weighing.load_inputs import WeighedLoad
from yieldmon.estimation.weighing.loads import calibrate_loads

MODEL = api.ForwardModel(api.Machine(), ())
GRAIN = {"friction": 0.3, "restitution": 0.5, "density": 1100.0, "shape_ratio": 2.0}
FREE = ("friction", "density", "restitution")


def _law(rng: np.random.Generator):
    """A force that is not the model's, over flow (kg/s), angle and speed (rad, rad/s): a coherent jet on a rough plate,
    shielding itself, with powers of flow and speed of its own."""
    gain, droop, rough, shield = rng.uniform(1.0, 1.7), np.radians(rng.uniform(0, 20)), rng.uniform(0, 0.2), rng.uniform(0, 0.02)
    by_flow, by_speed = rng.uniform(-0.15, 0.05), rng.uniform(-0.2, 0.2)

    def force(flow, angle, speed):
        jet = np.sin(angle) * np.sin(angle - droop) * (1.0 + rough / np.tan(angle)) / (1.0 + shield * flow)
        return gain * flow * 0.18 * speed * jet * (flow / 10.0) ** by_flow * (speed / 42.0) ** by_speed

    return force


def _calibrated(law, flows, angles_deg, speeds_rpm, rng: np.random.Generator) -> api.ParameterSet:
    grid = np.meshgrid(flows, np.radians(angles_deg), np.array(speeds_rpm) * api.RPM, indexing="ij")
    flow, angle, speed = (np.repeat(v.ravel(), 3) for v in grid)
    at = api.Conditions(angle, speed, mass_flow_kg_s=flow)
    per_pass = MODEL.paddle_momentum(at, GRAIN) / MODEL.force(at, GRAIN)
    reading = law(flow, angle, speed) * (1.0 + 0.01 * rng.standard_normal(flow.size)) * per_pass
    rows = api.Measurements(at, reading)
    start = api.default_start(MODEL, rows, ("restitution",))
    return api.calibrate(MODEL, rows, start, FREE, starts=2, intervals=False).parameter_set


FAR = {
    # calibrated over flows, angles and speeds; used at
    "another angle": (([5, 10, 15], [70], [400]), (10.0, [45.0, 50.0, 85.0, 90.0], 400.0)),
    "another speed": (([5, 10, 15], [70], [400]), (10.0, [70.0], [330.0, 480.0])),
    "another flow": (([9, 10, 11], [55, 70, 85], [400]), ([2.0, 20.0], [70.0], 400.0)),
}


@pytest.mark.parametrize("case", FAR)
def test_the_deviation_covers_laws_of_other_authors_outside_the_range(case: str) -> None:
    calibrated, used = FAR[case]
    flow, angle, speed = (v.ravel() for v in np.meshgrid(*used))
    angle, speed, z = np.radians(angle), speed * api.RPM, []
    for seed in range(10):
        rng = np.random.default_rng([seed, 31])
        law = _law(rng)
        known = _calibrated(law, *calibrated, rng)
        found = api.OpenLoop(MODEL, known).estimate(law(flow, angle, speed), angle, speed)
        assert set(found.status) == {int(api.FlowStatus.OUTSIDE_CALIBRATION)}
        z.append((found.mass_flow_kg_s - flow) / found.std_dev_kg_s)
    rms = float(np.sqrt(np.mean(np.square(z))))
    assert 0.3 < rms < 1.3
    assert np.mean(np.abs(z) < 2.0) > 0.9


def _by_loads(law, flows, rng: np.random.Generator) -> api.ParameterSet:
    """Of loads that were weighed at these mean flows."""
    machine, shipped, loads = api.Machine(), api.load_parameters(), []
    angle, speed = np.full(60, machine.home_plate_angle_rad), np.full(60, machine.nominal_elevator_speed_rad_s)
    for name, mean in enumerate(flows):
        flow = mean * np.linspace(0.8, 1.2, 60)
        weighed = flow.sum() * (1.0 + 0.003 * rng.standard_normal())
        force = law(flow, angle, speed)
        loads.append(WeighedLoad(str(name), weighed, 0.003 * weighed, np.ones(60), force, angle, speed, noise_sd=0.001))
    known = calibrate_loads(api.ForwardModel(machine, shipped.effects), shipped, loads).parameter_set
    return replace(known, provenance={"scale": "weighed"})


def test_the_deviation_covers_laws_of_other_authors_above_the_weighed_flows() -> None:
    machine, flow, z = api.Machine(), np.array([12.0, 14.0, 16.0]), []
    angle, speed = machine.home_plate_angle_rad, machine.nominal_elevator_speed_rad_s
    for seed in range(14):
        rng = np.random.default_rng([seed, 77])
        law = _law(rng)
        known = _by_loads(law, [4.0, 6.0, 9.0, 5.0, 7.0, 8.0], rng)
        found = api.OpenLoop(api.ForwardModel(machine, known.effects), known).estimate(law(flow, angle, speed), angle, speed)
        z.append((found.mass_flow_kg_s - flow) / np.hypot(found.std_dev_kg_s, 0.002 * flow))
    assert np.sqrt(np.mean(np.square(z))) < 1.3
    assert np.mean(np.abs(z) < 2.0) > 0.9


def test_weighed_loads_bound_the_flow_above_them_less_than_a_table_does() -> None:
    flow, angle, speed = np.array([3.0, 10.0, 18.0]), np.full(3, np.radians(70.0)), np.full(3, 400.0 * api.RPM)
    table = _known(0.0, mass_flow_kg_s=(6.0, 15.0))
    loads = replace(table, provenance={"scale": "weighed"})
    below, within, above = error_beyond(loads, flow, angle, speed) - error_beyond(table, flow, angle, speed)
    assert (below, within) == (0.0, 0.0)
    assert 0.008 < above < 0.02
    # What the table has shown to be off more counts for both.
    assert np.array_equal(*(error_beyond(replace(one, model_error=0.01), flow, angle, speed) for one in (table, loads)))


def _shares(known: api.ParameterSet, flow, angle_deg, speed_rpm) -> np.ndarray:
    angle, speed = np.radians(angle_deg), np.asarray(speed_rpm) * api.RPM
    force = MODEL.force(api.Conditions(angle, speed, mass_flow_kg_s=np.asarray(flow, dtype=float)), known.values)
    found = api.OpenLoop(MODEL, known).estimate(force, angle, speed)
    return np.asarray(found.std_dev_kg_s / found.mass_flow_kg_s)


def _known(model_error: float = 0.01, **limits: tuple[float, float]) -> api.ParameterSet:
    return api.ParameterSet(GRAIN, calibrated=CalibratedRange(**limits), model_error=model_error)


def test_the_deviation_grows_with_the_distance_and_with_the_error_found_within() -> None:
    angles = {"plate_angle_rad": (np.radians(50.0), np.radians(80.0))}
    within, edge, near, far = _shares(_known(**angles), 10.0, [65.0, 50.4, 45.0, 40.0], 400.0)
    assert within == pytest.approx(_shares(_known(), 10.0, [65.0], 400.0)[0])
    assert edge == pytest.approx(_shares(_known(), 10.0, [50.4], 400.0)[0])
    beyond = [np.sqrt(s**2 - _shares(_known(), 10.0, [a], 400.0)[0] ** 2) for s, a in ((near, 45.0), (far, 40.0))]
    assert 0.0 < beyond[0] < 0.6 * beyond[1]
    # A range of one angle says nothing of others; one over which the model held says much.
    held, one = _known(0.002, **angles), _known(0.002, plate_angle_rad=(np.radians(70.0),) * 2)
    assert 5.0 * _shares(held, 10.0, [45.0], 400.0)[0] < _shares(one, 10.0, [45.0], 400.0)[0]
    # What is not known to be limited is not widened.
    assert _shares(_known(0.0), 30.0, [20.0], 700.0)[0] == 0.0


STATED = 'covariance: {names: ["friction"], matrix: [[1.0e-20]]}\n'


@pytest.mark.parametrize(
    ("text", "within", "beyond"),
    [
        # of the force at 70 deg, and beside that 10 deg beyond a range of 30 deg; None: there is no range
        ("", 0.05, None),
        (STATED, 0.0, None),
        (f"{STATED}calibrated_range: {{plate_angle_deg: [50, 80]}}", 0.0, 0.0646),
        (f"{STATED}calibrated_range: {{plate_angle_deg: [50, 80]}}\nmodel_error: null", 0.0, 0.0646),
        (f"{STATED}calibrated_range: {{plate_angle_deg: [50, 80]}}\nmodel_error: 0", 0.0, 0.0082),
        (f"{STATED}calibrated_range: {{plate_angle_deg: [50, 80]}}\nmodel_error: 0.01", 0.01, 0.0347),
        (f"{STATED}provenance: {{scale: weighed}}", 0.0, None),
    ],
)
def test_a_model_error_that_is_not_known_is_not_one_of_0(text: str, within: float, beyond, tmp_path, capsys) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(f"{yaml.safe_dump({'format': 1, 'version': 1, **GRAIN})}{text}\n")
    assert main(["predict", "--mass-flow", "10", "--plate-angle", "70", "40", "--params", str(path), "--json"]) == 0
    printed = capsys.readouterr()
    home, away = (row["force_std_dev_n"] / row["force_n"] for row in json.loads(printed.out)["rows"])
    assert home == pytest.approx(within, abs=1e-9)
    assert np.sqrt(max(away**2 - home**2, 0.0)) == pytest.approx(beyond or 0.0, abs=2e-4)
    assert ("do not state the model's own error" in printed.err) is (within == 0.05)
    known = api.load_parameters(path)
    api.save_parameters(known, path)
    assert api.load_parameters(path).model_error == known.model_error


def test_a_test_facilitys_one_speed_covers_what_an_elevator_makes_of_it() -> None:
    at = 400.0 * api.RPM
    known = _known(elevator_speed_rad_s=(at, at), mass_flow_kg_s=(5.0, 15.0))
    speeds, flows = (v.ravel() for v in np.meshgrid([375.0, 385.0, 415.0, 425.0], [4.8, 4.9, 15.4, 15.6]))
    outside = known.calibrated.outside(flows, None, speeds * api.RPM).reshape(4, 4)
    assert not outside[1:3, 1:3].any()
    assert outside.sum() == 12


def _file(folder: Path) -> str:
    path = folder / "p.yaml"
    ranges = {"plate_angle_deg": [70, 70], "mass_flow_kg_s": [5, 15], "elevator_speed_rpm": [400, 400], "moisture_pct": [14, 16]}
    sd = {"names": ["restitution"], "matrix": [[1e-4]]}
    document = {"format": 1, "version": 1, **GRAIN, "covariance": sd, "model_error": 0.0, "calibrated_range": ranges}
    path.write_text(yaml.safe_dump(document))
    return str(path)


def test_predict_states_what_estimate_makes_of_it(tmp_path, capsys) -> None:
    params = _file(tmp_path)
    assert main(["predict", "--mass-flow", "10", "--plate-angle", "60", "70", "--params", params, "--json"]) == 0
    away, home = json.loads(capsys.readouterr().out)["rows"]
    assert home["force_std_dev_n"] == pytest.approx(0.01 / 1.5 * home["force_n"], rel=1e-3)
    assert away["force_std_dev_n"] > 0.05 * away["force_n"]
    table = tmp_path / "t.csv"
    table.write_text(
        "plate_angle_deg,force_n,sigma,moisture_pct\n"
        f"60,{away['force_n']},0,15\n60,{away['force_n']},{away['force_std_dev_n']},15\n"
        f"70,{home['force_n']},0,15\n70,{home['force_n']},0,25\n"
    )
    assert main(["estimate", str(table), "--params", params, "--json"]) == 0
    alone, twice, right, wet = (row["std_dev_kg_s"] for row in json.loads(capsys.readouterr().out)["rows"])
    assert twice == pytest.approx(np.sqrt(2.0) * alone, rel=1e-3)
    # Nine points wetter than any calibrated grain, at 2 % a point.
    assert np.sqrt(wet**2 - right**2) == pytest.approx(1.8, rel=0.01)

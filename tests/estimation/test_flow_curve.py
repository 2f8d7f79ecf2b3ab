"""The alpha-beta model and the look-up table: what they recover, what they say of themselves, and where they hold."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from yieldmon.errors import InputError
from yieldmon.estimation.estimators import estimator_of
from yieldmon.estimation.fitting.measurements import Measurements
from yieldmon.estimation.flow_curve import AlphaBeta, CurveEstimator, FlowCurve, LookUpTable, TableColumn, with_curve
from yieldmon.estimation.open_loop import FlowStatus, OpenLoop
from yieldmon.estimation.parameters import CalibratedRange, ParameterSet
from yieldmon.estimation.weighing.flow_curve_fit import fit_loads, fit_table
from yieldmon.estimation.weighing.load_inputs import WeighedLoad
from yieldmon.files import flow_curve_file, parameter_file
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel

MACHINE = Machine()
GRAIN = ParameterSet({"friction": 0.2, "restitution": 0.6, "density": 1100.0, "shape_ratio": 2.0})
MODEL = ForwardModel(MACHINE)
HOME = np.radians(70.0)
FLOWS = np.array([2.0, 4.0, 6.0, 9.0, 12.0, 15.0, 18.0, 21.0])
LAW = AlphaBeta(4.0, 0.5, HOME)
LAW_RANGE = CalibratedRange((2.0, 20.0), (HOME, HOME), (380.0 * RPM, 420.0 * RPM), (14.0, 16.0))


def known(curve: FlowCurve) -> CurveEstimator:
    found = estimator_of(MACHINE, with_curve(GRAIN, curve))
    assert isinstance(found, CurveEstimator)
    return found


def rows(flow: np.ndarray, angle_deg: float | np.ndarray = 70.0, speed_rpm: float | np.ndarray = 400.0) -> Measurements:
    """Rows of the published model."""
    flow, angle, speed = np.broadcast_arrays(flow, np.radians(angle_deg), np.asarray(speed_rpm) * RPM)
    conditions = Conditions(angle.ravel().copy(), speed.ravel().copy(), mass_flow_kg_s=flow.ravel().copy())
    return Measurements(conditions, np.real(MODEL.paddle_momentum(conditions, GRAIN.values)))


def force_of(flow: np.ndarray, angle_deg: float = 70.0, speed_rpm: float = 400.0) -> np.ndarray:
    return np.real(MODEL.force(Conditions(np.radians(angle_deg), speed_rpm * RPM, mass_flow_kg_s=flow), GRAIN.values))


def test_alpha_beta_is_flow_quadratic_in_force_over_speed() -> None:
    x, speed = np.meshgrid([0.3, 0.8, 1.5, 2.4], np.array([350.0, 400.0, 450.0]) * RPM)
    flow, speed = (4.0 * x + 0.5 * x**2).ravel(), speed.ravel()
    conditions = Conditions(np.full(flow.size, HOME), speed, mass_flow_kg_s=flow)
    found = fit_table(MACHINE, Measurements(conditions, x.ravel() * speed / MACHINE.passes_per_s(speed)), "alpha_beta")
    law = found.curve.law
    assert isinstance(law, AlphaBeta)
    assert (law.alpha, law.beta) == pytest.approx((4.0, 0.5))
    assert found.curve.relative_std_dev == 0.002
    assert found.curve.calibrated.mass_flow_kg_s == pytest.approx((flow.min(), flow.max()))


@pytest.mark.parametrize("speed_rpm", [330.0, 480.0])
def test_a_table_of_one_speed_holds_at_another_as_momentum_goes_with_speed(speed_rpm: float) -> None:
    # The published model has no gravity: the same paddle load gives momentum in proportion to speed, exactly.
    loop = known(fit_table(MACHINE, rows(FLOWS), "table").curve)
    between, faster = np.array([3.0, 5.0, 7.5, 10.5, 13.5]), speed_rpm / 400.0
    there = loop.invert(force_of(faster * between, speed_rpm=speed_rpm), HOME, speed_rpm * RPM)
    assert there == pytest.approx(faster * loop.invert(force_of(between), HOME, 400.0 * RPM), rel=1e-9)
    assert loop.invert(force_of(FLOWS), HOME, 400.0 * RPM) == pytest.approx(FLOWS, rel=1e-9)


def test_a_table_of_several_angles_is_read_between_them() -> None:
    curve = fit_table(MACHINE, rows(FLOWS[:, None], np.array([60.0, 65.0, 70.0, 75.0, 80.0])), "table").curve
    force, angles = np.full(5, 80.0), np.radians([65.0, 66.0, 67.5, 69.0, 70.0])
    found = known(curve).invert(force, angles, 400.0 * RPM)
    assert found == pytest.approx(np.interp(angles, angles[[0, -1]], found[[0, -1]]))
    status = known(curve).estimate(80.0, np.radians([59.5, 67.5, 82.0]), 400.0 * RPM).status
    assert list(status) == [FlowStatus.OK, FlowStatus.OK, FlowStatus.OUTSIDE_CALIBRATION]


def test_a_curve_without_a_range_states_the_same_whatever_rows_are_beside_and_is_never_exact() -> None:
    curve = replace(fit_table(MACHINE, rows(FLOWS), "alpha_beta").curve, calibrated=CalibratedRange(), relative_std_dev=0.0)
    alone, beside = (
        known(curve).estimate(f, HOME, 400.0 * RPM).std_dev_kg_s for f in (force_of(6.0), force_of(np.array([6.0, 18.0])))
    )
    assert float(alone) == pytest.approx(float(beside[0]))
    assert float(alone) > 0.002 * 6.0


@pytest.mark.parametrize("kind", ["alpha_beta", "table"])
def test_the_stated_deviation_is_that_of_flows_between_the_loads(kind: str) -> None:
    loop = known(fit_table(MACHINE, rows(FLOWS), kind).curve)
    between = np.linspace(2.2, 20.5, 40)
    found = loop.estimate(force_of(between), HOME, 400.0 * RPM)
    z = (found.mass_flow_kg_s - between) / found.std_dev_kg_s
    assert np.all(found.status == FlowStatus.OK)
    assert 0.05 < np.sqrt(np.mean(z**2)) < 1.2
    noisy = loop.estimate(force_of(between), HOME, 400.0 * RPM, 0.05 * force_of(between))
    assert np.all(noisy.noise_std_dev_kg_s > 0.04 * between)
    assert noisy.std_dev_kg_s == pytest.approx(np.hypot(found.std_dev_kg_s, noisy.noise_std_dev_kg_s))


@pytest.mark.parametrize(
    ("force_n", "angle_deg", "speed_rpm", "moisture_pct", "status"),
    [
        (80.0, 70.0, 400.0, 15.0, FlowStatus.OK),
        (80.0, 70.0, 400.0, np.nan, FlowStatus.OK),
        (0.0, 70.0, 400.0, 15.0, FlowStatus.NO_GRAIN),
        (-3.0, 70.0, 400.0, 15.0, FlowStatus.NO_GRAIN),
        (80.0, 60.0, 400.0, 15.0, FlowStatus.OUTSIDE_CALIBRATION),
        (80.0, 70.0, 470.0, 15.0, FlowStatus.OUTSIDE_CALIBRATION),
        (80.0, 70.0, 400.0, 22.0, FlowStatus.OUTSIDE_CALIBRATION),
        (10.0, 70.0, 400.0, 15.0, FlowStatus.OUTSIDE_CALIBRATION),
        (250.0, 70.0, 400.0, 15.0, FlowStatus.OUTSIDE_CALIBRATION),
        (np.nan, 70.0, 400.0, 15.0, FlowStatus.NOT_AVAILABLE),
        (80.0, np.nan, 400.0, 15.0, FlowStatus.NOT_AVAILABLE),
        (80.0, 70.0, 0.0, 15.0, FlowStatus.NOT_AVAILABLE),
    ],
)
def test_each_input_has_its_status(
    force_n: float, angle_deg: float, speed_rpm: float, moisture_pct: float, status: FlowStatus
) -> None:
    found = known(FlowCurve(LAW, 0.02, LAW_RANGE)).estimate(force_n, np.radians(angle_deg), speed_rpm * RPM, 1.0, moisture_pct)
    assert found.status == status
    there = status is not FlowStatus.NOT_AVAILABLE
    assert np.isfinite(found.mass_flow_kg_s) == np.isfinite(found.std_dev_kg_s) == there


def test_away_from_its_angle_a_curve_is_worth_less() -> None:
    loop = known(FlowCurve(LAW, 0.02, LAW_RANGE))
    sd = [float(loop.estimate(80.0, np.radians(a), 400.0 * RPM).std_dev_kg_s) for a in (70.0, 69.0, 65.0, 75.0)]
    assert sd[0] < sd[1] < sd[2] == pytest.approx(sd[3])
    # What the published model's force changes by over five degrees is within two of them.
    changed = abs(force_of(np.array([9.0]), 65.0)[0] / force_of(np.array([9.0]))[0] - 1.0)
    assert changed < 2.0 * sd[2] / float(loop.invert(80.0, HOME, 400.0 * RPM))


def test_a_parabola_that_bends_back_is_saturated_above_its_top() -> None:
    loop = known(FlowCurve(AlphaBeta(5.0, -0.5, HOME), 0.02))
    found = loop.estimate(np.array([4.9, 5.1]) * 400.0 * RPM, HOME, 400.0 * RPM)
    assert list(found.status) == [FlowStatus.OK, FlowStatus.SATURATED]
    assert found.mass_flow_kg_s == pytest.approx([12.495, np.nan], nan_ok=True)


def test_the_force_curve_ends_where_the_curve_has_no_answer() -> None:
    loop = known(FlowCurve(AlphaBeta(5.0, -0.5, HOME), 0.02))
    force, flow = loop.force_curve(HOME, 400.0 * RPM)
    assert 12.4 < np.nanmax(flow) <= 12.5
    assert list(np.isnan(flow)) == list(force > 5.0 * 400.0 * RPM)


@settings(max_examples=40)
@given(st.lists(st.floats(0.9, 1.1), min_size=8, max_size=8))
def test_a_table_rises_whatever_the_noise(noise: list[float]) -> None:
    exact = rows(FLOWS)
    curve = fit_table(MACHINE, Measurements(exact.conditions, exact.momentum * np.array(noise)), "table").curve
    flow = known(curve).invert(np.linspace(1.0, 250.0, 400), HOME, 400.0 * RPM)
    assert np.all(np.diff(flow) > 0.0)


def loads(flows: list[float]) -> list[WeighedLoad]:
    out = []
    for i, flow in enumerate(flows):
        x = (np.sqrt(LAW.alpha**2 + 4.0 * LAW.beta * flow) - LAW.alpha) / (2.0 * LAW.beta)
        speed = np.linspace(395.0, 405.0, 50) * RPM
        weighed = 50.0 * flow
        out.append(WeighedLoad(str(i), weighed, 0.005 * weighed, np.ones(50), x * speed, np.full(50, HOME), speed))
    return out


def test_weighed_loads_of_several_flows_give_both_coefficients() -> None:
    found = fit_loads(loads([4.0, 8.0, 12.0, 18.0]), HOME).curve
    assert isinstance(found.law, AlphaBeta)
    assert (found.law.alpha, found.law.beta) == pytest.approx((LAW.alpha, LAW.beta))


def test_weighed_loads_of_one_flow_give_one_coefficient() -> None:
    weighings = [
        WeighedLoad(load.name, load.weighed_kg * factor, load.std_dev_kg, load.duration_s, load.force_n,
                    load.plate_angle_rad, load.elevator_speed_rad_s)
        for load, factor in zip(loads([11.0, 11.1, 11.2, 11.3]), (1.01, 0.99, 1.01, 0.99), strict=True)
    ]  # fmt: skip
    found = fit_loads(weighings, HOME).curve
    assert isinstance(found.law, AlphaBeta)
    assert found.law.beta == 0.0
    assert 0.008 < found.relative_std_dev < 0.025


@pytest.mark.parametrize("power", [0.8, 0.9, 1.1])
def test_far_from_the_weighed_flows_a_curve_is_worth_less(power: float, tmp_path: Path) -> None:
    """A force that goes with a power of the flow, weighed at 9 to 12 kg/s and used at 3 and 22."""
    rng, speed, z = np.random.default_rng([int(100 * power)]), np.full(1, 400.0 * RPM), []
    for _ in range(8):
        weighings = []
        for flow in rng.uniform(9.0, 12.0, 4):
            kg = 1000.0 * flow
            weighed = kg * (1.0 + 0.005 * rng.standard_normal())
            force = np.full(1, 80.0 * (flow / 10.0) ** power)
            weighings.append(WeighedLoad("1", weighed, 0.005 * kg, np.full(1, 1000.0), force, np.full(1, HOME), speed))
        curve = fit_loads(weighings, HOME).curve
        far = np.array([3.0, 22.0])
        found = known(curve).estimate(80.0 * (far / 10.0) ** power, HOME, 400.0 * RPM)
        z.append((found.mass_flow_kg_s - far) / found.std_dev_kg_s)
    assert np.sqrt(np.mean(np.square(z))) < 2.0
    flow_curve_file.save(curve, tmp_path / "c.yaml")
    kept = flow_curve_file.load(tmp_path / "c.yaml")
    assert (kept.exponent_std_dev, kept.about_kg_s) == (curve.exponent_std_dev, curve.about_kg_s)
    assert curve.exponent_std_dev > 0.0


def test_a_curve_by_shared_trucks_is_no_better_than_the_other_monitor() -> None:
    shared = [
        replace(load, std_dev_kg=0.04 * load.weighed_kg, common_kg=0.03 * load.weighed_kg)
        for load in loads([4.0, 8.0, 12.0, 18.0])
    ]
    assert 0.03 < fit_loads(shared, HOME).curve.relative_std_dev < 0.035


def test_what_cannot_be_fitted_is_reported() -> None:
    with pytest.raises(ValueError, match="rows at 60, 70 deg; alpha_beta holds at one plate angle"):
        fit_table(MACHINE, rows(FLOWS[:, None], np.array([60.0, 70.0])), "alpha_beta")
    with pytest.raises(ValueError, match="2 loads at 70 deg; expected 3 or more"):
        fit_table(MACHINE, rows(FLOWS[:2]), "table")
    with pytest.raises(ValueError, match="2 weighed loads; expected 3 or more"):
        fit_loads(loads([4.0, 8.0]), HOME)
    with pytest.raises(ValueError, match="load 0 has no second with the plate at 60 deg"):
        fit_loads(loads([4.0, 8.0, 12.0]), np.radians(60.0))
    with pytest.raises(ValueError, match="rise from above 0"):
        TableColumn(HOME, (10.0, 9.0), (1.0, 2.0))


@pytest.mark.parametrize("kind", ["alpha_beta", "table"])
def test_a_curve_goes_through_files_and_processes_unchanged(kind: str, tmp_path: Path) -> None:
    fitted = fit_table(MACHINE, rows(FLOWS), kind).curve
    flow_curve_file.save(fitted, tmp_path / "c.yaml")
    curve = flow_curve_file.load(tmp_path / "c.yaml")
    force = force_of(FLOWS)
    assert known(curve).invert(force, HOME, 41.0) == pytest.approx(known(fitted).invert(force, HOME, 41.0), rel=1e-12)
    whole = with_curve(GRAIN, curve)
    assert pickle.loads(pickle.dumps(whole)).curve == curve  # noqa: S301 - made in the line itself
    again = parameter_file.from_document(parameter_file.to_document(whole), "a store")
    assert again.curve == curve
    assert again.provenance["estimator"] == kind


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("estimator: gamma\n", "estimator: is 'gamma'; expected one of alpha_beta, table"),
        ("friction: 0.2\n", "is a parameter file; expected a curve"),
        ("estimator: alpha_beta\nalpha: 4\nbeta: 0\nrelative_std_dev: 0.01\n", "plate_angle_deg: is None; expected a number"),
        ("estimator: alpha_beta\ngamma: 4\n", "gamma: unknown key; expected one of"),
        (
            "estimator: table\nrelative_std_dev: 0.1\nelevator_speed_rpm: 400\ncolumns: []\n",
            "columns: is []; expected a list",
        ),
        (
            "estimator: table\nrelative_std_dev: 0.1\nelevator_speed_rpm: 400\n"
            "columns: [{plate_angle_deg: 70, force_n: [10, 9], mass_flow_kg_s: [1, 2]}]\n",
            "columns[0]: table: force_n is [10.0, 9.0]; expected two or more numbers that rise from above 0",
        ),
    ],
)
def test_a_wrong_file_costs_one_line(text: str, reported: str, tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text(text)
    with pytest.raises(InputError) as caught:
        flow_curve_file.load(tmp_path / "c.yaml")
    assert reported in str(caught.value)


def test_without_a_curve_the_physics_counts() -> None:
    assert isinstance(estimator_of(MACHINE, GRAIN), OpenLoop)
    with pytest.raises(ValueError, match="no curve"):
        CurveEstimator(GRAIN)
    assert LookUpTable(41.9, (TableColumn(HOME, (1.0, 2.0), (1.0, 2.0)),)).coefficients == {}

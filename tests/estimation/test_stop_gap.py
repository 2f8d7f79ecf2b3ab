"""A calibration of a machine that no named physics describes: grain stays likely, and nothing is claimed beyond the table."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from yieldmon.estimation.admission import refusal
from yieldmon.estimation.fitting.calibration import calibrate
from yieldmon.estimation.fitting.measurements import Measurements
from yieldmon.estimation.fitting.stop_gap import with_stop_gap, without_stop_gap
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.grain import at_search_end
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel

MACHINE = Machine()
MODEL = ForwardModel(MACHINE)
TRUE = {"friction": 0.25, "restitution": 0.5, "density": 1050.0, "shape_ratio": 2.0}
FREE = ("friction", "restitution", "density")
START = TRUE | {"friction": 0.3, "density": 1000.0}
NOISE = 0.004
SEED = 60117


def missing(angle_rad: np.ndarray, flow_kg_s: np.ndarray) -> np.ndarray:
    """A cause of this test's own: grain that bends the plate's reading by angle and load."""
    return 1.0 + 0.2 * np.cos(angle_rad) ** 2 + 0.12 * np.exp(-flow_kg_s / 5.0)


def conditions(angles_deg: list[float], flows_kg_s: list[float]) -> Conditions:
    angle, flow = (each.ravel() for each in np.meshgrid(np.radians(angles_deg), flows_kg_s))
    return Conditions(angle, np.full(angle.shape, 400.0 * RPM), mass_flow_kg_s=flow)


def force(at: Conditions) -> np.ndarray:
    return np.real(MODEL.force(at, TRUE)) * missing(np.asarray(at.plate_angle_rad), np.asarray(at.mass_flow_kg_s))


@pytest.fixture(scope="module")
def rows() -> Measurements:
    at = conditions([50, 60, 70, 80, 90], [2, 4, 6, 9, 12, 16, 20])
    reading = force(at) / MACHINE.passes_per_s(np.asarray(at.elevator_speed_rad_s))
    noise = np.random.default_rng(SEED).standard_normal(reading.size)
    return Measurements(at, reading * (1.0 + NOISE * noise), NOISE * reading)


@pytest.fixture(scope="module")
def plain(rows: Measurements) -> ParameterSet:
    return calibrate(MODEL, rows, START, FREE, starts=4, intervals=False).parameter_set


@pytest.fixture(scope="module")
def corrected(rows: Measurements, plain: ParameterSet) -> ParameterSet:
    return with_stop_gap(MODEL, rows, plain, FREE)


def measured(parameters: ParameterSet, at: Conditions) -> tuple[np.ndarray, np.ndarray]:
    """Flow and standard deviation from the true force."""
    loop = OpenLoop(ForwardModel(MACHINE, parameters.effects), parameters)
    shown, speed = force(at), np.asarray(at.elevator_speed_rad_s)
    angle = np.asarray(at.plate_angle_rad)
    found = loop.estimate(shown, angle, speed, 1e-3)
    return found.mass_flow_kg_s, found.std_dev_kg_s


def test_loads_between_those_of_the_table_come_out_right(plain: ParameterSet, corrected: ParameterSet) -> None:
    at = conditions([55, 70, 85], [3, 7.5, 14, 18])
    true = np.asarray(at.mass_flow_kg_s)
    worst = [np.max(np.abs(measured(p, at)[0] / true - 1.0)) for p in (plain, corrected)]
    assert worst[0] > 0.02
    assert worst[1] < 0.008


def test_its_deviation_covers_what_is_left(corrected: ParameterSet) -> None:
    at = conditions([52, 60, 70, 80, 88], [3, 5, 7.5, 14, 18])
    flow, sd = measured(corrected, at)
    z = (flow - np.asarray(at.mass_flow_kg_s)) / sd
    assert np.sqrt(np.mean(z**2)) < 1.3
    assert np.max(sd / flow) < 0.02


def test_grain_stays_likely_where_least_squares_goes_to_an_end(plain: ParameterSet, corrected: ParameterSet) -> None:
    assert at_search_end(plain.values, FREE)
    assert not at_search_end(corrected.values, FREE)
    for name in FREE:
        assert abs(corrected.values[name] - TRUE[name]) < 2.5 * corrected.standard_deviation(name)


@pytest.mark.parametrize(("angle_deg", "flow_kg_s"), [(40.0, 10.0), (100.0, 10.0), (70.0, 35.0)])
def test_beyond_the_table_nothing_is_corrected_and_the_deviation_grows(
    corrected: ParameterSet, angle_deg: float, flow_kg_s: float
) -> None:
    at = Conditions(np.radians([angle_deg]), np.array([400.0 * RPM]), mass_flow_kg_s=np.array([flow_kg_s]))
    physics = without_stop_gap(corrected)
    values = [
        float(np.real(ForwardModel(MACHINE, p.effects).force(at, p.values))[0]) for p in (corrected, physics)
    ]  # fmt: skip
    assert values[0] == pytest.approx(values[1], rel=1e-12)
    inside = conditions([70], [10])
    loop = OpenLoop(ForwardModel(MACHINE, corrected.effects), corrected)
    outside = loop.estimate(values[0], np.radians(angle_deg), 400.0 * RPM)
    near = loop.estimate(force(inside)[0], np.radians(70.0), 400.0 * RPM)
    assert outside.std_dev_kg_s / outside.mass_flow_kg_s > 3.0 * near.std_dev_kg_s / near.mass_flow_kg_s


def test_a_model_that_is_right_is_hardly_corrected(rows: Measurements) -> None:
    at = rows.conditions
    reading = np.real(MODEL.force(at, TRUE)) / MACHINE.passes_per_s(np.asarray(at.elevator_speed_rad_s))
    noise = np.random.default_rng(SEED + 1).standard_normal(reading.size)
    right = Measurements(at, reading * (1.0 + NOISE * noise), NOISE * reading)
    fitted = calibrate(MODEL, right, START, FREE, starts=4, intervals=False).parameter_set
    found = with_stop_gap(MODEL, right, fitted, FREE)
    weights = [value for name, value in found.values.items() if name.startswith("stop_gap.w")]
    assert np.max(np.abs(weights)) < 0.01
    assert found.model_error < 0.004


def test_sweeps_update_nothing_beside_it(corrected: ParameterSet) -> None:
    assert "stop-gap" in refusal(corrected)
    assert without_stop_gap(corrected).effects == ()


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda rows: replace(rows, sigma=None), "sigma"),
        (lambda rows: rows.select(rows.columns()[2] < 5.0), "three loads"),
    ],
)
def test_rows_that_allow_none_are_refused(rows: Measurements, plain: ParameterSet, change, expected: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ValueError, match=expected):
        with_stop_gap(MODEL, change(rows), plain, FREE)


def test_exchange_coefficients_are_refused(rows: Measurements) -> None:
    values = {n: v for n, v in TRUE.items() if n != "restitution"} | {"k1": 0.2, "k2": 1.4}
    with pytest.raises(ValueError, match="k1 and k2"):
        with_stop_gap(MODEL, rows, ParameterSet(values), ("friction", "density", "k1", "k2"))

"""Covariance that grows, priors that move with moisture, priors and bounds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from yieldmon.errors import InputError
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.priors import Prior, fitting_bounds, physical_bounds, start_ranges
from yieldmon.estimation.self_calibration.drift import grow
from yieldmon.estimation.self_calibration.drift_rates import DriftRates
from yieldmon.estimation.self_calibration.moisture import MoistureMap, fit
from yieldmon.files import moisture_file
from yieldmon.physics.effects import registry
from yieldmon.physics.grain import GRAIN

VALUES = {"friction": 0.2, "restitution": 0.6, "density": 1100.0, "shape_ratio": 2.0}
NAMES = ("friction", "restitution", "density")
KNOWN = ParameterSet(VALUES, NAMES, np.diag([0.01**2, 0.02**2, 30.0**2]))


def test_variance_grows_in_proportion_to_time_and_grain() -> None:
    rates = DriftRates({"friction": 0.03}, {"density": 0.02}, {})
    later = grow(KNOWN, rates, hours=4.0, harvested_kg=0.5e6)
    assert later.covariance[0, 0] == pytest.approx(0.01**2 + (0.2 * 0.03) ** 2 * 4.0)
    assert later.covariance[2, 2] == pytest.approx(30.0**2 + (1100.0 * 0.02) ** 2 * 0.5)
    assert later.covariance[1, 1] == 0.02**2
    assert later.values == KNOWN.values


def test_growth_in_steps_is_growth_at_once_and_ends_at_the_limit() -> None:
    rates = DriftRates({"friction": 0.03}, {}, {"friction": 0.1})
    steps = KNOWN
    for _ in range(5):
        steps = grow(steps, rates, 1.0, 0.0)
    assert steps.covariance == pytest.approx(grow(KNOWN, rates, 5.0, 0.0).covariance)
    assert grow(KNOWN, rates, 1e6, 0.0).standard_deviation("friction") == pytest.approx(0.1 * 0.2)


def test_a_night_without_harvest_widens_less_than_two_hours_of_harvest() -> None:
    """By the defaults: 14 h of standing against 2 h at 40 t/h. What drifts is grain and machine, as they are used."""
    night, harvest = grow(KNOWN, DriftRates(), 14.0, 0.0), grow(KNOWN, DriftRates(), 2.0, 80e3)
    for name in NAMES:
        i = NAMES.index(name)
        assert night.covariance[i, i] - KNOWN.covariance[i, i] < harvest.covariance[i, i] - KNOWN.covariance[i, i]


def test_restitutions_rate_counts_for_the_impact_gain() -> None:
    later = grow(KNOWN, DriftRates({"restitution": 0.01}, {}, {}), 1.0, 0.0)
    assert later.covariance[1, 1] == pytest.approx(0.02**2 + (1.6 * 0.01) ** 2)


@pytest.mark.parametrize(("hours", "kg"), [(-1.0, 0.0), (0.0, -1.0)])
def test_time_does_not_run_backwards(hours: float, kg: float) -> None:
    with pytest.raises(ValueError, match="expected 0 or more"):
        grow(KNOWN, DriftRates(), hours, kg)


def test_negative_rates_are_refused() -> None:
    with pytest.raises(ValueError, match="drift rate of friction"):
        DriftRates({"friction": -0.1})


MAP = MoistureMap((14.0, 20.0, 26.0), {"friction": (0.1, 0.2, 0.4)}, doubt=0.5)


@pytest.mark.parametrize(("at", "value"), [(10.0, 0.1), (14.0, 0.1), (17.0, 0.15), (23.0, 0.3), (40.0, 0.4)])
def test_the_map_is_linear_between_its_points_and_constant_outside(at: float, value: float) -> None:
    assert MAP.at("friction", at) == pytest.approx(value)


def test_a_move_takes_value_and_error_along_and_adds_doubt() -> None:
    moved = MAP.moved(KNOWN, 14.0, 20.0)
    assert moved.values["friction"] == pytest.approx(0.4)
    assert moved.standard_deviation("friction") == pytest.approx(np.hypot(0.02, 0.5 * 0.2))
    assert moved.values["density"] == 1100.0


def test_there_and_back_keeps_the_values() -> None:
    back = MAP.moved(MAP.moved(KNOWN, 14.0, 23.0), 23.0, 14.0)
    assert back.values["friction"] == pytest.approx(0.2)
    assert back.standard_deviation("friction") > KNOWN.standard_deviation("friction")


def test_no_change_of_moisture_is_no_change() -> None:
    assert MAP.moved(KNOWN, 30.0, 40.0) is KNOWN


def test_a_map_from_calibrations() -> None:
    wet = ParameterSet(dict(VALUES, friction=0.5), ("friction",), np.diag([1e-4]))
    fitted = fit([26.0, 14.0], [wet, KNOWN])
    assert fitted.moisture_pct == (14.0, 26.0)
    assert fitted.values == {"friction": (0.2, 0.5)}


def test_the_shipped_map_is_the_published_one() -> None:
    shipped = moisture_file.load()
    assert shipped.moisture_pct == (14.0, 21.0, 26.0)
    assert shipped.at("friction", 21.0) == 0.15
    assert shipped.at("density", 26.0) == 1999.0


def test_a_map_file_reads_back(tmp_path: Path) -> None:
    moisture_file.save(MAP, tmp_path / "map.yaml")
    assert moisture_file.load(tmp_path / "map.yaml") == MAP


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("moisture_pct: [14]\nvalues: {friction: [0.1]}", "two or more ascending"),
        ("moisture_pct: [20, 14]\nvalues: {friction: [0.1, 0.2]}", "two or more ascending"),
        ("moisture_pct: [14, 20]\nvalues: {friction: [0.1]}", "expected 2 values"),
        ("moisture_pct: [14, 20]\nvalues: {colour: [0.1, 0.2]}", "colour: unknown parameter"),
        ("moisture_pct: [14, 20]\nvalues: {}", "a mapping of parameter names"),
        ("moisture_pct: [14, wet]\nvalues: {friction: [0.1, 0.2]}", "0 to 100 %"),
        ("moisture_pct: [14, 20]\nvalues: {friction: [0.1, 0.2]}\ncolour: red", "colour: unknown key"),
    ],
)
def test_a_bad_map_file_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "map.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as error:
        moisture_file.load(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


# Priors and bounds


def test_whitening_gives_the_gaussians_quadratic_form() -> None:
    covariance = np.array([[1e-4, 0.2, 0.0], [0.2, 900.0, 1.0], [0.0, 1.0, 0.01]])
    prior = Prior(("friction", "density", "restitution"), np.array([0.2, 1100.0, 0.6]), covariance)
    names = ("restitution", "shape_ratio", "friction", "density")
    white, mean = prior.whitening(names)
    theta = np.array([0.7, 5.0, 0.21, 1120.0])
    gap = np.array([0.01, 20.0, 0.1])
    assert np.sum((white @ (theta - mean)) ** 2) == pytest.approx(gap @ np.linalg.solve(covariance, gap))


def test_a_prior_that_is_no_covariance_is_refused() -> None:
    with pytest.raises(ValueError, match="not positive definite"):
        Prior(("friction", "density"), np.zeros(2), np.array([[1.0, 2.0], [2.0, 1.0]]))


def test_every_effect_parameter_has_bounds_and_a_start_range_inside_them() -> None:
    names = [f"{e.name}.{p.name}" for e in registry().values() for p in e.parameters]
    assert names
    ranges = start_ranges(names)
    for name in names:
        low, high = physical_bounds(name)
        assert low < high
        assert low <= ranges[name][0] <= ranges[name][1] <= high


def test_bounds_of_what_is_in_the_readings_unit_scale_with_it() -> None:
    assert physical_bounds("k1", 200.0) == tuple(200.0 * b for b in physical_bounds("k1"))
    assert physical_bounds("zero_offset.force_n", 200.0) == tuple(200.0 * b for b in physical_bounds("zero_offset.force_n"))
    softening = "cell_nonlinearity.softening_per_n"
    assert physical_bounds(softening, 200.0) == pytest.approx([b / 200.0 for b in physical_bounds(softening)])
    assert physical_bounds("friction", 200.0) == physical_bounds("friction")


def test_given_bounds_come_first() -> None:
    found = fitting_bounds(("friction", "density"), given={"friction": (0.1, 0.3)})
    assert found == {"friction": (0.1, 0.3), "density": GRAIN["density"].search}


def test_unknown_parameters_have_no_bounds() -> None:
    with pytest.raises(ValueError, match="unknown"):
        physical_bounds("colour")

"""The fit, its tangent plane, and the tests that are built on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import least_squares

from yieldmon.discrepancy import base_fit, candidates, crossvalidation, fit, lack_of_fit, noise, observations
from yieldmon.discrepancy.frame import Frame, predictions
from yieldmon.physics.effects import registry
from yieldmon.physics.machine import RPM


@pytest.fixture
def frame(make_rows, start) -> Frame:
    rows = make_rows({"zero_offset": 3.0})
    cells = observations.cells(rows)
    found, _ = noise.estimate(rows)
    return base_fit.base_frame(cells, found.of_cells(cells), start, "restitution")


def test_it_is_the_minimum_that_scipy_finds(frame) -> None:
    ours = fit.fit(frame, ("zero_offset",), tolerance=1e-9)
    names = [p.name for p in ours.parameters]

    def residual(x: np.ndarray) -> np.ndarray:
        return (np.real(predictions(frame, ("zero_offset",), dict(zip(names, x, strict=True)))) - frame.cells.mean) / frame.sd

    scale = [p.scale for p in ours.parameters]
    bounds = ([p.lower for p in ours.parameters], [p.upper for p in ours.parameters])
    theirs = least_squares(residual, [0.25, 1000.0, 0.5, 1.0], x_scale=scale, bounds=bounds, xtol=1e-12, ftol=1e-12)
    assert ours.chi2 == pytest.approx(2.0 * theirs.cost, rel=1e-5)
    np.testing.assert_allclose(ours.x, theirs.x, rtol=2e-2)


def test_it_finds_the_hidden_values(frame) -> None:
    found = fit.fit(frame, ("zero_offset",)).values
    assert found["zero_offset.force_n"] == pytest.approx(3.0, abs=0.2)
    assert found["friction"] == pytest.approx(0.3, abs=0.05)


def test_laid_out_prediction_is_the_row_by_row_one(frame) -> None:
    fitted = base_fit.fit_base(frame.with_cells(frame.cells, frame.sd))
    np.testing.assert_allclose(fitted.residual * frame.sd + frame.cells.mean, fitted.predict(frame.cells.conditions()), rtol=1e-5)


def test_bounds_hold(frame) -> None:
    narrow = replace(frame, base=tuple(replace(p, upper=0.1, start=0.05) if p.name == "friction" else p for p in frame.base))
    fitted = base_fit.fit_base(narrow)
    assert fitted.values["friction"] <= 0.1
    assert "friction" in fitted.at_bound


def test_covariance_is_that_of_the_scatter_and_widens_with_the_misfit(frame) -> None:
    fitted = fit.fit(frame, ("zero_offset",), tolerance=1e-9)
    wide = replace(fitted, parameters=tuple(replace(p, lower=-1e9, upper=1e9) for p in fitted.parameters))
    by_hand = np.linalg.inv(fitted.jacobian.T @ fitted.jacobian)
    error = fitted.columns_of_error(fitted.estimated_error)
    taken_up = (fitted.chi2 - fitted.marginal(error)[0]) / fitted.dof
    for ratio in (0.5, 4.0):
        wider = max(ratio - taken_up, 1.0)
        moved = by_hand @ fitted.jacobian.T @ error
        found = replace(wide, chi2=ratio * fitted.dof).covariance()
        np.testing.assert_allclose(found, wider * by_hand + moved @ moved.T, rtol=1e-4)


def test_no_parameter_is_less_certain_than_its_bounds_are_wide(frame) -> None:
    """Slip at these rows is another density and gain; a hundredth of the information leaves nothing determined."""
    fitted = fit.fit(replace(frame, sd=100.0 * frame.sd), ("chain_slip",))
    share = np.sqrt(np.diag(fitted.covariance())) / np.array([p.upper - p.lower for p in fitted.parameters])
    assert np.all(share <= 1.0 + 1e-9)
    assert share[-1] > 0.8


@pytest.mark.parametrize(("name", "size"), [("zero_offset", 4.0), ("plate_angle_offset", 0.06), ("paddle_wear", 0.02)])
def test_hidden_values_lie_within_their_standard_deviations(make_rows, start, name: str, size: float) -> None:
    errors = []
    for seed in range(8):
        rows = make_rows({name: size}, seed=seed, speeds_rpm=(400.0,), noise=0.02)
        found, odd = noise.estimate(rows)
        cells = observations.cells(rows.take(~odd))
        frame = base_fit.base_frame(cells, found.of_cells(cells), start, "restitution")
        fitted = fit.fit(frame, (name,))
        errors.append((fitted.x[-1] - size) / np.sqrt(fitted.covariance()[-1, -1]))
    # Chi-square of 8: 0.5 % on either side.
    assert 1.3 < np.sum(np.square(errors)) < 22.0


def test_leaving_a_group_out_in_the_tangent_plane_is_a_refit(frame) -> None:
    fitted = fit.fit(frame, ("zero_offset",), tolerance=1e-9)
    numbers = frame.cells.groups()["plate_angle"]
    quick = crossvalidation.left_out_residual(fitted, numbers)
    out = numbers == 2
    heavy = frame.sd.copy()
    heavy[out] *= 1e4
    refitted = fit.fit(replace(frame, sd=heavy), ("zero_offset",), fitted.values, tolerance=1e-9)
    true = refitted.residual[out] * heavy[out] / frame.sd[out]
    np.testing.assert_allclose(quick[out], true, atol=0.05 + 0.02 * np.max(np.abs(true)))


def test_the_f_ratio_has_its_distribution_where_the_rows_state_unlike_sigmas(make_rows, start) -> None:
    """40 tables (seeds 0 to 39) whose rows scatter as they say, by 0.5 to 5 times the middle one."""
    exact = make_rows(noise=0.0, speeds_rpm=(400.0,))
    p_values = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        sigma = 0.01 * exact.value.max() * rng.choice([0.5, 1.0, 5.0], len(exact))
        rows = replace(exact, value=exact.value + sigma * rng.standard_normal(len(exact)), sigma=sigma)
        found, _ = noise.estimate(rows)
        cells = observations.cells(rows)
        frame = base_fit.base_frame(cells, found.of_cells(cells), start, "restitution")
        p_values.append(lack_of_fit.lack_of_fit(fit.fit(frame, ()), found).p_value)
    assert stats.kstest(p_values, "uniform").pvalue > 0.01


def test_the_f_ratio_has_its_distribution_under_a_full_bootstrap(make_rows, start) -> None:
    """60 tables of the published model itself, each with its own noise estimate and nonlinear refit (seeds 0 to 59)."""
    p_values = []
    for seed in range(60):
        rows = make_rows(seed=seed, speeds_rpm=(400.0,))
        found, odd = noise.estimate(rows)
        cells = observations.cells(rows.take(~odd))
        frame = base_fit.base_frame(cells, found.of_cells(cells), start, "restitution")
        p_values.append(lack_of_fit.lack_of_fit(fit.fit(frame, ()), found).p_value)
    assert stats.kstest(p_values, "uniform").pvalue > 0.01
    assert np.mean(np.array(p_values) < 0.05) <= 0.15


def test_where_finds_the_region_and_its_sign(make_rows, start) -> None:
    rows = make_rows(alter=lambda f, angle, speed, flow: f * np.where((angle > 1.1) & (angle < 1.3) & (flow > 4.0), 0.9, 1.0))
    found, _ = noise.estimate(rows)
    cells = observations.cells(rows)
    frame = base_fit.base_frame(cells, found.of_cells(cells), start, "restitution")
    regions = lack_of_fit.where(base_fit.fit_base(frame), found, np.random.default_rng(0))
    assert regions[0].p_value < 0.01
    assert np.degrees(regions[0].plate_angle_rad) == pytest.approx([70.0, 70.0])
    assert regions[0].mean_error_pct == pytest.approx(8.0, abs=3.5)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda angle, speed, flow: np.abs(angle - np.radians(60.0)) < 0.01,
        lambda angle, speed, flow: np.abs(speed - 400.0 * RPM) < 0.1,
        lambda angle, speed, flow: flow > 15.0,
    ],
    ids=["one angle", "one speed", "highest flow"],
)
def test_where_shows_the_regime_that_is_wrong_and_not_what_recalibration_makes_of_it(make_rows, start, wrong) -> None:
    """Lowered by 12 % in less than half of the cells."""
    rows = make_rows(alter=lambda force, angle, speed, flow: force * np.where(wrong(angle, speed, flow), 0.88, 1.0))
    found, _ = noise.estimate(rows)
    cells = observations.cells(rows)
    frame = base_fit.base_frame(cells, found.of_cells(cells), start, "restitution")
    shown = np.zeros(len(cells), dtype=bool)
    for region in lack_of_fit.where(base_fit.fit_base(frame), found, np.random.default_rng(0)):
        shown[list(region.cells)] = True
    truly = wrong(cells.plate_angle_rad, cells.elevator_speed_rad_s, cells.load)
    assert 2.0 * np.count_nonzero(truly & shown) / (truly.sum() + shown.sum()) > 0.9


def test_where_is_silent_on_clean_data(make_rows, start) -> None:
    alarms = 0
    for seed in range(12):
        rows = make_rows(seed=100 + seed, speeds_rpm=(400.0,))
        found, _ = noise.estimate(rows)
        cells = observations.cells(rows)
        frame = base_fit.base_frame(cells, found.of_cells(cells), start, "restitution")
        alarms += bool(lack_of_fit.where(fit.fit(frame, ()), found, np.random.default_rng(seed)))
    assert alarms <= 2


def test_what_one_measures_is_no_candidate(frame) -> None:
    """The plate's thickness is given with the parameters; it is not fitted."""
    assert "top_edge" in registry()
    assert set(candidates.library(frame)) == {
        name for name, effect in registry().items() if effect.stage != "crop" and not effect.measured
    }

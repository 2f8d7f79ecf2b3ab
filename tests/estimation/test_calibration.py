"""Calibration: recovery of known parameters, the published tables, and honest reports of what is not known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from yieldmon.estimation.fitting import empirical
from yieldmon.estimation.fitting.batch import LOAD, MomentumBatch
from yieldmon.estimation.fitting.calibration import calibrate, default_start, profile_curves, search
from yieldmon.estimation.fitting.calibration_result import Calibration
from yieldmon.estimation.fitting.least_squares import levenberg_marquardt
from yieldmon.estimation.fitting.measurements import Measurements
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.priors import Prior
from yieldmon.files import table
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array

MACHINE = Machine()
MODEL = ForwardModel(MACHINE)
DATA = Path(__file__).parents[1] / "data"
TRUE = {"friction": 0.2, "restitution": 0.6, "density": 1100.0, "shape_ratio": 2.0}
FREE = ("friction", "restitution", "density")
FLOWS = np.array([2.0, 5.0, 9.0, 12.0, 15.0, 18.0, 21.0, 25.0])
HOME = Conditions(np.radians(70.0), 400.0 * RPM, mass_flow_kg_s=FLOWS)
START = {"friction": 0.6, "restitution": 0.2, "density": 1700.0, "shape_ratio": 2.0}


def generated(conditions: Conditions = HOME, values: dict[str, float] = TRUE, model: ForwardModel = MODEL) -> Measurements:
    return Measurements(conditions, np.real(model.paddle_momentum(conditions, values)))


def published(name: str, angle_deg: float | None = None) -> Measurements:
    data = table.load(DATA / f"{name}_table.csv")
    rows = Measurements(data.conditions(MACHINE), data.momentum(MACHINE))
    return rows if angle_deg is None else rows.select(np.isclose(rows.columns()[0], np.radians(angle_deg)))


def fit(rows: Measurements, impact: tuple[str, ...] = ("k1", "k2"), **options: object) -> Calibration:
    start = default_start(MODEL, rows, impact)
    return calibrate(MODEL, rows, start, ("friction", "density", *impact), **options)  # type: ignore[arg-type]


# Recovery


def test_a_single_free_parameter_may_stand_alone() -> None:
    found = calibrate(MODEL, generated(), TRUE | {"friction": 0.3}, "friction", starts=1)
    assert found.parameter_set.values["friction"] == pytest.approx(0.2, abs=1e-6)


def test_at_least_95_of_100_random_starts_reach_the_generating_parameters_to_1e_4() -> None:
    rows = generated(Conditions(np.radians(70.0), 400.0 * RPM, mass_flow_kg_s=FLOWS))
    low, high = np.array([0.0, 0.0, 750.0]), np.array([1.0, 1.0, 2000.0])
    starts = np.random.default_rng(70).uniform(low, high, (100, 3))
    batch = MomentumBatch(MODEL, HOME, FREE, {"shape_ratio": 2.0})

    def residuals(theta: Array, _: object) -> tuple[Array, Array]:
        value, slopes = batch(theta)
        return value - rows.momentum, slopes

    found = levenberg_marquardt(residuals, starts, low, high)
    error = np.max(np.abs(found.theta / np.array([TRUE[n] for n in FREE]) - 1.0), axis=1)
    assert np.sum(error < 1e-4) >= 95


def test_calibration_and_open_loop_on_generated_data() -> None:
    result = calibrate(MODEL, generated(), START, FREE, starts=20, rng=np.random.default_rng(1), intervals=False)
    for name in FREE:
        assert result.parameter_set.values[name] == pytest.approx(TRUE[name], rel=1e-6)
    assert sum(b.starts for b in result.basins) == 20
    assert len(result.basins) == 1
    force = np.real(MODEL.force(HOME, TRUE))
    flow = OpenLoop(MODEL, result.parameter_set).invert(force, np.radians(70.0), 400.0 * RPM)
    assert flow == pytest.approx(FLOWS, rel=1e-6)


def test_all_angles_and_exchange_form() -> None:
    values = {"friction": 0.35, "density": 1300.0, "shape_ratio": 2.0, "k1": 1.1, "k2": 0.7}
    conditions = Conditions(np.radians(np.tile([40.0, 55.0, 70.0, 90.0], 8)), 400.0 * RPM, mass_flow_kg_s=np.repeat(FLOWS, 4))
    rows = generated(conditions, values)
    result = fit(rows, intervals=False)
    for name, value in values.items():
        assert result.parameter_set.values[name] == pytest.approx(value, rel=1e-5)


def test_effect_parameters_by_their_qualified_name() -> None:
    model = ForwardModel(MACHINE, ("zero_offset",))
    values = TRUE | {"zero_offset.force_n": 3.0}
    conditions = Conditions(np.radians(np.tile([40.0, 70.0, 90.0], 8)), 400.0 * RPM, mass_flow_kg_s=np.repeat(FLOWS, 3))
    rows = generated(conditions, values, model)
    result = calibrate(model, rows, default_start(model, rows, ("restitution",)), (*FREE, "zero_offset.force_n"), intervals=False)
    assert result.parameter_set.values["zero_offset.force_n"] == pytest.approx(3.0, rel=1e-4)
    assert result.parameter_set.effects == ("zero_offset",)


@pytest.mark.parametrize("scale", [0.01, 200.0])
@pytest.mark.parametrize(
    ("name", "value", "power"),
    [
        ("cell_nonlinearity.softening_per_n", 0.003, -1.0),
        ("zero_offset.force_n", 3.0, 1.0),
        ("plate_buildup.weight_n", 5.0, 1.0),
        ("resting_grain.time_s", 0.05, 1.0),
    ],
)
def test_effects_in_the_readings_unit_are_found_in_any_unit(name: str, value: float, power: float, scale: float) -> None:
    model = ForwardModel(MACHINE, (name.partition(".")[0],))
    values = {"friction": 0.2, "density": 1100.0, "shape_ratio": 2.0, "k1": -0.4, "k2": 1.6, name: value}
    conditions = Conditions(np.radians(np.tile([40.0, 55.0, 70.0, 90.0], 8)), 400.0 * RPM, mass_flow_kg_s=np.repeat(FLOWS, 4))
    rows = Measurements(conditions, scale * generated(conditions, values, model).momentum)
    free = ("friction", "density", "k1", "k2", name)
    found = calibrate(model, rows, default_start(model, rows, ("k1", "k2")), free, starts=4, intervals=False)
    assert found.parameter_set.values[name] == pytest.approx(value * scale**power, rel=1e-3)


def test_same_seed_same_bits_other_seed_same_answer() -> None:
    rows = published("dem", 70.0)
    runs = [fit(rows, rng=np.random.default_rng(seed), intervals=False) for seed in (5, 5, 6)]
    assert runs[0].parameter_set.values == runs[1].parameter_set.values
    assert runs[2].residuals.rms == pytest.approx(runs[0].residuals.rms, rel=1e-6)


# The published tables


@pytest.mark.parametrize(("name", "largest_pct"), [("dem", 1.18), ("bench", 5.9)])
def test_residual_at_70_deg(name: str, largest_pct: float) -> None:
    assert fit(published(name, 70.0), intervals=False).residuals.rms_over_max_pct <= largest_pct


@pytest.mark.parametrize(("name", "largest_pct", "mean_pct"), [("dem", 4.28, 2.0), ("bench", 7.07, 2.6)])
def test_open_loop_on_means_at_70_deg(name: str, largest_pct: float, mean_pct: float) -> None:
    rows = published(name, 70.0)
    cells, index = rows.cells()
    means = Measurements(cells, np.bincount(index, rows.momentum) / np.bincount(index))
    # The physical range of density ends at 750 kg/m3, where the lightest load of the bench comes out 13.3 % off.
    result = fit(rows, bounds={"friction": (0.0, 2.0), "density": (300.0, 3000.0)}, intervals=False)
    found = empirical.Physical(MODEL, result.parameter_set).load_kg(means.columns(), means.momentum)
    error = 100.0 * np.abs(found / empirical.paddle_mass(means, MACHINE) - 1.0)
    assert error.max() <= largest_pct
    assert error.mean() <= mean_pct


@pytest.mark.parametrize(("name", "rms_pct", "noise_pct", "lack_f"), [("dem", 2.14, 0.91, 15.7), ("bench", 6.23, 4.20, 14.7)])
def test_all_angles_show_the_lack_of_fit(name: str, rms_pct: float, noise_pct: float, lack_f: float) -> None:
    rows = published(name)
    result = fit(rows, intervals=False)
    assert result.residuals.rms_over_max_pct == pytest.approx(rms_pct, abs=0.01)
    assert 100.0 * result.residuals.pure_error_sd / rows.momentum.max() == pytest.approx(noise_pct, abs=0.01)
    assert result.residuals.lack_of_fit_f == pytest.approx(lack_f, abs=0.1)
    assert any("an effect is missing" in s for s in result.sentences)


def test_the_robust_fit_of_the_bench_table_leans_less_on_an_outlier() -> None:
    rows = published("bench", 70.0)
    spoilt = rows.momentum.copy()
    spoilt[7] += 20.0 * 14.0
    spoilt_rows = Measurements(rows.conditions, spoilt)
    shift = {}
    for robust in (False, True):
        clean = fit(rows, robust=robust, intervals=False, starts=2).predicted
        dirty = fit(spoilt_rows, robust=robust, intervals=False, starts=2)
        shift[robust] = float(np.max(np.abs(dirty.predicted - clean)))
        assert 7 in dirty.residuals.outlier_rows
    assert shift[True] < 0.5 * shift[False]


@pytest.mark.parametrize("seed", [4, 5, 6])
def test_exact_zeros_of_grain_that_misses_do_not_narrow_a_robust_fit(seed: int) -> None:
    """A release 0.3 rad late throws below the plate at the lowest angles."""
    model = ForwardModel(MACHINE, ("release_angle",))
    angles, flows = np.meshgrid(np.radians([42.0, 50.0, 58.0, 62.0, 66.0, 74.0, 82.0, 90.0]), [2.0, 5.0, 9.0, 14.0, 19.0])
    conditions = Conditions(np.repeat(angles.ravel(), 3), 400.0 * RPM, mass_flow_kg_s=np.repeat(flows.ravel(), 3))
    values = TRUE | {"release_angle.angle_rad": 0.3}
    clean = np.real(model.paddle_momentum(conditions, values))
    rows = Measurements(conditions, clean * (1.0 + 0.01 * np.random.default_rng(seed).normal(size=clean.size)))
    assert np.count_nonzero(clean == 0.0) == clean.size // 4
    errors = [
        calibrate(model, part, values, FREE, starts=1, robust=True, intervals=False).parameters[0].standard_error
        for part in (rows, rows.select(clean > 0.0))
    ]
    assert errors[0] == pytest.approx(errors[1], rel=0.15)


def test_high_readings_that_scatter_as_replicates_do_are_no_outliers() -> None:
    """At 5 % of the reading high ones lie many times farther from the fit than low ones."""
    conditions = Conditions(
        np.radians(np.tile([45.0, 60.0, 75.0, 90.0], 48)), 42.0, mass_flow_kg_s=np.repeat([2.0, 4.0, 7.0, 20.0], 48)
    )
    clean = np.real(MODEL.paddle_momentum(conditions, TRUE))
    rows = Measurements(conditions, clean * (1.0 + 0.05 * np.random.default_rng(16).normal(size=clean.size)))
    assert fit(rows, intervals=False, starts=2).residuals.outlier_rows == ()
    spoilt = rows.momentum.copy()
    spoilt[3] *= 3.0
    assert fit(Measurements(conditions, spoilt), intervals=False, starts=2).residuals.outlier_rows == (3,)


# Errors


def noisy(seed: int, sd: float = 0.02) -> Measurements:
    conditions = Conditions(np.radians(np.tile([45.0, 60.0, 75.0, 90.0], 16)), 42.0, mass_flow_kg_s=np.repeat(FLOWS, 8))
    clean = np.real(MODEL.paddle_momentum(conditions, TRUE))
    return Measurements(conditions, clean + sd * np.random.default_rng(seed).normal(size=clean.size))


def test_standard_errors_and_intervals_match_the_scatter_of_repeated_calibrations() -> None:
    results = [calibrate(MODEL, noisy(seed), START, FREE, starts=1, intervals=seed < 20) for seed in range(40)]
    for i, name in enumerate(FREE):
        values = np.array([r.parameters[i].value for r in results])
        errors = np.array([r.parameters[i].standard_error for r in results])
        assert values.std() == pytest.approx(errors.mean(), rel=0.3), name
        covered = [low <= TRUE[name] <= high for low, high in (r.parameters[i].interval for r in results[:20])]
        # 95 % intervals: 16 or fewer of 20 would happen once in 60.
        assert sum(covered) >= 17, name


def test_profile_interval_ends_where_the_fit_gets_worse_by_the_quantile() -> None:
    rows = noisy(4, sd=0.2)
    result = calibrate(MODEL, rows, START, FREE, starts=1)
    low, high = result.parameters[2].interval
    best = float(np.sum((result.predicted - rows.momentum) ** 2))
    for end in (low, high):
        held = calibrate(
            MODEL, rows, dict(result.parameter_set.values, density=end), ("friction", "restitution"), starts=1, intervals=False
        )
        rise = float(np.sum((held.predicted - rows.momentum) ** 2)) - best
        dof = rows.momentum.size - 3
        # F(0.95; 1, 61) = 3.998
        assert rise / (best / dof) == pytest.approx(3.998, rel=0.03)


def test_profile_curves_are_those_of_fits_with_the_parameter_held() -> None:
    rows = noisy(4, sd=0.2)
    result = calibrate(MODEL, rows, START, FREE, starts=1)
    best = float(np.sum((result.predicted - rows.momentum) ** 2))
    variance = best / (rows.momentum.size - 3)
    curves = {c.name: c for c in profile_curves(MODEL, rows, result, points=9)}
    assert set(curves) == set(FREE)
    for name in FREE:
        curve = curves[name]
        assert np.all(np.diff(curve.rise) > 0.0), name
        assert curve.rise[4] == pytest.approx(0.0, abs=1e-6)
        low, high = next(p.interval for p in result.parameters if p.name == name)
        assert np.interp([-curve.limit, curve.limit], curve.rise, curve.values) == pytest.approx([low, high], rel=0.02)
        for at in (0, 2, 8):
            others = tuple(n for n in FREE if n != name)
            held = calibrate(
                MODEL, rows, dict(result.parameter_set.values) | {name: curve.values[at]}, others, starts=1, intervals=False
            )
            rise = float(np.sum((held.predicted - rows.momentum) ** 2)) - best
            assert curve.rise[at] ** 2 == pytest.approx(rise / variance, rel=1e-3), name


def test_a_given_sigma_is_used() -> None:
    rows = noisy(8)
    given = Measurements(rows.conditions, rows.momentum, np.full(rows.momentum.shape, 0.02))
    doubled = Measurements(rows.conditions, rows.momentum, np.full(rows.momentum.shape, 0.04))
    one = calibrate(MODEL, given, START, FREE, starts=1, intervals=False)
    two = calibrate(MODEL, doubled, START, FREE, starts=1, intervals=False)
    for a, b in zip(one.parameters, two.parameters, strict=True):
        assert b.standard_error / a.standard_error == pytest.approx(2.0, rel=0.15)


def test_lack_of_fit_of_rows_of_unlike_sigma_has_its_stated_false_alarm_rate() -> None:
    conditions = Conditions(np.radians(np.tile([45.0, 60.0, 75.0, 90.0], 16)), 42.0, mass_flow_kg_s=np.repeat(FLOWS, 8))
    clean = np.real(MODEL.paddle_momentum(conditions, TRUE))
    sigma = np.where(np.asarray(conditions.mass_flow_kg_s) == FLOWS[3], 0.5, 0.005)
    p_values = []
    for seed in range(60):
        rows = Measurements(conditions, clean + sigma * np.random.default_rng(seed).normal(size=clean.size), sigma)
        p_values.append(calibrate(MODEL, rows, TRUE, FREE, starts=1, intervals=False).residuals.lack_of_fit_p)
    # 3 of 60 expected below 0.05; 8 or more would happen once in 90.
    assert np.count_nonzero(np.array(p_values) < 0.05) <= 7


def test_noise_that_grows_with_the_reading_is_neither_a_missing_effect_nor_a_certainty() -> None:
    grid = np.meshgrid(np.radians([45.0, 55.0, 65.0, 75.0, 85.0]), [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 24.0], [31.0, 42.0, 52.0])
    angle, flow, speed = (np.tile(each.ravel(), 3) for each in grid)
    conditions = Conditions(angle, speed, mass_flow_kg_s=flow)
    clean = np.real(MODEL.paddle_momentum(conditions, TRUE))
    p_values, z, inside, own = [], [], [], []
    for seed in range(30):
        rows = Measurements(conditions, clean * (1.0 + 0.02 * np.random.default_rng(seed).normal(size=clean.size)))
        found = calibrate(MODEL, rows, TRUE, FREE, starts=1, intervals=seed < 15)
        p_values.append(found.residuals.lack_of_fit_p)
        z.append([(p.value - TRUE[p.name]) / p.standard_error for p in found.parameters])
        inside += [p.interval[0] <= TRUE[p.name] <= p.interval[1] for p in found.parameters if seed < 15]
        own.append(found.parameter_set.model_error)
    # 0.3 of 30 expected below 0.01; 3 or more would happen once in 300. Standard errors of rows that scatter alike: 1.5 to 1.8.
    assert np.count_nonzero(np.array(p_values) < 0.01) <= 2
    assert np.all(np.std(z, axis=0) < 1.25)
    assert np.mean(inside) > 0.85
    # Not known to be above the least that is assumed.
    assert np.median(own) == 0.0


DESIGNS = {
    # angles, flows, times that each is read; droop of the jet, rad, and power of the flow beside 1; least and largest rms z
    "30 rows read once": (
        [40.0, 50.0, 60.0, 70.0, 80.0, 90.0],
        [4.0, 8.0, 12.0, 16.0, 20.0],
        1,
        (0.25, 0.4),
        (0.0, 0.15),
        (0.5, 1.7),
    ),
    "a small table read twice": ([55.0, 65.0, 75.0], [6.0, 10.0, 14.0], 2, (0.0, 0.35), (-0.2, 0.1), (0.15, 1.25)),
}


@pytest.mark.parametrize("name", DESIGNS)
def test_what_the_model_misses_of_another_law_is_stated_and_bounded(name: str) -> None:
    """A coherent jet whose gain falls with the paddle's load, and power laws of the flow."""
    angles, flows, times, droops, powers, (low, high) = DESIGNS[name]
    angle, flow = (np.repeat(v.ravel(), times) for v in np.meshgrid(np.radians(angles), flows))
    ratio = generated(Conditions(np.radians([70.0]), 42.0, mass_flow_kg_s=np.array([8.0]))).momentum[0] / 8.0
    z, sizes, errors = [], [], []
    for seed in range(12):
        rng = np.random.default_rng([seed, 77])
        droop, shield, power = rng.uniform(*droops), rng.uniform(0.0, 0.03), rng.uniform(*powers)

        def law(m: Array, a: Array, droop=droop, shield=shield, power=power) -> Array:
            return ratio * m * np.sin(a) * np.sin(a - droop) / (1.0 + shield * m) * (m / 10.0) ** power

        reading = law(flow, angle) * (1.0 + 0.015 * rng.standard_normal(flow.size))
        rows = Measurements(Conditions(angle, 42.0, mass_flow_kg_s=flow), reading)
        known = fit(rows, ("restitution",), starts=2, intervals=False).parameter_set
        true, at = rng.uniform(min(flows), max(flows), 30), np.radians(rng.uniform(min(angles), max(angles), 30))
        force = law(true, at) * MACHINE.passes_per_s(42.0)
        found = OpenLoop(MODEL, known).estimate(force, at, 42.0)
        z.append((found.mass_flow_kg_s - true) / found.std_dev_kg_s)
        errors.append(np.sqrt(np.nanmean((found.mass_flow_kg_s / true - 1.0) ** 2)))
        sizes.append(known.model_error)
    assert low < np.sqrt(np.nanmean(np.square(z))) < high
    assert max(sizes) < 3.0 * max(errors)


def test_what_parameters_at_their_bounds_leave_is_an_error_of_the_model() -> None:
    """Readings that no grain of 1 + e gives: every parameter ends at a bound, and none of them makes up for an error. Flows of
    the rows themselves were 26 % off with a z of 2.4."""
    rows = published("dem")
    found = fit(rows, ("restitution",), starts=2, intervals=False)
    assert all(p.at_bound for p in found.parameters)
    angle, speed, mass, _ = rows.columns()
    passes = MACHINE.passes_per_s(speed)
    estimated = OpenLoop(MODEL, found.parameter_set).estimate(rows.momentum * passes, angle, speed, 0.046 * passes)
    z = (estimated.mass_flow_kg_s - mass * passes) / estimated.std_dev_kg_s
    assert 0.5 < np.sqrt(np.nanmean(np.square(z))) < 1.1


def test_few_rows_that_agree_by_chance_are_not_certain() -> None:
    """One degree of freedom: residuals are next to nothing in one table of ten."""
    rows = Conditions(np.radians([55.0, 55.0, 75.0, 75.0]), 42.0, mass_flow_kg_s=np.array([6.0, 14.0, 6.0, 14.0]))
    clean, z = generated(rows).momentum, []
    for seed in range(40):
        noise = 1.0 + 0.01 * np.random.default_rng([seed, 4]).standard_normal(4)
        known = calibrate(MODEL, Measurements(rows, clean * noise), TRUE, FREE, starts=1, intervals=False).parameter_set
        found = OpenLoop(MODEL, known).estimate(MODEL.force(HOME, TRUE), HOME.plate_angle_rad, 400.0 * RPM)
        z.append((found.mass_flow_kg_s - FLOWS)[2:4] / found.std_dev_kg_s[2:4])
    assert np.sqrt(np.mean(np.square(z))) < 1.3
    assert np.max(np.abs(z)) < 4.0


@pytest.mark.parametrize("robust", [False, True])
def test_repetitions_that_agree_by_a_coarse_resolution_leave_no_error_of_the_model(robust: bool) -> None:
    rows = noisy(4, sd=0.1)
    coarse = Measurements(rows.conditions, np.round(rows.momentum / 0.5) * 0.5)
    repeats = coarse.momentum.reshape(8, 2, 4)
    assert np.mean(repeats[:, 0] == repeats[:, 1]) > 0.5
    found = calibrate(MODEL, coarse, START, FREE, starts=1, robust=robust, intervals=False)
    assert found.parameter_set.model_error < 0.01


def test_rows_without_replicates_do_not_loosen_the_robust_fit() -> None:
    rows = noisy(5)
    number = np.arange(rows.momentum.size) % 8
    # One row of each condition, and a second of those at 45 deg.
    chosen = rows.select(number < 5)
    spoilt = chosen.momentum.copy()
    spoilt[13] += 20.0 * 0.02
    shift = {}
    for robust in (False, True):
        clean = calibrate(MODEL, chosen, START, FREE, starts=1, robust=robust, intervals=False)
        dirty = calibrate(MODEL, Measurements(chosen.conditions, spoilt), START, FREE, starts=1, robust=robust, intervals=False)
        assert dirty.residuals.pure_error_dof == 8
        shift[robust] = float(np.max(np.abs(dirty.predicted - clean.predicted)))
    assert shift[True] < 0.2 * shift[False]


def test_a_prior_counts_as_one_more_measurement() -> None:
    rows = noisy(9, sd=0.5)
    alone = calibrate(MODEL, rows, START, FREE, starts=1, intervals=False)
    prior = Prior.independent({"density": 1100.0}, {"density": 1.0})
    with_prior = calibrate(MODEL, rows, START, FREE, prior=prior, starts=1, intervals=False)
    assert with_prior.parameter_set.values["density"] == pytest.approx(1100.0, abs=1.0)
    assert with_prior.parameters[2].standard_error <= 1.0
    assert with_prior.parameters[0].standard_error < alone.parameters[0].standard_error


# What is not known


def test_at_bound_and_undetermined_parameters_are_reported_in_words() -> None:
    result = fit(published("dem", 70.0))
    by_name = {p.name: p for p in result.parameters}
    assert by_name["friction"].at_bound == "upper"
    assert by_name["density"].open_below
    assert not by_name["density"].determined
    text = " ".join(result.sentences)
    assert "friction is at its upper bound 1" in text
    assert "density is determined on one side only" in text
    assert "trade off" in text


def test_a_search_says_before_its_fit_is_examined_which_parameters_are_at_a_bound() -> None:
    rows, free = published("dem", 70.0), ("friction", "density", "k1", "k2")
    found = search(MODEL, rows, default_start(MODEL, rows, free[2:]), free)
    assert found.at_bound == tuple(p.name for p in fit(rows).parameters if p.at_bound)
    assert "friction" in found.at_bound


def test_density_of_thin_loads_is_not_determined() -> None:
    conditions = Conditions(np.radians([60.0, 70.0, 80.0, 90.0]), 42.0, mass_flow_kg_s=np.array([0.2, 0.3, 0.2, 0.3]))
    clean = np.real(MODEL.paddle_momentum(conditions, TRUE))
    rows = Measurements(conditions, clean * (1.0 + 0.01 * np.array([1.0, -1.0, 0.5, -0.5])))
    result = calibrate(MODEL, rows, dict(START), ("restitution", "density"), starts=3)
    density = result.parameters[1]
    assert density.open_below
    assert density.open_above
    assert "density is not determined: every value from 750 to 2000" in " ".join(result.sentences)
    # Root mean square distance of anywhere between the bounds from the value, which is a bound.
    assert density.value in (750.0, 2000.0)
    anywhere = (2000.0 - 750.0) / np.sqrt(3.0)
    assert 0.9 * anywhere < result.parameter_set.standard_deviation("density") <= anywhere


def test_a_standard_deviation_covers_the_truth_where_the_fit_ends_at_a_bound() -> None:
    """By a cap of width/sqrt(12), which holds for a value in the middle, density at its far bound is 2.5 from the truth here."""
    angle, speed, flow = (v.ravel() for v in np.meshgrid(np.radians([45.0, 65.0, 85.0]), [34.0, 46.0], np.linspace(2.0, 14.0, 5)))
    conditions = Conditions(angle, speed, mass_flow_kg_s=flow)
    clean = np.real(MODEL.paddle_momentum(conditions, TRUE))
    at_bound, z = 0, []
    for seed in range(12):
        rng = np.random.default_rng([seed, 5])
        sd = np.full(clean.shape, 0.03 * float(clean.max()))
        rows = Measurements(conditions, clean + sd * rng.standard_normal(clean.shape), sigma=sd)
        found = calibrate(MODEL, rows, dict(START), FREE, starts=2, intervals=False)
        known = found.parameter_set
        at_bound += any(p.at_bound for p in found.parameters)
        z += [abs(known.values[n] - TRUE[n]) / known.standard_deviation(n) for n in FREE]
    assert at_bound >= 2
    assert max(z) < 2.2


@pytest.mark.parametrize("share", [0.008, 0.016])
def test_bounds_take_no_more_off_the_standard_error_than_puts_it_within_them(share: float) -> None:
    """The best fit is not drawn towards the middle of the bounds, so its error is that of the rows."""
    angle, flow = (v.ravel() for v in np.meshgrid(np.radians([40.0, 55.0, 70.0, 85.0]), np.linspace(2.0, 18.0, 5)))
    conditions = Conditions(angle, 42.0, mass_flow_kg_s=flow)
    clean = np.real(MODEL.paddle_momentum(conditions, TRUE))
    noise = share * float(clean.max()) * np.random.default_rng(3).standard_normal(clean.shape)
    found = calibrate(MODEL, Measurements(conditions, clean + noise), dict(START), FREE, starts=2, intervals=False)
    assert not any(p.at_bound for p in found.parameters)
    anywhere = np.array([1.0, 1.0, 2000.0 - 750.0]) / np.sqrt(12.0)
    beyond = np.array([p.standard_error for p in found.parameters]) / anywhere
    stated = np.array([found.parameter_set.standard_deviation(name) for name in FREE]) / anywhere
    assert beyond.max() > 0.5
    assert stated.max() == pytest.approx(min(beyond.max(), 1.0), rel=1e-6)
    assert np.all(stated <= beyond * (1.0 + 1e-6))


def test_bounds_leave_the_flow_as_well_known_as_its_rows_make_it() -> None:
    """At one plate angle friction and density, each hardly known, make up for each other."""
    model, gravity = ForwardModel(MACHINE, ("gravity",)), {"gravity.acceleration_m_s2": 9.81}
    true, angle = TRUE | gravity | {"friction": 0.4}, np.radians(70.0)
    speed, flow = (np.tile(v.ravel(), 3) for v in np.meshgrid([36.0, 48.0], [2.0, 5.0, 9.0, 14.0, 19.0]))
    rows = Conditions(angle, speed, mass_flow_kg_s=flow)
    clean = np.real(model.paddle_momentum(rows, true))
    force = float(np.real(model.force(Conditions(angle, 42.0, mass_flow_kg_s=8.0), true)))
    stated = []
    for seed in range(5):
        noise = 0.01 * np.random.default_rng([seed, 8]).standard_normal(clean.shape)
        found = calibrate(model, Measurements(rows, clean * (1.0 + noise)), START | gravity, FREE, starts=2, intervals=False)
        stated.append(float(OpenLoop(model, found.parameter_set).estimate(force, angle, 42.0).std_dev_kg_s) / 8.0)
    assert max(stated) < 0.012


SINGLE_ROWS = {
    "angles and loads": ([40.0, 50.0, 60.0, 70.0, 80.0, 90.0], [4.0, 8.0, 12.0, 16.0, 20.0]),
    "few angles and loads": ([50.0, 65.0, 80.0], [5.0, 10.0, 15.0]),
    "one angle": ([70.0], [4.0, 8.0, 12.0, 16.0, 20.0]),
    "three rows": ([70.0], [5.0, 10.0, 15.0]),
}


@pytest.mark.parametrize("rows", SINGLE_ROWS)
def test_flows_between_rows_without_replicates_are_covered_where_the_model_is_wrong(rows: str) -> None:
    """A jet whose force falls with its thickness, read once in each place: nothing parts the model's error from noise."""
    angles, loads = SINGLE_ROWS[rows]
    rng = np.random.default_rng(12)
    off = []
    for gain, thins, below_deg in zip(
        rng.uniform(1.0, 1.5, 6), rng.uniform(0.005, 0.03, 6), rng.uniform(0.0, 20.0, 6), strict=True
    ):

        def per_paddle(angle_rad: Array, flow: Array) -> Array:
            turned = np.sin(angle_rad) * np.sin(angle_rad - np.radians(below_deg))  # noqa: B023
            return gain * 0.64 * flow * turned / (1.0 + thins * flow)  # noqa: B023

        angle, flow = (v.ravel() for v in np.meshgrid(np.radians(angles), loads))
        reading = per_paddle(angle, flow) * (1.0 + 0.01 * rng.standard_normal(flow.size))
        data = Measurements(Conditions(angle, 400.0 * RPM, mass_flow_kg_s=flow), reading)
        known = calibrate(MODEL, data, dict(START), FREE, starts=3, intervals=False).parameter_set
        at, true = np.radians(rng.uniform(min(angles), max(angles), 30)), rng.uniform(min(loads), max(loads), 30)
        force = per_paddle(at, true) * MACHINE.passes_per_s(400.0 * RPM)
        found = OpenLoop(MODEL, known).estimate(force, at, 400.0 * RPM)
        off.append((found.mass_flow_kg_s - true) / found.std_dev_kg_s)
    assert np.sqrt(np.nanmean(np.square(off))) < 1.5
    assert np.nanmean(np.abs(off) < 2.0) > 0.85


def test_rows_as_many_as_parameters_do_not_show_their_noise_and_it_is_said() -> None:
    rows = Conditions(np.radians(70.0), 400.0 * RPM, mass_flow_kg_s=np.array([5.0, 10.0, 15.0]))
    found = calibrate(MODEL, generated(rows), dict(START), FREE, starts=2, intervals=False)
    assert any("taken for 1 % of the largest reading" in text for text in found.sentences)
    force = MODEL.force(HOME, TRUE)
    stated = OpenLoop(MODEL, found.parameter_set).estimate(force[2], np.radians(70.0), 400.0 * RPM)
    assert 0.005 < stated.std_dev_kg_s / stated.mass_flow_kg_s < 0.03
    more = Conditions(np.radians(70.0), 400.0 * RPM, mass_flow_kg_s=np.array([5.0, 8.0, 10.0, 15.0]))
    assert not any("noise" in text for text in calibrate(MODEL, generated(more), dict(START), FREE, starts=2).sentences)


def test_an_outlier_of_a_robust_fit_is_no_error_of_the_model() -> None:
    """A twentieth of the readings is 30 % off, the others by noise of 1 %."""
    angle, flow = (v.ravel() for v in np.meshgrid(np.radians([40.0, 55.0, 70.0, 85.0]), np.linspace(2.0, 18.0, 6)))
    conditions = Conditions(np.tile(angle, 3), 42.0, mass_flow_kg_s=np.tile(flow, 3))
    rng = np.random.default_rng(4)
    reading = np.real(MODEL.paddle_momentum(conditions, TRUE)) * (1.0 + 0.01 * rng.standard_normal(72))
    reading[rng.choice(72, 4, replace=False)] *= [0.7, 1.3, 0.7, 1.3]
    found = calibrate(MODEL, Measurements(conditions, reading), dict(START), FREE, starts=2, robust=True, intervals=False)
    assert found.parameter_set.model_error < 0.01


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (lambda: generated(Conditions(1.2, 42.0, mass_flow_kg_s=np.array([1.0, 2.0]))), "2 rows cannot fix 3 parameters"),
        (lambda: Measurements(HOME, np.full(8, np.nan)), "finite numbers"),
        (lambda: Measurements(HOME, np.ones(8), np.zeros(8)), "sigma must hold a number above 0"),
        (
            lambda: Measurements(Conditions(1.2, 42.0, paddle_mass_kg=np.arange(60.0, 52.0, -1.0)), np.ones(8)),
            "the heaviest load, 60 kg a paddle in row 1;",
        ),
        (
            lambda: Measurements(Conditions(1.2, 42.0, mass_flow_kg_s=np.array([5.0, 7.0, 900.0, 9.0])), np.ones(4)),
            "the heaviest load, 900 kg/s in row 3;",
        ),
        (lambda: HOME, "data: is of type Conditions; expected Measurements"),
        (lambda: Measurements(Conditions(1.2, 42.0, mass_flow_kg_s=np.full(8, -5.0)), np.ones(8)), "load must be 0 or more"),
        (lambda: Measurements(Conditions(1.2, np.full(7, 42.0), mass_flow_kg_s=5.0), np.ones(8)), r"rad_s has the shape \(7,\)"),
        (lambda: Measurements(HOME, np.zeros(8)), "every reading is 0"),
    ],
)
def test_bad_rows_are_refused(rows, message: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ValueError, match=message):
        calibrate(MODEL, rows(), START, FREE)


@pytest.mark.parametrize(
    ("free", "changes", "message"),
    [
        (("friktion",), {}, r"\['friktion'\] are not among"),
        (("friction", "friction"), {}, "expected each once"),
        (FREE, {"starts": 0}, "starts 0: expected 1 or more"),
        (FREE, {"bounds": {"friction": (1.0, 0.0)}}, r"bounds of friction \(1, 0\): expected the lower one first"),
        (FREE, {"bounds": {"fricton": (0.0, 1.0)}}, "bounds of fricton: not in this model; expected one of friction"),
        (FREE, {"bounds": {"zero_offset.force_n": (0.0, 1.0)}}, "bounds of zero_offset.force_n: not in this model"),
    ],
)
def test_a_search_that_cannot_be_made_is_refused(free: tuple[str, ...], changes: dict, message: str) -> None:  # type: ignore[type-arg]
    rows = generated(Conditions(1.2, 42.0, mass_flow_kg_s=np.array([1.0, 2.0, 5.0, 9.0])))
    with pytest.raises(ValueError, match=message):
        calibrate(MODEL, rows, START, free, **changes)


def test_a_start_is_values_by_name() -> None:
    rows = generated(Conditions(1.2, 42.0, mass_flow_kg_s=np.array([1.0, 2.0, 5.0, 9.0])))
    with pytest.raises(ValueError, match="start: is of type ParameterSet; expected values by name"):
        calibrate(MODEL, rows, ParameterSet(values=START), FREE)  # type: ignore[arg-type]


def test_one_condition_is_enough_for_one_parameter_or_beside_a_prior() -> None:
    rows = generated(Conditions(1.2, 42.0, mass_flow_kg_s=np.full(10, 9.0)))
    alone = calibrate(MODEL, rows, START, ("restitution",), starts=1, intervals=False)
    assert np.isfinite(alone.parameters[0].standard_error)
    prior = Prior(FREE, np.array([START[name] for name in FREE]), np.diag([0.01, 0.01, 1e4]))
    beside = calibrate(MODEL, rows, START, FREE, prior=prior, starts=1, intervals=False)
    assert all(np.isfinite(parameter.standard_error) for parameter in beside.parameters)


def test_a_start_needs_one_form_of_the_impact() -> None:
    with pytest.raises(ValueError, match="impact 'restitution': expected"):
        default_start(MODEL, generated(Conditions(1.2, 42.0, mass_flow_kg_s=np.array([1.0, 2.0]))), "restitution")


# The batch


@pytest.mark.parametrize("names", [FREE, ("friction", "density", "k1", "k2", "shape_ratio")])
def test_the_shortcut_for_the_published_model_equals_complex_steps(names: tuple[str, ...]) -> None:
    values = {"friction": 0.3, "restitution": 0.5, "density": 1250.0, "shape_ratio": 2.1, "k1": 1.4, "k2": 0.6}
    fixed = {} if "shape_ratio" in names else {"shape_ratio": 2.1}
    conditions = Conditions(np.radians([41.0, 66.0, 89.0]), 42.0, mass_flow_kg_s=np.array([1.0, 9.0, 20.0]))
    batch = MomentumBatch(MODEL, conditions, names, fixed)
    theta = np.array([values[n] for n in names])
    value, slopes, by_load = batch.at_load(theta, batch.load)
    known = {n: values[n] for n in names} | fixed
    expected, jacobian = MODEL.derivatives(conditions, known, (*names, "mass_flow_kg_s"))
    assert value == pytest.approx(expected, rel=1e-13)
    assert np.column_stack((slopes, by_load)) == pytest.approx(jacobian, rel=1e-9)
    assert LOAD not in names


def test_rows_that_cannot_be_carried_are_nan_and_the_search_turns_back() -> None:
    conditions = Conditions(1.2, 42.0, paddle_mass_kg=np.array([1.0, 3.5]))
    rows = Measurements(conditions, np.real(MODEL.paddle_momentum(conditions, TRUE)))
    batch = MomentumBatch(MODEL, conditions, ("density",), {k: v for k, v in TRUE.items() if k != "density"})
    value, _ = batch(np.array([[600.0], [1100.0]]))
    assert np.isnan(value[0, 1])
    found = levenberg_marquardt(
        lambda t, _: (batch(t)[0] - rows.momentum, batch(t)[1]),
        np.array([[2000.0], [600.0]]),
        np.array([100.0]),
        np.array([5000.0]),
    )
    assert found.theta[0, 0] == pytest.approx(1100.0, rel=1e-6)
    assert found.cost[1] == np.inf
    assert found.theta[1, 0] == 600.0


def test_the_search_finds_a_minimum_on_a_bound() -> None:
    def bowl(theta: Array, _: object) -> tuple[Array, Array]:
        slopes = np.broadcast_to(np.diag([1.0, 3.0]) + 0.5, (len(theta), 2, 2))
        return np.einsum("mn,bn->bm", slopes[0], theta - np.array([2.0, 0.3])), slopes

    start = np.random.default_rng(2).uniform(0.0, 1.0, (10, 2))
    found = levenberg_marquardt(bowl, start, np.zeros(2), np.ones(2))
    matrix = np.diag([1.0, 3.0]) + 0.5
    # With the first coordinate held at its bound: the least squares of the second.
    second = 0.3 - matrix[:, 1] @ matrix[:, 0] * (1.0 - 2.0) / (matrix[:, 1] @ matrix[:, 1])
    assert found.theta[:, 0] == pytest.approx(1.0)
    assert found.theta[:, 1] == pytest.approx(second, abs=1e-7)
    assert found.converged.all()


# Empirical models


def test_each_empirical_model_recovers_what_it_can_describe() -> None:
    conditions = Conditions(np.radians(70.0), 42.0, paddle_mass_kg=np.array([0.1, 0.2, 0.4, 0.6, 0.8, 1.0]))
    mass = np.asarray(conditions.paddle_mass_kg)
    linear = Measurements(conditions, 5.0 * mass)
    assert empirical.ForceProportional.fit(linear, mass).load_kg(linear.columns(), linear.momentum) == pytest.approx(mass)
    # Solves mass = 0.2 momentum + 0.01 momentum^2, which is quadratic in force over speed.
    bent = Measurements(conditions, 10.0 * (np.sqrt(1.0 + mass) - 1.0))
    curve = empirical.AlphaBetaLoad.fit(bent, mass, MACHINE)
    assert min(curve.law.alpha, curve.law.beta) > 0.0
    assert curve.load_kg(bent.columns(), bent.momentum) == pytest.approx(mass)
    table_model = empirical.InterpolatedTable.fit(bent, mass)
    assert table_model.load_kg(bent.columns(), bent.momentum) == pytest.approx(mass)


def test_interpolated_table_has_no_answer_elsewhere_and_goes_on_above() -> None:
    conditions = Conditions(np.radians(70.0), 42.0, paddle_mass_kg=np.array([0.5, 1.0]))
    rows = Measurements(conditions, np.array([2.0, 3.0]))
    known = empirical.InterpolatedTable.fit(rows, np.array([0.5, 1.0]))
    columns = np.array([[np.radians(70.0), np.radians(60.0)], [42.0, 42.0], [0.0, 0.0], [np.nan, np.nan]])
    assert known.load_kg(columns, np.array([5.0, 2.0])) == pytest.approx([2.0, np.nan], nan_ok=True)


def test_cross_validation_leaves_each_load_out() -> None:
    # A model that only remembers fails on every load; one that knows the law does not.
    class Memory:
        def __init__(self, rows: Measurements) -> None:
            self.rows = rows

        def load_kg(self, columns: Array, momentum: Array) -> Array:
            seen = np.isclose(momentum[:, None], self.rows.momentum).any(axis=1)
            return np.where(seen, columns[2], 0.0)

    conditions = Conditions(np.radians(70.0), 42.0, paddle_mass_kg=np.array([0.1, 0.2, 0.4, 0.8]))
    rows = Measurements(conditions, 5.0 * np.asarray(conditions.paddle_mass_kg))
    found = {c.model: c for c in empirical.compare(rows, MACHINE, {"memory": Memory})}
    assert found["memory"].mean_abs_pct == pytest.approx(100.0)
    assert found["force-proportional (1 constant)"].max_abs_pct < 1e-9
    assert found["alpha-beta (2 coefficients)"].max_abs_pct < 1e-6


def test_too_few_loads_to_compare() -> None:
    conditions = Conditions(np.radians(70.0), 42.0, paddle_mass_kg=np.array([0.1, 0.2]))
    with pytest.raises(ValueError, match="2 loads"):
        empirical.compare(Measurements(conditions, np.ones(2)), MACHINE)


def test_lists_of_numbers_are_taken_as_arrays() -> None:
    rows = Measurements(Conditions([0.9, 1.2], 42.0, mass_flow_kg_s=[5.0, 10.0]), [3.0, 7.0], sigma=[0.1, 0.1])
    assert rows.momentum.tolist() == [3.0, 7.0]
    with pytest.raises(ValueError, match="sigma must hold a number above 0 for each row"):
        Measurements(Conditions([0.9, 1.2], 42.0, mass_flow_kg_s=[5.0, 10.0]), [3.0, 7.0], sigma=[0.1])

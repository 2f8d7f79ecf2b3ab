"""A pattern that sweeps share is found; what they do not share is not."""

from __future__ import annotations

import numpy as np
import pytest

from tests.plant_sweeps import MACHINE, MOISTURE_PCT, NONE, SPEED_RAD_S, STRONG, shown_force, sweep_windows
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.misfit import (
    ReducedSweep,
    SweepResiduals,
    common_misfit,
    pooled_residuals,
    reduce_sweep,
)
from yieldmon.files import parameter_file
from yieldmon.physics.model import Conditions, ForwardModel

ANGLES = np.radians([40.0, 45.0, 50.0, 55.0, 60.0, 65.0, 70.0, 75.0, 80.0, 85.0, 90.0])
SD = np.full(ANGLES.shape, 0.01)


def sweeps(pattern: np.ndarray, count: int, seed: int, scatter: float = 0.01) -> list[SweepResiduals]:
    rng = np.random.default_rng(seed)
    return [SweepResiduals(ANGLES, pattern + scatter * rng.standard_normal(ANGLES.size), SD, 3) for _ in range(count)]


LOCAL = np.where((np.radians(54.0) < ANGLES) & (np.radians(66.0) > ANGLES), -0.03, 0.0)


def test_a_shared_pattern_is_found_with_its_region_and_sign() -> None:
    found = common_misfit(sweeps(LOCAL, 6, seed=1))
    assert found.disagrees
    assert np.degrees(found.plate_angle_rad) == pytest.approx([55.0, 65.0])
    assert found.mean_relative_error == pytest.approx(-0.03, abs=0.01)


def test_noise_raises_no_alarm() -> None:
    assert not any(common_misfit(sweeps(0.0 * ANGLES, 6, seed)).disagrees for seed in range(200))


def test_a_pattern_of_one_sweep_alone_raises_no_alarm() -> None:
    """Flow that wandered in each sweep in its own way."""
    wander = [sweeps(0.08 * np.sin(4.0 * ANGLES + phase), 1, seed)[0] for seed, phase in enumerate(np.linspace(0.0, 5.0, 6))]
    assert not common_misfit(wander).disagrees


def test_noise_above_what_was_stated_raises_no_alarm() -> None:
    assert not any(common_misfit(sweeps(0.0 * ANGLES, 6, seed, scatter=0.05)).disagrees for seed in range(100))


def test_scatter_below_what_was_stated_sharpens_nothing() -> None:
    """The stated noise may be common to the sweeps; that they agree closely does not make a small pattern the model's."""
    assert not common_misfit(sweeps(0.1 * LOCAL, 6, seed=1, scatter=1e-4)).disagrees


def test_what_was_fitted_to_all_sweeps_counts_once() -> None:
    """p values of noise from which a parabola has been fitted away are uniform: mean 1/2, of 200 within 0.02 (standard error)."""
    basis, _ = np.linalg.qr(np.vander(ANGLES - ANGLES.mean(), 3))
    p_values = []
    for seed in range(200):
        drawn = [s.relative_residual for s in sweeps(0.0 * ANGLES, 6, seed)]
        common = basis @ (basis.T @ np.mean(drawn, axis=0))
        left = [SweepResiduals(ANGLES, r - common, SD, 0) for r in drawn]
        p_values.append(common_misfit(left, level=0.0, shared=3).p_value)
    assert np.mean(p_values) == pytest.approx(0.5, abs=0.08)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_few_sweeps_say_nothing(count: int) -> None:
    found = common_misfit(sweeps(LOCAL, count, seed=1))
    assert (found.disagrees, found.p_value) == (False, 1.0)


def test_unknown_residuals_are_passed_over() -> None:
    broken = [
        SweepResiduals(s.plate_angle_rad, np.where(ANGLES > 1.5, np.nan, s.relative_residual), s.sd, 3)
        for s in sweeps(LOCAL, 6, 1)
    ]
    assert common_misfit(broken).disagrees


MODEL = ForwardModel(MACHINE, ("gravity",))
SHIPPED = parameter_file.load()
COLUMNS = ("time_s", "plate_angle_rad", "elevator_speed_rad_s", "force_n", "force_std_dev_n", "moisture_pct")


def reduced(effects: dict, flow_kg_s: float, seed: int, **how: float) -> ReducedSweep:
    windows = sweep_windows(MACHINE, shown_force(MACHINE, effects), flow_kg_s=flow_kg_s, seed=seed, **how)
    found = reduce_sweep(MODEL, SHIPPED, **{name: np.array([getattr(w, name) for w in windows]) for name in COLUMNS})
    assert found is not None
    return found


def test_a_sweep_is_brought_to_one_flow() -> None:
    """Flow that doubles during the sweep leaves the forces of a steady one; plate angles come once each."""
    windows = sweep_windows(MACHINE, shown_force(MACHINE, NONE), flow_kg_s=8.0, seed=1, wander=0.0)
    columns = {name: np.array([getattr(w, name) for w in windows]) for name in COLUMNS}
    growing = 8.0 * np.exp(columns["time_s"] / columns["time_s"].max() * np.log(2.0))
    steady = np.full(growing.shape, 8.0 * np.sqrt(2.0))

    def sweep(flow: np.ndarray) -> ReducedSweep:
        force = shown_force(MACHINE, NONE)(flow, columns["plate_angle_rad"])
        found = reduce_sweep(MODEL, SHIPPED, **(columns | {"force_n": force}))
        assert found is not None
        return found

    one, other = sweep(growing), sweep(steady)
    assert np.degrees(one.plate_angle_rad) == pytest.approx([40.0, 50.0, 60.0, 70.0, 80.0, 90.0])
    apart = one.log_force - other.log_force
    assert apart - apart.mean() == pytest.approx(0.0, abs=0.01)


def test_a_reduced_sweep_scatters_by_its_standard_deviation() -> None:
    drawn = [reduced(NONE, 10.0, seed=seed) for seed in range(40)]
    scatter = np.std([s.log_force for s in drawn], axis=0, ddof=1)
    stated = np.sqrt(np.mean([s.sd**2 for s in drawn], axis=0))
    assert 0.6 < np.mean(scatter / stated) < 1.1


@pytest.mark.parametrize(
    "change", [{"friction": 0.35}, {"density": 1400.0}, {"restitution": 0.3}, {"friction": 0.1, "density": 950.0}], ids=str
)
def test_what_a_recalibration_absorbs_leaves_nothing(change: dict[str, float]) -> None:
    true = dict(SHIPPED.values) | change
    angle = np.radians(np.arange(40.0, 91.0, 10.0))
    sweeps = []
    for flow in (6.0, 9.0, 12.0, 15.0):
        conditions = Conditions(angle, np.full(6, SPEED_RAD_S), mass_flow_kg_s=np.full(6, flow))
        log_force = np.log(np.real(MODEL.force(conditions, true)))
        sweeps.append(ReducedSweep(angle, log_force, np.full(6, 0.01), flow, SPEED_RAD_S, MOISTURE_PCT))
    residuals, moved = pooled_residuals(MODEL, SHIPPED, sweeps)
    assert moved == 3
    assert np.concatenate([r.relative_residual for r in residuals]) == pytest.approx(0.0, abs=1e-4)


def test_the_plant_without_a_hidden_effect_leaves_next_to_nothing_and_with_one_a_pattern() -> None:
    clean, _ = pooled_residuals(MODEL, SHIPPED, [reduced(NONE, 6.0 + 2.0 * i, seed=i) for i in range(8)])
    strong, _ = pooled_residuals(MODEL, SHIPPED, [reduced(STRONG, 6.0 + 2.0 * i, seed=i) for i in range(8)])
    assert not common_misfit(clean, shared=3).disagrees
    assert common_misfit(strong, shared=3).disagrees


def test_a_tolerated_error_is_no_disagreement() -> None:
    assert common_misfit(sweeps(LOCAL, 6, seed=1)).disagrees
    assert not common_misfit(sweeps(LOCAL, 6, seed=1), tolerance=0.03).disagrees


@pytest.mark.parametrize(
    "spoil",
    [
        lambda c: c | {"force_n": -c["force_n"]},
        lambda c: c | {"plate_angle_rad": np.full(c["force_n"].shape, np.radians(40.0))},
        lambda c: {name: values[:2] for name, values in c.items()},
        lambda c: c | {"force_n": np.full(c["force_n"].shape, 1e6)},
    ],
    ids=["no force", "never at home", "one visit", "above a full paddle"],
)
def test_a_sweep_that_says_nothing(spoil) -> None:
    windows = sweep_windows(MACHINE, shown_force(MACHINE, NONE), flow_kg_s=8.0, seed=1)
    columns = {name: np.array([getattr(w, name) for w in windows]) for name in COLUMNS}
    assert reduce_sweep(MODEL, SHIPPED, **spoil(columns)) is None


def test_a_model_that_needs_moisture_says_nothing_without() -> None:
    windows = sweep_windows(MACHINE, shown_force(MACHINE, NONE), flow_kg_s=8.0, seed=1)
    columns = {name: np.array([getattr(w, name) for w in windows]) for name in COLUMNS}
    moist = ForwardModel(MACHINE, ("gravity", "moisture_dependence"))
    slopes = {f"moisture_dependence.{name}_per_pct": 0.0 for name in ("friction", "restitution", "density")}
    parameters = ParameterSet(dict(SHIPPED.values) | slopes)
    assert reduce_sweep(moist, parameters, **columns) is not None
    assert reduce_sweep(moist, parameters, **(columns | {"moisture_pct": np.full(len(windows), np.nan)})) is None

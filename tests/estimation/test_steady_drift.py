"""Rates of drift that are learnt along with the parameters, and what later updates say of earlier values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.drift import grow
from yieldmon.estimation.self_calibration.drift_rates import DriftRates
from yieldmon.estimation.self_calibration.steady_drift import DriftingParameters, advance, begin, carried, smoothed, updated

NAMES = ("friction", "restitution", "density")
KNOWN = ParameterSet(
    {"friction": 0.2, "restitution": 0.6, "density": 1100.0, "shape_ratio": 2.0}, NAMES, np.diag([0.02**2, 0.02**2, 50.0**2])
)
STILL = DriftRates({}, {}, {})
SEED = 20261121


def measured(prior: ParameterSet, name: str, value: float, sd: float) -> ParameterSet:
    """The textbook update of a Gaussian by one direct measurement of one parameter."""
    i = prior.covariance_names.index(name)
    gain = prior.covariance[:, i] / (prior.covariance[i, i] + sd**2)
    values = {n: prior.values[n] + g * (value - prior.values[name]) for n, g in zip(prior.covariance_names, gain, strict=True)}
    covariance = prior.covariance - np.outer(gain, prior.covariance[i])
    return replace(prior, values={**prior.values, **values}, covariance=0.5 * (covariance + covariance.T))


def test_without_rates_it_is_the_random_walk() -> None:
    rates = DriftRates({"friction": 0.03}, {"density": 0.02}, {})
    later, _ = advance(begin(KNOWN, {}), rates, 4.0, 0.5e6)
    assert later.parameters.covariance == pytest.approx(grow(KNOWN, rates, 4.0, 0.5e6).covariance)
    assert later.parameters.values == KNOWN.values


def test_an_unknown_rate_widens_in_proportion_to_grain_and_restitution_by_its_gain() -> None:
    later, _ = advance(begin(KNOWN, {"friction": 0.1, "restitution": 0.05}), STILL, 7.0, 2e6)
    assert later.parameters.standard_deviation("friction") == pytest.approx(np.hypot(0.02, 0.2 * 0.1 * 2.0))
    assert later.parameters.standard_deviation("restitution") == pytest.approx(np.hypot(0.02, 1.6 * 0.05 * 2.0))
    assert later.parameters.standard_deviation("density") == pytest.approx(50.0)


def test_k1_and_k2_share_restitutions_rate() -> None:
    values = {"friction": 0.2, "k1": -0.3, "k2": 1.5, "density": 1100.0, "shape_ratio": 2.0}
    assert begin(ParameterSet(values, ("k1", "k2"), np.eye(2)), {"restitution": 0.1}).names == ("k1", "k2")


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("friction", {"restitution": 0.6}),
        ("density", {"restitution": 0.6}),
        ("restitution", {"restitution": 0.6}),
        ("k1", {"k1": -0.3, "k2": 1.5}),
        ("k2", {"k1": -0.3, "k2": 1.5}),
    ],
)
def test_errors_are_carried_on_as_values_are(name: str, values: dict[str, float]) -> None:
    grain = {"friction": 0.2, "density": 1100.0, "shape_ratio": 2.0, **values}
    key = "restitution" if name in ("k1", "k2") else name
    ends = []
    for step in (-1e-4, 1e-4):
        moved = ParameterSet(grain | {name: grain[name] * (1.0 + step)}, (name,), np.eye(1))
        drifting = replace(begin(moved, {key: 0.1}), rates=np.array([0.2]))
        later, through = advance(drifting, STILL, 0.0, 1e6)
        ends.append(later.parameters.values[name])
    slope = (ends[1] - ends[0]) / (2e-4 * grain[name])
    assert through.transition[0, 0] == pytest.approx(slope, rel=1e-6)


def test_what_is_moved_takes_its_ties_with_the_rates_along() -> None:
    known, _ = advance(begin(KNOWN, {"friction": 0.1}), STILL, 0.0, 1e6)
    tie, spread = known.joint[0, 3], known.joint[3, 3]
    assert tie > 0.0
    moved = carried(known, replace(known.parameters, values={**known.parameters.values, "friction": 0.3}))
    assert moved.joint[0, 3] == moved.joint[3, 0] == pytest.approx(1.5 * tie)
    assert moved.joint[3, 3] == spread
    assert moved.joint[:3, :3] == pytest.approx(moved.parameters.covariance)


def trended(noise: float) -> tuple[list[float], list[float], DriftingParameters, list[float]]:
    """Friction rising by 10 % a kilotonne from 0.2, measured at every 0.1 kt: truth, filtered, what is known last, smoothed."""
    rng = np.random.default_rng(SEED)
    known, steps, truth, live = begin(KNOWN, {"friction": 0.3}), [], [], []
    for i in range(1, 31):
        known, step = advance(known, STILL, 1.0, 1e5)
        steps.append(step)
        true = 0.2 * float(np.exp(0.01 * i))
        known = updated(known, measured(known.parameters, "friction", true + noise * rng.standard_normal(), max(noise, 1e-4)))
        truth.append(true)
        live.append(known.parameters.values["friction"])
    return truth, live, known, [v["friction"] for v in smoothed(steps, known)][1:]


def test_a_steady_rate_is_learnt() -> None:
    _, live, known, _ = trended(0.0)
    assert known.rates == pytest.approx([0.1], abs=1e-3)
    ahead, _ = advance(known, STILL, 0.0, 1e6)
    assert ahead.parameters.values["friction"] == pytest.approx(live[-1] * 1.1, rel=0.01)


def test_later_updates_improve_the_past() -> None:
    truth, live, _, later = trended(0.02)
    early = slice(0, 15)
    error = np.abs(np.subtract(live, truth))[early].mean()
    assert np.abs(np.subtract(later, truth))[early].mean() < 0.6 * error


def test_smoothing_is_the_least_squares_fit_of_all_updates() -> None:
    """Three states of one parameter, two updates: against the joint Gaussian, conditioned at once."""
    sd, rate_sd, noise = 0.02, 0.3, 0.01
    known, steps = begin(replace(KNOWN, covariance=np.diag([sd**2, 1e-8, 1e-8])), {"friction": rate_sd}), []
    readings = (0.21, 0.19)
    for reading in readings:
        known, step = advance(known, STILL, 1.0, 1e5)
        steps.append(step)
        known = updated(known, measured(known.parameters, "friction", reading, noise))
    # Deviations from 0.2 of (start, rate); the second step's own linearisation adds rate x reading, second order, below 1e-3.
    design = np.array([[1.0, 0.02], [1.0, 0.04]])
    prior = np.diag([sd**2, rate_sd**2])
    gain = prior @ design.T @ np.linalg.inv(design @ prior @ design.T + noise**2 * np.eye(2))
    start = 0.2 + (gain @ (np.array(readings) - 0.2))[0]
    assert smoothed(steps, known)[0]["friction"] == pytest.approx(start, abs=2e-4)


def test_a_widened_update_counts_with_the_width_it_was_given() -> None:
    known, _ = advance(begin(KNOWN, {"friction": 0.3}), STILL, 1.0, 1e6)
    wide = replace(known.parameters, covariance=4.0 * known.parameters.covariance)
    posterior = measured(wide, "friction", 0.3, 0.001)
    joint = known.joint.copy()
    joint[:3, :3] *= 4.0
    plain = updated(replace(known, parameters=wide, joint=joint), posterior)
    found = updated(known, posterior, widening=4.0)
    assert found.joint == pytest.approx(plain.joint)
    assert found.rates == pytest.approx(plain.rates)


def test_a_jump_changes_a_rate_less_than_drift_of_its_size() -> None:
    """A reading five deviations off, once as drift that goes on and once as parameters less certain than they were taken for."""
    known, _ = advance(begin(KNOWN, {"friction": 0.3}), STILL, 1.0, 1e6)
    off = known.parameters.values["friction"] + 5.0 * known.parameters.standard_deviation("friction")
    drift = updated(known, measured(known.parameters, "friction", off, 0.001))
    wide = replace(known.parameters, covariance=16.0 * known.parameters.covariance)
    jump = updated(known, measured(wide, "friction", off, 0.001), widening=16.0)
    assert jump.parameters.values["friction"] == pytest.approx(off, rel=0.01)
    assert 0.0 < jump.rates[0] < 0.1 * drift.rates[0]
    assert jump.joint[3, 3] > 0.9 * known.joint[3, 3]


LIKELY = {"friction": 0.2, "restitution": 0.03}


@pytest.mark.parametrize("memory_kt", [0.03, 2.0, 500.0])
@pytest.mark.parametrize("parts", [2, 7])
def test_forgetting_in_steps_is_forgetting_at_once(memory_kt: float, parts: int) -> None:
    """Rates of 0, so that no value moves and the steps' scales are the same."""
    known = begin(KNOWN, LIKELY)
    at_once, through = advance(known, STILL, 1.0, 0.7e6, per_kilotonne=LIKELY, memory_kt=memory_kt)
    steps = known
    for _ in range(parts):
        steps, _ = advance(steps, STILL, 1.0 / parts, 0.7e6 / parts, per_kilotonne=LIKELY, memory_kt=memory_kt)
    assert steps.joint == pytest.approx(at_once.joint, rel=1e-6, abs=1e-12)
    assert through.transition[0, 3] == pytest.approx(0.2 * memory_kt * -np.expm1(-0.7 / memory_kt))


@pytest.mark.parametrize("grain_kg", [0.0, 1.0, 2e4, 1e6, 1e9])
def test_a_forgotten_rate_is_as_unsure_as_one_never_learnt(grain_kg: float) -> None:
    known = replace(begin(KNOWN, LIKELY), rates=np.array([0.1, -0.02]))
    narrow = known.joint.copy()
    narrow[3:, 3:] *= 0.01
    later, _ = advance(replace(known, joint=narrow), STILL, 0.0, grain_kg, per_kilotonne=LIKELY, memory_kt=2.0)
    left = np.exp(-grain_kg / 2e6)
    assert later.rates == pytest.approx(left * known.rates)
    expected = np.array([0.2, 0.03]) ** 2 * (1.0 - 0.99 * left**2)
    assert np.diag(later.joint)[3:] == pytest.approx(expected)
    fresh, _ = advance(known, STILL, 0.0, grain_kg, per_kilotonne=LIKELY, memory_kt=2.0)
    assert np.diag(fresh.joint)[3:] == pytest.approx(np.array([0.2, 0.03]) ** 2)


def test_a_rate_that_turns_is_followed_where_rates_are_forgotten() -> None:
    """Friction rises for 5 kt and falls for as long: the error at the end, with rates kept for ever and with a memory of 2 kt."""
    errors = []
    for memory_kt in (np.inf, 2.0):
        known, live, truth = begin(KNOWN, LIKELY), [], []
        for i in range(1, 101):
            known, _ = advance(known, STILL, 1.0, 1e5, per_kilotonne=LIKELY, memory_kt=memory_kt)
            truth.append(0.2 * (1.0 + 0.01 * min(i, 100 - i)))
            live.append(known.parameters.values["friction"])
            known = updated(known, measured(known.parameters, "friction", truth[-1], 0.005))
        errors.append(float(np.mean(np.abs(np.subtract(live, truth))[60:])))
    assert errors[1] < 0.6 * errors[0]


@pytest.mark.parametrize("memory_kt", [0.0, -1.0, float("nan")])
def test_a_memory_of_nothing_is_refused(memory_kt: float) -> None:
    with pytest.raises(ValueError, match="expected more than 0"):
        advance(begin(KNOWN, LIKELY), STILL, 1.0, 1.0, memory_kt=memory_kt)


@settings(max_examples=30)
@given(st.lists(st.tuples(st.sampled_from(NAMES), st.floats(0.5, 1.5), st.floats(0.0, 3e6)), max_size=12))
def test_covariance_stays_a_covariance(updates: list[tuple[str, float, float]]) -> None:
    known = begin(KNOWN, {"friction": 0.2, "restitution": 0.03, "density": 0.05})
    for name, factor, grain_kg in updates:
        likely = {"friction": 0.2, "restitution": 0.03, "density": 0.05}
        known, _ = advance(known, DriftRates(), 1.0, grain_kg, per_kilotonne=likely, memory_kt=2.0)
        prior = known.parameters
        known = updated(known, measured(prior, name, prior.values[name] * factor, prior.standard_deviation(name)))
        scale = np.sqrt(np.diag(known.joint))
        assert np.linalg.eigvalsh(known.joint / np.outer(scale, scale)).min() > -1e-9


@pytest.mark.parametrize("rates", [{"friction": -0.1}, {"density": float("nan")}])
def test_impossible_rates_are_refused(rates: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="expected 0 or more"):
        begin(KNOWN, rates)


def test_a_posterior_of_other_parameters_is_refused() -> None:
    other = ParameterSet(dict(KNOWN.values), ("friction",), np.eye(1) * 1e-4)
    with pytest.raises(ValueError, match="posterior of"):
        updated(begin(KNOWN, {}), other)

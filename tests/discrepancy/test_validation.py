"""Unseen rows decide: where they lie between two predictions, and what a model's own error of 0.2 % may do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from yieldmon.discrepancy import diagnosis
from yieldmon.discrepancy.policy import Policy
from yieldmon.discrepancy.validation import mean_square_interval, pooled, share
from yieldmon.estimation import model_error
from yieldmon.estimation.parameters import ParameterSet

QUICK = diagnosis.Options(policy=Policy(refits=8, exchanges=2, beam=2, pairs=4))
NONE = np.zeros((400, 0))


@pytest.mark.parametrize("truth", [0.0, 0.4, 1.0])
def test_share_is_where_the_readings_lie(truth: float) -> None:
    rng = np.random.default_rng(3)
    between = rng.normal(0.0, 2.0, 400)
    found = []
    for _ in range(200):
        before = rng.standard_normal(400) - truth * between
        found.append(share(before, before + between, NONE))
    assert np.mean([f.value for f in found]) == pytest.approx(truth, abs=0.01)
    assert np.std([f.value for f in found]) == pytest.approx(np.sqrt(1.0 / found[0].power), rel=0.15)
    assert np.mean([f.sd for f in found]) >= 0.95 * np.std([f.value for f in found])


def test_the_models_own_error_widens_the_share() -> None:
    rng = np.random.default_rng(4)
    between = np.linspace(-1.0, 1.0, 50)
    before = rng.standard_normal(50)
    plain = share(before, before + between, np.zeros((50, 0)))
    wide = share(before, before + between, 3.0 * between[:, None])
    assert wide.sd == pytest.approx(np.hypot(plain.sd, 3.0), rel=1e-9)
    assert wide.value == plain.value


def test_shares_are_pooled_by_their_power() -> None:
    rng = np.random.default_rng(5)
    before, between = rng.standard_normal(90), rng.standard_normal(90)
    whole = share(before, before + between, np.zeros((90, 0)))
    parts = [share(before[i : i + 30], (before + between)[i : i + 30], np.zeros((30, 0))) for i in (0, 30, 60)]
    assert pooled(parts).value == pytest.approx(whole.value, rel=1e-12)
    assert pooled([]).sd == np.inf


def test_interval_of_a_mean_square_covers() -> None:
    rng = np.random.default_rng(6)
    squares = np.mean(rng.standard_normal((2000, 12)) ** 2, axis=1)
    covered = [low <= 1.0 <= high for low, high in (mean_square_interval(float(s), 12) for s in squares)]
    assert np.mean(covered) == pytest.approx(0.95, abs=0.02)


@pytest.mark.parametrize("size", [0.01, 0.03])
def test_the_size_of_the_models_error_is_learnt_from_angles_and_loads_left_out(size: float) -> None:
    rng = np.random.default_rng(7)
    angle, load = (a.ravel() for a in np.meshgrid(np.radians(np.arange(40.0, 91.0, 5.0)), np.arange(1.0, 9.0), indexing="ij"))
    columns = model_error.basis(angle, load, np.full(angle.shape, 42.0))
    sd = 0.004
    tangent = np.linalg.qr(np.stack((np.ones(angle.size), angle), axis=-1))[0]
    found = []
    for _ in range(60):
        relative = size * columns @ rng.standard_normal(columns.shape[1]) + sd * rng.standard_normal(angle.size)
        residual = model_error.off(relative / sd, tangent)
        found.append(model_error.estimated(residual, tangent, np.full(angle.size, sd), model_error.groups_of(angle, load)))
    assert 0.6 * size < np.median(found) < 1.7 * size
    noise = model_error.off(rng.standard_normal(angle.size), tangent)
    assert model_error.estimated(noise, tangent, np.full(angle.size, sd), model_error.groups_of(angle, load)) < 0.003


def test_a_smooth_error_of_a_fifth_of_a_percent_is_not_named(make_rows, start: ParameterSet) -> None:
    def bent(force, angle, speed, flow):
        return force * (1.0 + 0.002 * np.cos(4.0 * angle) * np.sqrt(flow / 18.0))

    seen = diagnosis.examine(make_rows(alter=bent, noise=0.001), start, QUICK)
    assert seen.choice.verdict == "none"


def test_an_effect_that_unseen_rows_contradict_is_not_named(make_rows, start: ParameterSet) -> None:
    """Held-out rows from a machine without the effect: the fitted rows name it, the held-out ones do not agree."""
    rows, clean = make_rows({"zero_offset": 4.0}), make_rows()
    first = diagnosis.examine(rows, start, QUICK)
    assert first.choice.named == ("zero_offset",)
    assert first.validation is not None
    assert first.validation.agrees
    spoilt = replace(rows, value=np.where(first.is_held_out, clean.value, rows.value))
    second = diagnosis.examine(spoilt, start, QUICK)
    assert second.choice.named == ()
    assert second.choice.verdict == "unknown"
    assert any("is not named" in note for note in second.notes)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_the_verdict_does_not_depend_on_where_one_begins(make_rows, seed: int) -> None:
    rows = make_rows({"plate_friction": 0.3})
    rng = np.random.default_rng(seed)
    begins = (
        {"friction": float(rng.uniform(0.0, 2.0)), "density": float(rng.uniform(300.0, 3000.0)), "shape_ratio": 2.0,
         "restitution": float(rng.uniform(0.0, 1.0))}
        for _ in range(2)
    )  # fmt: skip
    found = [diagnosis.examine(rows, ParameterSet(values=b), QUICK).choice for b in begins]
    assert found[0].verdict == found[1].verdict == "effect"
    assert found[0].best.values == found[1].best.values

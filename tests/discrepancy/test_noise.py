"""Noise from replicates, from a smooth surface, as stated; outliers by majority and by surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from yieldmon.discrepancy import diagnosis_notes, noise, observations


def test_replicates_give_both_parts_of_the_noise(make_rows) -> None:
    rows = make_rows(noise=0.02, repeats=6)
    found, outlier = noise.estimate(rows)
    assert found.how == "replicates"
    assert not np.any(outlier)
    level = np.array([0.1, 0.5, 1.0]) * rows.value.max()
    np.testing.assert_allclose(found.sd(level), 0.02 * np.hypot(level, 0.1 * rows.value.max()), rtol=0.2)


def test_even_noise_is_kept_as_one_number(make_rows) -> None:
    rows = make_rows(noise=0.0)
    rows = replace(rows, value=rows.value + 1.5 * np.random.default_rng(3).standard_normal(len(rows)))
    found, _ = noise.estimate(rows)
    assert found.proportional == 0.0
    assert found.constant == pytest.approx(1.5, rel=0.15)


@pytest.mark.parametrize("repeats", [2, 3, 6])
def test_an_outlier_is_left_out_and_nothing_else(make_rows, repeats: int) -> None:
    rows = make_rows(repeats=repeats)
    value = rows.value.copy()
    value[17] += 0.3 * value.max()
    _, outlier = noise.estimate(replace(rows, value=value))
    assert np.flatnonzero(outlier).tolist() == [17]


@pytest.mark.parametrize(("repeats", "steps"), [(2, 3.0), (3, 3.0), (6, 4.0)])
def test_readings_in_steps_coarser_than_their_noise_are_no_outliers(make_rows, repeats: int, steps: float) -> None:
    rows = make_rows(noise=0.0, repeats=repeats)
    sd = 0.01 * float(rows.value.max())
    step = steps * sd
    noisy = rows.value + sd * np.random.default_rng(8).standard_normal(len(rows))
    found, outlier = noise.estimate(replace(rows, value=np.maximum(np.round(noisy / step), 1.0) * step))
    assert not np.any(outlier)
    # The rounding's own share, a twelfth of the step squared, does not show in all repetitions.
    assert 0.7 * sd < found.sd(np.array([rows.value.max()]))[0] < 1.6 * sd


def test_steps_at_which_hardly_any_repetition_differs_leave_the_rounding_as_noise(make_rows) -> None:
    """Noise of a fortieth of a step: the few repetitions on either side of an edge are no outliers among exact ones."""
    rows = make_rows(noise=1e-3)
    step = 0.03 * float(rows.value.max())
    coarse = replace(rows, value=step * np.round(rows.value / step))
    found, outlier = noise.estimate(coarse)
    assert not outlier.any()
    # Repetitions that agree have one rounding in common: their mean is no more exact than they are.
    assert np.all(found.of_cells(observations.cells(coarse)) >= 0.99 * step / np.sqrt(12.0))
    assert found.constant >= 0.99 * step / np.sqrt(12.0)


@pytest.mark.parametrize("missed", [0.1, 0.25, 0.3, 0.5])
def test_exact_zeros_where_all_grain_misses_the_plate_are_no_measure_of_the_scatter(make_rows, missed: float) -> None:
    for seed in range(1, 9):
        rows = make_rows(noise=0.01, seed=seed)
        cells_missed = np.random.default_rng(seed).permutation(int(rows.cell.max()) + 1) < missed * (rows.cell.max() + 1)
        found, outlier = noise.estimate(replace(rows, value=np.where(cells_missed[rows.cell], 0.0, rows.value)))
        assert not outlier.any()
        level = 0.5 * float(rows.value.max())
        assert found.sd(np.array([level]))[0] == pytest.approx(0.01 * np.hypot(level, 0.2 * level), rel=0.35)


def test_two_outliers_that_agree_do_not_outvote_the_truth(make_rows) -> None:
    rows = make_rows(repeats=3)
    places = np.flatnonzero(rows.cell == rows.cell[40])
    value = rows.value.copy()
    value[places[:2]] = 0.8 * value.max()
    _, outlier = noise.estimate(replace(rows, value=value))
    assert np.flatnonzero(outlier).tolist() == sorted(places[:2])


@pytest.mark.parametrize("drier", [True, False])
def test_an_outlier_in_damp_grain_is_judged_by_damp_grain(make_rows, drier: bool) -> None:
    """The wild row lies where the other moisture's rows lie, so that it looks right to whoever overlooks the moisture."""
    dry, damp = make_rows(repeats=3), make_rows({"zero_offset": 25.0}, repeats=3, seed=6)
    both = [dry, damp]
    rows = observations.with_cells(
        replace(
            dry,
            **{
                name: np.concatenate([getattr(r, name) for r in both])
                for name in ("plate_angle_rad", "load", "elevator_speed_rad_s", "value", "sigma", "cell")
            },
            trial=dry.trial + damp.trial,
            moisture_pct=np.repeat([14.0, 22.0], len(dry)),
        )
    )
    wild = 100 if drier else 100 + len(dry)
    value = rows.value.copy()
    value[wild] += 17.0 if drier else -20.0
    _, outlier = noise.estimate(replace(rows, value=value))
    assert np.flatnonzero(outlier).tolist() == [wild]


def test_without_replicates_a_smooth_surface_gives_the_noise(make_rows) -> None:
    rows = make_rows({"release_angle": 0.1}, repeats=1, noise=0.02)
    found, _ = noise.estimate(rows)
    assert found.how == "smooth"
    level = 0.5 * rows.value.max()
    assert found.sd(level) == pytest.approx(0.02 * level, rel=0.4)


def test_too_few_rows_for_a_surface_repeat_or_leave_the_noise_assumed(make_rows) -> None:
    rows = make_rows(repeats=2, speeds_rpm=(400.0,), noise=0.05)
    few = rows.take((rows.plate_angle_rad < np.radians(65.0)) & (rows.load < 7.0))
    assert len(few) == 12
    found, _ = noise.estimate(few)
    assert (found.how, found.dof) == ("replicates", 6)
    single, _ = noise.estimate(few.take(np.array([t == "0" for t in few.trial])))
    assert single.how == "assumed"
    assert "noise assumed" in diagnosis_notes.of_noise(single)


def test_stated_sigma_is_taken_at_its_word(make_rows) -> None:
    rows = make_rows(repeats=1)
    found, _ = noise.estimate(replace(rows, sigma=np.full(len(rows), 0.7)))
    assert (found.how, found.sd(50.0)) == ("stated", pytest.approx(0.7))


@pytest.mark.parametrize(("share", "outlier", "times"), [(1.0, 0.0, 1.0), (0.3, 0.0, 3.3), (0.3, 40.0, 3.3), (1.0, 40.0, 1.0)])
def test_stated_sigma_that_repeated_rows_refute_is_widened_to_what_they_scatter_by(
    share: float, outlier: float, times: float, make_rows
) -> None:
    rows = make_rows(noise=0.0)
    value = rows.value + 0.7 * np.random.default_rng(6).standard_normal(len(rows))
    value[7] += outlier
    found, _ = noise.estimate(replace(rows, value=value, sigma=np.full(len(rows), share * 0.7)))
    assert found.times == pytest.approx(times, rel=0.12)
    assert found.of_rows(replace(rows, sigma=np.full(len(rows), share * 0.7)), value) == pytest.approx(0.7, rel=0.12)
    assert ("times the stated sigma, since repeated rows" in diagnosis_notes.of_noise(found)) is (times > 1.0)


def test_each_row_weighs_by_its_own_sigma(make_rows) -> None:
    rows = make_rows(repeats=3)
    sigma = np.random.default_rng(2).choice([0.2, 1.0, 5.0], len(rows))
    stated = replace(rows, sigma=sigma)
    found, _ = noise.estimate(stated)
    grouped = observations.cells(stated)
    for number in (0, 7, 40):
        inside = rows.cell == number
        weight = sigma[inside] ** -2.0
        assert grouped.mean[number] == pytest.approx(np.average(rows.value[inside], weights=weight), rel=1e-12)
        assert found.of_cells(grouped)[number] == pytest.approx(weight.sum() ** -0.5, rel=1e-12)
    np.testing.assert_array_equal(found.of_rows(stated, rows.value), sigma)
    np.testing.assert_array_equal(found.of_rows(rows, rows.value), found.sd(rows.value))


def test_rows_that_repeat_a_condition_share_a_cell(make_rows) -> None:
    rows = make_rows(repeats=3)
    jittered = observations.with_cells(replace(rows, load=rows.load * np.random.default_rng(1).uniform(0.995, 1.005, len(rows))))
    assert np.array_equal(jittered.cell, rows.cell)
    assert np.all(np.bincount(rows.cell) == 3)


@pytest.mark.parametrize(("how", "share"), [("cells", 0.2), ("trials", 1 / 3), ("plate_angle_deg=60", 1 / 6), ("none", 0.0)])
def test_sealing(make_rows, how: str, share: float) -> None:
    rows = make_rows()
    held_out = observations.hold_out(rows, how, 1)
    assert np.mean(held_out) == pytest.approx(share, abs=0.03)
    assert np.array_equal(held_out, observations.hold_out(rows, how, 1))


@pytest.mark.parametrize("how", ["everything", "plate_angle_deg=71", "moisture_pct=15", "plate_angle_deg=x"])
def test_sealing_refuses_what_it_cannot_do(make_rows, how: str) -> None:
    with pytest.raises(ValueError, match="--hold-out"):
        observations.hold_out(make_rows(), how, 1)

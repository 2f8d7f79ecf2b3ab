"""Tables that are no measurements: copies, readings of the wrong sign; and what coarse readings look like beside them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from yieldmon.discrepancy import observations
from yieldmon.discrepancy.observations import Rows
from yieldmon.errors import InputError
from yieldmon.files.table import Table
from yieldmon.physics.machine import RPM, Machine


def as_table(rows: Rows, *, trial: bool = True) -> Table:
    columns = {
        "plate_angle_deg": np.degrees(rows.plate_angle_rad),
        "elevator_speed_rpm": rows.elevator_speed_rad_s / RPM,
        "mass_flow_kg_s": rows.load,
        "force_n": rows.value,
    }
    return Table("field.csv", "", "mass_flow_kg_s", "force_n", columns, {"trial": rows.trial} if trial else {})


def copied(table: Table, times: int) -> Table:
    """The rows `times` times, the trials numbered on."""
    columns = {name: np.tile(values, times) for name, values in table.columns.items()}
    text = {name: tuple(map(str, range(times * len(table)))) for name in table.text}
    return Table(table.path, "", table.load, table.reading, columns, text)


@pytest.mark.parametrize(("repeats", "times"), [(1, 3), (3, 2)])
@pytest.mark.parametrize("trial", [True, False])
def test_copied_rows_are_no_repetitions(make_rows: Callable[..., Rows], repeats: int, times: int, trial: bool) -> None:
    table = copied(as_table(make_rows(repeats=repeats), trial=trial), times)
    with pytest.raises(InputError, match=rf"field.csv: force_n: repeats .* in {len(table)} of {len(table)} rows, as copies do"):
        observations.from_table(table, Machine())


@pytest.mark.parametrize("trial", [True, False])
def test_rows_given_twice_in_a_trial_are_refused(make_rows: Callable[..., Rows], trial: bool) -> None:
    """A quarter of the rows twice, as by two exports: without a trial they may be readings that agree."""
    table = as_table(make_rows(), trial=trial)
    again = np.concatenate((np.arange(len(table)), np.arange(0, len(table), 4)))
    columns = {name: values[again] for name, values in table.columns.items()}
    text = {name: tuple(values[i] for i in again) for name, values in table.text.items()}
    twice = Table(table.path, "", table.load, table.reading, columns, text)
    if not trial:
        assert len(observations.from_table(twice, Machine())) == len(again)
        return
    with pytest.raises(InputError, match=rf"has {len(again) - len(table)} of {len(again)} rows twice: condition, trial and"):
        observations.from_table(twice, Machine())


def test_readings_of_a_coarse_resolution_are_no_copies(make_rows: Callable[..., Rows]) -> None:
    rows = make_rows(noise=0.003)
    coarse = as_table(rows)
    coarse.columns["force_n"][:] = np.round(rows.value)
    same = [len(np.unique(coarse.columns["force_n"][rows.cell == c])) < 3 for c in range(rows.cell.max() + 1)]
    assert np.mean(same) > 0.9
    assert len(observations.from_table(coarse, Machine())) == len(rows)
    one_day = Table(coarse.path, "", coarse.load, coarse.reading, coarse.columns, {"trial": ("monday",) * len(rows)})
    assert len(observations.from_table(one_day, Machine())) == len(rows)


def test_single_rows_that_read_alike_are_no_copies(make_rows: Callable[..., Rows]) -> None:
    rows = make_rows(repeats=1)
    assert len(observations.from_table(as_table(rows), Machine())) == len(rows)


def test_force_of_the_wrong_sign_is_refused(make_rows: Callable[..., Rows]) -> None:
    rows = make_rows()
    table = as_table(rows)
    table.columns["force_n"][:] = -rows.value
    with pytest.raises(InputError, match=rf"is negative in {len(rows)} of {len(rows)} rows; expected force on the plate counted"):
        observations.from_table(table, Machine())


def test_readings_that_are_all_zero_are_refused(make_rows: Callable[..., Rows]) -> None:
    table = as_table(make_rows())
    table.columns["force_n"][:] = 0.0
    with pytest.raises(InputError, match=r"field\.csv: force_n: has no reading above 0"):
        observations.from_table(table, Machine())


@pytest.mark.parametrize("missing", [0.0, np.nan])
def test_sigma_for_some_rows_only_is_refused(make_rows: Callable[..., Rows], missing: float) -> None:
    """Taken for the rows kept aside alone, it would judge them by another noise than the rest."""
    table = as_table(make_rows())
    sigma = np.full(len(table), 0.5)
    sigma[3] = missing
    stated = Table(table.path, "", table.load, table.reading, {**table.columns, "sigma": sigma}, table.text)
    with pytest.raises(InputError, match=rf"field.csv: sigma: is stated for {len(table) - 1} of {len(table)} rows; expected a"):
        observations.from_table(stated, Machine())


def test_a_few_negative_readings_are_kept(make_rows: Callable[..., Rows]) -> None:
    table = as_table(make_rows())
    lightest = np.argsort(table.columns["force_n"])[:20]
    table.columns["force_n"][lightest] -= 2.0 * table.columns["force_n"][lightest].max()
    assert len(observations.from_table(table, Machine())) == len(table)

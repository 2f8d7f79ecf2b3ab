"""Drift over a run, and errors between runs of different elevator speeds, beside effects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.discrepancy.test_alternatives import LAST_RULES, published
from yieldmon.discrepancy import observations
from yieldmon.discrepancy.choice import Choice, Step
from yieldmon.discrepancy.diagnosis_notes import of_run_order
from yieldmon.discrepancy.fit import fit
from yieldmon.discrepancy.lack_of_fit import lack_of_fit
from yieldmon.discrepancy.observations import Rows, with_cells
from yieldmon.discrepancy.run_order import BETWEEN, DRIFT, blocked_by, blocked_in_each_trial, of_order, speeds_in_turn
from yieldmon.discrepancy.selection import Search
from yieldmon.files import table
from yieldmon.physics.machine import Machine

COST = LAST_RULES.per_parameter
PLACE = np.arange(216.0)
RANDOM = np.random.default_rng(71).permutation(216).astype(float)


def ordered(rows: Rows, order: np.ndarray, *, timed: bool = False) -> Rows:
    """The rows, which lie speed by speed, measured in an order."""
    return replace(rows, order=order, timed=timed)


def drifting(rows: Rows, share: float) -> Rows:
    """Readings that rise by a share over the run."""
    assert rows.order is not None
    return replace(rows, value=rows.value * (1.0 + share * rows.order / rows.order.max()))


def repeated(rows: Rows, how: str) -> Rows:
    """The rows, which lie speed by speed, measured trial by trial: each trial's speeds in one sequence ("same"), backwards in
    every other trial ("turned"), or all mixed within the trial ("mixed")."""
    trial = np.array([int(name) for name in rows.trial])
    speed = rows.elevator_speed_rad_s * np.where((how == "turned") & (trial % 2 == 0), -1.0, 1.0)
    within = RANDOM[: len(rows)] if how == "mixed" else speed
    order = np.empty(len(rows))
    order[np.lexsort((within, trial))] = np.arange(float(len(rows)))
    return replace(rows, order=order)


def objection(rows: Rows, start, effect: str) -> str:
    """What speaks against one effect when the rules on what is left are not asked."""
    base, noise = published(rows, start)
    named = fit(base.frame, (effect,), base.values)
    search = Search(base=base, noise=noise, effects=(), rng=np.random.default_rng(1), policy=LAST_RULES)
    return search.objections.first(named, (Step(effect, (), (), 1.0, effect),))


@pytest.mark.parametrize(
    ("order", "in_turn"),
    [(PLACE, False), (PLACE[::-1], False), (RANDOM, True), (PLACE % 72, True), (None, True)],
    ids=["speed by speed", "the same backwards", "at random", "three rounds", "not known"],
)
def test_speeds_that_were_returned_to_are_distinguished_from_blocks(make_rows, order, in_turn) -> None:
    assert speeds_in_turn(replace(make_rows(), order=order)) == in_turn


@pytest.mark.parametrize(("order", "blocked"), [("same", True), ("turned", False), ("mixed", False)])
def test_trials_that_repeat_one_sequence_of_speeds_are_recognised(make_rows, order, blocked) -> None:
    assert blocked_in_each_trial(repeated(make_rows(), order)) == blocked


def test_a_drift_over_trials_of_one_sequence_of_speeds_is_no_effect_of_speed(make_rows, start) -> None:
    """Of readings that rise by 12 % over three trials each speed has had a share by its place in the trial."""
    rows = drifting(repeated(make_rows(), "same"), 0.12)
    assert speeds_in_turn(rows)
    why = objection(rows, start, "air_drag-by_time")
    assert "explains the rows as well as air_drag" in why
    assert "speed by speed in each trial" in why
    assert objection(replace(rows, order=None), start, "air_drag-by_time") == ""


def test_one_speed_is_no_block(make_rows) -> None:
    rows = make_rows(speeds_rpm=(400.0,))
    assert speeds_in_turn(replace(rows, order=np.arange(float(len(rows)))))


@pytest.mark.parametrize("timed", [False, True])
def test_a_drift_over_speeds_run_one_after_the_other_is_no_effect_of_speed(make_rows, start, timed) -> None:
    rows = drifting(ordered(make_rows(), PLACE, timed=timed), 0.08)
    why = objection(rows, start, "air_drag-by_time")
    assert "explains the rows as well as air_drag" in why
    assert ("time_s" in why) == timed
    assert objection(replace(rows, order=None, timed=False), start, "air_drag-by_time") == ""


def test_readings_high_at_one_speed_may_be_an_error_between_runs(make_rows, start) -> None:
    rows = ordered(make_rows(speeds_rpm=(340.0, 460.0)), np.arange(144.0))
    rows = replace(rows, value=rows.value * np.where(rows.elevator_speed_rad_s > 42.0, 1.03, 1.0))
    base, _ = published(rows, start)
    found = of_order(base, 1.0, COST)
    assert found is not None
    assert found.what in (BETWEEN, DRIFT)
    assert "explains the rows as well as air_drag" in objection(rows, start, "air_drag-by_time")


@pytest.mark.parametrize("effects", [{"gravity": 9.81}, {"speed_dependent_shape": -1.0}, {"zero_offset": 4.0}], ids=str)
def test_an_effect_of_another_shape_stands_whatever_the_order(make_rows, start, effects) -> None:
    (effect,) = effects
    for timed, order in ((False, PLACE), (True, PLACE), (True, RANDOM)):
        assert objection(ordered(make_rows(effects), order, timed=timed), start, effect) == ""


def test_drag_in_rows_that_were_measured_in_turn_stands(make_rows, start) -> None:
    rows = make_rows({"air_drag": 0.3})
    assert "air_drag" in objection(ordered(rows, PLACE), start, "air_drag-by_time")
    assert objection(ordered(rows, RANDOM, timed=True), start, "air_drag-by_time") == ""


@pytest.mark.parametrize(
    ("keys", "timed", "how"),
    [
        (("load", "plate_angle_rad"), False, "load by load"),
        (("plate_angle_rad", "load"), False, "plate angle by plate angle"),
        (("elevator_speed_rad_s", "load", "plate_angle_rad"), False, ""),
        (("load", "plate_angle_rad"), True, ""),
    ],
    ids=["load by load", "angle by angle", "speed by speed", "times stated"],
)
def test_rows_that_lie_by_load_or_angle_are_recognised(make_rows, keys, timed, how) -> None:
    rows = sorted_by(make_rows(), *keys, timed=timed)
    assert blocked_by(rows) == how
    assert blocked_by(replace(rows, order=None, timed=False)) == ""
    assert blocked_by(replace(rows, order=RANDOM, timed=False)) == ""


def sorted_by(rows: Rows, *keys: str, timed: bool = False) -> Rows:
    """The rows, measured in the order of these columns, the first one changing least often."""
    place = np.empty(len(rows))
    place[np.lexsort([getattr(rows, key) for key in reversed(keys)])] = np.arange(len(rows))
    return ordered(rows, place, timed=timed)


@pytest.mark.parametrize(
    ("keys", "warm_up", "offset_n", "said"),
    [
        (("load", "plate_angle_rad"), 0.08, 0.0, True),
        (("load", "plate_angle_rad"), 0.0, 6.0, False),
        (("elevator_speed_rad_s", "plate_angle_rad"), 0.08, 0.0, False),
    ],
    ids=["a gain that warms up while the load rises", "a zero offset in such rows", "the same drift in rows speed by speed"],
)
def test_a_name_that_a_drift_over_sorted_rows_explains_is_noted(make_rows, start, keys, warm_up, offset_n, said) -> None:
    rows = sorted_by(make_rows({"zero_offset": offset_n} if offset_n else {}), *keys)
    assert rows.order is not None
    rows = replace(rows, value=rows.value * (1.0 + warm_up * np.exp(-rows.order / 40.0)))
    base, noise = published(rows, start)
    best = fit(base.frame, ("zero_offset",), base.values)
    test = lack_of_fit(best, noise)
    steps = (Step("zero_offset", (), (), 1.0, "zero_offset"),)
    notes = of_run_order(Choice("effect", base, best, test, test, steps, (), 0.0), LAST_RULES)
    assert ["a drift over the run explains them as well as zero_offset" in note for note in notes] == [True] * said
    assert of_run_order(Choice("unknown", base, best, test, test, steps, (), 0.0), LAST_RULES) == []


def test_a_table_states_its_order(tmp_path) -> None:
    def read(head: str, cells: str) -> Rows:
        path = tmp_path / "t.csv"
        lines = [f"{40 + 5 * i},{3 + i},{20 + 7 * i}{cells.format(100 - i)}" for i in range(9)]
        path.write_text("\n".join([f"plate_angle_deg,mass_flow_kg_s,force_n{head}", *lines]) + "\n")
        return observations.from_table(table.load(path), Machine())

    plain, timed, half = read("", ""), read(",time_s", ",{}"), read(",time_s,sigma", ",-,1")
    assert not plain.timed
    assert plain.order is not None
    assert list(plain.order) == list(range(9))
    assert timed.timed
    assert timed.order is not None
    assert list(timed.order) == [100.0 - i for i in range(9)]
    assert not half.timed
    taken = with_cells(timed.take(np.arange(9) > 2))
    assert taken.timed
    assert taken.order is not None
    assert list(taken.order) == [97.0 - i for i in range(6)]

"""Delays: real rows, known shifts, known synthetic delays, and refusals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from yieldmon.field import sources
from yieldmon.field.delay import Delay, estimate_delay
from yieldmon.field.pairs import opposing_pairs
from yieldmon.field.sources.options import ReadOptions
from yieldmon.field.summary import delay_line
from yieldmon.field.table import HarvestTable
from yieldmon.field.tracks import tracks

from .synthetic import ag_leader


def estimated(table: HarvestTable, quantity: str = "flow") -> Delay:
    steps = tracks(table)
    return estimate_delay(
        steps, opposing_pairs(steps), quantity, default_s=12.0, declared_s=None, generator=np.random.default_rng(1)
    )


def moved(table: HarvestTable, rows: int) -> HarvestTable:
    """Flow `rows` later; what falls off at an end is unknown."""
    flow = np.roll(table["flow_kg_s"], rows)
    if rows > 0:
        flow[:rows] = np.nan
    elif rows < 0:
        flow[rows:] = np.nan
    return table.with_columns(flow_kg_s=flow)


def test_real_corn_has_the_delay_of_its_field(corn: Path) -> None:
    found = estimated(sources.read(corn, ReadOptions()))
    assert found.decision == "estimated"
    assert found.low_s is not None
    assert found.high_s is not None
    assert found.low_s < 15.0 < found.high_s
    assert found.held_out > 0.7
    assert found.no_shift < 0.2


@pytest.mark.parametrize("shift", [-20, -7, 3, 25])
def test_shifts_added_to_real_rows_come_back(corn: Path, shift: int) -> None:
    table = sources.read(corn, ReadOptions())
    here, there = estimated(table), estimated(moved(table, shift))
    assert there.decision == "estimated"
    assert there.value_s - here.value_s == pytest.approx(shift, abs=1.0)


@pytest.mark.parametrize("delay", [-5, 0, 8, 17, 30])
@pytest.mark.parametrize("where", [(40.0, -90.0), (-33.0, 20.0), (-17.0, 179.999)])
def test_synthetic_delay(tmp_path: Path, delay: int, where: tuple[float, float]) -> None:
    path = tmp_path / "field.txt"
    ag_leader(path, delay_s=delay, seed=abs(delay) + 1, latitude_deg=where[0], longitude_deg=where[1])
    found = estimated(sources.read(path, ReadOptions()))
    assert found.decision == "estimated"
    assert found.low_s is not None
    assert found.high_s is not None
    assert found.value_s == pytest.approx(delay, abs=1.0)
    assert found.low_s <= delay <= found.high_s


@pytest.mark.parametrize("seed", range(3))
def test_a_last_pass_half_beside_the_crop_hides_no_delay(tmp_path: Path, seed: int) -> None:
    path = tmp_path / "field.txt"
    ag_leader(path, delay_s=13, seed=seed, last_share=0.25, smooth_m=6.0)
    found = estimated(sources.read(path, ReadOptions()))
    assert found.decision == "estimated"
    assert found.value_s == pytest.approx(13, abs=1.0)


@pytest.mark.parametrize(("every_s", "delay"), [(2, 12), (3, 12), (5, 15)])
def test_a_row_of_several_seconds_has_its_place_in_their_middle(tmp_path: Path, every_s: int, delay: int) -> None:
    path = tmp_path / "field.txt"
    ag_leader(path, delay_s=delay, seed=4, every_s=every_s, passes=30, length_s=150)
    found = estimated(sources.read(path, ReadOptions()))
    assert found.decision == "estimated"
    assert found.value_s == pytest.approx(delay, abs=0.75)


@pytest.mark.parametrize("seed", range(6))
def test_noise_is_refused(tmp_path: Path, seed: int) -> None:
    path = tmp_path / "field.txt"
    ag_leader(path, delay_s=10, seed=seed, pure_noise=True)
    found = estimated(sources.read(path, ReadOptions()))
    assert found.decision == "cannot tell"
    assert found.value_s == 12.0
    assert found.low_s is None
    assert found.why


def test_flow_that_never_changes_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "field.txt"
    ag_leader(path, delay_s=10, seed=1)
    table = sources.read(path, ReadOptions())
    assert estimated(table.with_columns(flow_kg_s=np.full(len(table), 5.0))).decision == "cannot tell"
    assert estimated(table.with_columns(flow_kg_s=np.full(len(table), np.nan))).decision == "cannot tell"


def test_one_direction_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "field.txt"
    ag_leader(path, delay_s=10, seed=1, passes=1, length_s=400)
    assert "pairs" in estimated(sources.read(path, ReadOptions())).why


@pytest.mark.parametrize(("start", "round_s"), [(86_000, 86_400), (604_000, 604_800)])
def test_clock_over_midnight_and_week(tmp_path: Path, start: int, round_s: int) -> None:
    path = tmp_path / "field.txt"
    ag_leader(path, delay_s=9, seed=3, start_s=start, round_s=round_s)
    table = sources.read(path, ReadOptions())
    assert (np.diff(table["time_s"]) == 1).all()
    assert estimated(table).value_s == pytest.approx(9, abs=1.0)


def test_two_machines_keep_their_own_clocks(corn: Path) -> None:
    table = sources.read(corn, ReadOptions())
    twice = replace(table, source_of_row=(np.arange(len(table)) % 2).astype(np.int32), sources=table.sources * 2)
    assert len(np.unique(tracks(twice).stream)) == 2


@pytest.mark.parametrize(
    ("value_s", "said"), [(-0.04, "flow delay 0.0 s (-1.0 to 1.0)"), (-0.4, "flow delay -0.4 s (-1.0 to 1.0)")]
)
def test_a_delay_of_nothing_has_no_sign(tmp_path: Path, value_s: float, said: str) -> None:
    path = tmp_path / "field.txt"
    ag_leader(path, delay_s=9, seed=7, passes=12)
    found = estimated(sources.read(path, ReadOptions()))
    assert delay_line(replace(found, value_s=value_s, low_s=-1.0, high_s=1.0, declared_s=None), "flow") == said

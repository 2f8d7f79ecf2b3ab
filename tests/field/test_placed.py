"""Grain at its place, where a recorder writes rows when it likes: mass kept, and where the even recorder has it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from yieldmon.field import sources
from yieldmon.field.placed import measured_mass_kg, place
from yieldmon.field.sources.options import ReadOptions
from yieldmon.field.table import HarvestTable
from yieldmon.field.tracks import tracks

from .synthetic import ag_leader


def merged(table: HarvestTable, last: np.ndarray) -> HarvestTable:
    """Only the rows `last`, each with the mass and the time since the one before."""
    first = np.r_[0, last[:-1] + 1]
    interval_s = np.add.reduceat(table["interval_s"], first)
    mass_kg = np.add.reduceat(measured_mass_kg(table), first)
    return table.take(last).with_columns(interval_s=interval_s, flow_kg_s=mass_kg / interval_s)


@pytest.mark.parametrize("delay", [-6, 0, 12, 25])
@pytest.mark.parametrize("kept", [0.9, 0.6, 0.3])
def test_uneven_rows_put_the_grain_where_even_ones_do(tmp_path: Path, delay: int, kept: float) -> None:
    path = tmp_path / "field.txt"
    ag_leader(path, delay_s=delay, seed=7, smooth_m=30.0)
    even = sources.read(path, ReadOptions())
    even = even.with_columns(flow_kg_s=np.nan_to_num(even["flow_kg_s"]))
    rows = np.flatnonzero(np.random.default_rng(delay + 100).random(len(even)) < kept)
    uneven = merged(even, rows)
    true_kg = place(even, tracks(even), delay, 0.0).mass_kg
    true_kg = np.add.reduceat(np.nan_to_num(true_kg), np.r_[0, rows[:-1] + 1])
    placed = place(uneven, tracks(uneven), delay, delay)
    known = np.isfinite(placed.mass_kg) & (placed.mass_kg > 0)
    assert np.isfinite(placed.moisture_pct[known]).mean() > 0.99
    assert np.nansum(placed.mass_kg) + placed.lost_kg == pytest.approx(measured_mass_kg(uneven).sum(), rel=1e-9)
    assert np.abs(np.nan_to_num(placed.mass_kg) - true_kg).sum() < 0.06 * true_kg.sum()
    assert placed.lost_kg < 0.02 * true_kg.sum()
    assert (placed.from_row[np.nan_to_num(placed.mass_kg) > 0] >= 0).all()

"""Logs faster than a row a second."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from yieldmon.field import harvest
from yieldmon.field.cleaning import KEPT
from yieldmon.field.seconds import per_second
from yieldmon.field.table import HarvestTable, Label, Source, build

WIDTH_M, SPEED_M_S, FLOW_KG_S = 9.0, 1.1, 5.0
M_PER_DEG = 111_320.0


def passes(step_s: np.ndarray, header_down: np.ndarray | None = None) -> HarvestTable:
    """A straight pass to the north whose rows are step_s apart; the receiver gives a place five times a second, to 1 cm."""
    time_s = np.cumsum(step_s)
    north_m = np.round(SPEED_M_S * np.floor(time_s * 5.0) / 5.0, 2)
    count = len(time_s)
    return build(
        {
            "time_s": 1.5e9 + time_s,
            "longitude_deg": np.full(count, 13.5),
            "latitude_deg": 55.4 + north_m / M_PER_DEG,
            "flow_kg_s": np.full(count, FLOW_KG_S),
            "moisture_pct": np.full(count, 14.0),
            "interval_s": step_s,
            "distance_m": SPEED_M_S * step_s,
            "width_m": np.full(count, WIDTH_M),
            "header_down": np.ones(count) if header_down is None else header_down,
        },
        {"crop": Label.constant("wheat", count)},
        Source("log", "synthetic", count),
        unix_time=True,
    )


@given(st.lists(st.floats(0.02, 0.6), min_size=5, max_size=200), st.integers(0, 2**31))
@settings(max_examples=60)
def test_mass_and_way_stay(steps: list[float], seed: int) -> None:
    draw = np.random.default_rng(seed)
    table = passes(np.array(steps), draw.integers(0, 2, len(steps)).astype(float))
    flow = np.where(draw.random(len(steps)) < 0.2, np.nan, draw.uniform(0.0, 20.0, len(steps)))
    known = np.isfinite(flow)
    table = table.with_columns(flow_kg_s=flow, interval_s=np.where(known, table["interval_s"], 0.0))
    taken = per_second(table)
    for name in ("interval_s", "distance_m"):
        assert taken[name].sum() == pytest.approx(table[name].sum())
    assert np.nansum(taken["flow_kg_s"] * taken["interval_s"]) == pytest.approx(np.nansum(flow * table["interval_s"]))
    assert set(taken["header_down"]) == set(table["header_down"])
    assert np.isin(taken["time_s"], table["time_s"]).all()
    assert len(taken) <= len(table)


def test_an_unknown_flow_is_that_of_the_others_of_its_second() -> None:
    table = passes(np.full(40, 0.25))
    sparse = table.with_columns(flow_kg_s=np.where(np.arange(40) % 4 == 1, FLOW_KG_S, np.nan))
    taken = per_second(sparse)
    assert taken["flow_kg_s"][1:-1] == pytest.approx(FLOW_KG_S)
    assert (taken["flow_kg_s"] * taken["interval_s"])[1:-1].sum() == pytest.approx(FLOW_KG_S * taken["interval_s"][1:-1].sum())
    none = per_second(table.with_columns(flow_kg_s=np.full(40, np.nan)))
    assert np.isnan(none["flow_kg_s"]).all()


def test_a_log_of_a_second_a_row_is_left_as_it_is() -> None:
    table = passes(np.ones(50))
    assert per_second(table) is table


def test_sections_machines_and_rows_without_time_stay_apart() -> None:
    table = passes(np.full(40, 0.1))
    table = table.with_columns(section=np.tile([1.0, 2.0], 20), time_s=np.where(np.arange(40) < 4, np.nan, table["time_s"]))
    taken = per_second(table)
    assert np.isnan(taken["time_s"]).sum() == 4
    assert set(taken["section"]) == {1.0, 2.0}
    assert taken["interval_s"].sum() == pytest.approx(4.0)


def test_ten_rows_a_second_make_the_map_of_one_row_a_second() -> None:
    """Rows of 0.1 s with pauses of 0.31 to 0.41 s, as a combine's terminal logged them, and places that repeat."""
    draw = np.random.default_rng(5)
    fast_s = np.where(draw.random(12_000) < 0.03, draw.uniform(0.31, 0.41, 12_000), 0.1)
    fast = passes(fast_s)
    table = per_second(fast.with_columns(flow_kg_s=fast["flow_kg_s"] * draw.normal(1.0, 0.3, len(fast))))
    result = harvest.make_map(table, harvest.MapOptions(flow_delay_s=0.0, moisture_delay_s=0.0))
    points = result.cleaned.points_by_reason()
    assert points[KEPT] > 0.97 * len(table)
    assert result.totals.yield_kg_m2 == pytest.approx(FLOW_KG_S / (SPEED_M_S * WIDTH_M), rel=0.01)
    assert any("taken together" in note for note in result.table.sources[0].notes)

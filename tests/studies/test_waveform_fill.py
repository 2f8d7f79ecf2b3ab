"""Volume flow from trains of several heaps: what is kept is what the study says, and within the goal."""

from __future__ import annotations

import json

import pytest

from studies.waveform import fill

KEPT = json.loads((fill.FOLDER / "many_heaps.json").read_text())


def test_a_train_of_several_heaps_is_within_the_goal_where_one_heap_for_ever_is_not() -> None:
    found = fill.many_heaps()
    assert found["heaps"] == KEPT["heaps"]
    for way in ("index", "no index"):
        for row, kept in zip(found[way]["pulses"], KEPT[way]["pulses"], strict=True):
            assert row[:-1] == pytest.approx(kept[:-1], abs=0.11)
        mean_pct, largest_pct = found[way]["mean_of_heaps_mean_largest_pct"]
        assert mean_pct < 4.0
        assert largest_pct < 10.0
    assert found["no index"]["reference_heap_mean_largest_pct"][1] > 20.0

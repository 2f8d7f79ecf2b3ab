"""Truth beside a record, seconds at edges, signs and labels of the pictures."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="needs the plot extra")

from yieldmon.plots import alignment, errors, flow, residuals

TRUE_S = np.arange(1.0, 301.0)
TRUE_KG_S = np.where(TRUE_S < 40, 0.0, 10.0 + 3.0 * np.sin(TRUE_S / 17.0)) * (TRUE_S < 260)


@pytest.mark.parametrize(("first", "last"), [(0, 300), (0, 200), (50, 300), (30, 180)], ids=["all", "cut", "late", "middle"])
def test_the_truth_finds_its_place_though_the_record_ends_before_it(first, last):
    rng = np.random.default_rng(5)
    measured = TRUE_KG_S[first:last] + 0.3 * rng.standard_normal(last - first)
    measured[:4] = np.nan
    assert alignment.shift_s(TRUE_S[first:last] + 1_790_000_000.1, measured, TRUE_S, TRUE_KG_S) == 1_790_000_000.0


def test_an_even_flow_lets_both_end_together():
    assert alignment.shift_s(TRUE_S[:200] + 1000.0, np.full(200, 9.0), TRUE_S, np.full(300, 9.0)) == 900.0


def test_edges_are_where_the_flow_starts_and_stops():
    assert TRUE_S[errors.at_edges(TRUE_S, TRUE_S, TRUE_KG_S)].tolist() == [39.0, 40.0, 259.0, 260.0]
    figure = errors.draw(TRUE_KG_S, TRUE_KG_S, np.array([1.0, 29.0]), left_out=4)
    assert "4 s in which the flow starts or stops are left out" in figure.axes[0].get_title(loc="right")


def test_labels_of_neighbouring_tickets_do_not_overprint():
    time_s = np.arange(0.0, 7200.0)
    ones = np.ones(time_s.size)
    weighed = [(end_s, 990.0, 1000.0) for end_s in (3000.0, 3050.0, 3100.0, 6000.0)]
    figure = flow.draw(time_s, ones, ones, np.cumsum(ones), weighed=weighed)
    figure.savefig("/dev/null", format="png", dpi=110)
    boxes = [text.get_window_extent() for text in figure.axes[1].texts]
    assert len(boxes) == 4
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])


def test_the_map_has_the_sign_of_diagnose():
    figure = residuals.draw(np.array([60.0, 70.0]), np.array([5.0, 9.0]), "mass flow, kg/s", np.array([2.0, -1.0]))
    assert figure.axes[1].get_ylabel().startswith("model less measured")

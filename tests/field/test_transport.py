"""The machine's smear undone: a known one comes back, mass stays, and what does not help is off."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from yieldmon.field import sources
from yieldmon.field.harvest import MapOptions, inverted, make_map
from yieldmon.field.pairs import opposing_pairs
from yieldmon.field.sources.options import ReadOptions
from yieldmon.field.tracks import tracks
from yieldmon.field.transport import Filter, assess, filtered

from .synthetic import ag_leader


def smeared(flow: np.ndarray, tau_s: float) -> np.ndarray:
    decay, state, out = np.exp(-1.0 / tau_s), flow[0], []
    for value in flow:
        state = decay * state + (1 - decay) * value
        out.append(state)
    return np.array(out)


def test_a_known_smear_comes_back_and_mass_stays(tmp_path: Path) -> None:
    path = tmp_path / "field.txt"
    ag_leader(path, delay_s=0, seed=2, noise=0.0, passes=6)
    steps = tracks(sources.read(path, ReadOptions()))
    dull = replace(steps, flow_kg_s=smeared(steps.flow_kg_s, 4.0))
    back = filtered(dull, Filter(4.0, 1e-6))
    inner = slice(50, -50)
    assert back[inner] == pytest.approx(steps.flow_kg_s[inner], abs=0.05 * steps.flow_kg_s.max())
    assert back.sum() == pytest.approx(dull.flow_kg_s.sum(), rel=1e-9)
    control = filtered(dull, Filter(4.0, 3.0), control=True)
    assert control.sum() == pytest.approx(dull.flow_kg_s.sum(), rel=1e-9)
    assert np.abs(np.diff(control)).mean() < np.abs(np.diff(dull.flow_kg_s)).mean()


def test_an_inverse_that_is_applied_keeps_the_mass(corn: Path) -> None:
    table = sources.read(corn, ReadOptions())
    steps = tracks(table)
    found = assess(steps, opposing_pairs(steps), 14.0, np.random.default_rng(1))
    again = inverted(table, steps, found)
    assert (again["flow_kg_s"] * again["interval_s"]).sum() == pytest.approx(
        (table["flow_kg_s"] * table["interval_s"]).sum(), rel=1e-3
    )
    # A smoother of the same bandwidth is nearly as good or better on this field, so the inverse may not claim much.
    assert abs(found.margin) < 0.05
    assert found.plain < found.inverted


def test_noise_alone_is_not_undone(tmp_path: Path) -> None:
    path = tmp_path / "field.txt"
    ag_leader(path, delay_s=9, seed=4, noise=0.15)
    result = make_map(sources.read(path, ReadOptions()), MapOptions(transport=True))
    assert result.transport is not None
    assert not result.transport.better
    assert result.totals.by_reason["kept"] > 0

"""What the observables determine, and what seasons of kernel updates say: the studies' own statements hold in small."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from studies.waveform import identifiability, kernel_updates

SCALE = np.array([1.0, 1.0, -1.0, 0.0])
KEPT = json.loads((Path(identifiability.__file__).parent / "identifiability.json").read_text())


@pytest.mark.parametrize("flow_kg_s", [5.0, 12.0])
def test_only_kernels_determine_the_scale(flow_kg_s: float) -> None:
    known = identifiability.rows(flow_kg_s, "as shipped", "as shipped")
    for name, rows in known.items():
        moved = float(np.abs(rows @ SCALE).max()) / float(np.abs(rows).max())
        assert (moved > 0.1) is (name == "kernels"), name


def test_the_kept_table_is_what_the_study_says_and_no_sweep_makes_anything_worse() -> None:
    found = identifiability.report()
    assert len(found["rows"]) == len(KEPT["rows"]) == 24
    for row, kept in zip(found["rows"], KEPT["rows"], strict=True):
        assert (row["observables"], row["scale_unobservable"]) == (kept["observables"], kept["scale_unobservable"])
        assert row["at_home_pct"] == pytest.approx(kept["at_home_pct"], abs=0.02)
        assert row["with_a_sweep_pct"] == pytest.approx(kept["with_a_sweep_pct"], abs=0.02)
        assert row["scale_unobservable"] is ("kernels" not in row["observables"] and row["observables"] != "all four")
        assert all(row["with_a_sweep_pct"][name] <= sd + 0.01 for name, sd in row["at_home_pct"].items())


def test_a_season_s_first_load_is_measured_before_any_update() -> None:
    alone, updated = (
        kernel_updates.season(7, kernels_update=kernels_update, tickets=(), loads=3) for kernels_update in (False, True)
    )
    assert alone[0] == updated[0]
    assert len(alone) == 3
    assert np.mean([sd for _, sd in updated]) < np.mean([sd for _, sd in alone])


def test_where_grain_drifts_as_the_daemon_s_rates_say_kernel_updates_and_a_ticket_leave_what_is_stated() -> None:
    """The rates are those of the daemon, steady ones among them; without these a quarter less is stated after a ticket."""
    seasons = [
        kernel_updates.season(60 + i, kernels_update=True, tickets=(0,), rates=kernel_updates.RATES, as_expected=True, loads=16)
        for i in range(4)
    ]
    errors, stated = np.array(seasons)[:, 1:, 0], np.array(seasons)[:, 1:, 1]
    assert 0.6 < float(np.sqrt(np.mean((errors / stated) ** 2))) < 1.4
    still = replace(kernel_updates.RATES, steady_per_kilotonne=dict.fromkeys(kernel_updates.KNOWN_SD, 0.0))
    fixed = kernel_updates.season(60, kernels_update=False, tickets=(0,), rates=still, loads=16)
    drifting = kernel_updates.season(60, kernels_update=False, tickets=(0,), loads=16)
    assert drifting[-1][1] > 1.15 * fixed[-1][1]

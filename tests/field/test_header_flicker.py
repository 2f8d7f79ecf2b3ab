"""A header switch that flickers within a pass does not end it; a header that is lifted does."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from yieldmon.cli import main as cli

from .synthetic import ag_leader

STATUS = 8
"""Column of Ag Leader's text with the header's state."""
NOTE = "the header is up for at most 2 s within passes"


def mapped(path: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    words = ["map", str(path), "--out", str(path.parent / "out"), "--products", "none", "--flow-delay", "10", "--json"]
    assert cli.main(words) == 0
    return json.loads(capsys.readouterr().out)


def lifted(path: Path, out: Path, rows: np.ndarray) -> Path:
    """The same text with the other header state in these rows."""
    lines = [line.split(",") for line in path.read_text().splitlines()]
    for row in np.flatnonzero(rows):
        lines[row][STATUS] = "32" if lines[row][STATUS] == "33" else "33"
    out.write_text("".join(",".join(line) + "\n" for line in lines))
    return out


def test_a_switch_that_flickers_in_a_row_of_twenty_costs_little_of_the_mass(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ag_leader(tmp_path / "whole.txt", delay_s=10, seed=41)
    whole = mapped(tmp_path / "whole.txt", capsys)
    count = len((tmp_path / "whole.txt").read_text().splitlines())
    chosen = np.random.default_rng(42).random(count) < 0.05
    found = mapped(lifted(tmp_path / "whole.txt", tmp_path / "flickering.txt", chosen), capsys)
    assert found["mass_kg"]["integrated"] == pytest.approx(whole["mass_kg"]["integrated"], rel=1e-6)
    assert found["mass_kg"]["kept"] == pytest.approx(whole["mass_kg"]["kept"], rel=0.03)
    assert found["yield_t_ha"] == pytest.approx(whole["yield_t_ha"], rel=0.01)
    assert any(NOTE in note for note in found["notes"])
    assert not any(NOTE in note for note in whole["notes"])


@pytest.mark.parametrize(("seconds", "bridged"), [(1, True), (2, True), (3, False), (6, False)])
def test_only_moments_are_bridged(seconds: int, bridged: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ag_leader(tmp_path / "whole.txt", delay_s=10, seed=43, length_s=80, turn_s=12)
    whole = mapped(tmp_path / "whole.txt", capsys)
    count = len((tmp_path / "whole.txt").read_text().splitlines())
    chosen = np.isin(np.arange(count) % 92, np.arange(40, 40 + seconds))
    found = mapped(lifted(tmp_path / "whole.txt", tmp_path / "lifted.txt", chosen), capsys)
    more = found["points_by_reason"]["header up"] - whole["points_by_reason"]["header up"]
    assert more == (0 if bridged else 24 * seconds)
    assert any(f"{NOTE} ({24 * seconds} rows)" in note for note in found["notes"]) == bridged


def test_a_short_turn_at_the_headland_is_no_flicker(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ag_leader(tmp_path / "h.txt", delay_s=10, seed=44, turn_s=2)
    assert not any(NOTE in note for note in mapped(tmp_path / "h.txt", capsys)["notes"])

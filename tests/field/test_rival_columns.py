"""Several columns of yield or flow: they agree, differ by the drying, or a note names the one that counts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from yieldmon.cli import main as cli

from .synthetic import EARTH_M_DEG

ROWS, WAY_M = 200, 2.0
LB_AC_PER_T_HA = 892.179
COLUMNS = {
    "another yield": ("yield (t/ha)", {"yield mass (t/ha)": 0.6}, "yield mass (t/ha) contradicts yield (t/ha), which is used"),
    "in pounds": ("Yield (t/ha)", {"Yield Mass (lb/ac)": 1.5 * LB_AC_PER_T_HA}, "its numbers are 1.5 times as large"),
    "dried away": ("Yield Wet (t/ha)", {"Yield Dry (t/ha)": 0.5}, "Yield Dry (t/ha) contradicts Yield Wet (t/ha), which is used"),
    "one of two": ("yield (t/ha)", {"ertrag (t/ha)": 1.0, "yield mass (t/ha)": 3.0}, "yield mass (t/ha) contradicts yield"),
    "flows": ("flow (kg/s)", {"grain flow (kg/s)": 2.0}, "grain flow (kg/s) contradicts flow (kg/s), which is used"),
    "the same": ("yield (t/ha)", {"yield mass (t/ha)": 1.0}, ""),
    "the same in pounds": ("yield (t/ha)", {"yield mass (lb/ac)": LB_AC_PER_T_HA}, ""),
    "rounded": ("yield (t/ha)", {"yield mass (t/ha)": 1.01}, ""),
    "dried": ("Yield Wet (t/ha)", {"Yield Dry (t/ha)": 0.85}, ""),
    "no numbers": ("yield (t/ha)", {"yield mass (t/ha)": np.nan}, ""),
    "zeros": ("yield (t/ha)", {"yield mass (t/ha)": 0.0}, ""),
    "bushels": ("yield (t/ha)", {"yield vol (bu/ac)": 15.9}, ""),
}  # fmt: skip


def table(path: Path, used: str, others: dict[str, float]) -> Path:
    """A pass of 8 t/ha and 8 kg/s, with other columns that are as many times as large."""
    lines = [",".join(["lon", "lat", "time (s)", used, *others, "Width (m)"])]
    for row, wave in enumerate(1.0 + 0.3 * np.sin(np.arange(ROWS) / 9.0)):
        cells = [
            11.0,
            48.0 + row * WAY_M / EARTH_M_DEG,
            float(row),
            8.0 * wave,
            *(8.0 * wave * by for by in others.values()),
            6.0,
        ]
        lines.append(",".join("" if np.isnan(cell) else f"{cell:.8f}" for cell in cells))
    path.write_text("\n".join(lines) + "\n")
    return path


def said(path: Path, capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert cli.main(["map", str(path), "--out", "unused", "--products", "none", *words]) == 0
    return capsys.readouterr().err


@pytest.mark.parametrize(("used", "others", "note"), COLUMNS.values(), ids=COLUMNS)
def test_a_column_that_contradicts_the_used_one_is_named(
    used: str, others: dict[str, float], note: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = said(table(tmp_path / "h.csv", used, others), capsys)
    assert note in text
    assert ("contradicts" in text) is bool(note)


def test_who_chooses_a_column_is_not_told_of_the_others(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = table(tmp_path / "h.csv", "yield (t/ha)", {"yield mass (t/ha)": 0.6})
    assert "contradicts" not in said(path, capsys, "--column", "yield=yield mass (t/ha):t/ha")

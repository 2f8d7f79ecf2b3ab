"""Rows with more fields than the heading: a comma within a number or name moves what is behind it by a column."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from yieldmon.cli import main as cli

from .synthetic import EARTH_M_DEG

HEAD = "time,latitude,longitude,yield_kg_ha,field,moisture_pct,width_m"


def row(number: int, yield_kg_ha: str, field: str) -> str:
    north = 48.0 + 2.0 * number / EARTH_M_DEG
    east = 11.0 / math.cos(math.radians(48.0))
    return f"2025-08-01 07:{number // 60:02d}:{number % 60:02d},{north:.7f},{east:.7f},{yield_kg_ha},{field},14.5,6"


@pytest.mark.parametrize(
    ("lines", "said", "points"),
    [
        (
            [row(k, "6,667" if k % 3 == 1 else "967", "n") for k in range(300)],
            "rows 3, 6, 9, 12, 15 and 95 more: more than the 7 fields of its heading, as where a number or name has the comma "
            "that parts fields; left out",
            200,
        ),
        ([row(k, "6667", "North, by the road" if k == 5 else "n") for k in range(300)], "row 7: more than the 7 fields", 299),
        ([f"{row(k, '6667', 'n')},{k}" for k in range(300)], "rows have 8 fields and the heading 7: those beyond it", 300),
        ([f"{row(k, '6667', 'n')},," for k in range(300)], "", 300),
        ([row(k, "6667", "n") + "," * (k % 2) for k in range(300)], "", 300),
        ([row(k, '"6,667.0"', "n") for k in range(300)], "", 300),
    ],
    ids=["thousands", "a name", "columns without a name", "empty fields", "some empty fields", "thousands in quotes"],
)
def test_rows_of_more_fields_than_the_heading(
    lines: list[str], said: str, points: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "h.csv").write_text("\n".join([HEAD, *lines]) + "\n")
    assert cli.main(["map", str(tmp_path / "h.csv"), "--out", str(tmp_path / "map"), "--products", "none"]) == 0
    err = capsys.readouterr().err
    assert said in err
    assert ("heading" in err or "row 7" in err) == bool(said)
    assert f"{points} points" in err

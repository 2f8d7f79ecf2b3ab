"""Ag Leader text of a header with sections, or of odd seconds, holds the grain and the ground when it is read again."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from yieldmon.cli import main as cli

from .test_rows_of_strangers import AREA_M2, MASS_KG, YIELD_T_HA, Row, home, mass_kg, rows, text  # noqa: F401
from .test_sections_of_a_header import SECTIONS, of_sections

M_PER_IN, KG_PER_LB = 0.0254, 0.45359237


def mapped(capsys: pytest.CaptureFixture[str], name: str, out: str = "unused", products: str = "none") -> tuple[Any, str]:
    words = ["--out", out, "--products", products, "--flow-delay", "0", "--json"]
    assert cli.main(["map", name, *words]) == 0
    said = capsys.readouterr()
    return json.loads(said.out), said.err


def cells(name: str) -> list[list[str]]:
    with Path("out", name).open(encoding="ascii", newline="") as stream:
        return list(csv.reader(stream))


def with_times(change: float | str) -> list[Row]:
    """change: s added to each time, or by how much of a second they scatter."""
    drawn = np.random.default_rng(1).uniform(-0.04, 0.04, len(rows()))
    off = [change if isinstance(change, float) else 0.5 + one for one in drawn]
    return [row | {"time": row["time"] + one} for row, one in zip(rows(), off, strict=True)]


def test_sections_are_one_row_a_second_in_texts(capsys: pytest.CaptureFixture[str]) -> None:
    """Four rows a second were written; read again, three quarters of the grain and more were left out as duplicates."""
    Path("h.csv").write_text(text(of_sections("", beside=True)))
    first, _ = mapped(capsys, "h.csv", "out", "agleader")
    raw = cells("agleader_raw.txt")
    assert len(raw) == len({row[3] for row in raw}) == len(of_sections("", beside=True)) // SECTIONS
    mass = sum(float(row[2]) * KG_PER_LB * float(row[4]) for row in raw)
    assert mass == pytest.approx(first["mass_kg"]["integrated"], rel=2e-4)
    area = sum(float(row[5]) * float(row[6]) * M_PER_IN**2 for row in raw)
    assert area == pytest.approx(AREA_M2, rel=0.01)
    again, _ = mapped(capsys, "out/agleader_raw.txt")
    assert mass_kg(again) == pytest.approx(MASS_KG, rel=0.01)
    assert again["area_ha"] == pytest.approx(first["area_ha"], rel=0.01)
    Path("w.csv").write_text(text(rows()))
    whole, _ = mapped(capsys, "w.csv")
    assert again["mass_kg"]["kept"] == pytest.approx(whole["mass_kg"]["kept"], rel=0.01)
    clean = cells("agleader_clean.txt")
    assert len(clean) == len({row[3] for row in clean})
    kept = sum(float(row[2]) * KG_PER_LB * float(row[4]) for row in clean)
    assert kept == pytest.approx(first["mass_kg"]["kept"], rel=2e-4)


def test_a_text_with_a_row_for_each_section_is_read(capsys: pytest.CaptureFixture[str]) -> None:
    Path("h.csv").write_text(text(rows()))
    mapped(capsys, "h.csv", "out", "agleader")
    with Path("s.txt").open("w", encoding="ascii", newline="") as stream:
        east_in = 6.0 / M_PER_IN / SECTIONS
        for row in cells("agleader_raw.txt"):
            for section in range(SECTIONS):
                east_deg = (section - (SECTIONS - 1) / 2) * east_in * M_PER_IN / (111_320 * np.cos(np.radians(48.0)))
                flow, width_in = float(row[2]) / SECTIONS, float(row[6]) / SECTIONS
                cell = [f"{float(row[0]) + east_deg:.8f}", row[1], f"{flow:.4f}", *row[3:6], f"{width_in:.2f}", *row[7:]]
                csv.writer(stream).writerow(cell)
    document, said = mapped(capsys, "s.txt")
    assert "they are taken as 4 sections of the header" in said
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.01)
    assert document["area_ha"] * 1e4 == pytest.approx(AREA_M2, rel=0.01)
    assert document["yield_t_ha"] == pytest.approx(YIELD_T_HA, rel=0.02)
    assert "duplicate" not in document["mass_kg"]["left_out_by_reason"]


@pytest.mark.parametrize("change", [0.5, "scatter"])
def test_times_of_half_seconds_make_no_two_rows_one(change: float | str, capsys: pytest.CaptureFixture[str]) -> None:
    """0.5 and 1.5 s were written as 0 and 2, as was 2.5: every other row was left out as a duplicate when it was read again."""
    Path("h.csv").write_text(text(with_times(change)))
    first, _ = mapped(capsys, "h.csv", "out", "agleader")
    times = [row[3] for row in cells("agleader_raw.txt")]
    assert len(set(times)) == len(times) == len(rows())
    again, _ = mapped(capsys, "out/agleader_raw.txt")
    assert again["mass_kg"]["kept"] == pytest.approx(first["mass_kg"]["kept"], rel=0.01)


def test_steps_shorter_than_a_second_are_added_where_they_share_one(capsys: pytest.CaptureFixture[str]) -> None:
    slow = [row | {"time": 1.7e9 + 0.9 * (row["time"] - 1.7e9), "yield_t_ha": YIELD_T_HA} for row in rows()]
    Path("h.csv").write_text(text(slow))
    first, _ = mapped(capsys, "h.csv", "out", "agleader")
    raw = cells("agleader_raw.txt")
    assert len({row[3] for row in raw}) == len(raw)
    mass = sum(float(row[2]) * KG_PER_LB * float(row[4]) for row in raw)
    assert mass == pytest.approx(first["mass_kg"]["integrated"], rel=2e-4)
    again, _ = mapped(capsys, "out/agleader_raw.txt")
    assert again["mass_kg"]["integrated"] == pytest.approx(first["mass_kg"]["integrated"], rel=2e-3)
    assert again["mass_kg"]["kept"] == pytest.approx(first["mass_kg"]["kept"], rel=0.03)

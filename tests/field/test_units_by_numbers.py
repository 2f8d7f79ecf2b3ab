"""Columns whose cut names say no unit: the numbers tell it where flow and yield are of one mass, and are asked for elsewhere."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from yieldmon.cli import main as cli

from .synthetic import EARTH_M_DEG

ROWS, WAY_M, WIDTH_M, YIELD_KG_M2 = 200, 2.0, 12.0, 0.5
MASS_KG = ROWS * WAY_M * WIDTH_M * YIELD_KG_M2
LB_KG, FT_M, ACRE_M2 = 0.45359237, 0.3048, 4046.8564224
SYSTEMS = {
    "lb/s": (LB_KG, LB_KG / ACRE_M2, FT_M, FT_M),
    "lb/s, short tons, inches": (LB_KG, 2000 * LB_KG / ACRE_M2, FT_M / 12, FT_M / 12),
    "kg/s": (1.0, 1e-4, 1.0, 1.0),
    "t/h": (1 / 3.6, 0.1, 1.0, 1.0),
}


def mapped(path: Path, capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, Any, str]:
    code = cli.main(["map", str(path), "--out", "unused", "--products", "none", "--json", *words])
    said = capsys.readouterr()
    return code, json.loads(said.out) if code == 0 else None, said.err


def table(path: Path, system: str, *, dried: float = 1.0, intervals: bool = True) -> Path:
    """dried: by how much yield is smaller than flow. intervals: whether there is a column of them."""
    flow, per_area, length, width = SYSTEMS[system]
    waves = 1.0 + 0.3 * np.sin(np.arange(ROWS) / 9.0)
    names = ["lon", "lat", "Crop_Flw_M", "Yld_Mass_W", "Distance_f", "Swth_Wdth_"] + ["Duration_s"] * intervals
    lines = [",".join(names)]
    for row, wave in enumerate(waves):
        kg_m2 = YIELD_KG_M2 * wave
        cells = [11.0, 48.0 + row * WAY_M / EARTH_M_DEG, kg_m2 * WAY_M * WIDTH_M / flow, kg_m2 * dried / per_area]
        lines.append(",".join(f"{cell:.8f}" for cell in [*cells, WAY_M / length, WIDTH_M / width] + [1.0] * intervals))
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("system", SYSTEMS)
def test_numbers_tell_units(system: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, document, said = mapped(table(tmp_path / "h.csv", system), capsys)
    assert code == 0, said
    assert document["mass_kg"]["integrated"] == pytest.approx(MASS_KG, rel=0.03)
    assert document["area_ha"] == pytest.approx(ROWS * WAY_M * WIDTH_M * 1e-4, rel=0.02)
    assert "units that no column name states: Crop_Flw_M" in said


@pytest.mark.parametrize(("dried", "intervals"), [(0.95, True), (1.0, False), (2.0, True)])
def test_units_that_numbers_do_not_tell_are_asked_for(
    dried: float, intervals: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, said = mapped(table(tmp_path / "h.csv", "lb/s", dried=dried, intervals=intervals), capsys)
    assert code == 2
    assert "states no known unit for Crop_Flw_M, Yld_Mass_W" in said


def test_a_unit_that_is_given_helps_to_tell_the_others(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, document, _ = mapped(table(tmp_path / "h.csv", "lb/s"), capsys, "--column", "flow=Crop_Flw_M:lb/s")
    assert code == 0
    assert document["mass_kg"]["integrated"] == pytest.approx(MASS_KG, rel=0.03)


def test_a_given_unit_that_fits_no_others_is_asked_about(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, _, said = mapped(table(tmp_path / "h.csv", "lb/s"), capsys, "--column", "flow=Crop_Flw_M:kg/s")
    assert code == 2
    assert "states no known unit for Yld_Mass_W, Distance_f, Swth_Wdth_" in said


def test_rows_of_a_shapefile_of_sms_in_no_order(harvests: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, document, said = mapped(harvests / "sms_wheat.zip", capsys)
    assert code == 0, said
    # crp_flw_m (lb/s) times durtn_s over the rows of the DBF, by another program.
    assert document["mass_kg"]["integrated"] == pytest.approx(2418.645, abs=0.01)
    assert "crp_flw_m lb/s, yld_mss_w lb/ac, dstnc_f ft, swth_w_ ft" in said
    assert "in the order of obj__id" in said


def test_rows_without_times_last_as_long_as_they_say(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = table(tmp_path / "h.csv", "kg/s")
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([head, *rows[:50], rows[50].replace(",1.00000000", ",0.00000000"), *rows[51:]]) + "\n")
    code, _, said = mapped(path, capsys)
    assert code == 0, said
    assert "one after another at their intervals, in the order of the file" in said

"""What neighbouring passes show too is of the field and stays in the map; what one pass shows alone is an error."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from yieldmon.cli import main as cli

from .synthetic import EARTH_M_DEG

PASSES, PASS_S, SPEED_M_S, WIDTH_M, LATITUDE = 14, 120, 2.0, 6.0, 48.0
BASE_KG_M2 = 0.8
SPOT_PASSES, SPOT_S = range(4, 10), range(50, 70)
#: A spot of 36 m by 40 m, and 40 m of one pass.
SPOT = [(lane, along) for lane in SPOT_PASSES for along in SPOT_S]
ALONE = [(2, along) for along in SPOT_S]


def document(
    path: Path, places: list[tuple[int, int]], factor: float, capsys: pytest.CaptureFixture[str], lane_m: float = WIDTH_M
) -> Any:
    """The map of a field of known yields, no delay, with those of some places multiplied by a factor; passes lane_m beside each
    other."""
    rng = np.random.default_rng(2)
    lines = ["longitude,latitude,time_s,flow_kg_s,width_m,header"]
    for lane in range(PASSES):
        for along in range(PASS_S):
            second = along if lane % 2 == 0 else PASS_S - 1 - along
            amount = BASE_KG_M2 * (1.0 + 0.1 * np.sin(along / 9.0 + lane / 5.0) + 0.05 * rng.normal())
            amount *= factor if (lane, along) in places else 1.0
            north = SPEED_M_S * (along + (1.0 if lane % 2 == 0 else 0.0))
            cut_m = lane_m if lane else WIDTH_M
            east = lane * lane_m / np.cos(np.radians(LATITUDE))
            lines.append(
                f"{11.0 + east / EARTH_M_DEG:.8f},{LATITUDE + north / EARTH_M_DEG:.8f},"
                f"{1.7e9 + lane * 150 + second:.0f},{amount * cut_m * SPEED_M_S:.4f},{WIDTH_M},1"
            )
    order = sorted(lines[1:], key=lambda line: float(line.split(",")[2]))
    path.write_text("\n".join([lines[0], *order, ""]))
    words = ["map", str(path), "--out", "unused", "--flow-delay", "0", "--products", "none", "--json"]
    assert cli.main(words) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("factor", [0.0, 0.15, 2.6])
def test_a_spot_that_passes_share_is_kept(factor: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = document(tmp_path / "h.csv", SPOT, factor, capsys)
    assert found["mass_kg"]["kept"] > 0.98 * found["mass_kg"]["integrated"]
    assert found["kept_area_ha"] > 0.98 * found["area_ha"]
    cut = found["mass_kg"]["integrated"] / (1000.0 * found["area_ha"])
    assert found["yield_t_ha"] == pytest.approx(cut, rel=0.01)


@pytest.mark.parametrize(("factor", "reasons"), [(0.0, {"flow"}), (2.6, {"flow", "yield", "local outlier"})])
def test_what_one_pass_shows_alone_is_left_out(
    factor: float, reasons: set[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = document(tmp_path / "h.csv", ALONE, factor, capsys)["points_by_reason"]
    assert sum(found.get(reason, 0) for reason in reasons) >= len(ALONE) - 2


def test_a_whole_width_beside_passes_that_overlap_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = document(tmp_path / "h.csv", [], 1.0, capsys, 3.4)
    assert found["mass_kg"]["kept"] > 0.98 * found["mass_kg"]["integrated"]
    assert found["yield_t_ha"] == pytest.approx(10.0 * BASE_KG_M2, rel=0.01)

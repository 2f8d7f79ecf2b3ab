"""Task data as terminals write them: sections that switch off, other devices in the same log."""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from yieldmon.cli import main as cli

from .test_rows_of_strangers import AREA_M2, MASS_KG, PASS_S, PASSES, SPEED_M_S, WIDTH_M, YIELD_T_HA, home, rows  # noqa: F401

COUNT = PASSES * PASS_S
FLOW_MG_S = MASS_KG / COUNT * 1e6
Value = tuple[int, str, Sequence[int]]


def device(number: int, elements: Sequence[tuple[str, str, int]]) -> str:
    """elements: identifier, type, and maximum width in mm, 0 for none."""
    parts = "".join(
        f'<DET A="{name}" B="{place}" C="{kind}" E="{place}" F="0">' + (f'<DOR A="{90 + place}"/>' if width else "") + "</DET>"
        for place, (name, kind, width) in enumerate(elements)
    )
    widths = "".join(f'<DPT A="{90 + n}" B="0046" C="{width}"/>' for n, (_, _, width) in enumerate(elements) if width)
    return f'<DVC A="DVC-{number}" B="machine {number}">{parts}{widths}</DVC>'


def task_data(devices: Sequence[str], values: Sequence[Value]) -> Path:
    """A log of rows() in which each record has all values."""
    folder = Path("TASKDATA")
    folder.mkdir()
    (folder / "TASKDATA.XML").write_text(
        f'<ISO11783_TaskData VersionMajor="4">{"".join(devices)}<TSK A="TSK1" G="4"><TLG A="TLG00001"/></TSK></ISO11783_TaskData>'
    )
    listed = "".join(f'<DLV A="{ddi:04X}" B="" C="{element}"/>' for ddi, element, _ in values)
    (folder / "TLG00001.xml").write_text(f'<TIM A="" D="4"><PTN A="" B="" D=""/>{listed}</TIM>')
    out = bytearray()
    for number, row in enumerate(rows(speeds=False)):
        since = row["time"] - 315_964_800.0
        out += struct.pack("<IH", round(since % 86400 * 1000), int(since // 86400))
        out += struct.pack("<iiB", round(row["latitude"] * 1e7), round(row["longitude"] * 1e7), 4)
        out += bytes([len(values)]) + b"".join(struct.pack("<Bi", k, one[2][number]) for k, one in enumerate(values))
    (folder / "TLG00001.bin").write_bytes(out)
    return folder


def mapped(folder: Path, capsys: pytest.CaptureFixture[str]) -> Any:
    assert cli.main(["map", str(folder), "--out", "unused", "--products", "none", "--json", "--flow-delay", "0"]) == 0
    return json.loads(capsys.readouterr().out)


def test_sections_that_are_off_cut_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    """In every second pass two of four sections work, beside ground that was cut, and bring half of the grain."""
    halved = np.arange(COUNT) // PASS_S % 2 == 1
    states = np.where(halved, 0b0101, 0b01010101)
    quarter = round(WIDTH_M / 4 * 1000)
    elements = [("DET-1", "1", 4 * quarter), *((f"DET-{n}", "4", quarter) for n in range(2, 6))]
    flow = np.where(halved, FLOW_MG_S / 2, FLOW_MG_S).round().astype(int).tolist()
    document = mapped(task_data([device(1, elements)], [(161, "DET-1", states.tolist()), (87, "DET-1", flow)]), capsys)
    assert document["mass_kg"]["integrated"] == pytest.approx(0.75 * MASS_KG, rel=0.01)
    assert document["area_ha"] * 1e4 == pytest.approx(0.75 * AREA_M2, rel=0.01)
    assert document["yield_t_ha"] == pytest.approx(YIELD_T_HA, rel=0.02)


@pytest.mark.parametrize("where", ["log", "description"])
def test_the_width_is_that_of_the_device_that_measures_the_yield(where: str, capsys: pytest.CaptureFixture[str]) -> None:
    wide, narrow = round(1000 * WIDTH_M), 3000
    values: list[Value] = [(87, "DET-1", [round(FLOW_MG_S)] * COUNT)]
    if where == "log":
        values = [(67, "DET-9", [narrow] * COUNT), *values, (67, "DET-1", [wide] * COUNT)]
    described = where == "description"
    devices = [device(1, [("DET-1", "1", wide * described)]), device(2, [("DET-9", "1", narrow * described)])]
    document = mapped(task_data(devices, values), capsys)
    assert document["area_ha"] * 1e4 == pytest.approx(AREA_M2, rel=0.01)
    assert document["yield_t_ha"] == pytest.approx(YIELD_T_HA, rel=0.02)

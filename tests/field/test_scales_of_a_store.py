"""Loads of a store that were measured before and after its scale was set: a ticket of `map` scales those with the same scale."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from tests.seconds import measured_second
from yieldmon.cli import main as cli
from yieldmon.files import parameter_file
from yieldmon.service.storage.batch import Batch, Load, ParameterVersion
from yieldmon.service.storage.store import Store

from .synthetic import EARTH_M_DEG

LOAD_S, FLOW_KG_S, START_S = 100, 10.0, 1.76e9
ORIGINS = {1: "file", 2: "crop", 3: "sweep", 4: "ticket", 5: "crop", 6: "crop", 7: "sweep", 8: "undo"}
"""Parameter versions: the file's; corn's, the same; swept; weighed; soybean's; corn's again; swept; the ticket was undone."""


def store(path: Path, version_of: dict[int, tuple[int, ...]]) -> None:
    """Loads in which one version after the other measured as many seconds."""
    corn = parameter_file.load()
    density = {1: 0.0, 2: 0.0, 3: 5.0, 4: 100.0, 5: -60.0, 6: 100.0, 7: 103.0, 8: 0.0}
    versions = [replace(corn, values={**corn.values, "density": corn.values["density"] + density[v]}, version=v) for v in ORIGINS]
    rows = []
    for number in range(LOAD_S * len(version_of)):
        load = number // LOAD_S + 1
        used = version_of[load]
        east = 12.0 * load / (EARTH_M_DEG * math.cos(math.radians(48.0)))
        along = 2.0 * (number % LOAD_S)
        rows.append(
            measured_second(
                number + 1,
                START_S + number,
                FLOW_KG_S,
                load_number=load,
                parameter_version=used[number % LOAD_S * len(used) // LOAD_S],
                latitude_deg=48.0 + along / EARTH_M_DEG,
                longitude_deg=east,
                ground_speed_m_s=2.0,
            )
        )
    loads = [
        Load(n, "", "soybean" if used == (5,) else "corn", START_S + (n - 1) * LOAD_S, START_S + n * LOAD_S, 1000.0, None)
        for n, used in version_of.items()
    ]
    with Store(path) as opened:
        kept = tuple(ParameterVersion(p.version, START_S, ORIGINS[p.version], parameter_file.to_document(p)) for p in versions)
        opened.commit([Batch(1, START_S, {}, tuple(rows), tuple(loads), parameter_versions=kept)])


@pytest.mark.parametrize(
    ("used", "scaled"),
    [
        ((1,), True),
        ((2,), True),
        ((3,), True),
        ((2, 3), True),
        ((4,), False),
        ((6,), False),
        ((7,), False),
        ((2, 4), False),
        ((8,), True),
        ((5,), False),
    ],
)
def test_a_ticket_scales_loads_that_were_measured_with_its_scale(
    used: tuple[int, ...], scaled: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store(tmp_path / "s.sqlite", {1: (1,), 2: (2,), 3: (2,), 4: used})
    (tmp_path / "t.csv").write_text("load,weighed_kg\n1,900\n2,902\n3,898\n")
    words = ["map", str(tmp_path / "s.sqlite"), "--tickets", str(tmp_path / "t.csv"), "--out", str(tmp_path / "map")]
    assert cli.main([*words, "--products", "none", "--width", "6", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["loads"][3]["factor"] == pytest.approx(0.9 if scaled else 1.0, rel=2e-3)
    assert ("as measured, for no weighed load is of the same crop and calibration: load 4" in found["notes"]) != scaled

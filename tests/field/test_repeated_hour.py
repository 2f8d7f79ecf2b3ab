"""A harvest through the end of summer time in local times: one machine, whose clock says an hour twice."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
import pytest

from yieldmon.cli import main as cli

from .synthetic import EARTH_M_DEG

SPEED_M_S, PASS_S, WIDTH_M, FLOW_KG_S, STEP_S = 1.5, 400, 6.0, 9.0, 2
HOURS = 3.5
TWICE = "the hour at the end of summer time comes twice"


def rows(zone: str, begins: datetime, *, east_m: float = 0.0, pause_s: float = 0.0) -> list[tuple[str, str]]:
    """(local time, line); pause_s: what the machine stands about the change of the clock."""
    found, lane, along_m, way = [], 0, 0.0, 1.0
    away = timedelta(hours=1.5)
    for second in range(0, int(3600 * HOURS), STEP_S):
        along_m += way * SPEED_M_S * STEP_S
        if not 0.0 <= along_m <= SPEED_M_S * PASS_S:
            way, lane = -way, lane + 1
        moment = begins + timedelta(seconds=second)
        if abs((moment - begins - away).total_seconds()) < 0.5 * pause_s:
            continue
        east = 8.0 + (east_m + WIDTH_M * lane) / (EARTH_M_DEG * np.cos(np.radians(51.0)))
        local = f"{moment.astimezone(ZoneInfo(zone)):%Y-%m-%d %H:%M:%S}"
        found.append((local, f"{local},{east:.8f},{51.0 + along_m / EARTH_M_DEG:.8f},{FLOW_KG_S},{SPEED_M_S},{WIDTH_M}"))
    return found


def mapped(capsys: pytest.CaptureFixture[str], lines: list[str]) -> tuple[dict[str, Any], str]:
    head = "time,longitude,latitude,mass flow (kg/s),speed (m/s),width (m)"
    Path("h.csv").write_text("\n".join([head, *lines, ""]))
    assert cli.main(["map", "h.csv", "--out", "unused", "--products", "none", "--json"]) == 0
    said = capsys.readouterr()
    return json.loads(said.out), said.err


EUROPE = "Europe/Berlin", datetime(2026, 10, 24, 23, 30, tzinfo=UTC)
IOWA = "America/Chicago", datetime(2026, 11, 1, 5, 30, tzinfo=UTC)


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("where", [EUROPE, IOWA], ids=["europe", "iowa"])
@pytest.mark.parametrize("by_time", [False, True], ids=["as driven", "by time"])
@pytest.mark.parametrize("pause_s", [0.0, 20.0])
def test_one_machine_stays_one(where: tuple[str, datetime], by_time: bool, pause_s: float, capsys: Any) -> None:
    """It was taken apart as two."""
    found = rows(*where, pause_s=pause_s)
    document, said = mapped(capsys, [line for _, line in (sorted(found, key=lambda row: row[0]) if by_time else found)])
    assert TWICE in said
    assert "several machines" not in said
    assert "backwards" not in said
    assert document["mass_kg"]["integrated"] == pytest.approx(3600 * HOURS * FLOW_KG_S, rel=0.005)


def test_two_machines_of_one_name_stay_two(capsys: pytest.CaptureFixture[str]) -> None:
    """Of two at once the second does not begin where the first ends; nor is there a change of the clock in summer."""
    july = "Europe/Berlin", datetime(2026, 7, 24, 22, 0, tzinfo=UTC)
    later = july[0], july[1] + timedelta(hours=1)
    _, said = mapped(capsys, [line for _, line in rows(*july) + rows(*later, east_m=3000.0)])
    assert "several machines" in said
    assert TWICE not in said


def test_a_night_without_a_change_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    _, said = mapped(capsys, [line for _, line in rows("Europe/Berlin", datetime(2026, 10, 23, 23, 30, tzinfo=UTC))])
    assert TWICE not in said

"""Rows of several machines, by name, in one file: each stands for its own machine's time and way."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from yieldmon.cli import main as cli
from yieldmon.field.mixed import machines_apart

from .synthetic import EARTH_M_DEG

SECONDS, PASS_S, SPEED_M_S, WIDTH_M = 600, 100, 1.5, 6.0
HEAD = "time (s),longitude,latitude,mass flow (kg/s),speed (m/s),width (m),machine"
FLOWS_KG_S = {"north": 10.0, "south": 8.0}


def rows(*, late_s: float = 0.0, step_s: float = 1.0, clock_s: float = 0.0) -> list[tuple[float, str, str]]:
    """(time, machine, line) of even ground, to and fro; the second machine logs late_s after the first. clock_s: what the clock
    counts in, 0: exactly."""
    found = []
    for number, (machine, flow) in enumerate(FLOWS_KG_S.items()):
        for second in np.arange(0.0, SECONDS, step_s):
            lane, along = divmod(second, PASS_S)
            way_m = SPEED_M_S * (along if lane % 2 == 0 else PASS_S - along)
            east = way_m / (EARTH_M_DEG * np.cos(np.radians(51.0)))
            north = 51.0 + (2000.0 * number + WIDTH_M * lane) / EARTH_M_DEG
            time_s = second + number * late_s
            shown_s = time_s if not clock_s else clock_s * np.floor(time_s / clock_s)
            place = f"{8.0 + east:.8f},{north:.8f}"
            found.append((time_s, machine, f"{shown_s:.2f},{place},{flow},{SPEED_M_S},{WIDTH_M},{machine}"))
    return found


def mapped(capsys: pytest.CaptureFixture[str], lines: list[str], head: str = HEAD) -> tuple[dict[str, Any], str]:
    Path("h.csv").write_text("\n".join([head, *lines, ""]))
    assert cli.main(["map", "h.csv", "--out", "unused", "--products", "none", "--json"]) == 0
    said = capsys.readouterr()
    return json.loads(said.out), said.err


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("order", ["time", "machine"])
@pytest.mark.parametrize(
    "of",
    [{}, {"late_s": 0.5}, {"late_s": 0.5, "step_s": 1.25, "clock_s": 1.0}],
    ids=["in the same seconds", "half a second later", "by a clock of whole seconds"],
)
def test_no_mass_is_lost_between_two_machines(of: dict[str, float], order: str, capsys: pytest.CaptureFixture[str]) -> None:
    found = rows(**of)
    document, said = mapped(capsys, [line for _, _, line in (sorted(found) if order == "time" else found)])
    assert document["mass_kg"]["integrated"] == pytest.approx(SECONDS * sum(FLOWS_KG_S.values()), rel=0.003)
    assert "taken together" not in said


@pytest.mark.parametrize("order", ["time", "machine"])
def test_without_times_rows_follow_those_of_their_machine(order: str, capsys: pytest.CaptureFixture[str]) -> None:
    found = rows()
    lines = [line.partition(",")[2] for _, _, line in (sorted(found) if order == "time" else found)]
    document, said = mapped(capsys, lines, HEAD.partition(",")[2])
    assert document["mass_kg"]["integrated"] == pytest.approx(SECONDS * sum(FLOWS_KG_S.values()))
    assert "rows are taken as one second apart" in said


def test_fast_logs_of_two_machines_are_taken_together_machine_by_machine(capsys: pytest.CaptureFixture[str]) -> None:
    document, said = mapped(capsys, [line for _, _, line in sorted(rows(step_s=0.2, late_s=0.1))])
    assert document["mass_kg"]["integrated"] == pytest.approx(SECONDS * sum(FLOWS_KG_S.values()), rel=0.003)
    assert f"6000 rows 0.2 s apart are taken together to {2 * SECONDS} of a second" in said


def test_even_ground_has_no_local_outlier(capsys: pytest.CaptureFixture[str]) -> None:
    document, _ = mapped(capsys, [line for _, _, line in rows()])
    assert "local outlier" not in document["points_by_reason"]
    assert document["mass_kg"]["kept"] > 0.9 * document["mass_kg"]["integrated"]


def test_what_stands_out_on_even_ground_is_one(capsys: pytest.CaptureFixture[str]) -> None:
    lines = [line for _, _, line in rows()]
    lines[250] = lines[250].replace(",10.0,", ",13.0,")
    document, _ = mapped(capsys, lines)
    assert document["points_by_reason"]["local outlier"] >= 1


UNNAMED = HEAD.rpartition(",")[0]


def unnamed(line: str) -> str:
    return line.rpartition(",")[0]


@pytest.mark.parametrize("order", ["time", "machine"])
@pytest.mark.parametrize(
    "of",
    [{}, {"late_s": 0.5}, {"step_s": 0.2, "late_s": 0.1}, {"late_s": 0.5, "step_s": 1.25, "clock_s": 1.0}],
    ids=["in the same seconds", "half a second later", "five rows a second", "by a clock of whole seconds"],
)
def test_machines_without_names_are_taken_apart_by_their_places(
    of: dict[str, float], order: str, capsys: pytest.CaptureFixture[str]
) -> None:
    found = rows(**of)
    document, said = mapped(capsys, [unnamed(line) for _, _, line in (sorted(found) if order == "time" else found)], UNNAMED)
    assert document["mass_kg"]["integrated"] == pytest.approx(SECONDS * sum(FLOWS_KG_S.values()), rel=0.003)
    points = [one["points"] for one in document["delay"]["machines"]]
    assert len(points) == 2
    assert points[0] == pytest.approx(points[1], rel=0.01)
    assert "taken apart by their places, as machines 1" in said


def test_three_machines_without_names_are_taken_apart(capsys: pytest.CaptureFixture[str]) -> None:
    third = [(time, "west", line.replace(",8.", ",8.05", 1)) for time, machine, line in rows() if machine == "north"]
    document, _ = mapped(capsys, [unnamed(line) for _, _, line in sorted([*rows(), *third])], UNNAMED)
    assert document["mass_kg"]["integrated"] == pytest.approx(SECONDS * (10.0 + 8.0 + 10.0), rel=0.003)
    assert len(document["delay"]["machines"]) == 3


def test_an_hour_that_a_clock_shows_twice_is_harvested_twice(capsys: pytest.CaptureFixture[str]) -> None:
    again = [
        (time, machine, f"{time - SECONDS / 2:.2f}{line[line.index(',') :]}")
        for time, machine, line in rows()
        if machine == "north" and time >= SECONDS / 2
    ]
    before = [row for row in rows() if row[1] == "north" and row[0] < SECONDS / 2]
    document, _ = mapped(capsys, [unnamed(line) for _, _, line in (*before, *again)], UNNAMED)
    assert document["mass_kg"]["integrated"] == pytest.approx(SECONDS * 10.0, rel=0.003)


@pytest.mark.parametrize("named", [True, False])
def test_each_machine_stands_for_time_at_its_own_rate(named: bool, capsys: pytest.CaptureFixture[str]) -> None:
    both = [row for row in rows() if row[1] == "north"] + [row for row in rows(step_s=5.0) if row[1] == "south"]
    lines = [line if named else unnamed(line) for _, _, line in sorted(both)]
    document, _ = mapped(capsys, lines, HEAD if named else UNNAMED)
    assert document["mass_kg"]["integrated"] == pytest.approx(SECONDS * sum(FLOWS_KG_S.values()), rel=0.003)
    assert document["area_ha"] == pytest.approx(2 * SECONDS * SPEED_M_S * WIDTH_M / 1e4, rel=0.02)


def test_a_log_whose_rate_was_changed_keeps_its_mass(capsys: pytest.CaptureFixture[str]) -> None:
    north = [row for row in rows() if row[1] == "north" and row[0] < 300.0]
    slow = [row for row in rows(step_s=5.0) if row[1] == "north" and row[0] >= 300.0]
    document, _ = mapped(capsys, [unnamed(line) for _, _, line in (*north, *slow)], UNNAMED)
    # The first slow row comes one second after the last fast one.
    assert document["mass_kg"]["integrated"] == pytest.approx((SECONDS - 4.0) * 10.0, rel=0.003)
    assert document["area_ha"] == pytest.approx(SECONDS * SPEED_M_S * WIDTH_M / 1e4, rel=0.02)


def test_a_pause_is_no_row_that_lasts_so_long(capsys: pytest.CaptureFixture[str]) -> None:
    north = [row for row in rows() if row[1] == "north" and not 200.0 <= row[0] < 300.0]
    document, _ = mapped(capsys, [unnamed(line) for _, _, line in north], UNNAMED)
    assert document["mass_kg"]["integrated"] == pytest.approx((SECONDS - 100.0) * 10.0, rel=0.003)


def test_a_receiver_that_leaps_to_and_fro_is_one_machine(capsys: pytest.CaptureFixture[str]) -> None:
    """Some rows in a row lie 40 m off, and the next ones do not."""
    lines = []
    for time, machine, line in rows():
        if machine == "north":
            cells = unnamed(line).split(",")
            cells[2] = f"{float(cells[2]) + (40.0 / EARTH_M_DEG if time % 11 < 4 else 0.0):.8f}"
            lines.append(",".join(cells))
    document, said = mapped(capsys, lines, UNNAMED)
    assert document["mass_kg"]["integrated"] == pytest.approx(SECONDS * 10.0, rel=0.003)
    assert "taken apart" not in said


def test_a_damaged_time_is_no_overflow() -> None:
    time_s, still = np.r_[np.arange(50.0), 1.5e308], np.zeros(51)
    with np.errstate(over="raise"):
        assert machines_apart(time_s, still, still) is None

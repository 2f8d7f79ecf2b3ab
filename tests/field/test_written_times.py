"""Times as monitors and spreadsheets of several countries write them: none loses, doubles or stretches a harvest."""

from __future__ import annotations

import json
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from yieldmon.cli import main as cli

from .synthetic import EARTH_M_DEG

SECONDS, PASS_S, SPEED_M_S, WIDTH_M, FLOW_KG_S = 600, 100, 1.5, 6.0, 10.0
MASS_KG, AREA_HA = SECONDS * FLOW_KG_S, SECONDS * SPEED_M_S * WIDTH_M / 1e4
OVER_MIDNIGHT = datetime(2024, 8, 12, 23, 55, tzinfo=UTC)
"""In a time of the year in which 12/08 may be a day of August or of December, and 13/08 cannot."""


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def mapped(
    capsys: pytest.CaptureFixture[str],
    write: Callable[[datetime], str],
    names: str = "time",
    begin: datetime = OVER_MIDNIGHT,
    **of: Any,
) -> tuple[dict[str, Any], list[str]]:
    """The map of even ground driven to and fro, a row a second; `write` has the fields of `names` of a row's time."""
    rows = [f"{names},longitude,latitude,flow (kg/s),width (m)" + of.get("more", "")]
    for second in range(SECONDS):
        lane, along = divmod(second, PASS_S)
        way_m = SPEED_M_S * (along if lane % 2 == 0 else PASS_S - along)
        east = way_m / (EARTH_M_DEG * np.cos(np.radians(51.0)))
        north = 51.0 + WIDTH_M * lane / EARTH_M_DEG
        rows.append(
            f"{write(begin + timedelta(seconds=second))},{8.0 + east:.8f},{north:.8f},{FLOW_KG_S},{WIDTH_M}" + of.get("cells", "")
        )
    Path("h.csv").write_text("\n".join([*rows, ""]))
    code = cli.main(["map", "h.csv", "--out", "unused", "--products", "none", "--json"])
    said = capsys.readouterr()
    assert code == 0, said.err
    document = json.loads(said.out)
    return document, document["sources"][0]["notes"]


def as_pattern(pattern: str) -> Callable[[datetime], str]:
    return lambda at: at.strftime(pattern)


@pytest.mark.parametrize(
    "pattern",
    ['"%b %d, %Y %I:%M:%S %p"', '"%A, %d %B %Y %H:%M:%S"', '"%a, %b %d %Y %H:%M:%S"', "%Y.%m.%d. %H:%M:%S",
     "%Y-%m-%d %I:%M:%S %p",
     "%d/%m/%Y %H:%M:%S", "%d/%m/%Y %I:%M:%S %p", "%d-%m-%Y %H:%M:%S", "%d.%m.%y %H:%M:%S", "%m/%d/%y %H:%M:%S", "%H:%M:%S",
     "%I:%M:%S %p", "%m/%d/%Y %I:%M:%S %p", "%d-%b-%Y %H:%M:%S", "%d. %B %Y %H:%M:%S", "%Y/%m/%d %H:%M:%S",
     "%Y-%m-%d %H:%M:%S UTC"],
)  # fmt: skip
def test_a_harvest_over_midnight_is_one_of_ten_minutes(pattern: str, capsys: pytest.CaptureFixture[str]) -> None:
    document, notes = mapped(capsys, as_pattern(pattern))
    assert document["mass_kg"]["integrated"] == pytest.approx(MASS_KG, rel=1e-6)
    assert document["area_ha"] == pytest.approx(AREA_HA, rel=0.03)
    assert "no position" not in document["points_by_reason"]
    assert not any("backwards" in note for note in notes)


@pytest.mark.parametrize(
    ("names", "pattern"), [("date,time", "%d/%m/%Y,%H:%M:%S"), ("date,time", "%Y-%m-%d 00:00:00,%I:%M:%S %p")]
)
def test_days_stand_in_a_column_of_their_own(names: str, pattern: str, capsys: pytest.CaptureFixture[str]) -> None:
    document, _ = mapped(capsys, as_pattern(pattern), names)
    assert document["mass_kg"]["integrated"] == pytest.approx(MASS_KG, rel=1e-6)
    assert document["area_ha"] == pytest.approx(AREA_HA, rel=0.03)


def test_the_day_comes_first_where_the_harvest_then_is_shorter(capsys: pytest.CaptureFixture[str]) -> None:
    begin = datetime(2024, 8, 5, 23, 55, tzinfo=UTC)
    _, notes = mapped(capsys, as_pattern("%d/%m/%Y %H:%M:%S"), begin=begin)
    assert any("dates are read as day/month/year" in note for note in notes)
    _, notes = mapped(capsys, as_pattern("%m/%d/%Y %H:%M:%S"), begin=begin)
    assert any("dates are read as month/day/year" in note for note in notes)


@pytest.mark.parametrize(
    ("files", "options", "day", "said"),
    [
        (
            {"h.csv": ("%d/%m/%Y", 3, ",")},
            (),
            "2026-03-04",
            "no date shows the order: if the first is 2026-04-03, give --date ",
        ),
        (
            {"h.csv": ("%m/%d/%Y", 3, ",")},
            (),
            "2026-04-03",
            "no date shows the order: if the first is 2026-03-04, give --date ",
        ),
        ({"h.csv": ("%d/%m/%Y", 3, ",")}, ("--date", "2026-04-03"), "2026-04-03", "day/month/year"),
        ({"h.csv": ("%d/%m/%Y", 3, ";")}, (), "2026-04-03", "day/month/year"),
        ({"h.csv": ("%d/%m/%Y", 3, ","), "i.csv": ("%d/%m/%Y", 13, ",")}, (), "2026-04-03", "day/month/year"),
        ({"h.csv": ("%d/%m/%Y", 4, ",")}, (), "2026-04-04", "month/day/year"),
    ],
)
def test_dates_of_one_day_are_told_by_decimal_commas_another_file_or_a_person_and_else_asked_about(
    files: dict[str, tuple[str, int, str]], options: tuple[str, ...], day: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, (pattern, first, mark) in files.items():
        rows = [mark.join(("time", "longitude", "latitude", "flow (kg/s)", "width (m)"))]
        for second in range(200):
            at = datetime(2026, 4, first, 10, tzinfo=UTC) + timedelta(seconds=second)
            cells = (at.strftime(f"{pattern} %H:%M:%S"), f"{8 + 2e-5 * second:.8f}", f"{51 + 0.01 * first:.8f}", "10.0", "6.0")
            rows.append(mark.join(cell.replace(".", ",") if mark == ";" else cell for cell in cells))
        Path(name).write_text("\n".join([*rows, ""]))
    assert cli.main(["map", *files, "--out", "out", "--products", "csv", *options]) == 0
    (note,) = [line for line in capsys.readouterr().err.splitlines() if "h.csv: dates are read as" in line]
    assert said in note
    assert f",{day}T10:00:00" in next(Path("out").glob("*.csv")).read_text()


@pytest.mark.parametrize("more", [("", ""), (",interval (s)", ",1")])
def test_a_clock_of_minutes_keeps_ground_and_mass(more: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    document, notes = mapped(capsys, as_pattern("%d/%m/%Y %H:%M"), more=more[0], cells=more[1])
    assert document["mass_kg"]["integrated"] == pytest.approx(MASS_KG, rel=0.01)
    assert document["area_ha"] == pytest.approx(AREA_HA, rel=0.03)
    assert any("more coarsely than the rows follow" in note for note in notes)


def test_digits_and_shares_of_a_day_are_times(capsys: pytest.CaptureFixture[str]) -> None:
    def share(at: datetime) -> str:
        return f"{(at - at.replace(hour=0, minute=0, second=0)).total_seconds() / 86_400.0:.8f}"

    for write in (as_pattern("%H%M%S"), share):
        document, _ = mapped(capsys, write)
        assert document["mass_kg"]["integrated"] == pytest.approx(MASS_KG, rel=1e-6)
        assert document["area_ha"] == pytest.approx(AREA_HA, rel=0.03)


def test_hours_are_no_seconds(capsys: pytest.CaptureFixture[str]) -> None:
    Path("h.csv").write_text(
        "time,longitude,latitude,flow (kg/s),width (m)\n"
        + "".join(f"{9 + second / 3600:.6f},8.{second:05d},51.0,10,6\n" for second in range(300))
    )
    assert cli.main(["map", "h.csv", "--out", "unused", "--products", "none"]) == 2
    assert "h.csv: time: has steps of 0.00028 s; expected --column time=time:UNIT" in capsys.readouterr().err


def test_rows_whose_time_cannot_be_read_are_counted(capsys: pytest.CaptureFixture[str]) -> None:
    _, notes = mapped(capsys, lambda at: "n/a" if at.second == 7 else at.isoformat())
    assert "time holds no time that can be read in 10 of 600 rows" in notes


def test_each_machine_s_clock_goes_on_over_midnight_by_itself(capsys: pytest.CaptureFixture[str]) -> None:
    head, lines = "time,longitude,latitude,flow (kg/s),width (m),machine", []
    for second in range(SECONDS):
        for machine in range(2):
            # The second machine's clock is half a second behind, so about midnight the clocks step to and fro.
            at = OVER_MIDNIGHT + timedelta(seconds=second - 0.5 * machine)
            lane, along = divmod(second, PASS_S)
            way_m = SPEED_M_S * (along if lane % 2 == 0 else PASS_S - along)
            east = 8.0 + way_m / (EARTH_M_DEG * np.cos(np.radians(51.0)))
            lines.append(
                f"{at:%H:%M:%S.%f},{east:.8f},{51.0 + 0.01 * machine + WIDTH_M * lane / EARTH_M_DEG:.8f},{FLOW_KG_S},6,{machine}"
            )
    Path("h.csv").write_text("\n".join([head, *lines, ""]))
    assert cli.main(["map", "h.csv", "--out", "unused", "--products", "none", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["mass_kg"]["integrated"] == pytest.approx(2 * MASS_KG)
    assert document["area_ha"] == pytest.approx(2 * AREA_HA, rel=0.03)

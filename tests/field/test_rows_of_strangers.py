"""CSV files with rows that are doubled, missing, marked or misplaced, of a harvest whose mass and yield are known."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from yieldmon.cli import main as cli

from .synthetic import EARTH_M_DEG

PASSES, PASS_S, SPEED_M_S, WIDTH_M = 8, 120, 2.0, 6.0
YIELD_T_HA = 8.0
AREA_M2 = PASSES * PASS_S * SPEED_M_S * WIDTH_M
MASS_KG = AREA_M2 * YIELD_T_HA / 10.0
Row = dict[str, Any]


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def rows(start_s: float = 1.7e9, latitude: float = 48.0, longitude: float = 11.0, speeds: bool = True) -> list[Row]:
    """One a second; in each pass the yield goes through a wave, whose mean is YIELD_T_HA. speeds: if they differ a little."""
    found = []
    for number in range(PASSES * PASS_S):
        lane, along = divmod(number, PASS_S)
        change = 0.3 * np.sin(along / 3.0) if speeds else 0.0
        way = SPEED_M_S * (along + change) if lane % 2 == 0 else SPEED_M_S * (PASS_S - along + change)
        found.append(
            {
                "time": start_s + number + 20.0 * lane,
                "longitude": longitude + lane * WIDTH_M / (EARTH_M_DEG * np.cos(np.radians(latitude))),
                "latitude": latitude + way / EARTH_M_DEG,
                "yield_t_ha": YIELD_T_HA + 2.0 * np.sin(2 * np.pi * along / PASS_S + lane),
                "width_m": WIDTH_M,
            }
        )
    return found


def text(table: Iterable[Row]) -> str:
    lines = [dict(row) for row in table]
    return "\n".join([",".join(lines[0]), *(",".join(map(str, line.values())) for line in lines), ""])


def mapped(capsys: pytest.CaptureFixture[str], *contents: str | Iterable[Row], words: tuple[str, ...] = ()) -> tuple[Any, str]:
    names = [f"h{number}.csv" for number, _ in enumerate(contents)]
    for name, content in zip(names, contents, strict=True):
        Path(name).write_text(content if isinstance(content, str) else text(content))
    code = cli.main(["map", *names, "--out", "unused", "--products", "none", "--json", *words])
    said = capsys.readouterr()
    assert code == 0, said.err
    return json.loads(said.out), said.err


def mass_kg(document: Any) -> float:
    return float(document["mass_kg"]["integrated"])


def changed(change: Callable[[int, Row], Row], table: list[Row] | None = None) -> list[Row]:
    return [change(number, row) for number, row in enumerate(rows() if table is None else table)]


def with_distance(table: list[Row], m: float = SPEED_M_S) -> list[Row]:
    return [row | {"distance_m": m} for row in table]


@pytest.mark.parametrize("order", ["beside each other", "one after another"])
def test_rows_that_a_table_holds_twice_count_once(order: str, capsys: pytest.CaptureFixture[str]) -> None:
    table = with_distance(rows())
    twice = [row for row in table for _ in range(2)] if order == "beside each other" else table + table
    document, said = mapped(capsys, twice)
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.01)
    assert document["yield_t_ha"] == pytest.approx(YIELD_T_HA, rel=0.01)
    assert f"{len(table)} rows: the same as a row before: each counts once" in said


def test_rows_of_a_log_faster_than_its_clock_are_no_copies(capsys: pytest.CaptureFixture[str]) -> None:
    document, said = mapped(capsys, [part for row in with_distance(rows(), SPEED_M_S / 5) for part in [row] * 5])
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.01)
    assert "each counts once" not in said


@pytest.mark.parametrize("mark", ["99.9", "999", "65535", "-9999", "1e38"])
def test_a_mark_for_no_value_is_no_yield(mark: str, capsys: pytest.CaptureFixture[str]) -> None:
    document, said = mapped(capsys, changed(lambda n, row: row | {"yield_t_ha": mark} if n % 20 == 7 else row))
    assert mass_kg(document) == pytest.approx(0.95 * MASS_KG, rel=0.01)
    assert "unknown" in said


@pytest.mark.parametrize("mark", ["#N/A", "NoData", "---", "***", "<Null>"])
def test_words_for_no_value_leave_the_row_its_place(mark: str, capsys: pytest.CaptureFixture[str]) -> None:
    document, said = mapped(capsys, changed(lambda n, row: row | {"yield_t_ha": mark} if n % 20 == 7 else row))
    assert document["sources"][0]["points"] == PASSES * PASS_S
    assert "left out" not in said
    assert mass_kg(document) == pytest.approx(0.95 * MASS_KG, rel=0.01)


@pytest.mark.parametrize("mark", ["NULL", "", "-1.5"])
def test_ground_without_a_yield_is_cut_and_said(mark: str, capsys: pytest.CaptureFixture[str]) -> None:
    """A row without a yield between others ended its pass: a third of the grain was left out as of short passes."""
    document, said = mapped(capsys, changed(lambda n, row: row | {"yield_t_ha": mark} if n % 10 in (4, 7) else row))
    assert mass_kg(document) == pytest.approx(0.8 * MASS_KG, rel=0.01)
    assert "192 rows of passes without a flow, 20 % of the ground: their grain is not in the mass" in said
    assert document["area_ha"] * 1e4 == pytest.approx(AREA_M2, rel=0.01)
    assert document["yield_t_ha"] == pytest.approx(YIELD_T_HA, rel=0.02)
    assert "short pass" not in document["mass_kg"]["left_out_by_reason"]


@pytest.mark.parametrize("width", ["0", "-9999", "", "655.35"])
def test_grain_of_rows_without_a_width_is_named(width: str, capsys: pytest.CaptureFixture[str]) -> None:
    document, said = mapped(capsys, changed(lambda n, row: row | {"width_m": width} if n % 20 == 7 else row))
    assert mass_kg(document) == pytest.approx(0.95 * MASS_KG, rel=0.01)
    assert "48 rows with a yield and no width or distance: their grain is not counted" in said
    assert "flow_kg_s" not in said


@pytest.mark.parametrize("place", [{"longitude": 0, "latitude": 0}, {"longitude": "", "latitude": ""}, {"longitude": 11.01}])
def test_a_wrong_place_costs_no_grain(place: Row, capsys: pytest.CaptureFixture[str]) -> None:
    table = changed(lambda n, row: row | place if n % 37 == 17 else row)
    document, _ = mapped(capsys, table, words=("--without", "local outlier"))
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.01)
    assert document["area_ha"] * 1e4 == pytest.approx(AREA_M2, rel=0.06)
    assert document["yield_t_ha"] == pytest.approx(YIELD_T_HA, rel=0.02)


def test_rows_that_were_taken_out_do_not_change_the_clock(capsys: pytest.CaptureFixture[str]) -> None:
    def flowing(row: Row) -> Row:
        return row | {"flow_kg_s": row["yield_t_ha"] / 10 * SPEED_M_S * WIDTH_M}

    table = [flowing(row) for n, row in enumerate(with_distance(rows(speeds=False))) if n % 20 != 7]
    document, said = mapped(capsys, [{k: v for k, v in row.items() if k != "yield_t_ha"} for row in table])
    assert "evened out" not in said
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.01)
    assert document["yield_t_ha"] == pytest.approx(YIELD_T_HA, rel=0.015)


@pytest.mark.parametrize("times", [0.5, 2.0, 3600.0])
def test_a_flow_that_contradicts_the_yield_is_named(times: float, capsys: pytest.CaptureFixture[str]) -> None:
    def row_of(_: int, row: Row) -> Row:
        return row | {"flow_kg_s": times * row["yield_t_ha"] / 10 * SPEED_M_S * WIDTH_M / (1.0 if times < 9 else 3600.0 / 1.4)}

    _, said = mapped(capsys, changed(row_of))
    assert "times the flow that its yield gives; the flow is used; expected another unit" in said


def test_grain_as_weighed_comes_before_dried_grain(capsys: pytest.CaptureFixture[str]) -> None:
    def row_of(_: int, row: Row) -> Row:
        wet = row.pop("yield_t_ha")
        return row | {"Yield (t/ha)": 0.9 * wet, "Dry Yield (t/ha)": 0.8 * wet, "Wet Yield (t/ha)": wet}

    document, said = mapped(capsys, changed(row_of))
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.01)
    assert "dried" not in said


def test_a_hybrid_s_bushel_is_not_needed_beside_a_mass(capsys: pytest.CaptureFixture[str]) -> None:
    def row_of(_: int, row: Row) -> Row:
        pounds = row.pop("yield_t_ha") * 1000 / 0.45359237 * 0.40468564224
        return row | {"Yld Vol(Dry)(bu/ac)": pounds / 56, "Yld Mass(Dry)(lb/ac)": pounds, "Product": "P1366"}

    document, said = mapped(capsys, changed(row_of))
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.01)
    assert "Yld Mass(Dry)(lb/ac) is of dried grain" in said


@pytest.mark.parametrize(
    ("clock", "off"),
    [
        (lambda s: s + 7200.0, "7200"),
        (lambda s: s % 86400.0, r"-\d{9,}"),
        (lambda s: s + 18.0, "18"),
        (lambda s: s - 0.3, "-0.3"),
    ],
    ids=["hours", "no date", "leap seconds", "tenths"],
)
def test_a_copy_by_another_clock_counts_once(
    clock: Callable[[float], float], off: str, capsys: pytest.CaptureFixture[str]
) -> None:
    document, said = mapped(capsys, rows(), changed(lambda _, row: row | {"time": clock(row["time"])})[200:])
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.01)
    assert document["yield_t_ha"] == pytest.approx(YIELD_T_HA, rel=0.02)
    assert re.search(rf"also in h0\.csv by a clock that is {off} s off", said)


def test_the_next_year_on_the_same_tracks_is_no_copy(capsys: pytest.CaptureFixture[str]) -> None:
    year = changed(lambda n, row: row | {"time": row["time"] + 3.2e7 + 0.05 * n})
    document, _ = mapped(capsys, rows(), year)
    assert mass_kg(document) == pytest.approx(2 * MASS_KG, rel=0.07)


def test_times_of_the_day_in_no_order_go_on_over_midnight(capsys: pytest.CaptureFixture[str]) -> None:
    table = [row | {"time": row["time"] % 86400.0} for row in rows(start_s=86400.0 * 19000 - 500.0)]
    order = np.random.default_rng(5).permutation(len(table))
    document, said = mapped(capsys, [table[n] for n in order.tolist()])
    assert "the rows are in no order: the clock is taken to go on over midnight" in said
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.01)
    assert document["area_ha"] * 1e4 == pytest.approx(AREA_M2, rel=0.01)


@pytest.mark.parametrize("swapped", [True, False])
def test_exchanged_longitude_and_latitude_are_named(swapped: bool, capsys: pytest.CaptureFixture[str]) -> None:
    def headland(_: int, row: Row) -> Row:
        """The same ways, to the east and the west."""
        north, east = row["latitude"] - 48.0, (row["longitude"] - 11.0) * np.cos(np.radians(48.0))
        return row | {"time": row["time"] + 3600.0, "longitude": 11.0 + north / np.cos(np.radians(48.0)), "latitude": 47.9 + east}

    table = with_distance(rows(speeds=False)) + changed(headland, with_distance(rows(speeds=False)))
    if swapped:
        table = [row | {"longitude": row["latitude"], "latitude": row["longitude"]} for row in table]
    _, said = mapped(capsys, table)
    assert ("longitude and latitude seem exchanged" in said) == swapped


@pytest.mark.parametrize("scale", [1e3, 1e6, 1e9])
def test_unix_time_in_parts_of_a_second(scale: float, capsys: pytest.CaptureFixture[str]) -> None:
    document, _ = mapped(capsys, changed(lambda _, row: row | {"time": int(row["time"] * scale)}))
    assert mass_kg(document) == pytest.approx(MASS_KG, rel=0.01)


@pytest.mark.parametrize(
    "states", [("Abaixada", "Levantada"), ("Baissée", "Relevée"), ("engaged", "disengaged"), ("WAHR", "FALSCH")]
)
def test_states_of_a_header_in_other_words(states: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    table = changed(lambda n, row: row | {"header": states[n >= PASS_S]})
    document, said = mapped(capsys, table)
    assert "neither on nor off" not in said
    assert document["area_ha"] * 1e4 == pytest.approx(AREA_M2 / PASSES, rel=0.02)

"""Records from files that anybody may have made: one line for what no second has, never a traceback."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest

from tests.service.test_store import second
from yieldmon.cli.main import main
from yieldmon.errors import InputError
from yieldmon.service.logs import recorded
from yieldmon.service.storage.batch import Batch, Load
from yieldmon.service.storage.store import Store

GOOD = dataclasses.asdict(second(1, latitude_deg=50.0, longitude_deg=9.0, ground_speed_m_s=1.5, mass_flow_kg_s=10.0))
STRANGE = [
    ("time_s", float("inf")), ("time_s", 1e300), ("duration_s", 0.0), ("duration_s", float("nan")), ("mass_kg", float("inf")),
    ("latitude_deg", 1000.0), ("longitude_deg", -181.0), ("total_kg", float("nan")), ("load_number", 10**30), ("quality", 10**9),
]  # fmt: skip


@pytest.mark.parametrize(("name", "value"), STRANGE, ids=[f"{name} {value:g}" for name, value in STRANGE])
@pytest.mark.parametrize("out", ["x.zip", "x.geojson", "x.txt", "x.csv"])
def test_a_number_that_no_second_has_is_one_line(tmp_path: Path, capsys, name, value, out):
    path = tmp_path / "r.jsonl"
    path.write_text(json.dumps(GOOD | {name: value}) + "\n")
    words = [] if out == "x.csv" else ["--swath", "6", "--flow-delay", "0", "--start-delay", "0", "--end-delay", "0"]
    assert main(["export", str(path), "--out", str(tmp_path / out), *words]) == 2
    said = capsys.readouterr().err
    assert f"line 1: {name}" in said
    assert said.count("\n") == 1
    assert not (tmp_path / out).exists()


@pytest.mark.parametrize("line", ["[" * 100_000, '{"a":' * 100_000, "1e999", "null", '"x"'])
def test_json_that_is_no_record_is_one_line(tmp_path: Path, line):
    path = tmp_path / "r.jsonl"
    path.write_text(line + "\n")
    with pytest.raises(InputError):
        recorded.read_seconds(path)


@pytest.mark.parametrize(("time_s", "date"), [(5.0, "1970-01-01T00:00:05Z"), (5.99e9, "2159-10-2")])
def test_task_data_of_a_time_that_it_has_no_room_for_is_one_line(tmp_path: Path, capsys, time_s, date):
    path = tmp_path / "r.jsonl"
    path.write_text(json.dumps(GOOD | {"time_s": time_s}) + "\n")
    words = ["--swath", "6", "--flow-delay", "0", "--start-delay", "0", "--end-delay", "0"]
    assert main(["export", str(path), "--out", str(tmp_path / "x.zip"), *words]) == 2
    said = capsys.readouterr().err
    assert f"task data cannot hold a point of {date}" in said
    assert ".geojson" in said
    assert said.count("\n") == 1


def test_a_store_is_read_whole_by_a_link_while_it_is_written(tmp_path: Path):
    path, link = tmp_path / "s.sqlite", tmp_path / "elsewhere" / "link.sqlite"
    link.parent.mkdir()
    link.symlink_to(path)
    with Store(path) as store:
        for number in range(1, 4):
            store.commit([Batch(number, 1.0, {}, (second(number),))])
            assert [row.number for row in recorded.read_seconds(link)] == list(range(1, number + 1))


def test_names_of_loads_are_no_formulas_and_no_commands_to_a_terminal(tmp_path: Path):
    path, out = tmp_path / "s.sqlite", tmp_path / "loads.csv"
    with Store(path) as store:
        store.commit([Batch(1, 1.0, {}, loads=(Load(1, "=cmd|' /C calc'!A0", "corn\x1b[2J", 1.0, None, 10.0, None),))])
    assert main(["export", str(path), "--what", "loads", "--out", str(out)]) == 0
    text = out.read_text()
    assert "'=cmd" in text
    assert "\x1b" not in text


def test_damaged_seconds_are_left_out_and_reported(tmp_path: Path, caplog):
    import sqlite3

    path = tmp_path / "s.sqlite"
    with Store(path) as store:
        store.commit([Batch(n, 1.0, {}, seconds=(second(n),)) for n in range(1, 6)])
    database = sqlite3.connect(path)
    database.execute("UPDATE second SET mass_kg = 7.0 WHERE number = 3")
    database.commit()
    database.close()
    assert [row.number for row in recorded.read_seconds(path)] == [1, 2, 4, 5]
    assert "1 second damaged and left out (number 3)" in caplog.text

"""What is read of datasets: the report, the comparison, and both from an object store."""

from __future__ import annotations

import errno
import json
import re
import shutil
import socket
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.fleet import logs
from tests.fleet.sealing import seal
from tests.schema_check import problems
from yieldmon import __version__
from yieldmon.cli.main import main
from yieldmon.files.parameter_file import load as load_parameters
from yieldmon.files.parameter_file import save as save_parameters
from yieldmon.fleet.comparison import compare
from yieldmon.fleet.dataset_files import MARK
from yieldmon.fleet.html import page
from yieldmon.fleet.prior import crop_prior
from yieldmon.fleet.summary import summarise
from yieldmon.resources import shipped

PARAMETERS = """\
format: 1
version: 2
friction: 0.25
density: 1090.0
shape_ratio: 2.0
restitution: 0.55
"""


def measure(source: Path, out: str, *options: str) -> int:
    return main(["fleet", "run", str(source), "--out", out, "--workers", "0", *options])


@pytest.fixture(scope="module")
def season(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("season")
    source = logs.tree(folder / "tree")
    (source / "m0" / "2026-10-01" / "tickets.csv").write_text("load,weighed_kg\na.log,80\n")
    (source / "m1" / "2026-10-02" / "broken.log").write_text("<script>\n")
    (folder / "p.yaml").write_text(PARAMETERS)
    assert measure(source, str(folder / "first")) == 1
    assert measure(source, str(folder / "second"), "--params", str(folder / "p.yaml")) == 1
    return folder


@pytest.mark.parametrize(
    ("name", "first", "last", "change_pct", "shown"),
    [
        ("friction", 0.2, 0.25, 25.0, "+25.00 %"),
        ("restitution", 0.5, 0.53, 2.0, "+2.00 %"),
        ("restitution", 0.0, 0.015, 1.5, "+1.50 %"),
        ("plate_friction", 0.02, 0.15, None, "0.15 ± 0.03"),
        ("zero_offset", -1.0, 0.5, None, "0.5 ± 0.03"),
    ],
)
def test_drift_is_relative_to_what_the_force_follows_and_of_effects_their_size(
    name: str, first: float, last: float, change_pct: float | None, shown: str, season: Path, tmp_path: Path
) -> None:
    data = tmp_path / "data"
    shutil.copytree(season / "first", data)
    for day, value in (("2026-10-01", first), ("2026-10-02", last)):
        table = data / "machine=m0" / f"day={day}" / "parameters.parquet"
        row = {"time_s": 0.0, "version": 2, "origin": "sweep", "reason": "", "name": name, "value": value, "std_dev": 0.03}
        kept = [entry for entry in pq.read_table(table).to_pylist() if entry["name"] != name]
        pq.write_table(pa.Table.from_pylist([*kept, row], schema=pq.read_schema(table)), table)
        seal(table.parent)
    summary = summarise(str(data))
    [machine] = [m for m in summary["machines"] if m["machine"] == "m0"]
    drift = machine["parameters"][name]
    assert (drift["first"], drift["last"]) == (first, last)
    assert drift["change_pct"] == (None if change_pct is None else pytest.approx(change_pct))
    assert shown in page(summary)


def test_names_that_differ_at_their_end_only(season: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = tmp_path / "data"
    shutil.copytree(season / "first", data)
    for old, new in (("m0", "New Holland CR 7.90"), ("m1", "New Holland CR 7.80")):
        (data / f"machine={old}").rename(data / f"machine={new.replace(' ', '%20')}")
    assert main(["fleet", "report", str(data)]) == 0
    shown = capsys.readouterr().out.splitlines()
    assert [line[:20] for line in shown[1:3]] == ["New Holland CR 7.80 ", "New Holland CR 7.90 "]
    assert len({len(line) for line in shown[:3]}) == 1


def test_report(season: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fleet", "report", str(season / "first"), "--json", "--html", str(tmp_path / "r.html")]) == 0
    found = json.loads(capsys.readouterr().out)
    assert problems(found, "fleet-report") == []
    assert [(m["machine"], m["days"]) for m in found["machines"]] == [("m0", 2), ("m1", 2)]
    assert found["totals"]["machine_days"] == 4
    assert found["totals"]["mass_kg"] == pytest.approx(sum(day["mass_kg"] for day in found["days"]))
    [ticket] = found["tickets"]
    assert ticket["error_pct"] == pytest.approx(100.0 * (ticket["measured_kg"] / 80.0 - 1.0))
    assert found["machines"][0]["tickets"]["count"] == 1
    assert found["machines"][0]["parameters"]["friction"]["change_pct"] == 0.0
    assert [item["where"] for item in found["poisoned"]] == ["broken.log"]
    text = (tmp_path / "r.html").read_text()
    assert "<script>" not in text
    assert "http" not in text
    assert "2026-10-02" in text
    assert "@media print{.scroll{max-height:none;" in text


def test_days_of_one_machine_measured_with_other_parameters_are_named_and_not_called_drift(
    season: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As after a run with new parameters that was interrupted."""
    mixed, day = tmp_path / "mixed", "machine=m0/day=2026-10-02"
    shutil.copytree(season / "first", mixed)
    shutil.rmtree(mixed / day)
    shutil.copytree(season / "second" / day, mixed / day)
    assert main(["fleet", "report", str(mixed), "--json", "--html", str(tmp_path / "r.html")]) == 0
    printed = capsys.readouterr()
    found = json.loads(printed.out)
    assert problems(found, "fleet-report") == []
    [doubtful] = [item for item in found["doubtful"] if "other parameters" in item["problem"]]
    assert (doubtful["machine"], doubtful["day"]) == ("m0", "2026-10-02")
    assert doubtful["problem"].startswith("this day was measured with other parameters or settings than 2026-10-01")
    parameters = {machine["machine"]: machine["parameters"] for machine in found["machines"]}
    assert parameters["m0"]["friction"]["first"] != parameters["m0"]["friction"]["last"]
    assert parameters["m0"]["friction"]["change_pct"] is None
    assert parameters["m1"]["friction"]["change_pct"] == 0.0
    assert main(["fleet", "report", str(mixed)]) == 0
    assert [line.split()[-1] for line in capsys.readouterr().out.splitlines()[1:3]] == ["-", "+0.00"]
    assert "2 configurations" in (tmp_path / "r.html").read_text()


def test_tickets_of_a_machine_that_are_all_far_from_what_was_measured_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Kilograms in a column of tonnes gave a mean error of -99.9 %, without a word."""
    for machine, table in (("kg", "load,weighed_t\na.log,20\n"), ("t", "load,weighed_t\na.log,0.02\n")):
        logs.write(tmp_path / "tree" / machine / "d" / "a.log", 60.0 if machine == "t" else 61.0)
        (tmp_path / "tree" / machine / "d" / "tickets.csv").write_text(table)
    assert measure(tmp_path / "tree", str(tmp_path / "out")) == 0
    capsys.readouterr()
    assert main(["fleet", "report", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr()
    slip = "as if kilograms were taken for tonnes"
    said = rf"doubtful: kg d: the machine's tickets weigh \d+ times what was measured, {slip}\n"
    assert re.fullmatch(said, printed.err)
    assert "2 machines, 2 days, " in printed.out


def test_report_names_damaged_logs_and_those_counted_twice(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, out = tmp_path / "tree", str(tmp_path / "out")
    whole = logs.text(60.0)
    for name, text in (("m0/d1/a.log", whole), ("m2/d2/b c.log", whole), ("m1/d1/a.log", whole.replace("\n", "\ngarbage\n", 1))):
        path = source / name
        path.parent.mkdir(parents=True)
        path.write_text(text)
    assert measure(source, out) == 0
    capsys.readouterr()
    assert main(["fleet", "report", out, "--html", str(tmp_path / "r.html")]) == 0
    said = capsys.readouterr().err.splitlines()
    assert said == [
        "doubtful: m1 d1: damaged: a.log:2: 'garbage' is not a candump line",
        "doubtful: m2 d2: b c.log holds the same as m0 d1 a.log; the sums leave it out",
    ]
    text = (tmp_path / "r.html").read_text()
    assert all(line.partition(" ")[2].replace("'", "&#x27;") in text for line in said)


def test_report_names_logs_of_a_machine_that_overlap(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A packed log beside its text, and the end of a log in another day's folder; none of logs that follow each other, in
    whatever order, or of another machine."""
    source, out, at = tmp_path / "tree", str(tmp_path / "out"), logs.START_S
    a = logs.write(source / "m0/d1/a.log", 60.0, at)
    assert main(["pack", str(a), "--out", str(a.with_suffix(".parquet"))]) == 0
    lines = logs.write(source / "m1/d1/a.log", 65.0, at).read_text().splitlines(keepends=True)
    (source / "m1/d2").mkdir()
    (source / "m1/d2/b.log").write_text("".join(lines[len(lines) // 3 :]))
    for name, place in (("10.log", 100.0), ("9.log", 0.0)):
        logs.write(source / "m2/d1" / name, 55.0, at + place)
    assert measure(source, out) == 0
    capsys.readouterr()
    assert main(["fleet", "report", out, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert problems(found, "fleet-report") == []
    masses = {(day["machine"], day["day"]): day["mass_kg"] for day in found["days"]}
    packed, later = found["doubtful"]
    assert re.search(r"a\.parquet: up to \S+ it holds the frames of a\.log again \(\+0 ms\); left out", packed["problem"])
    why = "as of a second recorder, another machine, or a clock that was set back"
    assert later["problem"].endswith(f"at times that d1 a.log has too, {why}; the sums leave them out")
    twice = {(day["machine"], day["day"]): day["counted_again_kg"] for day in found["days"]}
    # Forces of 60 and 65 mV for as long: once each.
    assert masses["m0", "d1"] == pytest.approx(masses["m1", "d1"] * 60.0 / 65.0, rel=0.02)
    assert twice["m0", "d1"] == 0.0
    assert masses["m1", "d2"] == pytest.approx(0.0, abs=1e-9) != twice["m1", "d2"]
    assert twice["m1", "d1"] == twice["m2", "d1"] == 0.0
    for machine in found["machines"]:
        assert machine["mass_kg"] == sum(mass for (name, _), mass in masses.items() if name == machine["machine"])
    assert found["totals"]["mass_kg"] == pytest.approx(sum(masses.values()))
    assert found["totals"]["counted_again_kg"] == pytest.approx(sum(twice.values()))
    assert (later["machine"], later["day"]) == ("m1", "d2")
    assert "b.log has" in later["problem"]
    assert "at times that d1 a.log has too" in later["problem"]


def test_report_names_logs_with_the_samples_of_another_at_other_times(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """By a recorder whose clock is five and a half hours ahead, and converted to times from the log's begin; not of a log that
    only resembles another."""
    source, out = tmp_path / "tree", str(tmp_path / "out")
    text = logs.write(source / "m0/d1/a.log", 60.0).read_text()
    for name, shift_s in (("d1/ahead.log", 19800.0), ("d2/from_begin.log", -logs.START_S)):
        (source / "m0" / name).parent.mkdir(exist_ok=True)
        shifted = re.sub(r"^\((\S+)\)", lambda found, s=shift_s: f"({float(found[1]) + s:.6f})", text, flags=re.MULTILINE)
        (source / "m0" / name).write_text(shifted)
    logs.write(source / "m0/d3/other.log", 60.0, logs.START_S + 1000.0)
    assert measure(source, out) == 0
    capsys.readouterr()
    assert main(["fleet", "report", out, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert problems(found, "fleet-report") == []
    assert [(item["day"], item["problem"]) for item in found["doubtful"]] == [
        ("d1", "ahead.log holds the samples of d1 a.log at other times; the sums leave it out"),
        ("d2", "from_begin.log holds the samples of d1 a.log at other times; the sums leave it out"),
    ]
    once, none, other = (day["mass_kg"] for day in found["days"])
    assert (none, other) == (pytest.approx(0.0, abs=1e-9), pytest.approx(once, rel=0.15))


def test_report_names_a_ticket_of_which_nothing_was_measured(tmp_path: Path) -> None:
    """As where all of its log repeats one before it; to the errors it counts as a loss of all."""
    day = tmp_path / "tree" / "m" / "2026-10-01"
    logs.write(day / "a.log")
    (day / "b.log").write_text("".join(logs.text().splitlines(keepends=True)[2000:]))
    (day / "tickets.csv").write_text("load,weighed_kg\na.log,20\nb.log,20\n")
    assert measure(tmp_path / "tree", str(tmp_path / "out")) == 0
    said = [item["problem"] for item in summarise(str(tmp_path / "out"))["doubtful"]]
    assert "the ticket of b.log weighs 20 kg, and nothing was measured" in said
    assert not any("a.log weighs" in text for text in said)


def test_a_large_error_keeps_its_column(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    day = tmp_path / "tree" / "m" / "2026-10-01"
    day.mkdir(parents=True)
    (day / "a.log").write_text(logs.text(grain_s=60.0))
    (day / "tickets.csv").write_text("load,weighed_kg\na.log,1\n")
    assert measure(tmp_path / "tree", str(tmp_path / "out")) == 0
    capsys.readouterr()
    assert main(["fleet", "report", str(tmp_path / "out")]) == 0
    heading, row = capsys.readouterr().out.splitlines()[:2]
    assert len(row.split()) == len(heading.replace(" %", "").split())


def test_report_names_days_without_a_zero(tmp_path: Path) -> None:
    source, out = tmp_path / "tree", str(tmp_path / "out")
    lines = logs.text(60.0).splitlines(keepends=True)
    (source / "m0/d1").mkdir(parents=True)
    (source / "m0/d1/in grain.log").write_text("".join(lines[len(lines) * 2 // 3 :]))
    assert measure(source, out) == 0
    found = summarise(out)
    [item] = found["doubtful"]
    assert item["problem"].startswith("no zero of the sensor is known, so none of the ")
    assert found["totals"]["mass_kg"] == 0.0


def with_faults(day: Path, rows: list[tuple[str, float, float | None]]) -> None:
    """A day of a dataset has these faults: code, begin, end."""
    table = [{"code": code, "begin_s": begin, "end_s": end, "detail": ""} for code, begin, end in rows]
    pq.write_table(pa.Table.from_pylist(table, schema=pq.read_schema(day / "faults.parquet")), day / "faults.parquet")
    seal(day)


def test_report_counts_faults(season: Path, tmp_path: Path) -> None:
    data = tmp_path / "data"
    shutil.copytree(season / "first", data)
    for day, codes in (
        ("machine=m0/day=2026-10-01", ("SensorStuck", "SensorStuck", "BusError")),
        ("machine=m0/day=2026-10-02", ("SensorStuck",)),
        ("machine=m1/day=2026-10-01", ("BusError",)),
        ("machine=m1/day=2026-10-02", ()),
    ):
        begins_s = pq.read_table(data / day / "records.parquet", columns=["time_s"])["time_s"][0].as_py()
        with_faults(data / day, [(code, begins_s + k, begins_s + k + 1.0) for k, code in enumerate(codes)])
    found = summarise(str(data))
    counted = {
        machine["machine"]: {code: (entry["count"], entry["days"]) for code, entry in machine["faults"].items()}
        for machine in found["machines"]
    }
    assert counted == {"m0": {"SensorStuck": (3, 2), "BusError": (1, 1)}, "m1": {"BusError": (1, 1)}}
    assert [day["faults"] for day in found["days"]] == [
        {"SensorStuck": 2, "BusError": 1},
        {"SensorStuck": 1},
        {"BusError": 1},
        {},
    ]


def test_a_fault_lasts_to_its_end_or_that_of_the_day(season: Path, tmp_path: Path) -> None:
    """Within the day's seconds, also where the clock was set back while it lasted."""
    data = tmp_path / "data"
    shutil.copytree(season / "first", data)
    day = data / "machine=m0" / "day=2026-10-01"
    record = pq.read_table(day / "records.parquet", columns=["time_s"])["time_s"].to_pylist()
    first, last, seconds = record[0], record[-1], len(record)
    faults = {
        "SensorStuck": (first + 2.0, first + 5.0, 3.0),
        "ZeroDrifted": (last - 9.0, None, 9.0),
        "ClockJumped": (last, first, 0.0),
        "BusError": (first, first + 7200.0, float(seconds)),
    }
    with_faults(day, [(code, begin, end) for code, (begin, end, _) in faults.items()])
    [found] = [m["faults"] for m in summarise(str(data))["machines"] if m["machine"] == "m0"]
    for code, (_, _, lasted) in faults.items():
        assert found[code]["seconds"] == pytest.approx(lasted, abs=1.0), code


@pytest.mark.parametrize(
    ("start_s", "expected"),
    [(1_790_000_000.0, ["day10", "day9", "day8"]), (0.0, ["day8", "day9", "day10"])],
    ids=["by date", "by name where the clock has none"],
)
def test_days_are_in_the_order_of_time(
    tmp_path: Path, start_s: float, expected: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    for number, day in enumerate(("day10", "day9", "day8")):
        logs.write(tmp_path / "tree" / "m0" / day / "a.log", 50.0 + number, start_s + 1000.0 * number * (start_s > 0.0))
    assert measure(tmp_path / "tree", str(tmp_path / "out")) == 0
    capsys.readouterr()
    found = summarise(str(tmp_path / "out"))
    assert [day["day"] for day in found["days"]] == expected
    [machine] = found["machines"]
    assert (machine["first_day"], machine["last_day"]) == (expected[0], expected[-1])
    assert list(machine["parameters"]["friction"]["by_day"]) == expected


def test_a_clock_that_is_off_by_years_is_named_and_orders_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As receivers say after 1024 weeks, or computers whose battery is empty."""
    first = 1790812800.0  # 2026-10-01
    weeks = 1024 * 7 * 86400.0
    starts = {"2026-10-01": first + 7200.0, "2026-10-02": first + 86400.0 - weeks, "20261003": first + 2 * 86400.0 - 7200.0}
    for number, (day, start_s) in enumerate(starts.items()):
        logs.write(tmp_path / "tree" / "m" / day / "a.log", 50.0 + number, start_s)
    logs.write(tmp_path / "tree" / "n" / "2026-10-01" / "a.log", 55.0, 50.0)
    assert measure(tmp_path / "tree", str(tmp_path / "out")) == 0
    found = summarise(str(tmp_path / "out"))
    assert [(item["day"], item["problem"]) for item in found["doubtful"]] == [
        ("2026-10-02", "a.log begins on 2007-02-16 by its clock")
    ]
    assert [day["day"] for day in found["days"]] == ["2026-10-01", "2026-10-02", "20261003", "2026-10-01"]


def test_any_log_of_a_day_whose_clock_is_off_by_years_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Only the first log of a day was looked at: one of another year, put into the wrong folder, counted without a word."""
    for number, years in enumerate((0, 2, 3)):
        start_s = logs.START_S + years * 365.25 * 86400.0
        logs.write(tmp_path / "tree" / "m" / "2026-10-01" / f"{number}.log", 50.0 + number, start_s)
    assert measure(tmp_path / "tree", str(tmp_path / "out")) == 0
    [doubtful] = summarise(str(tmp_path / "out"))["doubtful"]
    assert doubtful["problem"] == "1.log begins on 2028-09-30 by its clock (and 1 more off)"


def test_names_from_files_cannot_break_the_page(season: Path) -> None:
    summary = summarise(str(season / "first"))
    summary["dataset"] = "<img src=x>"
    assert "<img" not in page(summary)


def test_comparison(season: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = str(season / "first"), str(season / "second")
    assert main(["fleet", "compare", first, first]) == 0
    assert main(["fleet", "compare", first, second]) == 1
    capsys.readouterr()
    assert main(["fleet", "compare", first, second, "--json"]) == 1
    assert problems(json.loads(capsys.readouterr().out), "fleet-compare") == []
    capsys.readouterr()
    found = compare(first, second)
    assert found["equal"] == 0
    assert found["because"] == {"parameters_sha256": 4}
    for item in found["different"]:
        assert item["mass_kg"][0] > 0.0
        assert item["mass_change_pct"] == pytest.approx(100.0 * (item["mass_kg"][1] / item["mass_kg"][0] - 1.0))
        assert {"records", "parameters", "loads"} <= set(item["tables"])
        assert "mass_flow_kg_s" in item["columns"]
        assert "elevator_speed_rpm" not in item["columns"]


def test_parameters_of_another_crop_are_no_other_logs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of two versions of the parameters one names its crop, as a calibration does."""
    logs.tree(tmp_path / "tree", machines=1, days=1)
    known = load_parameters(shipped("config/parameters/corn.yaml"))
    save_parameters(replace(known, provenance={**known.provenance, "crop": "corn"}), tmp_path / "p.yaml")
    assert measure(tmp_path / "tree", str(tmp_path / "a"), "--crop", "wheat") == 0
    assert measure(tmp_path / "tree", str(tmp_path / "b"), "--params", str(tmp_path / "p.yaml"), "--crop", "wheat") == 0
    assert [summarise(str(tmp_path / out))["days"][0]["crop"] for out in "ab"] == ["wheat", "corn"]
    assert measure(tmp_path / "tree", str(tmp_path / "c")) == 0
    capsys.readouterr()
    main(["fleet", "compare", str(tmp_path / "c"), str(tmp_path / "b")])
    assert "logs" not in capsys.readouterr().out


def of_an_earlier_release(dataset: Path, day: Path) -> Path:
    """A copy of a dataset in which the records of one day lack a column, have one more, and one of another kind."""
    records = dataset / day / "records.parquet"
    table = pq.read_table(records).drop_columns(["shape_verdict"])
    place = table.column_names.index("quality")
    table = table.set_column(place, "quality", table["quality"].cast(pa.string()))
    pq.write_table(table.append_column("rows_before", table["number"]), records)
    provenance = dataset / day / "provenance.parquet"
    table = pq.read_table(provenance)
    place = table.column_names.index("software_version")
    pq.write_table(table.set_column(place, "software_version", pa.array(["0.0.1"] * table.num_rows)), provenance)
    software = json.loads((dataset / day / MARK).read_text())["software"]
    seal(dataset / day, software={**software, "version": "0.0.1"})
    return dataset


def test_days_of_an_earlier_release_are_read_beside_others(
    season: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As days that the source has no longer stay in a dataset."""
    day = sorted((season / "first").glob("machine=*/day=*"))[0].relative_to(season / "first")
    old = of_an_earlier_release(shutil.copytree(season / "first", tmp_path / "old"), day)
    capsys.readouterr()
    assert main(["fleet", "report", str(old)]) == 0
    [said] = [line for line in capsys.readouterr().err.splitlines() if "measured by" in line]
    assert said.startswith(f"doubtful: m0 2026-10-02: this day was measured by yieldmon {__version__} (")
    assert "2026-10-01 by 0.0.1 (" in said
    found = compare(str(old), str(season / "first"))
    assert problems(found, "fleet-compare") == []
    assert (found["equal"], len(found["different"])) == (3, 1)
    assert found["columns_only_in_first"] == {"rows_before": 1}
    assert found["columns_only_in_second"] == {"shape_verdict": 1}
    assert found["different"][0]["columns"] == {}
    capsys.readouterr()
    assert main(["fleet", "compare", str(old), str(season / "first")]) == 1
    assert f"columns of records only in {old}: rows_before" in capsys.readouterr().out.splitlines()


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A server that speaks S3, with an empty bucket."""
    moto = pytest.importorskip("moto.server")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    server = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=port)
    server.start()
    for name, value in (
        ("AWS_ENDPOINT_URL", f"http://127.0.0.1:{port}"),
        ("AWS_ACCESS_KEY_ID", "test"),
        ("AWS_SECRET_ACCESS_KEY", "test"),
        ("AWS_DEFAULT_REGION", "us-east-1"),
    ):
        monkeypatch.setenv(name, value)
    import s3fs

    s3fs.S3FileSystem.clear_instance_cache()
    s3fs.S3FileSystem().makedirs("fleet", exist_ok=True)
    yield "s3://fleet"
    s3fs.S3FileSystem.clear_instance_cache()
    server.stop()


def test_object_store(season: Path, bucket: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import s3fs

    files = s3fs.S3FileSystem()
    for path in sorted((season / "tree").rglob("*.*")):
        if path.is_file():
            files.put_file(str(path), f"fleet/logs/{path.relative_to(season / 'tree').as_posix()}")
    assert main(["fleet", "run", f"{bucket}/logs", "--out", f"{bucket}/season", "--workers", "0", "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert (document["done"], document["failed"]) == (4, 0)
    # Whatever a run that was killed has left between is gone with the next.
    files.pipe_file("fleet/season/machine=m0/day=2026-10-01/stray.parquet", b"half")
    files.rm_file("fleet/season/machine=m1/day=2026-10-01/_COMMITTED")
    assert main(["fleet", "run", f"{bucket}/logs", "--out", f"{bucket}/season", "--workers", "0", "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert (document["done"], document["skipped"]) == (1, 3)
    here = season / "first"
    there = {path.removeprefix("fleet/season/"): files.cat_file(path) for path in files.find("fleet/season")}
    assert there == {path.relative_to(here).as_posix(): path.read_bytes() for path in here.rglob("*") if path.is_file()}
    first, second = summarise(str(here)), summarise(f"{bucket}/season")
    assert {**first, "dataset": ""} == {**second, "dataset": ""}
    assert compare(str(here), f"{bucket}/season")["equal"] == 4


def test_a_storage_that_fails_is_one_line_with_its_address(
    season: Path, bucket: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import s3fs

    def busy(*_: object, **__: object) -> None:
        raise OSError(errno.EBUSY, "Reduce your request rate.")

    s3fs.S3FileSystem().put(str(season / "first"), "fleet/other", recursive=True)
    # As DuckDB reads, and as the marks are found.
    for owner, name in ((s3fs.core.S3File, "_fetch_range"), (s3fs.S3FileSystem(), "ls")):
        with monkeypatch.context() as patched:
            patched.setattr(owner, name, busy)
            assert main(["fleet", "report", f"{bucket}/other"]) == 1
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        assert said.startswith(f"yieldmon: {bucket}/other: ")
        assert "Reduce your request rate." in said
    assert main(["fleet", "report", f"{bucket}/other"]) == 0


@pytest.mark.parametrize("commits", [0, 2])
def test_a_storage_that_goes_away_leaves_its_days_to_the_next_run(
    commits: int, season: Path, bucket: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What cannot be reached is told in exceptions of the storage's own library, which are no errors of the system."""
    import botocore.exceptions
    import s3fs

    for path in (season / "tree").rglob("a.log"):
        s3fs.S3FileSystem().put_file(str(path), f"fleet/farm{commits}/logs/{path.relative_to(season / 'tree').as_posix()}")
    committed = 0
    real = s3fs.S3FileSystem._call_s3  # noqa: SLF001

    async def gone(self: object, method: str, *words: object, **named: object) -> object:
        nonlocal committed
        if commits <= committed:
            raise botocore.exceptions.EndpointConnectionError(endpoint_url="http://farm:9000")
        answer = await real(self, method, *words, **named)
        committed += method == "put_object" and str(named.get("Key", "")).endswith(MARK)
        return answer

    words = ["fleet", "run", f"{bucket}/farm{commits}/logs", "--out", f"{bucket}/farm{commits}/season", "--workers", "0"]
    with monkeypatch.context() as patched:
        patched.setattr(s3fs.S3FileSystem, "_call_s3", gone)
        assert main(words) == 1
    said = capsys.readouterr().err
    assert committed == commits
    assert "Traceback" not in said
    assert said.splitlines()[-1].startswith(f"yieldmon: {words[2]}, {words[4]}: EndpointConnectionError: ")
    s3fs.S3FileSystem.clear_instance_cache()
    assert main([*words, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["done"], document["skipped"], document["failed"]) == (4 - commits, commits, 0)


def test_prior_from_the_tickets_of_a_dataset(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for number, weighed in enumerate((20.0, 21.0, 22.0)):
        day = tmp_path / "tree" / f"m{number}" / "d"
        logs.write(day / "a.log", 60.0)
        (day / "tickets.csv").write_text(f"load,weighed_kg\na.log,{weighed}\n")
    dataset, out = str(tmp_path / "season"), tmp_path / "corn.yaml"
    assert measure(tmp_path / "tree", dataset, "--crop", "corn") == 0
    assert main(["fleet", "prior", dataset, "--crop", "corn", "--out", str(out), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert problems(found, "fleet-prior") == []
    assert {name: entry["loads"] for name, entry in found["machines"].items()} == {"m0": 1, "m1": 1, "m2": 1}
    # A machine that weighs heavier for the same force has denser grain or a smaller gain.
    shifts = [entry["density_pct"] - entry["gain_pct"] for entry in found["machines"].values()]
    assert shifts == sorted(shifts)
    assert found["parameters"]["density"]["standard_deviation"] > 0.0
    assert load_parameters(out).provenance["machines"] == "3"
    assert main(["fleet", "prior", dataset, "--crop", "wheat"]) == 2
    assert main(["fleet", "prior", dataset, "--crop", "grass"]) == 2


def test_a_machine_whose_two_tickets_contradict_each_other_is_named_and_no_prior(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of two tickets neither is known to be wrong, yet no grain has the density that both together ask for."""
    for number in range(5):
        day = tmp_path / "tree" / f"m{number}" / "d"
        for load, (mv, weighed) in enumerate(((45.0, 16.0), (120.0, 36.0 if number else 26.0))):
            logs.write(day / f"{load}.log", mv + number, logs.START_S + 100.0 * load)
            with (day / "tickets.csv").open("a") as table:
                table.write(("" if load else "load,weighed_kg\n") + f"{load}.log,{weighed}\n")
    dataset = str(tmp_path / "season")
    assert measure(tmp_path / "tree", dataset, "--crop", "corn") == 0
    found = crop_prior(dataset, "corn")
    assert [machine.name for machine in found.machines] == ["m1", "m2", "m3", "m4"]
    (said,) = found.left_out
    assert said.startswith("m0: its tickets contradict each other, as if a weight were wrong: they imply grain ")
    assert found.prior.parameter_set.standard_deviation("density") < 0.5 * found.prior.parameter_set.values["density"]


def test_a_prior_takes_trucks_of_two_combines_as_such(tmp_path: Path) -> None:
    for number in range(3):
        day = tmp_path / "tree" / f"m{number}" / "d"
        logs.write(day / "a.log", 60.0 + number)
        (day / "tickets.csv").write_text("load,weighed_kg,std_dev_kg,other_kg,other_std_dev_kg\na.log,31,0.3,10,0.4\n")
    assert measure(tmp_path / "tree", str(tmp_path / "season"), "--crop", "corn") == 0
    loads = [machine.loads[0] for machine in crop_prior(str(tmp_path / "season"), "corn").machines]
    assert {(load.weighed_kg, round(load.std_dev_kg, 9), round(load.common_kg, 9)) for load in loads} == {(21.0, 0.5, 0.4)}


def test_a_prior_takes_the_seconds_of_the_logs_that_a_ticket_covers_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whatever the logs are called, and whatever lies between them: a second recorder's logs, and those of another load."""
    found = {}
    for kind in ("whole", "parts"):
        for number, weighed in enumerate((100.0, 105.0, 110.0)):
            day = tmp_path / kind / f"m{number}" / "d"
            lines = logs.text(60.0 + number, grain_s=40.0).splitlines(keepends=True)
            logs.write(day / "other.log", 90.0, logs.START_S + 2000.0)
            half = len(lines) * 3 // 4
            parts = {"1.log": lines[half:], "2.log": lines[:half], "3.log": lines[half // 2 : half + 200]}
            for name, part in parts.items() if kind == "parts" else [("z.log", lines)]:
                (day / name).write_text("".join(part))
            (day / "tickets.csv").write_text(f"load,weighed_kg\n{'1-3' if kind == 'parts' else 'z'},{weighed}\n")
        dataset = str(tmp_path / f"{kind}-season")
        assert measure(tmp_path / kind, dataset, "--crop", "corn") == 0
        assert main(["fleet", "prior", dataset, "--crop", "corn", "--json"]) == 0
        document = json.loads(capsys.readouterr().out)
        assert document["left_out"] == []
        found[kind] = document["machines"]
    for name, entry in found["whole"].items():
        # Where a log ends and another of an earlier time follows, part of a second is lost.
        assert found["parts"][name]["gain_pct"] == pytest.approx(entry["gain_pct"], abs=3.0)


def test_a_ticket_of_a_renamed_machine_counts_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for number, weighed in enumerate((20.0, 21.0, 22.0)):
        day = tmp_path / "tree" / f"m{number}" / "d"
        logs.write(day / "a.log", 60.0 + number)
        (day / "tickets.csv").write_text(f"load,weighed_kg\na.log,{weighed}\n")
    dataset = str(tmp_path / "season")
    assert measure(tmp_path / "tree", dataset, "--crop", "corn") == 0
    assert main(["fleet", "prior", dataset, "--crop", "corn", "--json"]) == 0
    once = json.loads(capsys.readouterr().out)
    (tmp_path / "tree" / "m2").rename(tmp_path / "tree" / "renamed")
    assert measure(tmp_path / "tree", dataset, "--crop", "corn") == 0
    assert main(["fleet", "prior", dataset, "--crop", "corn", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["left_out"] == ["renamed d: a.log repeats m2 d: a.log, with the same logs and weight"]
    assert found | {"left_out": []} == once
    # Its slips in pounds, rounded to whole ones.
    (tmp_path / "tree" / "renamed").rename(tmp_path / "tree" / "pounds")
    (tmp_path / "tree" / "pounds" / "d" / "tickets.csv").write_text("load,weighed_t\na.log,0.02201\n")
    assert measure(tmp_path / "tree", dataset, "--crop", "corn") == 0
    assert main(["fleet", "prior", dataset, "--crop", "corn", "--json"]) == 0
    assert "pounds d: a.log repeats m2 d: a.log, with the same logs and weight" in json.loads(capsys.readouterr().out)["left_out"]


def test_a_load_on_two_rows_of_a_days_tickets_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Unless they are parts of it, which add up."""
    weighed = {"m0": "a.log,20,\na.log,20,\n", "m1": "a.log,8,1\na.log,13,2\n"}
    for machine, rows in weighed.items():
        day = tmp_path / "tree" / machine / "d"
        logs.write(day / "a.log", 60.0 + int(machine[1]))
        (day / "tickets.csv").write_text(f"load,weighed_kg,part\n{rows}")
    measure(tmp_path / "tree", str(tmp_path / "season"), "--crop", "corn")
    assert "tickets.csv: line 3, load: load a.log has a ticket already (line 2)" in capsys.readouterr().err
    assert main(["fleet", "report", str(tmp_path / "season"), "--json"]) in (0, 1)
    document = json.loads(capsys.readouterr().out)
    assert "tickets.csv: line 3, load: load a.log has a ticket already" in str(document)


def test_a_machine_without_a_ticket_that_can_be_used_does_not_stop_the_prior(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number, weighed in enumerate((20.0, 21.0, 22.0, 400.0)):
        day = tmp_path / "tree" / f"m{number}" / "d"
        logs.write(day / "a.log", 60.0)
        (day / "tickets.csv").write_text(f"load,weighed_kg\na.log,{weighed}\n")
    dataset = str(tmp_path / "season")
    assert measure(tmp_path / "tree", dataset, "--crop", "corn") == 0
    assert main(["fleet", "prior", dataset, "--crop", "corn", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert sorted(found["machines"]) == ["m0", "m1", "m2"]
    assert [reason.partition(": ")[0] for reason in found["left_out"]] == ["m3 d"]
    shutil.rmtree(tmp_path / "season" / "machine=m2")
    assert main(["fleet", "prior", dataset, "--crop", "corn"]) == 2
    said = capsys.readouterr().err
    assert "tickets of 2 machines for corn that can be used; left out: m3 d: " in said
    assert said.count("\n") == 1


def test_a_ticket_that_no_other_bears_out_is_named_and_no_prior(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of one machine with four tickets the third is ten times or twice too much."""
    for machine in range(4):
        for day in range(4):
            folder = tmp_path / "tree" / f"m{machine}" / f"d{day}"
            logs.write(folder / "a.log", 60.0 + 4.0 * machine + day)
            (folder / "tickets.csv").write_text(f"load,weighed_kg\na.log,{20 + machine + 0.1 * day}\n")
    dataset = str(tmp_path / "season")
    assert measure(tmp_path / "tree", dataset, "--crop", "corn") == 0
    assert main(["fleet", "prior", dataset, "--crop", "corn", "--json"]) == 0
    right = json.loads(capsys.readouterr().out)
    assert right["left_out"] == []
    for times in (2, 4):
        (tmp_path / "tree" / "m1" / "d2" / "tickets.csv").write_text(f"load,weighed_kg\na.log,{times * 21.2}\n")
        assert measure(tmp_path / "tree", dataset, "--crop", "corn") == 0
        capsys.readouterr()
        assert main(["fleet", "prior", dataset, "--crop", "corn", "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert [reason.partition(" weighs")[0] for reason in found["left_out"]] == ["m1 d2: a.log"]
        assert found["machines"]["m1"]["loads"] == 3
        assert found["parameters"]["density"]["value"] == pytest.approx(right["parameters"]["density"]["value"], rel=0.01)
        doubtful = [entry for entry in summarise(dataset)["doubtful"] if "ticket" in entry["problem"]]
        assert [(entry["machine"], entry["day"]) for entry in doubtful] == [("m1", "d2")]
        assert f"weighs {times * 21.2:.0f} kg, " in doubtful[0]["problem"]


def test_a_machine_that_weighs_in_pounds_is_named_and_a_crop_is_one_under_all_its_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = ["machine,day,log,tickets,crop"]
    for machine, crop in enumerate(("corn", "Mais", "Corn", "maize", "körnermais", "mais")):
        logs.write(tmp_path / f"{machine}.log", 60.0 + 2.0 * machine)
        weighed = (20.0 + 0.8 * machine) * (2.2046 if machine == 3 else 1.0)
        (tmp_path / f"{machine}.csv").write_text(f"load,weighed_kg\n1,{weighed}\n")
        rows.append(f"m{machine},d,{machine}.log,{machine}.csv,{crop}")
    manifest, dataset = tmp_path / "manifest.csv", str(tmp_path / "season")
    manifest.write_text("\n".join(rows).replace("maize", "cron") + "\n")
    assert measure(manifest, dataset) == 2
    assert f"{manifest}: line 5, crop: is 'cron'; expected corn" in capsys.readouterr().err
    manifest.write_text("\n".join(rows) + "\n")
    assert measure(manifest, dataset, "--crop", "cron") == 2
    assert measure(manifest, dataset) == 0
    capsys.readouterr()
    assert main(["fleet", "prior", dataset, "--crop", "Körnermais", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [*found["machines"]] == ["m0", "m1", "m2", "m4", "m5"]
    (said,) = found["left_out"]
    assert said.startswith("m3: its tickets weigh 2.")
    assert said.endswith(", as if pounds were taken for kilograms")
    assert main(["fleet", "prior", dataset, "--crop", "wheat"]) == 2
    assert "0 machines for wheat; its tickets are for corn; expected" in capsys.readouterr().err


def test_tickets_of_days_without_a_crop_are_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for machine in range(3):
        day = tmp_path / "tree" / f"m{machine}" / "d"
        logs.write(day / "a.log", 60.0 + machine)
        (day / "tickets.csv").write_text("load,weighed_kg\na.log,20\n")
    dataset = str(tmp_path / "season")
    assert measure(tmp_path / "tree", dataset) == 0
    capsys.readouterr()
    assert main(["fleet", "prior", dataset, "--crop", "corn"]) == 2
    said = capsys.readouterr().err
    assert "3 tickets of days without a crop; expected at least 3, or `fleet run --crop`" in said
    assert said.count("\n") == 1

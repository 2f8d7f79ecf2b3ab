"""`yieldmon fleet run`: the same results as `process`, each partition whole and once, whatever happens to logs and runs."""

from __future__ import annotations

import gzip
import itertools
import json
import multiprocessing
import random
import re
import shutil
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.fleet import logs
from tests.fleet.logs import dataset_files
from tests.fleet.runs import LOADED, tasks
from yieldmon.cli.main import main
from yieldmon.errors import InputError
from yieldmon.fleet import manifest
from yieldmon.fleet.dataset import Dataset, Superseded
from yieldmon.fleet.dataset_files import MARK
from yieldmon.fleet.identity import parameters_sha256, software
from yieldmon.fleet.worker import DONE, LEFT, SKIPPED, Outcome, Task, work


def test_command_measures_and_skips(tree: Path, measured: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for done, skipped in ((4, 0), (0, 4)):
        assert main(["fleet", "run", str(tree), "--out", str(tmp_path / "out"), "--workers", "0", "--json"]) == 0
        printed = capsys.readouterr()
        document = json.loads(printed.out)
        assert (document["done"], document["skipped"], document["failed"]) == (done, skipped, 0)
        assert "dashboard: http://" in printed.err
    made, same = dataset_files(tmp_path / "out"), dataset_files(measured)
    assert {name: made[name] for name in made} == {name: same[name] for name in same if name != "_run"}


def test_workers_that_do_not_start_are_one_line(tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").touch()
    import dask

    with dask.config.set({"temporary_directory": str(tmp_path / "file" / "folder")}):
        assert main(["fleet", "run", str(tree), "--out", str(tmp_path / "out"), "--workers", "0"]) == 1
    said = capsys.readouterr().err
    assert said.startswith("yieldmon: the workers do not start: ")
    assert "Not a directory" in said
    assert said.count("\n") == 1


def test_records_are_those_of_process(tree: Path, measured: Path, tmp_path: Path) -> None:
    log, out = tree / "m1" / "2026-10-02" / "a.log", tmp_path / "rows.parquet"
    assert main(["process", str(log), "--out", str(out), "--jobs", "1"]) == 0
    assert out.read_bytes() == (measured / "machine=m1" / "day=2026-10-02" / "records.parquet").read_bytes()


@pytest.mark.parametrize("what", ["log", "parameters", "software"])
def test_what_changed_is_measured_again(tree: Path, measured: Path, tmp_path: Path, what: str) -> None:
    source, out = shutil.copytree(tree, tmp_path / "tree"), shutil.copytree(measured, tmp_path / "out")
    first, second, *_ = tasks(source, out)
    assert work(first).status == SKIPPED
    if what == "log":
        path = Path(first.partition.logs[0])
        content = path.read_bytes()
        path.write_bytes(content[:-2] + (b"0\n" if content[-2:-1] != b"0" else b"1\n"))
        assert path.stat().st_size == len(content)
    elif what == "parameters":
        values = {**LOADED.parameters.values, "friction": 0.3}
        changed = replace(LOADED, parameters=replace(LOADED.parameters, values=values))
        first = replace(first, configured=changed, parameters_sha256=parameters_sha256(changed))
    else:
        # A worker elsewhere whose software is another is no worker of this run.
        first = replace(first, software=replace(software(), source_sha256="0" * 64))
    outcome = work(first)
    assert outcome.status == (LEFT if what == "software" else DONE)
    assert work(second).status == SKIPPED
    before, after = ({n: b for n, b in dataset_files(d).items() if n.startswith(first.partition.name)} for d in (measured, out))
    assert (before == after) is (what == "software")


def test_poisoned_logs_are_named_and_the_rest_goes_on(
    tree: Path, measured: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, out = shutil.copytree(tree, tmp_path / "tree"), tmp_path / "out"
    (source / "m0" / "2026-10-01" / "b.log").write_text("nonsense\n")
    (source / "m1" / "2026-10-01" / "a.log").write_bytes(b"")
    for _ in range(2):
        assert main(["fleet", "run", str(source), "--out", str(out), "--workers", "0", "--json"]) == 1
        document = json.loads(capsys.readouterr().out)
        assert document["failed"] == 1
        assert {(item["partition"], item["where"]) for item in document["poisoned"]} == {
            ("machine=m0/day=2026-10-01", "b.log"), ("machine=m1/day=2026-10-01", "machine=m1/day=2026-10-01"),
        }  # fmt: skip
    made, same = dataset_files(out), dataset_files(measured)
    for name in ("machine=m0/day=2026-10-01/records.parquet", "machine=m0/day=2026-10-02/loads.parquet"):
        assert made[name] == same[name]
    assert not (out / "machine=m1" / "day=2026-10-01").exists()
    failure = json.loads(made["_failed/machine=m1/day=2026-10-01.json"])
    assert failure["machine"] == "m1"
    assert "a.log" in failure["problem"]
    assert str(tmp_path) not in failure["problem"]
    logs.write(source / "m1" / "2026-10-01" / "a.log", 70.0)
    (source / "m0" / "2026-10-01" / "b.log").unlink()
    assert main(["fleet", "run", str(source), "--out", str(out), "--workers", "0"]) == 0
    assert dataset_files(out) == {name: content for name, content in same.items() if name != "_run"}


def test_remains_of_killed_runs_go(tree: Path, measured: Path, tmp_path: Path) -> None:
    out = shutil.copytree(measured, tmp_path / "out")
    whole = dataset_files(measured)
    (out / "_temporary" / "x").mkdir(parents=True)
    (out / "_temporary" / "x" / "records.parquet").write_bytes(b"half")
    (out / "machine=m0" / "day=2026-10-01" / "records-1.parquet").write_bytes(b"stray")
    (out / "machine=m0" / "day=2026-10-02" / MARK).unlink()
    (out / "machine=m7" / "day=1").mkdir(parents=True)
    (out / "machine=m7" / "day=1" / "loads.parquet").write_bytes(b"half")
    assert [work(task).status for task in tasks(tree, out)] == [SKIPPED, DONE, SKIPPED, SKIPPED]
    Dataset(str(out)).end((out / "_run").read_text())
    assert dataset_files(out) == {name: content for name, content in whole.items() if name != "_run"}


def test_a_run_that_was_taken_over_writes_nothing(tree: Path, tmp_path: Path) -> None:
    old, *_ = tasks(tree, tmp_path / "out")
    Dataset(str(tmp_path / "out")).begin()
    before = dataset_files(tmp_path / "out")
    with pytest.raises(Superseded):
        work(old)
    assert dataset_files(tmp_path / "out") == before


def test_loads_and_tickets(tmp_path: Path) -> None:
    day = tmp_path / "tree" / "m" / "1"
    for place, (mv, name) in enumerate(((60.0, "a.log"), (80.0, "b.log.gz"), (50.0, "c.log"))):
        logs.write(day / name, mv, logs.START_S + 100.0 * place)
    (day / "tickets.csv").write_text("load,weighed_kg\n1,90\nb,120\n2-3,200\nz.log,30\n")
    outcome: Outcome = work(tasks(tmp_path / "tree", tmp_path / "out")[0])
    assert [item.problem for item in outcome.poisoned] == ["tickets.csv: line 5, load: no log that was measured is z.log"]
    folder = tmp_path / "out" / "machine=m" / "day=1"
    rows = pq.ParquetFile(folder / "loads.parquet").read().to_pylist()
    records = pq.ParquetFile(folder / "records.parquet").read().to_pylist()
    of = {(row["kind"], row["name"]): row for row in rows}
    parts = [of["log", name] for name in ("a.log", "b.log.gz", "c.log")]
    for place, row in enumerate(parts):
        begin = logs.START_S + 100.0 * place
        inside = [r["mass_kg"] for r in records if begin < r["time_s"] - 0.5 < begin + 100.0]
        assert row["measured_kg"] == pytest.approx(sum(inside), rel=1e-12)
        assert row["measured_kg"] > 10.0
    assert of["ticket", "1"]["measured_kg"] == parts[0]["measured_kg"]
    assert of["ticket", "b"]["weighed_kg"] == 120.0
    assert of["ticket", "2-3"]["measured_kg"] == pytest.approx(parts[1]["measured_kg"] + parts[2]["measured_kg"], rel=1e-12)
    assert of["load", "1"]["measured_kg"] == pytest.approx(sum(part["measured_kg"] for part in parts), rel=1e-12)
    [known] = pq.ParquetFile(folder / "provenance.parquet").read().to_pylist()
    assert known["crop"] == ""
    assert [name for name, _ in json.loads(known["logs"])] == ["a.log", "b.log.gz", "c.log"]


def test_logs_that_are_called_the_same_in_folders_that_are_too_stay_apart(tmp_path: Path) -> None:
    """Two cards of one recorder, say: mass and tickets of each log are its own."""
    for place, (mv, card) in enumerate(((60.0, "left"), (90.0, "right"))):
        logs.write(tmp_path / card / "can0" / "0001.log", mv, logs.START_S + 100.0 * place)
    (tmp_path / "tickets.csv").write_text("load,weighed_kg\n1,24\nright/can0/0001.log,36\n0001.log,30\n")
    table = tmp_path / "fleet.csv"
    rows = (f"m,d,{card}/can0/0001.log,tickets.csv" for card in ("left", "right"))
    table.write_text("\n".join(["machine,day,log,tickets", *rows]) + "\n")
    outcome: Outcome = work(tasks(table, tmp_path / "out")[0])
    assert [item.problem for item in outcome.poisoned] == ["tickets.csv: line 4, load: no log that was measured is 0001.log"]
    rows_of = pq.ParquetFile(tmp_path / "out" / "machine=m" / "day=d" / "loads.parquet").read().to_pylist()
    kg = {row["name"]: row["measured_kg"] for row in rows_of if row["kind"] == "log"}
    assert [*kg] == ["left/can0/0001.log", "right/can0/0001.log"]
    tickets = {row["weighed_kg"]: row["measured_kg"] for row in rows_of if row["kind"] == "ticket"}
    assert tickets == {24.0: kg["left/can0/0001.log"], 36.0: kg["right/can0/0001.log"]}
    assert kg["left/can0/0001.log"] < 0.8 * kg["right/can0/0001.log"]


def test_a_ticket_is_one_of_the_machine_and_day_that_it_is_for(tmp_path: Path) -> None:
    """One table for all, as a truck scale writes it: another machine's first load is not this one's, and neither is that of
    another day."""
    rows = ["machine,day,log,tickets"]
    for place, (machine, day) in enumerate((("a", "1"), ("b", "1"), ("c", "1"), ("c", "2"))):
        logs.write(tmp_path / f"{machine}{day}.log", 60.0, logs.START_S + 86400.0 * place)
        rows.append(f"{machine},{day},{machine}{day}.log,tickets.csv")
    (tmp_path / "fleet.csv").write_text("\n".join(rows) + "\n")
    (tmp_path / "tickets.csv").write_text("load,weighed_kg,machine\n1,20,a\n1,25,c\nc2,30,c\n1,35,B\n1,40,\n")
    found = {}
    for task in tasks(tmp_path / "fleet.csv", tmp_path / "out"):
        outcome: Outcome = work(task)
        of_day = pq.ParquetFile(tmp_path / "out" / task.partition.name / "loads.parquet").read().to_pylist()
        weighed = [row["weighed_kg"] for row in of_day if row["kind"] == "ticket"]
        said = {item.problem.partition(", load: ")[0].rpartition(" ")[2]: item.problem for item in outcome.poisoned}
        found[task.partition.machine + task.partition.day] = weighed, sorted(said)
        assert said["5"] == "tickets.csv: line 5, load: is of the machine 'B'; expected a or b or c"
        assert "line 6, load: load 1 is one in each of the 4 days that this table is for; expected the name of" in said["6"]
    assert found == {
        "a1": ([20.0], ["5", "6"]), "b1": ([], ["5", "6"]), "c1": ([], ["3", "4", "5", "6"]), "c2": ([30.0], ["3", "5", "6"]),
    }  # fmt: skip


def test_two_whole_tickets_for_the_same_logs_leave_out_these_two_alone(tmp_path: Path) -> None:
    day = tmp_path / "tree" / "m" / "1"
    for place, (mv, name) in enumerate(((60.0, "a.log"), (80.0, "b.log"))):
        logs.write(day / name, mv, logs.START_S + 100.0 * place)
    (day / "tickets.csv").write_text("load,weighed_kg,part\n1,90,\n1,95,\nb,50,1\nb,70,2\n")
    outcome: Outcome = work(tasks(tmp_path / "tree", tmp_path / "out")[0])
    (refused,) = outcome.poisoned
    assert (refused.where, refused.problem.partition(";")[0]) == (
        "tickets.csv: line 3, load", "tickets.csv: line 3, load: load 1 has a ticket already (line 2)"
    )  # fmt: skip
    rows = pq.ParquetFile(tmp_path / "out" / "machine=m" / "day=1" / "loads.parquet").read().to_pylist()
    assert [(row["name"], row["weighed_kg"]) for row in rows if row["kind"] == "ticket"] == [("b", 120.0)]


def test_a_ticket_over_logs_of_the_same_time_is_held_against_their_mass_once(tmp_path: Path) -> None:
    """Two recorders on one machine, the second one from the middle on; with a clock or from 0."""
    text = logs.text(60.0)
    later = text.splitlines(keepends=True)[len(text.splitlines()) // 2 :]
    for name, epoch_s in (("dated", 0.0), ("from 0", logs.START_S)):
        day = tmp_path / "tree" / "m" / name
        day.mkdir(parents=True)
        for log, lines in (("1.log", text.splitlines(keepends=True)), ("2.log", later)):
            times = (f"({float(line[1:18]) - epoch_s:017.6f})" for line in lines)
            (day / log).write_text("".join(time + line[19:] for time, line in zip(times, lines, strict=True)))
        (day / "tickets.csv").write_text("load,weighed_kg\n1-2,24\n")
    both = tasks(tmp_path / "tree", tmp_path / "out")
    assert [task.partition.day for task in both] == ["dated", "from 0"]
    for task in both:
        assert work(task).status == DONE
        rows = pq.ParquetFile(tmp_path / "out" / task.partition.name / "loads.parquet").read().to_pylist()
        of = {row["name"]: row["measured_kg"] for row in rows if row["kind"] != "load"}
        assert of["1.log"] > 15.0
        assert of["2.log"] == 0.0
        assert of["1-2"] == pytest.approx(of["1.log"] + of["2.log"], rel=0.02)


def test_logs_outside_the_folders_of_days_are_named(tmp_path: Path) -> None:
    """Whose mass would be missed by nobody; tables and databases may be of another kind, and are left out."""
    inside = {"m 0/d1/a.log"}
    refused = {"a.log", "m 0/b.log.gz", "m 0/c.log.1", "m 0/tickets.csv", "m 0/d1/candump.log-20261001.gz"}
    nested = {"m 0/d1/morning/a.log": "m 0/d1/morning", "2026/10/01/a.asc": "2026/10/01"}
    left_out = {"m 0/d1/notes.txt", "fields.csv", "m 0/d1/maps/fields.csv", "m 0/machine=m/day=d/records.parquet"}
    for name in (*inside, *refused, *nested, *left_out, "m 0/config.yaml", "readme.txt"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("")
    for name in ("m 0/d2", "m1"):
        (tmp_path / name).mkdir()
    found = manifest.load(str(tmp_path))
    assert [partition.logs for partition in found.partitions] == [(str(tmp_path / name),) for name in inside]
    folders = {"m 0/d1/maps", "m 0/machine=m", "m 0/d2", "m1"}
    assert {Path(path).relative_to(tmp_path).as_posix() for path in found.left_out} == {
        "m 0/d1/notes.txt",
        "fields.csv",
        *folders,
    }
    assert {Path(error.where).relative_to(tmp_path).as_posix() for error in found.refused} == {*refused, *nested.values()}


@pytest.mark.parametrize(
    ("name", "read"), [("config.yml", "config.yaml"), ("Config.yaml", "config.yaml"), ("CONFIG.YML", "config.yaml")]
)
def test_a_machine_whose_configuration_is_called_otherwise_is_refused(tmp_path: Path, name: str, read: str) -> None:
    """It would be measured by the configuration of all others."""
    for each in ("m0/d/a.log", "m1/d/a.log", "m1/d2/a.log", f"m0/{name}", f"m1/d/{name}"):
        logs.write(tmp_path / each)
    found = manifest.load(str(tmp_path))
    assert [(partition.machine, partition.day) for partition in found.partitions] == [("m1", "d2")]
    assert [str(error) for error in found.refused] == [
        f"{tmp_path / folder / name}: is not read under this name; expected {read}" for folder in ("m0", "m1/d")
    ]


def test_tickets_that_are_called_otherwise_are_refused(tmp_path: Path) -> None:
    for each in ("m/d/a.log", "m/d/Tickets.CSV"):
        logs.write(tmp_path / each)
    found = manifest.load(str(tmp_path))
    assert [Path(log).name for log in found.partitions[0].logs] == ["a.log"]
    assert [str(error).partition(": ")[2] for error in found.refused] == ["is not read under this name; expected tickets.csv"]


def test_a_worker_of_another_release_leaves_its_days(tree: Path, tmp_path: Path) -> None:
    task = tasks(tree, tmp_path / "out")[0]
    outcome = work(replace(task, software=replace(task.software, version="0.0.1")))
    assert (outcome.status, outcome.poisoned) == (LEFT, ())
    assert "expected that of the client, 0.0.1" in outcome.why_left
    assert Dataset(str(tmp_path / "out")).failures() == []


@pytest.mark.parametrize("name", ["b.log.zst", "b.ASC.bz2", "b.blf.xz", "b.log.zip"])
def test_a_log_that_is_compressed_in_another_way_is_named(tmp_path: Path, name: str) -> None:
    day = tmp_path / "m" / "d"
    day.mkdir(parents=True)
    for each in ("a.log", name, "letter.zip"):
        (day / each).touch()
    found = manifest.load(str(tmp_path))
    assert [str(error).partition(": ")[2] for error in found.refused] == [
        f"is compressed as {Path(name).suffix}, which is not read; expected the log as it is, or as .gz"
    ]
    assert [Path(path).name for path in found.left_out] == ["letter.zip"]
    assert [Path(log).name for log in found.partitions[0].logs] == ["a.log"]


def test_logs_of_a_day_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    """Since they are one record, and a ticket's number counts them."""
    names = ["1.log", "2.log", "9.blf", "10.log", "11.log.gz", "run 2.log", "run 10.log", "ü1.log"]
    (tmp_path / "m" / "d").mkdir(parents=True)
    for name in sorted(names):
        (tmp_path / "m" / "d" / name).write_bytes(b"")
    [partition] = manifest.load(str(tmp_path)).partitions
    assert [Path(log).name for log in partition.logs] == names


@pytest.mark.parametrize("dated", [True, False])
def test_logs_of_a_day_are_one_record_in_the_order_of_their_times(dated: bool, tmp_path: Path) -> None:
    """Whatever they are called; logs that begin at 0 each say nothing of their order, which is that of their names."""
    lines = logs.text(60.0).splitlines(keepends=True)
    half = len(lines) * 4 // 5
    found = {}
    parts = lines[:half], lines[half:]
    for day, of in (
        ("whole", {"1.log": lines}),
        ("by name", dict(zip(("1.log", "2.log"), parts, strict=True))),
        ("by time", dict(zip(("morning.log", "afternoon.log"), parts, strict=True))),
    ):
        folder = tmp_path / "tree" / "m" / day
        folder.mkdir(parents=True)
        for name, part in of.items():
            epoch_s = 0.0 if dated else float(part[0][1:18])
            (folder / name).write_text("".join(f"({float(line[1:18]) - epoch_s:017.6f}){line[19:]}" for line in part))
    for task in tasks(tmp_path / "tree", tmp_path / "out"):
        assert work(task).status == DONE
        place = tmp_path / "out" / task.partition.name
        rows = pq.ParquetFile(place / "loads.parquet").read().to_pylist()
        [load] = [row["measured_kg"] for row in rows if row["kind"] == "load"]
        codes = {row["code"] for row in pq.ParquetFile(place / "faults.parquet").read().to_pylist()}
        found[task.partition.day] = load, "ClockJumped" in codes
    if dated:
        assert found["by time"] == found["by name"] == found["whole"]
        assert not found["whole"][1]
    else:
        assert found["by time"][0] < 0.7 * found["whole"][0], "the grain before the zero has no mass"


def _shifted(lines: Sequence[str], by_s: float) -> list[str]:
    return [f"({float(line[1:18]) + by_s:017.6f}){line[19:]}" for line in lines]


@pytest.mark.parametrize(
    ("strange", "jumps"),
    [
        ("nothing", False),
        ("empty log", False),
        ("log of others", False),
        ("unreadable log", False),
        ("clock set by a receiver", True),
        ("clock of the last shutdown", True),
        ("first frame damaged to 0", False),
        ("first frame damaged to 2286", False),
        ("gzipped, cut short", False),
        ("begin alike", False),
    ],
)
def test_no_strange_log_takes_the_others_out_of_their_order(strange: str, jumps: bool, tmp_path: Path) -> None:
    """The day's mass and records are those of `process` on the logs in the order of time."""
    lines = logs.text(60.0).splitlines(keepends=True)
    ends = [len(lines) * share // 5 for share in (0, 3, 4, 5)]
    parts = [lines[first:last] for first, last in itertools.pairwise(ends)]
    names = ["z.log", "y.log", "x.log"]
    expected = ["z.log", "y.log", "x.log"]
    folder = tmp_path / "tree" / "m" / "d"
    folder.mkdir(parents=True)
    if strange.startswith("clock"):
        # Of each log the first second, half a second of it without a frame.
        by_s = -logs.START_S if strange == "clock set by a receiver" else -40_000.0
        for place, part in enumerate(parts[:2]):
            first_s = float(part[0][1:18])
            wrong = sum(float(line[1:18]) < first_s + 1.0 for line in part)
            again = by_s if by_s == -logs.START_S else -first_s + logs.START_S + by_s
            parts[place] = _shifted(part[:wrong], again) + part[wrong:]
    elif strange.startswith("first frame"):
        time_s = 0.0 if strange.endswith("to 0") else 9_999_999_999.0
        parts[2] = [f"({time_s:017.6f}) can0 123#00\n", *parts[2]]
    elif strange == "begin alike":
        parts, names, expected = [lines, lines[: len(lines) // 3]], ["b.log", "a.log"], ["a.log", "b.log"]
    for name, part in zip(names, parts, strict=True):
        (folder / name).write_text("".join(part))
    if strange == "empty log":
        (folder / "m.log").write_text("")
        expected = [*expected, "m.log"]
    elif strange == "log of others":
        (folder / "m.log").write_text(f"({logs.START_S - 5.0:017.6f}) can0 123#00\n")
        expected = ["m.log", *expected]
    elif strange == "unreadable log":
        (folder / "m.log").write_bytes(b"\x00\x01 nothing of a log" * 50)
    elif strange == "gzipped, cut short":
        packed = gzip.compress("".join(parts[2]).encode())
        (folder / "x.log").unlink()
        (folder / "x.log.gz").write_bytes(packed[: len(packed) * 9 // 10])
        expected[2] = "x.log.gz"
    [task] = tasks(tmp_path / "tree", tmp_path / "out")
    assert work(task).status == DONE
    place = tmp_path / "out" / task.partition.name
    paths = [str(folder / name) for name in expected]
    assert main(["process", *paths, "--out", str(tmp_path / "records.parquet")]) == 0
    assert (place / "records.parquet").read_bytes() == (tmp_path / "records.parquet").read_bytes()
    rows = pq.ParquetFile(place / "loads.parquet").read().to_pylist()
    assert [row["name"] for row in rows if row["kind"] == "log"] == expected
    assert sum(row["measured_kg"] for row in rows if row["kind"] == "log") > 12.0
    codes = {row["code"] for row in pq.ParquetFile(place / "faults.parquet").read().to_pylist()}
    assert ("ClockJumped" in codes) == jumps


def test_a_ticket_covers_logs_by_name_whatever_their_order_in_time(tmp_path: Path) -> None:
    """Also where another log lies between them in time."""
    day = tmp_path / "tree" / "m" / "d"
    for name, mv, place in (("a.log", 60.0, 2), ("b.log", 80.0, 0), ("c.log", 50.0, 1)):
        logs.write(day / name, mv, logs.START_S + 100.0 * place)
    (day / "tickets.csv").write_text("load,weighed_kg\n1-2,90\n2-3,200\n")
    [task] = tasks(tmp_path / "tree", tmp_path / "out")
    assert work(task).status == DONE
    rows = pq.ParquetFile(tmp_path / "out" / task.partition.name / "loads.parquet").read().to_pylist()
    of = {row["name"]: row for row in rows if row["kind"] != "load"}
    assert list(of)[:3] == ["b.log", "c.log", "a.log"]
    for name, covered in (("1-2", ("b.log", "a.log")), ("2-3", ("b.log", "c.log"))):
        ticket, parts = of[name], [of[log] for log in covered]
        assert ticket["measured_kg"] == pytest.approx(sum(part["measured_kg"] for part in parts), rel=1e-12)
        assert (ticket["first_number"], ticket["last_number"]) == (parts[0]["first_number"], parts[1]["last_number"])
        assert (ticket["start_s"], ticket["end_s"]) == (parts[0]["start_s"], parts[1]["end_s"])
        assert json.loads(ticket["logs"]) == list(covered)


@pytest.mark.parametrize("name", ["._a.log", ".DS_Store", "Thumbs.db", "notes.txt"])
def test_what_file_managers_leave_is_no_log(tmp_path: Path, name: str) -> None:
    logs.write(tmp_path / "m" / "d" / "a.log")
    (tmp_path / "m" / "d" / name).write_text("two stones in the header")
    found = manifest.load(str(tmp_path))
    assert [Path(log).name for log in found.partitions[0].logs] == ["a.log"]
    assert [Path(path).name for path in found.left_out] == [name]
    assert found.refused == ()


def test_a_manifest_is_a_tree_in_a_table(tree: Path, tmp_path: Path) -> None:
    table = tmp_path / "fleet.csv"
    rows = [f"{m},{d},{tree / m / d / 'a.log'}" for m in ("m0", "m1") for d in ("2026-10-01", "2026-10-02")]
    table.write_text("machine,day,log\n" + "\n".join(rows) + "\n")
    assert manifest.load(str(table)) == manifest.load(str(tree))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("machine,log\nm,x.log\n", "has no column day"),
        ("machine,day,log,colour\nm,1,x.log,red\n", "has colour"),
        ("machine,day,log\nm/../n,1,x.log\n", "is 'm/../n'"),
        ("machine,day,log\nm,1,x.log\nm,2,x.log\n", "a second time"),
        ("machine,day,log,crop\nm,1,x.log,corn\nm,1,y.log,wheat\n", "differs from a row above"),
        ("machine,day,log\n", "row"),
    ],
)
def test_manifests_that_make_no_sense(tmp_path: Path, content: str, said: str) -> None:
    path = tmp_path / "fleet.csv"
    path.write_text(content)
    with pytest.raises(InputError, match=re.escape(said)):
        manifest.load(str(path))


def test_nothing_is_written_over_what_is_no_dataset(tree: Path, tmp_path: Path) -> None:
    (tmp_path / "photographs.txt").write_text("mine")
    with pytest.raises(InputError, match="holds photographs"):
        Dataset(str(tmp_path)).begin()
    assert main(["fleet", "run", str(tree), "--out", str(tmp_path), "--workers", "0"]) == 2
    assert main(["fleet", "run", str(tmp_path / "nowhere"), "--out", str(tmp_path / "o")]) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["photographs.txt"]


def test_kill_at_any_instant_leaves_whole_partitions(tree: Path, measured: Path, tmp_path: Path) -> None:
    """kill -9 of the process that works, at random instants; the next run makes good what is missing."""
    out, chance, context = tmp_path / "out", random.Random(7), multiprocessing.get_context("fork")
    whole = {name: content for name, content in dataset_files(measured).items() if name != "_run"}
    for _ in range(8):
        todo = tasks(tree, out)
        worker = context.Process(target=_all, args=(todo,))
        worker.start()
        time.sleep(chance.uniform(0.05, 0.8))
        worker.kill()
        worker.join()
        made = dataset_files(out)
        there = {path.rpartition("/")[0] for path in made if path.endswith(MARK)}
        for path, content in made.items():
            if path.startswith("machine="):
                assert path.rpartition("/")[0] in there, "a partition is there whole or not at all"
                assert content == whole[path]
    _all(tasks(tree, out))
    Dataset(str(out)).end((out / "_run").read_text())
    assert dataset_files(out) == whole


def _all(todo: list[Task]) -> None:
    for task in todo:
        work(task)

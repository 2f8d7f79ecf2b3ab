"""What becomes of a run when one machine of many, one log of many or one moment of many is bad."""

from __future__ import annotations

import gzip
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from tests.fleet import logs
from tests.schema_check import problems
from yieldmon.cli.main import main
from yieldmon.fleet.copies import with_copies
from yieldmon.fleet.dataset import Dataset
from yieldmon.fleet.dataset_files import MARK
from yieldmon.fleet.manifest import load

ROOT = Path(__file__).parents[2]
#: Shells start background jobs with the signal ignored, and what they start inherits that.
INTERRUPTIBLE = (
    "import runpy, signal; signal.signal(signal.SIGINT, signal.default_int_handler);"
    "runpy.run_module('yieldmon', run_name='__main__', alter_sys=True)"
)
DAY = "2026-10-01"


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    return logs.tree(tmp_path / "tree", machines=2, days=1)


def fleet_run(source: Path, out: Path, capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, dict[str, Any], str]:
    """Exit code, document and what was said."""
    code = main(["fleet", "run", str(source), "--out", str(out), "--workers", "0", "--json", *words])
    printed = capsys.readouterr()
    assert not printed.out or problems(json.loads(printed.out), "fleet-run") == []
    return code, json.loads(printed.out or "{}"), printed.err


def days(out: Path) -> list[str]:
    return sorted(path.parent.relative_to(out).as_posix() for path in out.rglob(MARK))


BROKEN = {
    "no yaml": b"engine: [",
    "unknown key": b"engnie: {}\n",
    "no text": b"\xff\xfe\x00",
    "no machine": b"machine_file: nowhere.yaml\n",
}


@pytest.mark.parametrize("content", BROKEN.values(), ids=BROKEN.keys())
def test_one_machines_configuration_does_not_stop_the_others(
    tree: Path, tmp_path: Path, content: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    logs.write(tree / "m0" / "2026-10-02" / "a.log", 55.0)
    config, out = tree / "m0" / "config.yaml", tmp_path / "out"
    config.write_bytes(content)
    code, document, _ = fleet_run(tree, out, capsys)
    assert (code, document["done"], document["failed"]) == (1, 1, 2)
    assert {item["partition"] for item in document["poisoned"]} == {f"machine=m0/day={day}" for day in (DAY, "2026-10-02")}
    assert all(item["problem"].startswith("m0/") for item in document["poisoned"])
    assert str(tmp_path) not in (out / "_failed" / "machine=m0" / f"day={DAY}.json").read_text()
    assert days(out) == [f"machine=m1/day={DAY}"]
    config.unlink()
    assert fleet_run(tree, out, capsys)[:1] == (0,)
    assert len(days(out)) == 3
    assert Dataset(str(out)).failures() == []


def test_one_line_a_machine_not_a_day(tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs.write(tree / "m0" / "2026-10-02" / "a.log", 55.0)
    (tree / "m0" / "config.yaml").write_text("engine: [")
    assert main(["fleet", "run", str(tree), "--out", str(tmp_path / "out"), "--workers", "0"]) == 1
    said = [line for line in capsys.readouterr().err.splitlines() if "config.yaml" in line]
    assert len(said) == 1
    assert said[0].startswith("not measured: machine=m0 (2 days): m0/config.yaml")


@pytest.mark.parametrize("harm", ["configuration", "name"])
def test_strict_refuses_all_and_writes_nothing(tree: Path, tmp_path: Path, harm: str, capsys: pytest.CaptureFixture[str]) -> None:
    if harm == "configuration":
        (tree / "m0" / "config.yaml").write_text("engine: [")
    else:
        logs.write(tree / "(2)" / DAY / "a.log", 33.0)
    assert main(["fleet", "run", str(tree), "--out", str(tmp_path / "out"), "--workers", "0", "--strict"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_the_configuration_of_all_is_needed(tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "c.yaml").write_text("engine: [")
    words = ["fleet", "run", str(tree), "--out", str(tmp_path / "out"), "--workers", "0", "--config", str(tmp_path / "c.yaml")]
    assert main(words) == 2
    assert "c.yaml" in capsys.readouterr().err


def test_a_folder_that_cannot_be_a_machine_does_not_stop_the_others(
    tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    logs.write(tree / "m\n0" / DAY / "a.log", 33.0)
    logs.write(tree / "m1" / "(7 Oct)" / "a.log", 34.0)
    code, document, _ = fleet_run(tree, tmp_path / "out", capsys)
    assert (code, document["done"]) == (1, 2)
    assert len(document["poisoned"]) == 2
    assert all("a name that begins with a letter or digit" in item["problem"] for item in document["poisoned"])


def test_a_copy_is_counted_once(tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    undisturbed, out, day = tmp_path / "undisturbed", tmp_path / "out", tree / "m0" / DAY
    logs.write(day / "c.log", 45.0, logs.START_S + 100.0)
    assert fleet_run(tree, undisturbed, capsys)[0] == 0
    shutil.copy(day / "a.log", day / "b.log")
    (day / "d.log.gz").write_bytes(gzip.compress((day / "c.log").read_bytes()))
    (tree / "m0" / "2026-10-02").mkdir()
    shutil.copy(day / "a.log", tree / "m0" / "2026-10-02" / "a.log")
    code, document, said = fleet_run(tree, out, capsys)
    assert (code, document["partitions"]) == (0, 2)
    assert [(Path(item["log"]).name, Path(item["same_as"]).name) for item in document["copies"]] == [
        ("b.log", "a.log"), ("d.log.gz", "c.log"), ("a.log", "a.log"),
    ]  # fmt: skip
    assert said.count("holds the same as") == 3
    for table in ("records", "loads"):
        name = f"machine=m0/day={DAY}/{table}.parquet"
        assert (out / name).read_bytes() == (undisturbed / name).read_bytes()
    assert main(["fleet", "report", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["doubtful"] == []


def test_a_copy_keeps_its_place_in_what_tickets_count(tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    day = tree / "m0" / DAY
    shutil.copy(day / "a.log", day / "b.log")
    logs.write(day / "c.log", 45.0, logs.START_S + 100.0)
    (day / "tickets.csv").write_text("load,weighed_kg\n3,90\n2,80\n")
    code, document, _ = fleet_run(tree, tmp_path / "out", capsys)
    assert code == 1
    assert [item["problem"] for item in document["poisoned"]] == ["tickets.csv: line 3, load: no log that was measured is 2"]


def test_only_the_same_content_on_the_same_machine_is_a_copy(tree: Path) -> None:
    """Another machine's log, one that ends or begins alike, and empty ones are measured."""
    day = tree / "m0" / DAY
    text = (day / "a.log").read_bytes()
    (day / "b.log").write_bytes(text[:-40])
    (day / "c.log").write_bytes(text[40:])
    (day / "d.log.gz").write_bytes(gzip.compress(text)[:-9])
    for name in ("e.log", "f.log"):
        (day / name).write_bytes(b"")
    shutil.copy(day / "a.log", tree / "m1" / DAY / "z.log")
    assert [partition.copies for partition in with_copies(load(str(tree)).partitions)] == [(), ()]


def test_a_log_that_cannot_be_read_is_left_out_and_measured_when_it_can(
    tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, out, day = tmp_path / "fleet.csv", tmp_path / "out", tree / "m0" / DAY
    table.write_text(f"machine,day,log\nm0,{DAY},{day / 'a.log'}\nm0,{DAY},{day / 'later.log'}\nm1,{DAY},{tree / 'gone.log'}\n")
    code, document, _ = fleet_run(table, out, capsys)
    assert (code, document["done"], document["failed"]) == (1, 1, 1)
    assert document["poisoned"][0]["where"] == "later.log"
    assert document["poisoned"][1]["problem"].startswith("gone.log: No such file")
    logs.write(day / "later.log", 45.0, logs.START_S + 100.0)
    logs.write(tree / "gone.log", 50.0)
    code, document, _ = fleet_run(table, out, capsys)
    assert (code, document["done"], document["poisoned"]) == (0, 2, [])


def test_empty_logs_are_no_copies_of_each_other(tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for machine in ("m0", "m1"):
        (tree / machine / DAY / "b.log").touch()
    assert fleet_run(tree, tmp_path / "out", capsys)[0] == 0
    assert main(["fleet", "report", str(tmp_path / "out"), "--json"]) == 0
    doubts = json.loads(capsys.readouterr().out)["doubtful"]
    assert [(doubt["machine"], doubt["problem"]) for doubt in doubts] == [
        (machine, "damaged: b.log: no frame at all") for machine in ("m0", "m1")
    ]


def test_logs_that_add_nothing_to_their_day_are_named_at_each_run(
    tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, day = tmp_path / "out", tree / "m0" / DAY
    text = (day / "a.log").read_bytes()
    (day / "b.log").touch()
    (day / "c.log").write_text("(1600000000.000000) can0 18F00400#FFFFFFFFFFFFFFFF\n" * 3)
    (day / "d.log.gz").write_bytes(gzip.compress(text.lower())[:-99])
    for status in ("done", "skipped"):
        code, document, _ = fleet_run(tree, out, capsys)
        assert (code, document[status], document["poisoned"]) == (0, 2, [])
        assert {item["partition"] for item in document["doubtful"]} == {f"machine=m0/day={DAY}"}
        cut, again, other, empty = (item["problem"] for item in document["doubtful"])
        assert "the compressed data end early" in cut
        assert "it holds the frames of a.log again (+0 ms); left out" in again
        assert (empty, other) == (
            "b.log: no frame at all", "c.log: none of its 3 frames is one that yieldmon takes in",
        )  # fmt: skip
    assert main(["fleet", "run", str(tree), "--out", str(out), "--workers", "0"]) == 0
    assert f"doubtful: machine=m0/day={DAY}: b.log: no frame at all" in capsys.readouterr().err


def test_a_day_of_many_bad_logs_is_the_day_without_them(tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good, out, day = tmp_path / "good", tmp_path / "out", tree / "m0" / DAY
    assert fleet_run(tree, good, capsys)[0] == 0
    for name in ("A.log", "b.asc", "c.blf", "d.log.gz", "e.log"):
        (day / name).write_bytes(b"\x1f\x8bnothing that a log could be: " + name.encode())
    code, document, _ = fleet_run(tree, out, capsys)
    assert (code, document["done"]) == (1, 2)
    bad = {item["where"] for item in document["poisoned"]} | {item["problem"].partition(":")[0] for item in document["doubtful"]}
    assert bad == {"A.log", "b.asc", "c.blf", "d.log.gz", "e.log"}
    for table in ("records", "faults", "sweeps"):
        name = f"machine=m0/day={DAY}/{table}.parquet"
        assert (out / name).read_bytes() == (good / name).read_bytes()


def test_what_is_no_file_in_a_manifest_does_not_stop_the_others(
    tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A pipe without a writer would be waited for without end."""
    os.mkfifo(tmp_path / "pipe.log")
    (tmp_path / "loop.log").symlink_to("loop.log")
    (tmp_path / "folder.log").mkdir()
    rows = [f"m0,{DAY},{tree / 'm0' / DAY / 'a.log'}", f"m0,{DAY},pipe.log", f"m1,{DAY},loop.log", "m2,d,folder.log"]
    (tmp_path / "fleet.csv").write_text("machine,day,log\n" + "\n".join(rows) + "\n")
    code, document, _ = fleet_run(tmp_path / "fleet.csv", tmp_path / "out", capsys)
    assert (code, document["done"]) == (1, 1)
    said = [item["problem"].partition("fleet.csv: ")[2] for item in document["poisoned"]]
    assert said == [
        f"line {line}, log: {name}.log is not a file; expected a log" for line, name in ((3, "pipe"), (4, "loop"), (5, "folder"))
    ]


def test_links_that_lead_back_are_one_line_each(tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tree / "again").symlink_to(tree)
    (tree / "m0" / "up").symlink_to("..")
    (tree / "m1" / "above").symlink_to(tmp_path)
    code, document, said = fleet_run(tree, tmp_path / "out", capsys)
    assert (code, document["done"]) == (1, 2)
    assert {Path(item["where"]).name for item in document["poisoned"]} == {"again", "up", "above"}
    assert all("leads back" in item["problem"] for item in document["poisoned"])
    assert "left out" not in said


def test_a_note_of_a_failure_goes_once_its_day_is_there(tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As a client leaves it that was killed before it could ask again for a day that a dying worker had committed."""
    out = tmp_path / "out"
    assert fleet_run(tree, out, capsys)[0] == 0
    whole = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    Dataset(str(out)).fail(
        f"machine=m0/day={DAY}", {"machine": "m0", "day": DAY, "problem": "KilledWorker"}, Dataset(str(out)).begin()
    )
    assert len(Dataset(str(out)).failures()) == 1
    assert fleet_run(tree, out, capsys)[0] == 0
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == whole


def test_a_source_that_cannot_be_read_whole_says_nothing_of_what_left_it(
    tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert fleet_run(tree, tmp_path / "out", capsys)[0] == 0
    (tree / "m0").rename(tree / "(m0)")
    code, _, said = fleet_run(tree, tmp_path / "out", capsys)
    assert code == 1
    assert "not in the source" not in said


def test_links_are_what_they_lead_to(tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    elsewhere = logs.write(tmp_path / "elsewhere" / DAY / "a.log", 45.0)
    (tree / "m2").symlink_to(elsewhere.parents[1])
    (tree / "m0" / DAY / "b.log").symlink_to(logs.write(tmp_path / "b.log", 46.0, logs.START_S + 100.0))
    (tree / "m1" / DAY / "b.log").symlink_to("nowhere")
    os.mkfifo(tree / "m1" / DAY / "pipe.log")
    code, document, _ = fleet_run(tree, tmp_path / "out", capsys)
    assert (code, document["done"]) == (1, 3)
    assert [Path(item["where"]).name for item in document["poisoned"]] == ["b.log", "pipe.log"]
    assert load(str(tree)).partitions[0].logs[1].endswith("b.log")


def test_days_that_the_source_has_no_longer_are_named(tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert fleet_run(tree, tmp_path / "out", capsys)[0] == 0
    (tree / "m0").rename(tree / "new name")
    code, _, said = fleet_run(tree, tmp_path / "out", capsys)
    assert code == 0
    assert "machine=m0: 1 day is in" in said
    assert "machine=m1" not in said
    assert main(["fleet", "report", str(tmp_path / "out"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert problems(found, "fleet-report") == []
    [doubt] = found["doubtful"]
    assert doubt["problem"] == f"a.log holds the same as m0 {DAY} a.log; the sums leave it out"
    assert [(day["machine"], day["mass_kg"] > 0.0) for day in found["days"]] == [("m0", True), ("m1", True), ("new name", False)]


@pytest.mark.parametrize("when", ["while Dask is imported", "at work"])
def test_interrupted(tmp_path: Path, when: str) -> None:
    """Ctrl-C as a terminal sends it, a signal to the whole process group, and again while the workers are stopped."""
    source, out = logs.tree(tmp_path / "tree", machines=2, days=20), tmp_path / "out"
    reported = ["-X", "importtime"] if when != "at work" else []
    command = [sys.executable, *reported, "-c", INTERRUPTIBLE, "fleet", "run", str(source), "--out", str(out)]
    said = tmp_path / "said"
    with said.open("w") as stream:
        running = subprocess.Popen([*command, "--workers", "1"], cwd=ROOT, start_new_session=True, stderr=stream)
        try:
            end_s = time.monotonic() + 120.0
            while running.poll() is None and time.monotonic() < end_s:
                if days(out) if when == "at work" else "dask.typing" in said.read_text():
                    break
                time.sleep(0.01)
            for _ in range(3):
                os.killpg(running.pid, signal.SIGINT)
            running.wait(120.0)
        finally:
            running.kill()
    lines = [line for line in said.read_text().splitlines() if not line.startswith("import time:")]
    assert running.returncode == 130
    # Before the last line, the dashboard's address and how far it is.
    assert [line for line in lines[:-1] if not re.match(r"yieldmon: (dashboard: |\d+ of 40 days)", line)] == []
    # Also those whose worker was stopped before it could answer for them.
    assert lines[-1] == f"yieldmon: interrupted; {len(days(out))} of 40 days are in {out}; run again to continue"
    assert {path.name for path in out.glob("*")} <= {"_run", "machine=m0", "machine=m1"}
    for day in out.glob("machine=*/*"):
        assert (day / MARK).is_file()


@pytest.mark.parametrize("kind", ["absent", "a folder", "damaged"])
def test_a_day_is_measured_whatever_becomes_of_its_tickets(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Tickets that cannot be read lost the mass of the day, damaged ones did not."""
    logs.write(tmp_path / "a.log", 60.0)
    (tmp_path / "m.csv").write_text("machine,day,log,tickets\nm,d,a.log,weighed.csv\n")
    if kind == "a folder":
        (tmp_path / "weighed.csv").mkdir()
    elif kind == "damaged":
        (tmp_path / "weighed.csv").write_bytes(b"\xff\xfe\x00")
    code, document, _ = fleet_run(tmp_path / "m.csv", tmp_path / "out", capsys)
    assert (code, document["done"], document["failed"]) == (1, 1, 0)
    [left_out] = document["poisoned"]
    assert left_out["where"] == "weighed.csv"
    assert str(tmp_path) not in left_out["problem"]
    assert main(["fleet", "report", str(tmp_path / "out"), "--json"]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["totals"]["mass_kg"] > 10.0
    assert printed.err.startswith("left out: m d: weighed.csv: ")
    if kind == "a folder":
        (tmp_path / "weighed.csv").rmdir()
    (tmp_path / "weighed.csv").write_text("load,weighed_kg\na.log,20\n")
    code, document, _ = fleet_run(tmp_path / "m.csv", tmp_path / "out", capsys)
    assert (code, document["done"], document["poisoned"]) == (0, 1, [])


def test_machines_that_differ_in_capitals_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs.write(tmp_path / "a.log", 60.0)
    logs.write(tmp_path / "b.log", 70.0)
    (tmp_path / "m.csv").write_text("machine,day,log\nNorth,d,a.log\nnorth,d,b.log\n")
    code, document, said = fleet_run(tmp_path / "m.csv", tmp_path / "out", capsys)
    assert (code, document["done"]) == (0, 2)
    assert "North and north differ only in upper and lower case and count as 2 machines; use one name for one machine" in said

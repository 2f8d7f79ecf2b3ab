"""Days of a dataset that were damaged, or whose logs change while they are read: no other figure without a word, and nothing goes
that cannot be measured again."""

from __future__ import annotations

import random
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.file_limit import files_end_at
from tests.fleet import logs
from tests.fleet.logs import dataset_files
from tests.fleet.runs import tasks
from yieldmon.cli.main import main
from yieldmon.errors import InputError
from yieldmon.fleet import worker
from yieldmon.fleet.comparison import compare
from yieldmon.fleet.dataset import Dataset
from yieldmon.fleet.dataset_files import MARK
from yieldmon.fleet.summary import summarise
from yieldmon.fleet.tables import RECORDS, TABLES
from yieldmon.fleet.worker import DONE, LEFT, SKIPPED, work

DAY = "machine=m0/day=2026-10-01"


def flip(path: Path, seed: int) -> None:
    """One bit of a file."""
    chance, content = random.Random(f"{path.name} {seed}"), bytearray(path.read_bytes())
    content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
    path.write_bytes(content)


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-10])


@pytest.mark.parametrize("table", [table for table in TABLES if table != RECORDS])
def test_a_flipped_bit_is_no_other_figure(measured: Path, tmp_path: Path, table: str) -> None:
    """Parquet's pages have no checksums: a flip in a sum is a sum."""
    data = shutil.copytree(measured, tmp_path / "data")
    path = data / DAY / f"{table}.parquet"
    whole = path.read_bytes()
    for seed in range(20):
        flip(path, seed)
        with pytest.raises(InputError, match=f"{table}.parquet: is not what its mark says; expected what `fleet run` wrote"):
            summarise(str(data))
        path.write_bytes(whole)


def garbled(path: Path) -> None:
    """As long as before, and no table any more."""
    path.write_bytes(path.read_bytes()[:-8] + b"no table")


def emptied(path: Path) -> None:
    path.write_bytes(b"")


@pytest.mark.parametrize(
    ("day", "harm"),
    [*((day, harm) for day in ("2026-10-01", "2026-10-02") for harm in (cut, emptied, Path.unlink)), ("2026-10-01", garbled)],
)
def test_records_that_are_no_table_are_named_with_what_mends_them(
    measured: Path, tmp_path: Path, day: str, harm: Callable[[Path], None], capsys: pytest.CaptureFixture[str]
) -> None:
    """DuckDB's words name a pattern or magic bytes, and nothing to do. Records as long as before are read only where logs
    overlap, of the first day at the beginning."""
    data = shutil.copytree(measured, tmp_path / "data")
    harm(data / "machine=m0" / f"day={day}" / "records.parquet")
    assert main(["fleet", "report", str(data)]) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert re.search(rf"m0/day={day}/records.parquet: is (missing|not what its mark says); .* measures the day again", said[0])


def test_a_flipped_bit_is_no_difference_of_two_releases(measured: Path, tmp_path: Path) -> None:
    data = shutil.copytree(measured, tmp_path / "data")
    flip(data / DAY / "records.parquet", 0)
    mark = data / DAY / MARK
    mark.write_text(mark.read_text().replace('"sha256": "', '"sha256": "0', 1))
    with pytest.raises(InputError, match=r"is not what its mark says"):
        compare(str(data), str(measured))


@pytest.mark.parametrize("table", [RECORDS, "loads"])
@pytest.mark.parametrize("damage", [lambda path: flip(path, 0), cut, Path.unlink], ids=["flipped", "cut", "missing"])
def test_damaged_days_are_not_called_equal(measured: Path, tmp_path: Path, table: str, damage: Callable[[Path], None]) -> None:
    """A copy on another disk has the marks of the original."""
    data = shutil.copytree(measured, tmp_path / "data")
    damage(data / DAY / f"{table}.parquet")
    for pair in ((measured, data), (data, measured)):
        with pytest.raises(InputError, match=rf"{table}\.parquet: is (not what its mark says|missing)"):
            compare(*map(str, pair))


def flipped(path: Path) -> None:
    flip(path, 1)


@pytest.mark.parametrize("harm", [cut, Path.unlink, flipped])
@pytest.mark.parametrize("file", ["records.parquet", "loads.parquet", MARK])
def test_a_damaged_day_is_measured_again(
    tree: Path, measured: Path, tmp_path: Path, file: str, harm: Callable[[Path], None]
) -> None:
    data = shutil.copytree(measured, tmp_path / "data")
    harm(data / DAY / file)
    found = tasks(tree, data)
    assert sorted(work(task).status for task in found) == [DONE, *[SKIPPED] * 3]
    Dataset(str(data)).end(found[0].token)
    assert {**dataset_files(data), "_run": b""} == {**dataset_files(measured), "_run": b""}


# A day without a mark was never whole.
@pytest.mark.parametrize(
    ("file", "harm"),
    [
        (file, harm)
        for file in ("records.parquet", "loads.parquet", MARK)
        for harm in (cut, Path.unlink)
        if (file, harm) != (MARK, Path.unlink)
    ],
)
def test_a_damaged_day_stays_where_its_logs_are_gone(
    tree: Path, measured: Path, tmp_path: Path, file: str, harm: Callable[[Path], None], capsys: pytest.CaptureFixture[str]
) -> None:
    """Finished months are kept out of the source; what of them can be read is all there is."""
    data, source = shutil.copytree(measured, tmp_path / "data"), shutil.copytree(tree, tmp_path / "tree")
    shutil.rmtree(source / "m0" / "2026-10-01")
    harm(data / DAY / file)
    before = dataset_files(data / DAY)
    assert main(["fleet", "run", str(source), "--out", str(data), "--workers", "0"]) == 0
    assert dataset_files(data / DAY) == before
    said = [line for line in capsys.readouterr().err.splitlines() if f"{DAY}/{file}: is " in line]
    assert len(said) == 1
    assert main(["fleet", "report", str(data)]) == 2
    assert f"{DAY}/{file}" in capsys.readouterr().err


def test_a_log_that_grows_while_it_is_read_leaves_the_day(tree: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is measured would not be what the mark says it is from."""
    log = logs.write(tmp_path / "tree" / "m" / "1" / "a.log")
    whole = log.read_bytes()
    log.write_bytes(whole[: len(whole) // 2])
    measure = worker.measure

    def meanwhile(*arguments: object) -> object:
        log.write_bytes(whole)
        return measure(*arguments)  # type: ignore[arg-type]

    [task] = tasks(tmp_path / "tree", tmp_path / "out")
    with monkeypatch.context() as patched:
        patched.setattr(worker, "measure", meanwhile)
        outcome = work(task)
    assert (outcome.status, outcome.poisoned) == (LEFT, ())
    assert outcome.why_left == "a.log was written to while it was measured; expected files whose transfer is complete"
    assert Dataset(task.dataset).names() == []
    assert work(task).status == DONE


def test_the_earlier_of_two_runs_that_begin_together_removes_nothing_of_the_other(measured: Path, tmp_path: Path) -> None:
    data = shutil.copytree(measured, tmp_path / "data")
    cut(data / DAY / MARK)
    half = data / "machine=m1" / "day=2026-10-03" / "records.parquet"

    def other_begins(problem: InputError) -> None:
        Dataset(str(data)).begin((), lambda problem: None)
        half.parent.mkdir()
        half.write_bytes(b"as an object store has it before the mark")

    with pytest.raises(InputError, match="was taken over by another `fleet run`"):
        Dataset(str(data)).begin((), other_begins)
    assert half.exists()


def test_a_report_says_that_days_may_be_missing(tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A run was killed: what is there is not all."""
    data, page = tmp_path / "data", tmp_path / "season.html"
    fleet = ["fleet", "run", str(tree), "--out", str(data), "--workers", "0"]
    assert main(fleet) == 0
    (data / "_run").write_text("of a run that was killed")
    said = "days may be missing: a `fleet run` is under way, was interrupted or left days out; run it again"
    for unfinished in (True, False):
        capsys.readouterr()
        assert main(["fleet", "report", str(data), "--html", str(page), "--force"]) == 0
        assert (f"yieldmon: {data}: {said}\n" in capsys.readouterr().err) == unfinished
        assert (said[1:] in page.read_text()) == unfinished
        assert summarise(str(data))["unfinished"] == unfinished
        assert main(fleet) == 0


def test_a_run_that_leaves_days_out_is_not_finished(tree: Path, tmp_path: Path) -> None:
    data = tmp_path / "data"
    fleet = ["fleet", "run", str(tree), "--out", str(data), "--workers", "0"]
    with files_end_at(1 << 13):
        assert main(fleet) == 1
    assert Dataset(str(data)).unfinished
    assert main(fleet) == 0
    assert not Dataset(str(data)).unfinished

"""Datasets that somebody else has had in hand: links, damaged marks and tables, names that are patterns or statements."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from yieldmon.cli.main import main
from yieldmon.errors import InputError
from yieldmon.fleet import tables
from yieldmon.fleet.dataset import Dataset
from yieldmon.fleet.dataset_files import MARK
from yieldmon.fleet.manifest import load
from yieldmon.fleet.querying import opened
from yieldmon.fleet.summary import summarise

DAY = "machine=m0/day=1"
KNOWN = {
    "software_version": "1", "source_sha256": "0" * 64, "parameters_sha256": "0", "crop": "corn", "poisoned": "[]", "frames": 1,
    "seconds": 10, "total_mass_kg": 50.0, "zero_known": True,
}  # fmt: skip


def made(folder: Path, *names: str) -> Path:
    """A dataset with these partitions, of one row of provenance each."""
    dataset = Dataset(str(folder))
    token = dataset.begin()
    for name in names:
        with dataset.workspace() as workspace:
            output = workspace / "output"
            output.mkdir()
            for table in tables.TABLES:
                rows = [KNOWN] if table == tables.PROVENANCE else []
                # The records' columns do not matter here.
                tables.write(tables.LOADS if table == tables.RECORDS else table, rows, output / f"{table}.parquet")
            dataset.commit(name, output, {"key": name, "poisoned": []}, token)
    dataset.end(token)
    return folder


@pytest.fixture
def season(tmp_path: Path) -> Path:
    return made(tmp_path / "season", DAY, "machine=m1/day=1")


@pytest.fixture
def elsewhere(tmp_path: Path) -> Path:
    """A folder that is no part of the dataset, and what is in it."""
    folder = tmp_path / "photographs"
    (folder / "day=1").mkdir(parents=True)
    (folder / "day=1" / "a.jpg").write_text("mine")
    (folder / "b.jpg").write_text("mine")
    return folder


def content(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


@pytest.mark.parametrize("place", ["machine=x", "machine=m0/day=9", "_temporary", "_failed", "_run", "_failed/machine=x"])
def test_a_run_goes_through_no_link(season: Path, elsewhere: Path, place: str) -> None:
    before = content(elsewhere)
    link = season / place
    link.parent.mkdir(exist_ok=True)
    link.symlink_to(elsewhere / "day=1" if place.endswith("9") else elsewhere)
    with pytest.raises(InputError, match="is a link"):
        Dataset(str(season)).begin()
    assert content(elsewhere) == before


def test_a_link_among_the_files_of_a_day_goes_alone(season: Path, elsewhere: Path) -> None:
    before = content(elsewhere)
    (season / DAY / "stray").symlink_to(elsewhere)
    Dataset(str(season)).begin()
    assert not os.path.lexists(season / DAY / "stray")
    assert content(elsewhere) == before
    assert len(Dataset(str(season)).commits()) == 2


def test_what_another_program_has_partitioned_alike_is_not_cleaned(tmp_path: Path) -> None:
    theirs = tmp_path / "theirs" / "machine=a" / "day=1" / "part-0.parquet"
    theirs.parent.mkdir(parents=True)
    theirs.write_text("mine")
    with pytest.raises(InputError, match="holds machine=a"):
        Dataset(str(tmp_path / "theirs")).begin()
    assert theirs.read_text() == "mine"


@pytest.mark.parametrize(
    "mark",
    [
        b"", b"{", b"[]", b"null", b"\xff", b"[" * 100_000, b"{}", b'{"key": 1, "files": {}, "poisoned": []}',
        b'{"key": "a", "files": [], "poisoned": []}', b'{"key": "a", "files": {"records.parquet": 1}, "poisoned": []}',
        b'{"key": "a", "files": {}, "poisoned": [1]}',
        b'{"key": "a", "files": {}, "poisoned": [], "samples": []}', b'{"key": "a", "files": {}, "poisoned": [{"where": "a"}]}',
    ],
)  # fmt: skip
def test_a_damaged_mark_is_one_line_and_the_next_run_begins_that_day_anew(
    season: Path, capsys: pytest.CaptureFixture[str], mark: bytes
) -> None:
    (season / DAY / MARK).write_bytes(mark)
    assert main(["fleet", "report", str(season)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert f"{DAY}/{MARK}: is damaged" in said
    Dataset(str(season)).begin()
    assert [commit.name for commit in Dataset(str(season)).commits()] == ["machine=m1/day=1"]


@pytest.mark.parametrize("document", [b"{", b"[]", b'{"machine": "m0"}', b'{"machine": 1, "day": "1", "problem": "p"}'])
def test_a_damaged_note_of_a_failure_is_one_line(season: Path, document: bytes, capsys: pytest.CaptureFixture[str]) -> None:
    note = season / "_failed" / f"{DAY}.json"
    note.parent.mkdir(parents=True)
    note.write_bytes(document)
    assert main(["fleet", "report", str(season)]) == 2
    assert "is damaged" in capsys.readouterr().err


def test_what_a_failure_says_is_text_on_the_terminal(season: Path, capsys: pytest.CaptureFixture[str]) -> None:
    note = season / "_failed" / f"{DAY}.json"
    note.parent.mkdir(parents=True)
    note.write_text(json.dumps({"machine": "m0", "day": "1", "problem": "\x1b]0;owned\x07\nyieldmon: all is well"}))
    assert main(["fleet", "report", str(season)]) == 0
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert not any(character in said for character in "\x1b\x07")


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:40])


def other_columns(path: Path) -> None:
    tables.write(tables.SWEEPS, [], path)


def no_table(path: Path) -> None:
    path.write_text("SELECT 1")


@pytest.mark.parametrize("harm", [cut, other_columns, no_table, Path.unlink])
def test_a_damaged_table_is_one_line(season: Path, capsys: pytest.CaptureFixture[str], harm: Callable[[Path], None]) -> None:
    for name in (DAY, "machine=m1/day=1"):
        harm(season / name / "provenance.parquet")
    assert main(["fleet", "report", str(season)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert str(season) in said


@pytest.mark.parametrize("name", ["machine=m'0/day=1", "machine=*/day=1", "machine=m0/day=1; DROP TABLE x", "machine=../day=.."])
def test_names_that_no_run_gives_are_refused(season: Path, name: str) -> None:
    (season / DAY).rename(season / "moved")
    (season / name).parent.mkdir(exist_ok=True)
    (season / "moved").rename(season / name)
    for act in (Dataset(str(season)).commits, Dataset(str(season)).begin, lambda: summarise(str(season))):
        with pytest.raises(InputError, match="names as"):
            act()
    assert (season / name / MARK).is_file()


@pytest.mark.parametrize("name", ["JD S790 #2", "100% Müller", "a=b?c*[1]", "m0"])
def test_a_machine_is_called_as_its_folder_is(tmp_path: Path, name: str) -> None:
    """Hive's way: what a path, a pattern or a query would take for its own stands as %XX, and readers give the name back."""
    log = tmp_path / "logs" / name / "7 Oct" / "a.log"
    log.parent.mkdir(parents=True)
    log.touch()
    [partition] = load(str(tmp_path / "logs")).partitions
    assert (partition.machine, partition.day) == (name, "7 Oct")
    assert not {" ", "#", "?", "*", "["} & {*partition.name}
    out = str(made(tmp_path / "season", partition.name))
    assert [(commit.machine, commit.day) for commit in Dataset(out).commits()] == [(name, "7 Oct")]
    with opened(out) as query:
        assert query.rows("SELECT machine, day FROM provenance") == [{"machine": name, "day": "7 Oct"}]
    Dataset(out).begin()
    assert len(Dataset(out).commits()) == 1


@pytest.mark.parametrize("name", ["(2)", "m\\0", "m\n0", "..", "", "Ä" * 50])
def test_a_name_that_is_no_folders_is_refused_with_one_line(tmp_path: Path, name: str) -> None:
    manifest = tmp_path / "manifest.csv"
    manifest.write_text(f'machine,day,log\n"{name}",1,a.log\n', encoding="utf-8")
    with pytest.raises(InputError, match=r"begins with a letter or digit"):
        load(str(manifest))


@pytest.mark.parametrize("folder", ["season[1]", "season*", "season?", "it's; DROP"])
def test_a_dataset_is_read_by_its_own_name(tmp_path: Path, folder: str) -> None:
    """Read as a pattern, season[1] is season1, and season* both."""
    made(tmp_path / "season1", "machine=other/day=1")
    asked = made(tmp_path / folder, DAY)
    assert [commit.name for commit in Dataset(str(asked)).commits()] == [DAY]
    with opened(str(asked)) as query:
        assert query.rows("SELECT machine, day FROM provenance") == [{"machine": "m0", "day": "1"}]
    Dataset(str(asked)).begin()
    assert len(Dataset(str(asked)).commits()) == 1


@pytest.mark.parametrize("folder", ["machine=a", "day=1/season"])
def test_a_dataset_in_a_partition_of_another_is_refused(tmp_path: Path, folder: str) -> None:
    """Readers take machine and day from the first such folder of the path."""
    with pytest.raises(InputError, match="called like a partition"):
        Dataset(str(tmp_path / folder))

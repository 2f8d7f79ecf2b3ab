"""Trees as contractors keep them: archives, copies under way, many machines without a log."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.fleet import logs
from yieldmon.cli.main import main
from yieldmon.errors import InputError
from yieldmon.fleet import manifest


@pytest.mark.parametrize("name", ["b.log.part", "b.mf4.filepart", "b.BLF.crdownload", "b.log.gz.tmp"])
def test_a_log_that_is_still_being_copied_is_refused(name: str, tmp_path: Path) -> None:
    day = tmp_path / "tree" / "m0" / "d"
    logs.write(day / "a.log")
    (day / name).write_bytes(b"half")
    (day / "notes.part").write_text("no log")
    found = manifest.load(str(tmp_path / "tree"))
    assert [Path(error.where).name for error in found.refused] == [name]
    assert [Path(path).name for path in found.left_out] == ["notes.part"]


@pytest.mark.parametrize("place", ["m1/2026-10-02/logs.zip", "m1/2026-10-02.tar.gz", "m1/2026-10-02/all.7Z"])
def test_an_archive_in_the_place_of_a_days_logs_is_refused(place: str, tmp_path: Path) -> None:
    logs.write(tmp_path / "m0" / "2026-10-01" / "a.log")
    archive = tmp_path / place
    archive.parent.mkdir(parents=True)
    archive.write_bytes(b"archive")
    found = manifest.load(str(tmp_path))
    assert [(error.where, error.problem) for error in found.refused] == [(str(archive), "is an archive, which is not read")]


def test_an_archive_beside_the_folders_of_days_is_said(tmp_path: Path) -> None:
    logs.write(tmp_path / "m0" / "2026-10-01" / "a.log")
    for place in ("m0/2026-10-02.zip", "m1.tgz"):
        (tmp_path / place).write_bytes(b"archive")
    assert sorted(manifest.load(str(tmp_path)).left_out) == sorted(
        str(tmp_path / place) for place in ("m0/2026-10-02.zip", "m1.tgz")
    )


def test_of_many_empty_machines_not_every_one_is_a_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs.write(tmp_path / "tree" / "m" / "2026-10-01" / "a.log")
    for number in range(300):
        (tmp_path / "tree" / f"e{number}").mkdir()
    assert main(["fleet", "run", str(tmp_path / "tree"), "--out", str(tmp_path / "season"), "--workers", "1", "--json"]) == 0
    said = capsys.readouterr()
    assert len(json.loads(said.out)["left_out"]) == 300
    assert said.err.count("left out") == 51
    assert "250 more left out" in said.err


COMPOSED, APART = "M\u00fcller", "Mu\u0308ller"


@pytest.mark.parametrize(("first", "second"), [((COMPOSED, "d"), (APART, "e")), (("m0", COMPOSED), ("m0", APART))])
def test_one_name_in_two_codings_is_refused(first: tuple[str, str], second: tuple[str, str], tmp_path: Path) -> None:
    for machine, day in (first, second):
        logs.write(tmp_path / machine / day / "a.log")
    found = manifest.load(str(tmp_path))
    assert len(found.partitions) == 1
    [refused] = found.refused
    assert "accents coded otherwise" in str(refused)


def test_one_name_in_two_codings_in_a_table_is_refused(tmp_path: Path) -> None:
    logs.write(tmp_path / "a.log")
    (tmp_path / "b.log").write_bytes((tmp_path / "a.log").read_bytes())
    table = tmp_path / "manifest.csv"
    table.write_text(f"machine,day,log\n{COMPOSED},d,a.log\n{APART},d,b.log\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"line 3, machine: .*accents coded otherwise"):
        manifest.load(str(table))

"""Trees as contractors keep them: archives, copies under way, many machines without a log."""

from __future__ import annotations

import gzip
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


CANDUMP = "(1790841600.000000) can0 18FF0117#803E00FFFFFFFFFF\n"
READ, REFUSED, LEFT_OUT = "read", "refused", "left out"


@pytest.mark.parametrize(
    ("place", "content", "what"),
    [
        ("m/d/b.txt", CANDUMP, READ),
        ("m/d/b.TXT", "\ufeff# of the north field\n\n" + CANDUMP, READ),
        ("m/d/b.txt.gz", CANDUMP, READ),
        ("m/d/b.txt", "***BUSMASTER Ver 2.6.0***\n***PROTOCOL CAN***\n", READ),
        ("m/d/b.txt", "# Logger type: CL2000\n# HW rev: 6.3x\n", READ),
        ("m/d/b.txt", " Chn Identifier Flg   DLC  D0...1...2...3...4...5...6..D7       Time     Dir\n", READ),
        ("m/d/b.txt", "  can0  18FF0117   [8]  80 3E 00 FF FF FF FF FF\n", READ),  # without times: named as it is read
        ("m/d/b.txt", CANDUMP.encode("utf-16"), READ),
        ("m/d/b.txt.1", CANDUMP, REFUSED),
        ("m/d/b.txt.part", CANDUMP, REFUSED),
        ("m/b.txt", CANDUMP, REFUSED),
        ("m/d/morning/b.txt", CANDUMP, REFUSED),
        ("m/d/b.txt", "load 2: a stone in the header (12:40) can0 off\n", LEFT_OUT),
        ("m/d/b.txt.gz", "load 2\n", LEFT_OUT),
        ("m/d/b.txt.1", "load 2\n", LEFT_OUT),
        ("m/d/b.txt", "", LEFT_OUT),
        ("m/d/b.txt.zip", b"PK\x03\x04\x14\x00", LEFT_OUT),
        ("m/d/b.mf4.kmf", "", LEFT_OUT),
    ],
)
def test_a_text_file_is_a_log_where_it_begins_as_one(place: str, content: str | bytes, what: str, tmp_path: Path) -> None:
    logs.write(tmp_path / "m" / "d" / "a.log")
    path = tmp_path / place
    path.parent.mkdir(parents=True, exist_ok=True)
    text = content if isinstance(content, bytes) else content.encode()
    path.write_bytes(gzip.compress(text) if place.endswith(".gz") else text)
    found = manifest.load(str(tmp_path))
    named = {
        READ: [log for log in found.partitions[0].logs if not log.endswith("a.log")],
        REFUSED: [error.where for error in found.refused],
        LEFT_OUT: list(found.left_out),
    }
    of = path.parent if path.parent.name == "morning" else path
    assert named == {READ: [], REFUSED: [], LEFT_OUT: [], what: [str(of)]}


def test_what_is_left_out_and_may_be_a_log_is_said_with_what_to_do(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs.write(tmp_path / "tree" / "m" / "d" / "a.txt")
    for name in ("b.kmf", "plan.txt"):
        (tmp_path / "tree" / "m" / "d" / name).write_text("north first")
    assert main(["fleet", "run", str(tmp_path / "tree"), "--out", str(tmp_path / "season"), "--workers", "0"]) == 0
    said = capsys.readouterr().err
    assert "b.kmf: left out, not read as a log: export b.kmf as .mf4" in said
    assert "plan.txt: left out, holds no log of a day" in said
    assert "1 measured" in said


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
    assert main(["fleet", "run", str(tmp_path / "tree"), "--out", str(tmp_path / "season"), "--workers", "0", "--json"]) == 0
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

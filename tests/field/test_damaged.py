"""Damaged harvests: a sample of the long run in tests/robustness, and damages with known outcomes."""

from __future__ import annotations

import json
import shutil
import zipfile
from pathlib import Path

import pytest

from tests.robustness.fuzz_harvests import base_files, fuzz
from yieldmon.cli import main as cli
from yieldmon.errors import InputError
from yieldmon.field import sources
from yieldmon.field.sources.options import ReadOptions
from yieldmon.field.sources.task_data import timelog


def test_a_sample_of_damaged_files() -> None:
    outcomes, findings = fuzz(60, seed=3)
    assert findings == []
    assert sum(outcomes.values()) == 60


def test_whole_ones_are_maps(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole = base_files(tmp_path)
    assert len(whole) == 10
    for path in whole:
        code = cli.main(["map", str(path), "--out", str(tmp_path / "out"), "--products", "none", "--json"])
        reported = capsys.readouterr()
        assert code == 0, reported.err
        assert json.loads(reported.out)["mass_kg"]["integrated"] > 0


def test_missing_and_damaged_logs_are_named(harvests: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["map", str(harvests / "isoxml"), "--out", str(tmp_path / "out"), "--products", "none", "--json"]) == 0
    reported = capsys.readouterr()
    (source,) = json.loads(reported.out)["sources"]
    why = {one["part"]: one["why"] for one in source["skipped"]}
    assert "missing" in why["TLG00001"]
    assert "well-formed" in why["TLG00003"]
    assert "TLG00006" not in why
    assert source["points"] == 187
    assert sum("TLG00003" in line for line in reported.err.splitlines()) == 1


def test_machine_total_is_near_the_integral(harvests: Path) -> None:
    table = sources.read(harvests / "isoxml", ReadOptions())
    (source,) = table.sources
    assert source.mass_kg is not None
    assert (table["flow_kg_s"] * table["interval_s"]).sum() == pytest.approx(source.mass_kg, rel=0.01)
    assert {name for name in table.extra if name.startswith("DDI EA60")} == {"DDI EA60 DET-1"}


@pytest.mark.parametrize(
    ("log", "mass_kg", "area_m2"),
    [("TLG00003", 91_885.0, 19_500.0), ("TLG00006", None, None)],
    ids=["a task with one log", "a task with two"],
)
def test_totals_of_the_task_for_a_log_without_counters(
    harvests: Path, tmp_path: Path, log: str, mass_kg: float | None, area_m2: float | None
) -> None:
    shutil.copy(harvests / "isoxml" / "TASKDATA.XML", tmp_path)
    shutil.copy(harvests / "isoxml" / "TLG00006.bin", tmp_path / f"{log}.bin")
    header = (harvests / "isoxml" / "TLG00006.xml").read_text()
    (tmp_path / f"{log}.xml").write_text(header.replace('"005A"', '"E0AA"').replace('"0074"', '"E0AB"'))
    (source,) = sources.read(tmp_path, ReadOptions()).sources
    assert (source.mass_kg, source.area_m2) == (mass_kg, area_m2)


@pytest.mark.parametrize("share", [0.3, 0.8])
def test_a_truncated_log_gives_its_first_records(harvests: Path, tmp_path: Path, share: float) -> None:
    shutil.copytree(harvests / "isoxml", tmp_path / "t")
    log = tmp_path / "t" / "TLG00006.bin"
    data = log.read_bytes()
    log.write_bytes(data[: int(share * len(data))])
    table = sources.read(tmp_path / "t", ReadOptions())
    assert len(table) == pytest.approx(187 * share, abs=6)
    (why,) = (one.why for one in table.sources[0].skipped if one.part == "TLG00006")
    assert why.endswith(" bytes in 1 place are damaged")


def test_a_damaged_stretch_costs_its_records_only(harvests: Path, tmp_path: Path) -> None:
    shutil.copytree(harvests / "isoxml", tmp_path / "t")
    log = tmp_path / "t" / "TLG00006.bin"
    data = bytearray(log.read_bytes())
    data[9000:9060] = b"\xff" * 60
    log.write_bytes(bytes(data))
    table = sources.read(tmp_path / "t", ReadOptions())
    assert 180 <= len(table) < 187
    assert next(one.why for one in table.sources[0].skipped if one.part == "TLG00006").endswith(" bytes in 1 place are damaged")


def test_a_broken_task_file_leaves_the_logs(harvests: Path, tmp_path: Path) -> None:
    shutil.copytree(harvests / "isoxml", tmp_path / "t")
    task = tmp_path / "t" / "TASKDATA.XML"
    task.write_bytes(task.read_bytes()[:5000])
    table = sources.read(tmp_path / "t", ReadOptions())
    assert len(table) == 187
    assert table.sources[0].skipped[0].part == "TASKDATA.XML"


def test_rows_that_are_no_rows_are_reported(corn: Path, tmp_path: Path) -> None:
    lines = corn.read_text().splitlines()[:300]
    lines[10] = "a,b,c"
    lines[20] = lines[20].replace(",", ",x", 1)
    wrong = lines[20].split(",")[1]
    path = tmp_path / "field.txt"
    path.write_text("\n".join(lines))
    table = sources.read(path, ReadOptions())
    assert len(table) == 298
    assert [(one.part, one.why) for one in table.sources[0].skipped] == [
        ("row 11", "fewer than 10 fields"), ("row 21", f"a field that is not a number, such as '{wrong}'"),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a.csv", b"lon,lat,time,flow,width_m\n1,2,3,4,5\n", "no known unit for flow"),
        ("a.csv", b"lon,lat,time,Flow(lb/s),width_m\n", "no row"),
        ("a.csv", b"lon,lat,Flow(stone/s),width_m\n1,2,3,4\n", "no known unit for Flow(stone/s)"),
        ("a.csv", b"lon,lat,Flow(lb/s)\n1,2,3\n", "--width"),
        ("a.csv", b"Flow(lb/s),width_m\n1,2\n", "longitude"),
        ("a.txt", b"", "empty"),
        ("a.bin", b"\x01\x02\x03", "no known kind"),
        ("a.zip", b"PK\x03\x04 nothing", ""),
        ("a.geojson", b"{}", ""),
        ("a.gpkg", b"SQLite format 3\0 no", ""),
        ("a.sqlite", b"SQLite format 3\0" + b"\0" * 2000, ""),
        ("TASKDATA.XML", b"<!DOCTYPE x [<!ENTITY a 'b'>]><ISO11783_TaskData/>", "document type"),
    ],
)
def test_what_cannot_be_read_is_one_line(name: str, content: bytes, says: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        sources.read(path, ReadOptions())
    assert "\n" not in str(caught.value)
    assert says in str(caught.value)


def test_a_zip_of_several_reads_what_it_can(corn: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "all.zip", "w") as archive:
        archive.write(corn, "north/corn.txt")
        archive.writestr("notes.txt", "bring oil")
    table = sources.read(tmp_path / "all.zip", ReadOptions())
    assert len(table) == 6000
    assert table.sources[0].skipped[0].part == "notes.txt"


def test_a_long_member_name_is_shortened_in_the_report(tmp_path: Path) -> None:
    path = tmp_path / "all.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(f"{'a' * 5000}.txt", "bring oil")
    data = path.read_bytes()
    # The directory and the file itself then give it two names.
    path.write_bytes(data.replace(b"aaa", b"bbb", 1))
    with pytest.raises(InputError) as caught:
        sources.read(path, ReadOptions())
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize("member", ["TASKDATA.XML", "field.shp", "field.txt"])
def test_a_zip_whose_names_are_no_text_is_one_line(member: str, tmp_path: Path) -> None:
    path = tmp_path / "field.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(f"\u00e4{member}", "bring oil")
    # The flag says that the name is UTF-8.
    path.write_bytes(path.read_bytes().replace("\u00e4".encode(), b"\x9b\x9b"))
    with pytest.raises(InputError, match="damaged zip"):
        sources.read(path, ReadOptions())


def test_what_gdal_says_of_a_damaged_table_is_one_note(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (good,) = [path for path in base_files(tmp_path) if path.name == "points_shp.zip"]
    with zipfile.ZipFile(good) as whole, zipfile.ZipFile(tmp_path / "t.zip", "w") as spoilt:
        for name in whole.namelist():
            content = whole.read(name)
            middle = len(content) // 2
            spoilt.writestr(name, content[:middle] + content[middle + 3 :] + b"   " if name.endswith(".dbf") else content)
    capfd.readouterr()
    (source,) = sources.read(tmp_path / "t.zip", ReadOptions()).sources
    assert any("parsed incompletely" in note and "more of its warnings" in note for note in source.notes)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("value", "read"), [("-2147483648", True), ("4294967295", True), ("4294967296", False), ("9" * 400, False)]
)
def test_a_value_of_process_data_has_32_bits(value: str, read: bool) -> None:
    text = f'<TIM A=""><DLV A="0054" B="{value}" C="DET-1"/></TIM>'.encode()
    if read:
        assert timelog.header(text, "TLG00001.XML").constants == {(0x54, "DET-1"): float(value)}
        return
    with pytest.raises(InputError, match=r"^TLG00001.XML: DLV 0: has no identifier or a value that is not a number"):
        timelog.header(text, "TLG00001.XML")


@pytest.mark.parametrize("before", ["\n", "\n\n", "\r\n", "\v", "\f", "\x1c", " \n\t\n"])
@pytest.mark.parametrize("end", ["", "\n"])
def test_one_row_behind_lines_without_any_is_read(tmp_path: Path, before: str, end: str) -> None:
    """Also where the last line is the only one that holds something."""
    row = "-96.42,41.15,12.0,1000,1,60,240,18.5,33,1,777,Field: North,Load: 1,Corn,Corn,1,2,330.0"
    path = tmp_path / "a.txt"
    path.write_text(before + row + end)
    table = sources.read(path, ReadOptions())
    assert len(table) == 1
    assert table["latitude_deg"][0] == 41.15

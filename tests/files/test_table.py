"""Measurement tables: the published ones, unknown values, and one line for each way to get them wrong."""

from __future__ import annotations

import gzip
import zipfile
from pathlib import Path

import numpy as np
import pytest

from yieldmon.errors import InputError
from yieldmon.files import table
from yieldmon.physics.machine import RPM, Machine

DATA = Path(__file__).parent.parent / "data"


@pytest.mark.parametrize(
    ("name", "rows", "reading"), [("dem_table.csv", 162, "momentum_kg_m_s"), ("bench_table.csv", 360, "response")]
)
def test_published_tables(name, rows, reading):
    loaded = table.load(DATA / name)
    assert (len(loaded), loaded.load, loaded.reading) == (rows, "paddle_mass_kg", reading)
    assert len(loaded.text["trial"]) == rows
    assert loaded.notes == ()


def test_unknown_values_and_columns(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text(
        "plate_angle_deg,mass_flow_kg_s,force_n,elevator_speed_rpm,moisture_pct,operator\n"
        "70,12,100,-,nan,ann\n"
        "# a remark\n"
        "60,,50,300,15.5,bob\n",
        encoding="utf-8",
    )
    loaded = table.load(path)
    np.testing.assert_array_equal(loaded.columns["mass_flow_kg_s"], [12.0, np.nan])
    np.testing.assert_allclose(loaded.speed_rad_s(Machine()), [Machine().nominal_elevator_speed_rad_s, 300.0 * RPM])
    assert loaded.text["operator"] == ("ann", "bob")
    assert "operator" in loaded.notes[0]
    machine = Machine()
    passes = loaded.speed_rad_s(machine) * machine.sprocket_pitch_radius_m / machine.paddle_spacing_m
    np.testing.assert_allclose(loaded.momentum(machine) * passes, [100.0, 50.0])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "is empty"),
        ("plate_angle_deg,mass_flow_kg_s,force_n\n70,1,5,2\n", "line 2: has 4 fields; expected 3, as in the header (decimal"),
        ("# note\n\nplate_angle_deg,mass_flow_kg_s,force_n\n70,1,2\n\n70,x,2\n", "line 6, mass_flow_kg_s: is 'x'"),
        ("plate_angle_deg,mass_flow_kg_s,force_n\n70,1_0,2\n", "line 2, mass_flow_kg_s: is '1_0'"),
        ("plate_angle_deg,mass_flow_kg_s,force_n\n", "has a header and no rows"),
        ("mass_flow_kg_s,force_n\n1,2\n", "header: has no plate_angle_deg"),
        ("plate_angle_deg,force_n\n1,2\n", "no load column"),
        ("plate_angle_deg,mass_flow_kg_s,momentum_kg_m_s,paddle_momentum_kg_m_s\n1,2,3,4\n", "under both its names"),
        ("plate_angle_deg,mass_flow_kg_s\n1,2\n", "no reading"),
        ("plate_angle_deg,mass_flow_kg_s,force_n,response\n1,2,3,4\n", "header: has ['force_n', 'response']"),
        ("plate_angle_deg,mass_flow_kg_s,force_n,force_n\n1,2,3,4\n", "force_n more than once"),
        ("plate_angle_deg,mass_flow_kg_s,force_n\n70,x,2\n", "line 2, mass_flow_kg_s: is 'x'; expected a number in kg/s"),
        ("plate_angle_deg,mass_flow_kg_s,force_n\n70,-1,2\n", "line 2, mass_flow_kg_s: is -1; expected 0 to 1000 kg/s"),
        ("plate_angle_deg,mass_flow_kg_s,force_n\n70,1\n", "line 2: has 2 fields; expected 3"),
        ("plate_angle_deg,mass_flow_kg_s,force_n\n-,1,2\n", "line 2, plate_angle_deg: is unknown"),
        ("plate_angle_deg,mass_flow_kg_s,force_n\n700,1,2\n", "line 2, plate_angle_deg: is 700; expected 0 to 180 deg"),
        ("plate_angle_deg,mass_flow_kg_s,force_n\n70,1,inf\n", "line 2, force_n: is inf"),
    ],
)
def test_bad_tables_are_named(tmp_path, text, expected):
    path = tmp_path / "t.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        table.load(path)
    assert expected in str(caught.value)
    assert str(caught.value).startswith(str(path))


def test_a_file_that_is_not_text_and_one_that_is_not_there(tmp_path):
    (tmp_path / "binary.csv").write_bytes(b"\xfe\xfe\x00plate")
    with pytest.raises(InputError, match="not UTF-8"):
        table.load(tmp_path / "binary.csv")
    with pytest.raises(InputError, match="No such file"):
        table.load(tmp_path / "missing.csv")


@pytest.mark.parametrize(
    ("content", "problem"),
    [(gzip.compress(b"plate_angle_deg\n"), "is compressed"), ("plate_angle_deg\n".encode("utf-16"), "is UTF-16 text")],
    ids=["gzip", "utf-16"],
)
def test_what_is_no_plain_text_is_named(tmp_path, content, problem):
    path = tmp_path / "t.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match=problem):
        table.load(path)


PLAIN = [[70.0, 12.5, 100.0], [60.0, np.nan, 50.0]]
WAYS = {
    "commas": "plate_angle_deg,mass_flow_kg_s,force_n\n70,12.5,100\n60,,50\n",
    "semicolons and decimal commas": "plate_angle_deg;mass_flow_kg_s;force_n\n70;12,5;100\n60;;50\n",
    "semicolons and points": "plate_angle_deg;mass_flow_kg_s;force_n\n70;12.5;1,0e2\n60;-;50\n",
    "tabs": "plate_angle_deg\tmass_flow_kg_s\tforce_n\n70\t12.5\t100\n60\tNaN\t50\n",
    "header in capitals": "Plate_Angle_Deg, MASS_FLOW_KG_S ,Force_N\n70,12.5,100\n60,n/a,50\n",
    "byte-order mark": "\ufeffplate_angle_deg,mass_flow_kg_s,force_n\n70,12.5,100\n60,,50\n",
    "quotes and Windows line ends": '"plate_angle_deg","mass_flow_kg_s","force_n"\r\n"70","12.5","100"\r\n"60","","50"\r\n',
}


@pytest.mark.parametrize("text", WAYS.values(), ids=WAYS)
def test_a_table_reads_the_same_however_it_was_saved(tmp_path, text):
    path = tmp_path / "t.csv"
    path.write_bytes(text.encode())
    loaded = table.load(path)
    found = np.stack([loaded.columns[name] for name in ("plate_angle_deg", "mass_flow_kg_s", "force_n")], axis=1)
    np.testing.assert_array_equal(found, PLAIN)
    assert loaded.lines == (2, 3)
    assert "1 row without a load or a reading is left out (line 3)" in loaded.unread(np.isnan(found[:, 1]))


def test_a_workbook_reads_as_its_table(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in (["Plate_angle_deg", "mass_flow_kg_s", "force_n"], [70, 12.5, 100], [60, None, 50.0]):
        book.active.append(row)
    book.save(tmp_path / "t.xlsx")
    loaded = table.load(tmp_path / "t.xlsx")
    found = np.stack([loaded.columns[name] for name in ("plate_angle_deg", "mass_flow_kg_s", "force_n")], axis=1)
    np.testing.assert_array_equal(found, PLAIN)
    (tmp_path / "no.xlsx").write_bytes(b"PK\x03\x04 nothing")
    with pytest.raises(InputError, match="no Excel workbook"):
        table.load(tmp_path / "no.xlsx")


@pytest.mark.parametrize(
    ("filled", "said"),
    [
        (("", "rows", ""), []),
        (("rows", "more"), ["t.xlsx: of its sheets rows is read; not read: more"]),
        (("", "rows", "more", "other"), ["t.xlsx: of its sheets rows is read; not read: more, other"]),
    ],
    ids=["an empty one first", "two", "several"],
)
def test_of_a_workbooks_sheets_the_first_with_cells_is_read(tmp_path, monkeypatch, caplog, filled, said):
    """An empty one before it made the table empty, and others were passed over without a word."""
    openpyxl = pytest.importorskip("openpyxl")
    monkeypatch.chdir(tmp_path)
    book = openpyxl.Workbook()
    book.remove(book.active)
    for number, name in enumerate(filled):
        sheet = book.create_sheet(name or f"empty{number}")
        for row in (["plate_angle_deg", "mass_flow_kg_s", "force_n"], [70, 12.5 + (name != "rows"), 100]) if name else ():
            sheet.append(row)
    book.save("t.xlsx")
    assert list(table.load("t.xlsx").columns["mass_flow_kg_s"]) == [12.5]
    assert [record.getMessage() for record in caplog.records] == said


MAIN = b"http://schemas.openxmlformats.org/spreadsheetml/2006/main"


@pytest.mark.parametrize("member", ["xl/worksheets/sheet1.xml", "xl/workbook.xml"])
@pytest.mark.parametrize("content", [b"", b"<worksheet", b"<worksheet/>", b"\xff\xfe"])
def test_a_damaged_workbook_is_refused(tmp_path, member, content):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["plate_angle_deg", "mass_flow_kg_s", "force_n"])
    book.active.append([70, 12.5, 100])
    book.save(tmp_path / "good.xlsx")
    with zipfile.ZipFile(tmp_path / "good.xlsx") as good, zipfile.ZipFile(tmp_path / "t.xlsx", "w") as spoilt:
        for name in good.namelist():
            spoilt.writestr(name, content if name == member else good.read(name))
    with pytest.raises(InputError, match=r"t\.xlsx"):
        table.load(tmp_path / "t.xlsx")


def test_a_workbook_of_another_program_is_read_without_a_word(tmp_path, recwarn):
    """Without styles, as programs write it that are not Excel."""
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in (["plate_angle_deg", "mass_flow_kg_s", "force_n"], [70, 12.5, 100]):
        book.active.append(row)
    book.save(tmp_path / "good.xlsx")
    with zipfile.ZipFile(tmp_path / "good.xlsx") as good, zipfile.ZipFile(tmp_path / "t.xlsx", "w") as plain:
        for name in good.namelist():
            content = good.read(name)
            plain.writestr(name, b'<styleSheet xmlns="' + MAIN + b'"/>' if name == "xl/styles.xml" else content)
    recwarn.clear()
    assert table.load(tmp_path / "t.xlsx").lines == (2,)
    assert not recwarn.list


def test_a_workbook_of_charts_alone_is_refused(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.create_chartsheet()
    book.remove(book.worksheets[0])
    book.save(tmp_path / "t.xlsx")
    with pytest.raises(InputError, match=r"t\.xlsx"):
        table.load(tmp_path / "t.xlsx")


@pytest.mark.parametrize(
    ("speeds", "note"),
    [
        (("300", "", "nan"), "2 rows have no elevator_speed_rpm (line 3, ...): the machine's nominal speed is taken there"),
        (("300", "300", "-"), "1 row has no elevator_speed_rpm (line 4)"),
        (("", "", ""), ""),
        (("300", "310", "320"), ""),
    ],
)
def test_rows_without_a_speed_in_a_table_that_has_some_are_said(tmp_path: Path, speeds: tuple[str, ...], note: str) -> None:
    path = tmp_path / "t.csv"
    rows = "".join(f"70,10,80,{speed}\n" for speed in speeds)
    path.write_text(f"plate_angle_deg,mass_flow_kg_s,force_n,elevator_speed_rpm\n{rows}")
    notes = "".join(table.load(path).notes)
    assert note in notes
    assert bool(note) is bool(notes)


def test_of_two_loads_and_readings_the_ones_that_hold_something_count(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("plate_angle_deg,mass_flow_kg_s,paddle_mass_kg,force_n,momentum_kg_m_s\n70,-,0.5,nan,3\n80,,0.6,,4\n")
    found = table.load(path)
    assert (found.load, found.reading) == ("paddle_mass_kg", "momentum_kg_m_s")
    path.write_text("plate_angle_deg,mass_flow_kg_s,paddle_mass_kg,force_n,momentum_kg_m_s\n70,-,-,-,-\n")
    found = table.load(path)
    assert (found.load, found.reading) == ("mass_flow_kg_s", "force_n")

"""Exports, each opened by a reader that is not ours: csv, pyarrow, GDAL through geopandas, isoxml on node."""

from __future__ import annotations

import csv
import dataclasses
import json
import os
import shutil
import struct
import subprocess
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest

from tests.file_limit import files_end_at
from tests.seconds import measured_second
from yieldmon import data_dictionary as ddi
from yieldmon.cli import main as cli
from yieldmon.errors import InputError
from yieldmon.export import agleader
from yieldmon.export.points import PointSettings, yield_points
from yieldmon.export.taskdata import ENTRIES, binary_log, files, write
from yieldmon.frames import EstimateQuality
from yieldmon.service.logs.recorded import read_loads, read_seconds
from yieldmon.service.logs.tables import open_table
from yieldmon.service.storage.batch import Batch, Load
from yieldmon.service.storage.rows import SecondRow
from yieldmon.service.storage.store import Store

#: A store of version 0.1.0.
STORE = Path(__file__).resolve().parents[1] / "golden" / "store-0.1.0.sqlite"

ROOT = Path(__file__).parents[2]
START_S = 1_760_000_000
SWATH_M, SPEED_M_S, DELAY_S = 9.0, 2.0, 10
METRE_DEG = 1.0 / 111_195.0


def second(number: int) -> SecondRow:
    """Two passes north from second 1 and 101, 60 s each; grain reaches the sensor DELAY_S later. A sweep in the second pass."""
    driving = 1 <= number <= 60 or 101 <= number <= 160
    measuring = 1 <= number - DELAY_S <= 60 or 101 <= number - DELAY_S <= 160
    flow = 9.0 + (number - DELAY_S) / 100.0
    quality = EstimateQuality.SWEEPING if 130 <= number < 140 else EstimateQuality.OK
    return measured_second(
        number,
        START_S + number + 0.1,
        flow,
        mass_flow_kg_s=flow if measuring else None,
        std_dev_kg_s=0.2 if measuring else None,
        quality=int(quality if measuring else EstimateQuality.NOT_HARVESTING),
        mass_kg=flow if measuring else 0.0,
        load_number=1 if number < 100 else 2,
        load_kg=0.0,
        total_kg=9.0 * number,
        latitude_deg=40.0 + SPEED_M_S * number * METRE_DEG,
        ground_speed_m_s=SPEED_M_S if driving else 0.0,
    )


ROWS = [second(number) for number in range(1, 181)]
LOADS = (
    Load(1, "north", "corn", START_S, START_S + 99.0, 560.0, None),
    Load(2, "north", "corn", START_S + 99.0, None, 600.0, 570.0),
)
WORDS = ["--swath", str(SWATH_M), "--flow-delay", str(DELAY_S), "--field", "north"]
SETTINGS = PointSettings(SWATH_M, DELAY_S)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The record as a table and as a store."""
    place = tmp_path_factory.mktemp("export")
    with open_table(str(place / "r.csv")) as writer:
        for row in ROWS:
            writer.write(row)
    with Store(place / "r.sqlite") as store:
        store.commit([Batch(1, START_S, {}, tuple(ROWS), LOADS)])
    return place


@pytest.fixture
def exported(folder, tmp_path):
    """Exports and returns the file."""

    def run(name: str, *words: str, record: str = "r.csv") -> Path:
        assert cli.main(["export", str(folder / record), "--out", str(tmp_path / name), *words]) == 0
        return tmp_path / name

    return run


def test_grain_goes_back_where_it_was_cut():
    points = yield_points(ROWS, SETTINGS)
    assert points
    for point in points:
        number = round(point.time_s - START_S - 0.1)
        assert point.latitude_deg == 40.0 + SPEED_M_S * number * METRE_DEG
        assert point.mass_flow_kg_s == pytest.approx(9.0 + number / 100.0)
        assert point.yield_kg_m2 == pytest.approx(point.mass_flow_kg_s / (SPEED_M_S * SWATH_M))
        assert point.dry_yield_kg_m2 == pytest.approx(point.yield_kg_m2 * 80.0 / 84.5)


def test_start_and_end_of_each_pass_are_left_out():
    points = yield_points(ROWS, SETTINGS)
    seconds = [round(point.time_s - START_S - 0.1) for point in points]
    assert seconds == [*range(5, 57), *range(105, 157)]
    assert [point.pass_number for point in points] == [1] * 52 + [2] * 52
    assert [point.held for point in points] == [120 <= second < 130 for second in seconds]


def test_a_clock_that_is_set_back_between_two_passes_takes_no_point_away():
    set_back = [dataclasses.replace(row, time_s=row.time_s - 3600.0) if row.number > 80 else row for row in ROWS]
    points, expected = yield_points(set_back, SETTINGS), yield_points(ROWS, SETTINGS)
    assert [(p.pass_number, p.mass_kg, p.latitude_deg) for p in points] == [
        (p.pass_number, p.mass_kg, p.latitude_deg) for p in expected
    ]
    (log,) = ET.fromstring(files(points, lambda _: ("north", ""), lambda _: 15.5)["TASKDATA.XML"]).iter("TIM")
    assert log.attrib["A"] < log.attrib["B"]
    assert int(log.attrib["C"]) > 0


@pytest.mark.parametrize("words", [[], ["--start-delay", "0", "--end-delay", "0"]])
def test_an_export_says_how_much_of_the_grain_its_points_hold(exported, capsys, words):
    found = json.loads(exported("p.geojson", *WORDS, *words).read_text())["features"]
    held = sum(one["properties"]["mass_kg"] for one in found)
    whole = sum(row.mass_kg for row in ROWS)
    assert held <= whole + 1e-6
    assert capsys.readouterr().err.endswith(f"p.geojson: {len(found)} yield points with {held:.0f} of {whole:.0f} kg\n")


def test_a_record_without_positions():
    with pytest.raises(InputError, match="no second with position"):
        yield_points([dataclasses.replace(row, latitude_deg=None) for row in ROWS], SETTINGS)


def test_moisture_not_known_leaves_dry_mass_open():
    points = yield_points([dataclasses.replace(row, moisture_pct=None) for row in ROWS], SETTINGS)
    assert {(point.dry_mass_flow_kg_s, point.dry_yield_kg_m2) for point in points} == {(None, None)}


@pytest.mark.parametrize("record", ["r.csv", "r.sqlite"])
def test_seconds_as_csv_and_parquet(exported, record):
    table = pyarrow.parquet.read_table(exported("s.parquet", record=record)).to_pylist()
    assert table == [dataclasses.asdict(row) for row in ROWS]
    with exported("s.csv", record=record).open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["mass_kg"] for row in rows] == [repr(row.mass_kg) for row in ROWS]
    assert rows[0]["mass_flow_kg_s"] == ""


@pytest.mark.parametrize("place", [0, 4, 200, -9])
def test_a_damaged_table_of_seconds_is_refused(tmp_path, place):
    with open_table(str(tmp_path / "s.parquet")) as writer:
        for number in range(1, 40):
            writer.write(second(number))
    spoilt = bytearray((tmp_path / "s.parquet").read_bytes())
    spoilt[place : place + 8 or None] = b"\xff" * 8
    (tmp_path / "s.parquet").write_bytes(spoilt)
    with pytest.raises(InputError, match=r"s\.parquet"):
        read_seconds(tmp_path / "s.parquet")


def test_a_table_of_seconds_has_no_loads(tmp_path):
    with pytest.raises(InputError, match=r"s\.csv: is a table of seconds, which has no loads; expected a daemon's store"):
        read_loads(tmp_path / "s.csv")


def test_loads_as_csv_and_parquet(exported):
    table = pyarrow.parquet.read_table(exported("l.parquet", "--what", "loads", record="r.sqlite")).to_pylist()
    stored = [dataclasses.asdict(load) for load in LOADS]
    for row in stored:
        # By cause, for the engine alone.
        del row["budget"]
    assert [{name: row[name] for name in stored[0]} for row in table] == stored
    # No ticket came: what was measured is what is corrected, and nothing was posted.
    assert [(row["corrected_mass_kg"], row["ticket_mass_kg"], row["posted_mass_kg"]) for row in table] == [
        (load.mass_kg, None, None) for load in LOADS
    ]
    lines = exported("l.csv", "--what", "loads", record="r.sqlite").read_text(encoding="utf-8").splitlines()
    assert lines[0].split(",") == list(table[0])
    assert len(lines) == 3


@pytest.mark.parametrize("name", ["p.geojson", "p.gpkg"])
def test_maps_open_in_gdal(exported, name):
    import geopandas

    frame = geopandas.read_file(exported(name, *WORDS))
    points = yield_points(ROWS, SETTINGS)
    assert frame.crs.to_epsg() == 4326
    assert set(frame.geom_type) == {"Point"}
    assert np.allclose(frame.geometry.x, [point.longitude_deg for point in points], rtol=0, atol=1e-12)
    assert np.allclose(frame.geometry.y, [point.latitude_deg for point in points], rtol=0, atol=1e-12)
    for column in ("mass_flow_kg_s", "yield_kg_m2", "dry_yield_kg_m2", "moisture_pct", "pass_number", "held", "time_s"):
        assert frame[column].tolist() == [getattr(point, column) for point in points], column


def test_points_as_parquet(exported):
    table = pyarrow.parquet.read_table(exported("p.parquet", "--what", "points", *WORDS)).to_pylist()
    assert table == [dataclasses.asdict(point) for point in yield_points(ROWS, SETTINGS)]


@pytest.mark.parametrize("delay_s", [DELAY_S, DELAY_S + 0.5])
@pytest.mark.parametrize("phase_s", [0.0, 0.25, 0.5])
def test_each_second_of_a_pass_has_its_own_point_wherever_in_the_second_the_rows_end(phase_s: float, delay_s: float) -> None:
    rows = [dataclasses.replace(row, time_s=START_S + row.number + phase_s) for row in ROWS]
    points = yield_points(rows, dataclasses.replace(SETTINGS, flow_delay_s=delay_s))
    for number, seconds in ((1, 60), (2, 60)):
        times_s = [point.time_s for point in points if point.pass_number == number]
        assert np.diff(times_s).tolist() == [1.0] * (len(times_s) - 1)
        assert seconds - 9 <= len(times_s) <= seconds - 7


@pytest.mark.parametrize(("name", "reported"), [("p.txt", True), ("p.zip", False), ("p.geojson", False)])
def test_formats_that_cannot_say_that_the_delay_is_taken_out_are_named(exported, capsys, name: str, reported: bool) -> None:
    exported(name, *WORDS)
    assert ("corrected for a flow delay of 10 s" in capsys.readouterr().err) is reported


def test_agleader_text_gives_the_same_yield(exported):
    """Yield as yield-cleaning tools compute it: flow times interval over distance times swath, in their units."""
    with exported("p.txt", *WORDS).open(encoding="ascii", newline="") as stream:
        lines = list(csv.reader(stream))
    points = yield_points(ROWS, SETTINGS)
    assert {len(line) for line in lines} == {17}
    assert len(lines) == len(points)
    for line, point in zip(lines, points, strict=True):
        longitude, latitude, flow_lb_s, _, interval_s, distance_in, swath_in, moisture_pct, header = map(float, line[:9])
        assert (longitude, latitude) == pytest.approx((point.longitude_deg, point.latitude_deg), abs=6e-8)
        kg_m2 = flow_lb_s * 0.45359237 * interval_s / (distance_in * swath_in * 0.0254**2)
        assert kg_m2 == pytest.approx(point.yield_kg_m2, rel=3e-3)
        assert (moisture_pct, header) == (20.0, 33.0)
    assert lines[0][11:14] == ["F1:north", "L1:<1>", "corn"]


@pytest.mark.parametrize("swath_m", [9.1, 4.57])
def test_agleader_text_has_the_swath_that_was_given(exported, swath_m):
    """9.1 m were written as 358 inches, 0.1 % less."""
    with exported("p.txt", *WORDS, "--swath", str(swath_m)).open(encoding="ascii", newline="") as stream:
        swaths_m = [float(line[6]) * 0.0254 for line in csv.reader(stream)]
    assert swaths_m == pytest.approx([swath_m] * len(swaths_m), rel=3e-5)


def test_agleader_text_of_half_seconds_has_each_second_once(tmp_path):
    """Times of 0.5, 1.5 and 2.5 s were written as 0, 2 and 2; an interval of 1.25 s as 1."""
    points = [dataclasses.replace(p, time_s=p.time_s + 0.4, duration_s=1.25) for p in yield_points(ROWS, SETTINGS)]
    agleader.write(tmp_path / "p.txt", points, lambda _: ("north", "corn"))
    lines = [line.split(",") for line in (tmp_path / "p.txt").read_text().splitlines()]
    assert len({line[3] for line in lines}) == len(lines)
    assert {line[4] for line in lines} == {"1.25"}


#: The example line of Ag Leader's GPS 2000/2100 Operator's Manual (April 1998), page 8-7.
MANUAL_LINE = "-93.62784,42.002036,.5,6,1,1,360,13,3,0,970101,F001:North,L002: Tile,Corn,13,0,935"


def test_agleader_text_has_the_manuals_columns(exported):
    """Same number of columns, and the same kind in each: a decimal number, a whole number, or a word with the same mark."""

    def kind(word: str) -> str:
        head, colon, _ = word.partition(":")
        if colon:
            return head[0] + ":"
        try:
            return "number" if float(word) is not None else ""
        except ValueError:
            return "word"

    (manual,) = csv.reader([MANUAL_LINE])
    with exported("m.txt", *WORDS).open(encoding="ascii", newline="") as stream:
        for line in csv.reader(stream):
            assert [kind(word) for word in line] == [kind(word) for word in manual]


def test_a_field_named_with_quotes_stays_one_column(exported):
    words = [*WORDS[: WORDS.index("--field")], "--field", 'the "long"\nHöhe, groß']
    with exported("q.txt", *words).open(encoding="ascii", newline="") as stream:
        lines = list(csv.reader(stream))
    assert lines
    assert {(len(line), line[11]) for line in lines} == {(17, "F1:the 'long' Hohe, gross")}


def test_task_data_by_the_standards_layout(exported):
    """Parsed from the layout of ISO 11783-10, byte by byte."""
    with zipfile.ZipFile(exported("t.zip", *WORDS)) as archive:
        content = {name: archive.read(name) for name in archive.namelist()}
        assert {member.compress_type for member in archive.infolist()} == {zipfile.ZIP_DEFLATED}
    root = ET.fromstring(content["TASKDATA/TASKDATA.XML"])
    header = ET.fromstring(content["TASKDATA/TLG00001.xml"])
    log = content["TASKDATA/TLG00001.bin"]
    assert (root.tag, root.attrib["VersionMajor"], root.attrib["DataTransferOrigin"]) == ("ISO11783_TaskData", "4", "2")
    assert int(root.find("TSK/TLG").attrib["B"]) == len(log)
    identifiers = [int(value.attrib["A"], 16) for value in header.iter("DLV")]
    assert identifiers == [87, 84, 90, 99, 181, 182, 183, 184, 239, 67]
    assert {int(entry.attrib["B"], 16) for entry in root.iter("DPD")} == set(identifiers)
    presentations = {entry.attrib["A"] for entry in root.iter("DVP")}
    assert {entry.attrib["F"] for entry in root.iter("DPD") if "F" in entry.attrib} == presentations
    points = yield_points(ROWS, SETTINGS)
    place = 0
    for point in points:
        milliseconds, days, north, east, status, count = struct.unpack_from("<IHiiBB", log, place)
        place += 16
        values = {}
        for _ in range(count):
            index, value = struct.unpack_from("<Bi", log, place)
            values[identifiers[index]] = value
            place += 5
        # 1980-01-01 is 3652 days after 1970-01-01.
        assert (days + 3652) * 86400 + milliseconds / 1000 == pytest.approx(point.time_s, abs=1e-3)
        assert (north, east) == (round(point.latitude_deg * 1e7), round(point.longitude_deg * 1e7))
        assert status == 1
        assert values[87] == round(point.mass_flow_kg_s * 1e6)
        assert values[84] == round(point.yield_kg_m2 * 1e6)
        assert (values[99], values[184], values[239]) == (200_000, 155_000, int(point.held))
        assert values[67] == round(point.swath_m * 1000)
    assert place == len(log)
    assert values[90] == round(sum(point.mass_kg for point in points))


@pytest.fixture(scope="session")
def isoxml() -> dict[str, str]:
    """Environment in which node finds the package isoxml."""
    modules = ROOT / "out" / "node" / "node_modules"
    if shutil.which("node") is None or not (modules / "isoxml").is_dir():
        missing = "no node with the package isoxml: tools/isoxml installs it"
        if os.environ.get("CI", "").lower() in ("1", "true"):
            pytest.fail(missing)
        pytest.skip(missing)
    return {**os.environ, "NODE_PATH": str(modules)}


@pytest.mark.isoxml
def test_task_data_with_a_moisture_that_is_not_known_have_no_dry_total():
    dry = ddi.DRY_TOTAL
    for moisture_pct, whole in ((20.0, True), (None, False)):
        rows = [dataclasses.replace(row, moisture_pct=moisture_pct if row.number == 40 else 20.0) for row in ROWS]
        content, totals = binary_log(yield_points(rows, SETTINGS), lambda _: 15.5)
        assert (dry in totals) is whole
        assert totals[ddi.TOTAL_MASS] > 0
        assert content


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"time_s": -1e9}, "cannot hold a point of 1938-04-24T22:13:20Z; expected times from 1980 to 2159"),
        ({"mass_kg": 3e9}, "a point does not fit task data: .*; expected masses below 2 Mt"),
    ],
)
def test_what_task_data_cannot_hold_is_refused(tmp_path: Path, change: dict[str, float], said: str) -> None:
    points = yield_points(ROWS, SETTINGS)
    with pytest.raises(InputError, match=said):
        write(tmp_path / "t.zip", [points[0], dataclasses.replace(points[1], **change)], lambda _: ("north", ""), lambda _: 15.5)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ValueError, match="no points"):
        files([], lambda _: ("north", ""), lambda _: 15.5)


def test_task_data_in_an_independent_reader(exported, isoxml):
    words = ["node", str(Path(__file__).with_name("read_taskdata.cjs")), str(exported("t.zip", *WORDS))]
    done = subprocess.run(words, env=isoxml, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    points = yield_points(ROWS, SETTINGS)
    assert (found["warnings"], found["errors"]) == ([], [])
    assert found["field"]["PartfieldDesignator"] == "north"
    units = {info["DDINumber"]: info["unit"] for info in found["valuesInfo"]}
    assert units == {entry.ddi: entry.unit or "n.a." for entry in ENTRIES}
    assert len(found["records"]) == len(points)
    for record, point in zip(found["records"], points, strict=True):
        assert record["position"]["PositionNorth"] == pytest.approx(point.latitude_deg, abs=6e-8)
        assert record["position"]["PositionEast"] == pytest.approx(point.longitude_deg, abs=6e-8)
        values = record["values"]
        assert values["0057_DET-1"] == round(point.mass_flow_kg_s * 1e6)
        assert values["00B5_DET-1"] == round(point.dry_yield_kg_m2 * 1e6)
        assert values["00EF_DET-1"] == int(point.held)
    totals = {int(total["ProcessDataDDI"], 16): total["ProcessDataValue"] for total in found["totals"]}
    assert totals[90] == round(sum(point.mass_kg for point in points))


def test_task_data_is_read_by_map(exported, capsys):
    path = exported("t.zip", *WORDS)
    assert cli.main(["map", str(path), "--out", "unused", "--products", "none", "--json", "--flow-delay", "0"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["mass_kg"]["integrated"] == pytest.approx(sum(point.mass_kg for point in yield_points(ROWS, SETTINGS)), rel=0.01)


def test_task_data_say_that_the_delay_is_taken_out(exported, capsys):
    assert cli.main(["map", str(exported("p.zip", *WORDS)), "--out", "unused", "--products", "none", "--json"]) == 0
    delay = json.loads(capsys.readouterr().out)["delay"]["flow_s"]
    assert (delay["declared"], delay["value"]) == (0.0, 0.0)


def test_task_data_as_a_folder(exported):
    folder = exported("card", "--format", "taskdata", *WORDS)
    assert sorted(path.name for path in (folder / "TASKDATA").iterdir()) == ["TASKDATA.XML", "TLG00001.bin", "TLG00001.xml"]


FIELDS = {1: ("north", "corn"), 2: ("south", "soybean")}


def test_task_data_has_a_task_for_each_field_and_crop(tmp_path, capsys):
    """Grain of all fields and crops was one total of one field."""
    with Store(tmp_path / "s.sqlite") as store:
        loads = tuple(dataclasses.replace(load, field=FIELDS[load.number][0], crop=FIELDS[load.number][1]) for load in LOADS)
        store.commit([Batch(1, START_S + 200.0, {}, tuple(ROWS), loads)])
    words = ["export", str(tmp_path / "s.sqlite"), "--out", str(tmp_path / "t.zip"), *WORDS[:4]]
    assert cli.main(words) == 0
    with zipfile.ZipFile(tmp_path / "t.zip") as archive:
        root = ET.fromstring(archive.read("TASKDATA/TASKDATA.XML"))
        assert {f"TASKDATA/TLG0000{n}.{end}" for n in (1, 2) for end in ("bin", "xml")} < set(archive.namelist())
    crops = {one.attrib["A"]: one.attrib["B"] for one in root.iter("CTP")}
    fields = {one.attrib["A"]: (one.attrib["C"], crops[one.attrib["G"]]) for one in root.iter("PFD")}
    totals = {
        fields[task.attrib["E"]]: int(value.attrib["B"])
        for task in root.iter("TSK")
        for value in task.iter("DLV")
        if int(value.attrib["A"], 16) == 90
    }
    points = yield_points(ROWS, SETTINGS)
    sums = {FIELDS[n]: round(sum(point.mass_kg for point in points if point.load_number == n)) for n in FIELDS}
    assert totals == sums
    assert cli.main([*words[:3], str(tmp_path / "one.zip"), *WORDS[:4], "--field", "all", "--grain", "corn"]) == 0
    with zipfile.ZipFile(tmp_path / "one.zip") as archive:
        root = ET.fromstring(archive.read("TASKDATA/TASKDATA.XML"))
    assert [one.attrib["C"] for one in root.iter("PFD")] == ["all"]


def test_task_data_is_not_written_beside_another_log(exported, folder, capsys):
    """A reader would take that log's harvest, too."""
    card = exported("card2", "--format", "taskdata", *WORDS)
    (card / "TASKDATA" / "TLG00002.bin").write_bytes(b"")
    words = ["export", str(folder / "r.csv"), "--out", str(card), "--format", "taskdata", "--force", *WORDS]
    assert cli.main(words) == 2
    assert "holds logs that these task data do not replace (TLG00002.bin); expected another folder" in capsys.readouterr().err


def test_no_part_of_task_data_is_left_on_a_full_medium(folder, exported, capsys):
    """A TASKDATA.XML was left that names a log which is not there."""
    card = exported("card", "--format", "taskdata", *WORDS)
    before = {path.name: path.read_bytes() for path in (card / "TASKDATA").iterdir()}
    words = ["export", str(folder / "r.csv"), "--out", str(card), "--format", "taskdata", "--force", "--field", "x" * 30, *WORDS]
    with files_end_at(max(map(len, before.values())) - 1):
        assert cli.main(words) == 1
    assert f"\nyieldmon: {card / 'TASKDATA'}: File too large" in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in (card / "TASKDATA").iterdir()} == before


WRONG = [
    (["r.csv", "--out", "x.kml"], "yieldmon: --out: is x.kml; expected a name that ends in one of "),
    (["r.csv", "--out", "x.geojson"], "yieldmon: --swath: is missing; expected the working width in m"),
    (["r.csv", "--out", "x.geojson", "--swath", "0"], "yieldmon: --swath: is 0; expected 0.1 to 50"),
    (["r.csv", "--out", "x.gpkg", "--what", "loads"], "yieldmon: --what: loads as geopackage; expected loads as csv or parquet"),
    (["r.csv", "--out", "x.csv", "--what", "loads"], "r.csv: "),
    (["r.csv", "--out", "x.txt", "--swath", "9", "--flow-delay", "61"], "yieldmon: --flow-delay: is 61; expected 0 to 60"),
    (["gone.sqlite", "--out", "x.csv"], "gone.sqlite: no such file"),
    (["bad.csv", "--out", "x.csv"], "bad.csv: line 2: has no column 'number'; expected a table"),
    (["word.csv", "--out", "x.csv"], "word.csv: line 2: number: is 'one'; expected a value of kind int"),
]


@pytest.mark.parametrize(("words", "line"), WRONG)
def test_one_line_for_what_cannot_be_exported(words, line, folder, capsys, monkeypatch):
    (folder / "bad.csv").write_text("a,b\n1,2\n", encoding="utf-8")
    good = (folder / "r.csv").read_text(encoding="utf-8").splitlines()
    (folder / "word.csv").write_text(f"{good[0]}\n{good[1].replace('1,', 'one,', 1)}\n", encoding="utf-8")
    monkeypatch.chdir(folder)
    assert cli.main(["export", *words]) == 2
    said = capsys.readouterr().err
    assert line in said
    assert said.count("\n") == 1
    assert not list(folder.glob("x.*"))


VERBS = [
    ["export", "{store}", "--out", "{out}.csv"],
    ["export", "{store}", "--out", "{out}.csv", "--what", "loads"],
    ["plot", "flow", "{store}", "--out", "{out}.png"],
]


@pytest.mark.parametrize("words", VERBS, ids=lambda words: " ".join(words[-2:]))
def test_a_store_that_is_read_stays_as_it_is(words, folder, tmp_path):
    """Also one of the version before, which a daemon would bring up to date."""
    store, out = tmp_path / "store" / "r.sqlite", tmp_path / "x"
    store.parent.mkdir()
    shutil.copy(STORE, store)
    before = store.read_bytes()
    assert cli.main([word.format(store=store, out=out) for word in words]) == 0
    assert store.read_bytes() == before
    assert [entry.name for entry in store.parent.iterdir()] == ["r.sqlite"]


@pytest.mark.parametrize("words", VERBS, ids=lambda words: " ".join(words[-2:]))
def test_an_empty_file_is_no_store_and_becomes_none(words, tmp_path, capsys):
    empty = tmp_path / "r.sqlite"
    empty.touch()
    assert cli.main([word.format(store=empty, out=tmp_path / "x") for word in words]) == 2
    assert capsys.readouterr().err.startswith(f"yieldmon: {empty}: is ")
    assert empty.read_bytes() == b""


def test_without_pyogrio_one_line(monkeypatch, folder, tmp_path, capsys):
    monkeypatch.setitem(__import__("sys").modules, "pyogrio.raw", None)
    monkeypatch.setitem(__import__("sys").modules, "pyogrio", None)
    assert cli.main(["export", str(folder / "r.csv"), "--out", str(tmp_path / "x.gpkg"), *WORDS]) == 1
    assert capsys.readouterr().err == "yieldmon: needs pyogrio, which is not installed; pip install 'yieldmon[geo]'\n"


def test_a_geopackage_that_outgrows_its_medium_is_one_line(folder, tmp_path, capsys):
    """GDAL reports it with errors of its own."""
    out = tmp_path / "out"
    out.mkdir()
    with files_end_at(8192):
        assert cli.main(["export", str(folder / "r.csv"), "--out", str(out / "x.gpkg"), *WORDS]) == 1
    said = capsys.readouterr().err
    assert said.startswith(f"yieldmon: {out / 'x.gpkg'}: ")
    assert said.count("\n") == 1
    assert "; expected " in said
    assert list(out.iterdir()) == []


def test_empty_loads_are_left_out_and_counted(tmp_path, capsys):
    loads = (*LOADS[:1], Load(2, "", "", START_S, START_S + 1.0, 0.0, 0.0), Load(3, "", "", START_S, None, 0.0, 0.0))
    with Store(tmp_path / "s.sqlite") as store:
        store.commit([Batch(1, START_S, {}, tuple(ROWS), loads)])
    words = ["export", str(tmp_path / "s.sqlite"), "--out", str(tmp_path / "l.csv"), "--what", "loads", "--force"]
    for given, numbers, said in (
        ([], ["1", "3"], "l.csv: 2 loads; 1 empty load not listed; --all lists it\n"),
        (["--all"], ["1", "2", "3"], "l.csv: 3 loads\n"),
    ):
        assert cli.main([*words, *given]) == 0
        with (tmp_path / "l.csv").open(encoding="utf-8") as stream:
            assert [row["number"] for row in csv.DictReader(stream)] == numbers
        assert capsys.readouterr().err.endswith(said)
    assert cli.main([*words[:4], "--all", "--force"]) == 2
    assert "--all: has no meaning with seconds; expected --what loads" in capsys.readouterr().err


def test_grain_between_loads_has_no_load_number(tmp_path, capsys):
    """As `map` has it: what comes after a load's end carries its number in the record and belongs to none."""
    loads = (Load(1, "north", "wheat", START_S, START_S + 50.5, 560.0, None), dataclasses.replace(LOADS[1], crop="wheat"))
    with Store(tmp_path / "s.sqlite") as store:
        store.commit([Batch(1, START_S, {}, tuple(ROWS), loads)])
    words = [str(tmp_path / "s.sqlite"), "--swath", "9", "--flow-delay", str(DELAY_S), "--what", "points", "--out"]
    assert cli.main(["export", *words, str(tmp_path / "p.csv")]) == 0
    with (tmp_path / "p.csv").open(encoding="utf-8") as stream:
        points = list(csv.DictReader(stream))
    # Cut at second n, measured at n + DELAY_S.
    seconds = [round(float(point["time_s"]) - START_S - 0.1) for point in points]
    expected = ["2" if n > 100 else "1" if n + DELAY_S <= 50 else "" for n in seconds]
    assert [point["load_number"] for point in points] == expected
    assert {"", "1", "2"} == set(expected)
    # Dry at the moisture of both loads' crop, which is not the one of corn.
    assert {round(float(p["dry_yield_kg_m2"]) / float(p["yield_kg_m2"]), 6) for p in points} == {round(80.0 / 86.5, 6)}
    for name in ("p.txt", "p.zip", "p.gpkg", "p.parquet"):
        assert cli.main(["export", *words, str(tmp_path / name)]) == 0
    lines = (tmp_path / "p.txt").read_text(encoding="ascii").splitlines()
    assert {tuple(line.split(",")[12:14]) for line in lines} == {(f'"L{n}:<1>"', '"wheat"') for n in (0, 1, 2)}
    table = pyarrow.parquet.read_table(tmp_path / "p.parquet").to_pylist()
    assert [row["load_number"] for row in table] == [int(n) if n else None for n in expected]


def test_a_stores_points_have_the_field_crop_and_dry_mass_of_their_loads(tmp_path):
    """As `load list` has them: wheat is dry at 13.5 %, corn at 15.5."""
    rows = [dataclasses.replace(row, load_number=1 if row.number <= 99 else 2, moisture_pct=20.0) for row in ROWS]
    loads = (
        Load(1, "north", "wheat", START_S, START_S + 99.0, 560.0, None),
        Load(2, "south", "", START_S + 99.0, None, 600.0, None),
    )
    with Store(tmp_path / "two.sqlite") as store:
        store.commit([Batch(1, START_S, {}, tuple(rows), loads)])
    words = ["export", str(tmp_path / "two.sqlite"), "--swath", "9", "--flow-delay", str(DELAY_S), "--out"]
    assert cli.main([*words, str(tmp_path / "t.txt")]) == 0
    written = {tuple(line.split(",")[11:14]) for line in (tmp_path / "t.txt").read_text().splitlines()}
    assert written == {('"F1:north"', '"L1:<1>"', '"wheat"'), ('"F1:south"', '"L2:<1>"', '"corn"')}
    for given, of_wheat in (([], 80.0 / 86.5), (["--grain", "rice"], 80.0 / 87.0), (["--reference-moisture", "10"], 80.0 / 90.0)):
        assert cli.main([*words, str(tmp_path / "t.csv"), "--what", "points", "--force", *given]) == 0
        with (tmp_path / "t.csv").open(encoding="utf-8") as stream:
            points = list(csv.DictReader(stream))
        shares = {p["load_number"]: float(p["dry_yield_kg_m2"]) / float(p["yield_kg_m2"]) for p in points}
        assert shares == {"1": pytest.approx(of_wheat), "2": pytest.approx(of_wheat if given else 80.0 / 84.5)}

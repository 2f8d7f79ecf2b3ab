"""Text and vector files as other programs write them: names, languages, clocks and states."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from yieldmon.errors import InputError
from yieldmon.field import sources
from yieldmon.field.sources.options import ReadOptions
from yieldmon.field.table import HarvestTable

#: Three points 2 m apart, one second each, 1 kg on 2 m by 9.144 m: 0.5468 t/ha; the header is up at the last.
OFFICE = """Longitude,Latitude,Field,Product,Obj. Id,Distance(ft),Duration(s),Area Count,Swth Wdth(ft),Crop Flw(M)(lb/s),\
Moisture(%),Yld Mass(Dry)(lb/ac),Pass Num,Date
-92.1,39.0,North 40,CORN,1,6.5617,1,On,30,2.20462,16,9,1,9/23/2013 11:59:59 AM
-92.1,39.00001796,North 40,CORN,2,6.5617,1,On,30,2.20462,16,9,1,9/23/2013 12:00:00 PM
-92.1,39.00003592,North 40,CORN,3,6.5617,1,Off,30,2.20462,16,9,1,9/23/2013 12:00:01 PM
"""
GERMAN = """Längengrad;Breitengrad;Datum;Uhrzeit;Ertrag [t/ha];Feuchte [%];Geschwindigkeit [km/h];Arbeitsbreite [m];Frucht
-92,1;39,0;23.09.2013;11:59:59;0,5468;16,0;7,2;9,144;Mais
-92,1;39,00001796;23.09.2013;12:00:00;0,5468;16,0;7,2;9,144;Mais
-92,1;39,00003592;23.09.2013;12:00:01;0,5468;16,0;7,2;9,144;Mais
"""
SPANISH = """longitud,latitud,timestamp,Rendimiento (kg/ha),Humedad (%),Velocidad (m/s),Ancho (m),Cultivo,work state
-92.1,39.0,2013-09-23T11:59:59Z,546.8,16.0,2.0,9.144,Maíz,working
-92.1,39.00001796,2013-09-23T12:00:00Z,546.8,16.0,2.0,9.144,Maíz,working
-92.1,39.00003592,2013-09-23T12:00:01Z,546.8,16.0,2.0,9.144,Maíz,raised
"""
NOON_S = 1_379_937_600.0


def looks_right(table: HarvestTable) -> None:
    assert table.unix_time
    assert table["time_s"].tolist() == [NOON_S - 1, NOON_S, NOON_S + 1]
    assert table["flow_kg_s"] == pytest.approx([1.0, 1.0, 1.0], rel=1e-3)
    assert table["moisture_pct"].tolist() == [16.0, 16.0, 16.0]
    assert table["width_m"] == pytest.approx([9.144] * 3, rel=1e-6)
    assert len(set(table.labels["crop"].text().tolist())) == 1


@pytest.mark.parametrize(
    ("content", "encoding", "down"),
    [
        (OFFICE, "utf-8-sig", [1, 1, 0]),
        (OFFICE, "utf-16", [1, 1, 0]),
        (GERMAN, "cp1252", None),
        (GERMAN, "utf-8", None),
        (GERMAN.replace("[t/ha]", "[dt/ha]").replace("0,5468", "5,468"), "utf-8", None),
        (SPANISH.replace("(kg/ha)", "(q/ha)").replace("546.8", "5.468"), "utf-8", [1, 1, 0]),
        (SPANISH.replace("(kg/ha)", "(sc/ha)").replace("546.8", "9.1133"), "utf-8", [1, 1, 0]),
        (SPANISH.replace("Rendimiento", "(hum.)Masa de rend.").replace("Ancho", "Anch. de fja."), "utf-8", [1, 1, 0]),
        (SPANISH, "utf-8", [1, 1, 0]),
        (SPANISH, "cp1252", [1, 1, 0]),
        (SPANISH.replace("working", "in Betrieb").replace("raised", "NA"), "utf-8", [np.nan] * 3),
    ],
    ids=[
        "office",
        "office utf-16",
        "german windows",
        "german utf-8",
        "decitonnes",
        "quintals",
        "sacks of 60 kg",
        "spanish SMS",
        "spanish utf-8",
        "spanish windows",
        "strange states",
    ],
)
def test_texts(content: str, encoding: str, down: list[float] | None, tmp_path: Path) -> None:
    path = tmp_path / "field.csv"
    path.write_text(content, encoding=encoding, newline="\r\n")
    table = sources.read(path, ReadOptions())
    looks_right(table)
    if down is not None:
        assert np.array_equal(table["header_down"], down, equal_nan=True)
    reported = any("neither on nor off" in note for note in table.sources[0].notes)
    assert reported == ("Betrieb" in content)


@pytest.mark.parametrize("clock", ["moments", "days", "both"])
def test_vector_files_date_their_points(clock: str, tmp_path: Path) -> None:
    geopandas = pytest.importorskip("geopandas")
    moments = np.array([NOON_S - 1, NOON_S, NOON_S + 1]).astype("datetime64[s]").astype("datetime64[ms]")
    columns: dict[str, Any] = {"Flow(kg/s)": [1.0] * 3, "Moisture": [16.0] * 3, "Swath(m)": [9.144] * 3, "Crop": ["Corn"] * 3}
    if clock != "moments":
        columns["Date"] = moments.astype("datetime64[D]").astype(object) if clock == "days" else moments
    if clock != "days":
        columns["Time" if clock == "moments" else "GpsTime"] = moments
    points = geopandas.points_from_xy([-92.1] * 3, [39.0, 39.00001796, 39.00003592])
    path = tmp_path / "field.gpkg"
    geopandas.GeoDataFrame(columns, geometry=points, crs="EPSG:4326").to_file(path)
    table = sources.read(path, ReadOptions())
    if clock == "days":
        assert "no time" in table.sources[0].notes[-1]
    else:
        looks_right(table)


def test_geojson_a_feature_a_line(tmp_path: Path) -> None:
    said = {"Flow(kg/s)": 1.0, "Moisture": 16.0, "Swath(m)": 9.144}
    lines = []
    for clock, latitude in (("11:59:59", 39.0), ("12:00:00", 39.00001796), ("12:00:01", 39.00003592)):
        place = {"type": "Point", "coordinates": [-92.1, latitude]}
        properties = {"Time": f"2013-09-23T{clock}Z", **said}
        lines.append(json.dumps({"type": "Feature", "properties": properties, "geometry": place}))
    path = tmp_path / "field.geojsonl"
    path.write_text("\n".join([*lines, ""]))
    looks_right(sources.read(path, ReadOptions()))


#: Three rows of Ag Leader text 2 m apart, 1 kg/s; the header is up at the last.
AG_LEADER = """-92.1,39.0,2.20462,43199,1,78.74,360,16.0,33,1,4711,F1:north,L1:<1>,Corn
-92.1,39.00001796,2.20462,43200,1,78.74,360,16.0,33,1,4711,F1:north,L1:<1>,Corn
-92.1,39.00003592,2.20462,43201,1,78.74,360,16.0,32,1,4711,F1:north,L1:<1>,Corn
"""
HEADER = "Longitude,Latitude,Flow,GPS Time,Interval,Distance,Swath,Moisture,Header Status,Pass,Serial,Field,Load,Grain\n"
UNITS = HEADER.replace("Flow", "Flow(lb/s)").replace("Interval", "Interval(s)").replace("Swath", "Swath(in)")


@pytest.mark.parametrize("suffix", [".txt", ".csv", ".TXT", ".dat"])
@pytest.mark.parametrize(
    "content",
    [
        AG_LEADER,
        AG_LEADER.replace(",", ";").replace(".", ","),
        AG_LEADER.replace(",", "\t").replace(".", ","),
        AG_LEADER.replace(",", " , "),
        AG_LEADER.replace(",Corn", ',"Corn","DK 616",7,1.2,812.3'),
        HEADER + AG_LEADER,
        UNITS.replace("Distance", "Distance(in)") + AG_LEADER,
        (HEADER + AG_LEADER).replace(",", ";").replace(".", ","),
    ],
    ids=["plain", "semicolons", "tabs", "blanks", "advanced", "header", "header with units", "header, semicolons"],
)
def test_ag_leader_dialects(content: str, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"field{suffix}"
    path.write_text(content, encoding="utf-8-sig", newline="\r\n")
    table = sources.read(path, ReadOptions())
    assert table.sources[0].kind == "Ag Leader text"
    assert table.sources[0].skipped == ()
    assert table["flow_kg_s"] == pytest.approx([1.0, 1.0, 1.0], rel=1e-5)
    assert table["longitude_deg"].tolist() == [-92.1] * 3
    assert table["width_m"] == pytest.approx([9.144] * 3, rel=1e-6)
    assert table["header_down"].tolist() == [1, 1, 0]
    assert table.labels["field"].names == ("F1:north",)


def test_a_header_without_units_needs_ways_in_inches(tmp_path: Path) -> None:
    path = tmp_path / "metric.csv"
    path.write_text(HEADER + AG_LEADER.replace("78.74", "2.0"))
    with pytest.raises(InputError, match="states no units, and the distances are not in inches"):
        sources.read(path, ReadOptions())
    units = {"flow": ("Flow", "kg/s"), "distance": ("Distance", "m"), "width": ("Swath", "in"), "interval": ("Interval", "s")}
    table = sources.read(path, ReadOptions(columns=units))
    assert table["flow_kg_s"].tolist() == [2.20462] * 3
    assert table["distance_m"].tolist() == [2.0] * 3
    assert table["header_down"].tolist() == [1, 1, 0]


@pytest.mark.parametrize(
    ("states", "down"),
    [
        (("33", "33", "32"), [1, 1, 0]),
        (("1", "1", "0"), [1, 1, 0]),
        (("2", "1", "0"), [1, 1, 0]),
        (("true", "On", "raised"), [1, 1, 0]),
    ],
)
def test_states_of_a_header(states: tuple[str, ...], down: list[float], tmp_path: Path) -> None:
    path = tmp_path / "states.csv"
    rows = [f"-92.1,{39.0 + 0.00001796 * k:.8f},{k},1.0,9.0,{state}" for k, state in enumerate(states)]
    path.write_text("lon,lat,time,flow_kg_s,width_m,header\n" + "\n".join(rows))
    assert sources.read(path, ReadOptions())["header_down"].tolist() == down


@pytest.mark.parametrize("delimiter", [",", "\t", ";"])
def test_decimal_commas(delimiter: str, tmp_path: Path) -> None:
    path = tmp_path / "comma.csv"
    rows = [delimiter.join(f'"{cell}"' for cell in ("-92,1", f"39,0000{k}", str(k), "1,5", "9")) for k in range(3)]
    path.write_text(delimiter.join(("lon", "lat", "time", "flow_kg_s", "width_m")) + "\n" + "\n".join(rows))
    table = sources.read(path, ReadOptions())
    assert table["flow_kg_s"].tolist() == [1.5] * 3
    assert table["longitude_deg"].tolist() == [-92.1] * 3


@pytest.mark.parametrize(
    ("times", "unit", "unix"),
    [
        (("1379937599", "1379937600", "1379937601"), "", True),
        (("1379937599000", "1379937600000", "1379937601000"), "", True),
        (("1379937599000", "1379937600000", "1379937601000"), "ms", True),
        (("1379937599.0", "1379937600.0", "1379937601.0"), "", True),
        (("2013092311", "2013092312", "2013092313"), "s", True),
        (("20130923115959", "20130923120000", "20130923120001"), "", True),
        (("20130923T115959", "20130923T120000", "20130923T120001"), "", True),
        (("24538654", "24538655", "24538656"), "s", False),
        (("20111231", "20111232", "20111233"), "", False),
        (("43199", "43200", "43201"), "", False),
        (("43199.5", "43200.5", "43201.5"), "", False),
    ],
)
def test_times_that_are_numbers(times: tuple[str, ...], unit: str, unix: bool, tmp_path: Path) -> None:
    path = tmp_path / "clock.csv"
    rows = [f"-92.1,{39.0 + 0.00001796 * k:.8f},{time},1.0,9.0" for k, time in enumerate(times)]
    path.write_text("lon,lat,timestamp,flow_kg_s,width_m\n" + "\n".join(rows))
    table = sources.read(path, ReadOptions(columns={"time": ("timestamp", unit)} if unit else {}))
    assert np.diff(table["time_s"]).tolist() == [1.0, 1.0]
    assert table["interval_s"].tolist() == [1.0, 1.0, 1.0]
    assert table.unix_time == unix
    if unix and unit != "s":
        assert table["time_s"][1] == NOON_S


def test_positions_of_a_text_in_a_plane(tmp_path: Path) -> None:
    """UTM zone 15: 500 km east is its middle, 93 degrees west."""
    path = tmp_path / "utm.csv"
    path.write_text("x,y,time,flow_kg_s,width_m\n" + "\n".join(f"500000,{4_316_776.6 + 2 * k},{k},1.0,9.0" for k in range(3)))
    table = sources.read(path, ReadOptions(crs="EPSG:32615"))
    assert table["longitude_deg"] == pytest.approx([-93.0] * 3, abs=1e-7)
    assert table["latitude_deg"] == pytest.approx([39.0] * 3, abs=1e-3)
    with pytest.raises(InputError, match="not known"):
        sources.read(path, ReadOptions(crs="EPSG:99999"))


@pytest.mark.parametrize(
    ("mass", "names"), [("load_kg", ()), ("Load (kg)", ()), ("load_kg,load_number", ("7",)), ("Load", ("512.5",))]
)
def test_a_mass_of_a_load_is_no_loads_name(tmp_path: Path, mass: str, names: tuple[str, ...]) -> None:
    path = tmp_path / "record.csv"
    cells = ",".join({"load_number": "7"}.get(name, "512.5") for name in mass.split(","))
    rows = [f"-92.1,{39.0 + 2e-5 * k},{1.7e9 + k},2.0,5.0,9.1,{cells}" for k in range(3)]
    head = f"longitude_deg,latitude_deg,time_s,ground_speed_m_s,mass_flow_kg_s,width_m,{mass}"
    path.write_text("\n".join([head, *rows]) + "\n")
    found = sources.read(path, ReadOptions())
    assert tuple(name for name in found.labels["load"].names if name) == names


#: One point a second, 2 m apart, 1 kg/s on 9.144 m.
LOGGED = 400
HEADING = "Longitude,Latitude,Flow(kg/s),Swath(m),Distance(m),Moisture(%),When"


def logged(when: list[str], *, order: list[int] | None = None, moisture: str = "16.0") -> str:
    rows = [f"-92.1,{39.0 + 1.798e-5 * n:.8f},1.0,9.144,2.0,{moisture},{when[n]}" for n in range(LOGGED)]
    return "\n".join([HEADING, *(rows[n] for n in order or range(LOGGED))]) + "\n"


def read_logged(content: str, tmp_path: Path, time: str = "When") -> HarvestTable:
    path = tmp_path / "field.csv"
    path.write_text(content)
    return sources.read(path, ReadOptions({"time": (time.partition(":")[0], time.partition(":")[2])}))


@pytest.mark.parametrize("unit", ["", ":d"])
def test_days_of_a_spreadsheet_to_five_digits(unit: str, tmp_path: Path) -> None:
    days = [f"{41880.47525 + n / 86400.0:.5f}" for n in range(LOGGED)]
    table = read_logged(logged(days), tmp_path, f"When{unit}")
    assert table.unix_time
    # 29 August 2014, 11:24:21 UTC: (41880.47525 - 25569) days since 1970.
    assert table["time_s"][0] == pytest.approx(1_409_311_461.6, abs=1.0)
    assert np.ptp(table["interval_s"][20:-20]) < 0.2
    assert (table["flow_kg_s"] * table["interval_s"]).sum() == pytest.approx(LOGGED, rel=0.01)
    assert any("evened out" in note for note in table.sources[0].notes)


def test_steps_that_really_differ_stay(tmp_path: Path) -> None:
    moments = np.cumsum(np.where(np.arange(LOGGED) % 3 == 0, 3.0, 1.0))
    rows = [
        f"-92.1,{39.0 + 8.99e-6 * 2.0 * moment:.8f},1.0,9.144,{2.0 * step},16.0,{moment}"
        for moment, step in zip(moments, np.diff(moments, prepend=0.0), strict=True)
    ]
    table = read_logged("\n".join([HEADING, *rows]) + "\n", tmp_path, "When:s")
    assert table["time_s"].tolist() == moments.tolist()
    assert not any("evened" in note for note in table.sources[0].notes)


def test_days_without_times_are_no_clock(tmp_path: Path) -> None:
    table = read_logged(logged(["2018-07-18"] * LOGGED), tmp_path)
    assert not table.unix_time
    assert table["time_s"].tolist() == list(range(LOGGED))
    assert any("holds days and no times" in note for note in table.sources[0].notes)


def test_rows_without_times_in_another_order_are_refused(tmp_path: Path) -> None:
    order = np.random.default_rng(11).permutation(LOGGED).tolist()
    with pytest.raises(InputError, match=r"not in the order driven .*expected --column time"):
        read_logged(logged(["2018-07-18"] * LOGGED, order=order), tmp_path)
    assert len(read_logged(logged([str(n) for n in range(LOGGED)], order=order), tmp_path)) == LOGGED


@pytest.mark.parametrize(
    ("quantity", "unit", "message"),
    [
        ("time", "weeks", "has the unit 'weeks'; expected one of s, "),
        ("header", "kg", "--column header: has the unit 'kg'"),
        ("pass", "m", "--column pass: has the unit 'm'"),
    ],
)
def test_a_unit_that_would_count_for_nothing_is_refused(quantity: str, unit: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "field.csv"
    path.write_text(logged([str(n) for n in range(LOGGED)]))
    with pytest.raises(InputError, match=message):
        sources.read(path, ReadOptions({quantity: ("When", unit)}))


def test_the_hint_names_the_quantity_of_the_column(tmp_path: Path) -> None:
    path = tmp_path / "field.csv"
    path.write_text("Longitude,Latitude,Yield,Swath(m)\n-92.1,39.0,5.1,9.144\n")
    with pytest.raises(InputError, match="states no known unit for Yield; expected --column yield=Yield:UNIT"):
        sources.read(path, ReadOptions())


@pytest.mark.parametrize(
    ("cut", "quantity"),
    [("Yld_Vol_Dr", "yield"), ("Yld_Mass_W", "yield"), ("Yld_Mass_D", "yield"), ("Crop_Flw_M", "flow"), ("Swth_Wdth_", "width")],
)
def test_names_as_shapefiles_cut_them(cut: str, quantity: str, tmp_path: Path) -> None:
    path = tmp_path / "field.csv"
    path.write_text(f"Longitude,Latitude,{cut}\n-92.1,39.0,5.1\n")
    with pytest.raises(InputError, match=f"states no known unit for {cut}; expected --column {quantity}={cut}:UNIT"):
        sources.read(path, ReadOptions())


def test_no_moisture_is_0(tmp_path: Path) -> None:
    table = read_logged(logged([str(n) for n in range(LOGGED)], moisture="0"), tmp_path)
    assert np.isnan(table["moisture_pct"]).all()
    assert any("moisture_pct" in note for note in table.sources[0].notes)


def test_a_german_log_by_flow_names_its_machine_and_load(tmp_path: Path) -> None:
    path = tmp_path / "drusch.csv"
    head = "Längengrad;Breitengrad;Zeit;Durchfluss [t/h];Geschwindigkeit [km/h];Arbeitsbreite [m];Maschine;Ladung"
    rows = [f"-92,1;39,0000{1800 * k:04d};2013-09-23T12:00:0{k}Z;3,6;7,2;9,144;4711;Hof 3" for k in range(3)]
    path.write_text("\n".join([head, *rows, ""]), encoding="utf-8")
    table = sources.read(path, ReadOptions())
    assert table["flow_kg_s"] == pytest.approx([1.0, 1.0, 1.0])
    assert (table.labels["machine"].names, table.labels["load"].names) == (("4711",), ("Hof 3",))


@pytest.mark.parametrize("place", ["Länge;Breite", "Laenge [°];Breite [°]"])
def test_length_and_breadth_beside_each_other_are_a_place(place: str, tmp_path: Path) -> None:
    path = tmp_path / "drusch.csv"
    path.write_text(GERMAN.replace("Längengrad;Breitengrad", place), encoding="utf-8")
    looks_right(sources.read(path, ReadOptions()))


def test_breadth_beside_a_longitude_is_a_width(tmp_path: Path) -> None:
    path = tmp_path / "drusch.csv"
    path.write_text(GERMAN.replace("Arbeitsbreite [m]", "Breite [m]"), encoding="utf-8")
    looks_right(sources.read(path, ReadOptions()))
    path.write_text(GERMAN.replace("Längengrad;Breitengrad", "Länge;Nord"), encoding="utf-8")
    with pytest.raises(InputError, match="has no longitude and latitude"):
        sources.read(path, ReadOptions())

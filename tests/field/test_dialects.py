"""Text and vector files as other programs write them: names, languages, clocks and states."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

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
        (SPANISH, "utf-8", [1, 1, 0]),
        (SPANISH, "cp1252", [1, 1, 0]),
        (SPANISH.replace("working", "in Betrieb").replace("raised", "NA"), "utf-8", [np.nan] * 3),
    ],
    ids=["office", "office utf-16", "german windows", "german utf-8", "spanish utf-8", "spanish windows", "strange states"],
)
def test_texts(content: str, encoding: str, down: list[float] | None, tmp_path: Path) -> None:
    path = tmp_path / "field.csv"
    path.write_text(content, encoding=encoding, newline="\r\n")
    table = sources.read(path, ReadOptions())
    looks_right(table)
    if down is not None:
        assert np.array_equal(table["header_down"], down, equal_nan=True)
    told = any("neither on nor off" in note for note in table.sources[0].notes)
    assert told == ("Betrieb" in content)


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

"""Parquet that other programs write, and files that are no harvest at all."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow
import pyarrow.parquet
import pytest
import shapely

from yieldmon.cli import main as cli

from .test_rows_of_strangers import AREA_M2, MASS_KG, home, rows  # noqa: F401


def table(*, places: str) -> pyarrow.Table:
    """places: "columns", or an encoding of GeoParquet."""
    found = rows(speeds=False)
    columns = {name: pyarrow.array([row[name] for row in found]) for name in ("longitude", "latitude", "yield_t_ha", "width_m")}
    milliseconds = [round(row["time"] * 1000) for row in found]
    columns["IsoTime"] = pyarrow.array(milliseconds, pyarrow.timestamp("ms", "UTC"))
    columns["crop"] = pyarrow.array(["wheat"] * len(found)).dictionary_encode()
    columns["notes"] = pyarrow.array([["a", "list"]] * len(found))
    if places == "columns":
        return pyarrow.table(columns)
    longitudes, latitudes = columns.pop("longitude"), columns.pop("latitude")
    shapes = shapely.to_wkb(shapely.points(longitudes.to_numpy(), latitudes.to_numpy())).tolist()
    columns["geometry"] = pyarrow.array(shapes, pyarrow.binary())
    said = {"version": "1.1.0", "primary_column": "geometry", "columns": {"geometry": {"encoding": places}}}
    return pyarrow.table(columns).replace_schema_metadata({"geo": json.dumps(said)})


@pytest.mark.parametrize("places", ["columns", "WKB"])
def test_parquet_is_the_harvest(places: str, capsys: pytest.CaptureFixture[str]) -> None:
    pyarrow.parquet.write_table(table(places=places), "h.parquet")
    assert cli.main(["map", "h.parquet", "--out", "unused", "--products", "none", "--json", "--flow-delay", "0"]) == 0
    found: Any = json.loads(capsys.readouterr().out)
    assert found["mass_kg"]["integrated"] == pytest.approx(MASS_KG, rel=0.01)
    assert found["area_ha"] * 1e4 == pytest.approx(AREA_M2, rel=0.01)
    assert (found["sources"][0]["kind"], found["crop"]) == ("Parquet", "wheat")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (table(places="point"), "has places as point; expected GeoParquet with places as WKB"),
        (table(places="columns").slice(0, 0), "has no rows"),
        (table(places="columns").drop_columns(["yield_t_ha"]), "has no column of flow or yield among longitude"),
        (table(places="columns").drop_columns(["longitude"]), "has no longitude and latitude"),
    ],
)
def test_parquet_that_is_no_harvest(content: pyarrow.Table, says: str, capsys: pytest.CaptureFixture[str]) -> None:
    pyarrow.parquet.write_table(content, "h.parquet")
    assert cli.main(["map", "h.parquet", "--out", "unused", "--products", "none"]) == 2
    assert says in capsys.readouterr().err


@pytest.mark.parametrize(
    ("head", "says"),
    [
        (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "is an old Excel file; expected its sheet saved as CSV or *.xlsx"),
        (
            b"PK\x03\x04" + bytes(26) + b"mimetypeapplication/vnd.oasis.opendocument.spreadsheet",
            "is an OpenDocument file; expected",
        ),
        (b"\x1f\x8b\x08\x00", "is compressed; expected what is in it (gunzip)"),
        (b"Rar!\x1a\x07", "is a RAR archive"),
    ],
)
def test_what_cannot_be_read_says_what_would_do(head: bytes, says: str, capsys: pytest.CaptureFixture[str]) -> None:
    Path("h.dat").write_bytes(head + bytes(100))
    assert cli.main(["map", "h.dat", "--out", "unused", "--products", "none"]) == 2
    assert says in capsys.readouterr().err


def test_parquet_with_a_name_that_is_no_text(capsys: pytest.CaptureFixture[str]) -> None:
    pyarrow.parquet.write_table(table(places="columns"), "h.parquet")
    Path("h.parquet").write_bytes(Path("h.parquet").read_bytes().replace(b"width_m", b"\xafidth_m"))
    assert cli.main(["map", "h.parquet", "--out", "unused", "--products", "none"]) == 2
    assert "h.parquet: " in capsys.readouterr().err

"""Several machines, fields, crops and files in one map: each keeps its own delay, ground and thresholds; all is read or named."""

from __future__ import annotations

import json
import shutil
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from yieldmon.cli import main as cli
from yieldmon.field.plane import Plane, Sites

from .synthetic import EARTH_M_DEG, ag_leader

EARLY, LATE = 8, 14
WRITTEN = ("--products", "geopackage,geotiff")


def mapped(capsys: pytest.CaptureFixture[str], *words: str | Path) -> tuple[dict[str, Any], str]:
    code = cli.main(["map", *map(str, words), "--out", "unused", "--products", "none", "--json"])
    reported = capsys.readouterr()
    assert code == 0, reported.err
    document: dict[str, Any] = json.loads(reported.out)
    return document, reported.err


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def two_machines(folder: Path) -> tuple[list[str], list[str]]:
    """Rows of two machines with other delays, side by side in one field and at the same times."""
    ag_leader(folder / "a.txt", delay_s=LATE, seed=5)
    ag_leader(folder / "b.txt", delay_s=EARLY, seed=6, longitude_deg=-90.0 + 24 * 6.0 / (EARTH_M_DEG * np.cos(np.radians(40.0))))
    late, early = ((folder / name).read_text().splitlines() for name in ("a.txt", "b.txt"))
    return late, [row.replace(",4711,", ",4712,") for row in early]


@pytest.mark.parametrize("order", ["one after the other", "by turns", "two files"])
def test_two_combines_keep_their_own_delays(order: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    late, early = two_machines(tmp_path)
    rows = [*late, *early] if order == "one after the other" else [row for pair in zip(late, early, strict=True) for row in pair]
    (tmp_path / "both.txt").write_text("\n".join(rows))
    files = [tmp_path / "a.txt", tmp_path / "b.txt"] if order == "two files" else [tmp_path / "both.txt"]
    document, _ = mapped(capsys, *files)
    machines = document["delay"]["machines"]
    assert len(machines) == 2
    for delay_s in (EARLY, LATE):
        of = [one["flow_s"] for one in machines if one["flow_s"]["low"] <= delay_s <= one["flow_s"]["high"]]
        assert len(of) == 1, machines
    assert sum(one["points"] for one in machines) == len(late) + len(early)
    assert "duplicate" not in document["points_by_reason"]
    mass = document["mass_kg"]
    assert mass["kept"] + sum(mass["left_out_by_reason"].values()) == pytest.approx(mass["integrated"], abs=1.0)


def test_a_small_file_takes_what_its_machine_reports_elsewhere(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ag_leader(tmp_path / "monday.txt", delay_s=LATE, seed=5)
    rows = (tmp_path / "monday.txt").read_text().splitlines()
    (tmp_path / "tuesday.txt").write_text("\n".join(rows[-92 * 2 :]))
    (tmp_path / "monday.txt").write_text("\n".join(rows[: -92 * 2]))
    alone, _ = mapped(capsys, tmp_path / "tuesday.txt")
    assert alone["delay"]["flow_s"]["decision"] == "cannot tell"
    both, _ = mapped(capsys, tmp_path / "monday.txt", tmp_path / "tuesday.txt")
    assert [one["flow_s"]["decision"] for one in both["delay"]["machines"]] == ["estimated", "estimated"]
    assert both["delay"]["machines"][1]["flow_s"]["value"] == pytest.approx(LATE, abs=1.0)


@pytest.mark.parametrize("north_deg", [0.03, 1.8, -70.0])
def test_two_fields_in_one_file_are_each_as_they_are_alone(
    north_deg: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ag_leader(tmp_path / "one.txt", delay_s=LATE, seed=5)
    ag_leader(tmp_path / "other.txt", delay_s=LATE, seed=7, latitude_deg=40.0 + north_deg, start_s=60_000)
    both = tmp_path / "both.txt"
    both.write_text((tmp_path / "one.txt").read_text() + (tmp_path / "other.txt").read_text().replace("F1:north", "F2:south"))
    alone = [mapped(capsys, tmp_path / name)[0] for name in ("one.txt", "other.txt")]
    together, _ = mapped(capsys, both)
    assert "far away" not in together["points_by_reason"]
    assert together["area_ha"] == pytest.approx(sum(one["area_ha"] for one in alone), rel=1e-3)
    assert together["mass_kg"]["kept"] == pytest.approx(sum(one["mass_kg"]["kept"] for one in alone), rel=0.1)


def test_fields_far_apart_have_their_products(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import pyogrio
    import rasterio

    ag_leader(tmp_path / "one.txt", delay_s=LATE, seed=5)
    ag_leader(tmp_path / "other.txt", delay_s=LATE, seed=7, latitude_deg=-30.0, longitude_deg=150.0, start_s=60_000)
    out = tmp_path / "out"
    assert cli.main(["map", str(tmp_path / "one.txt"), str(tmp_path / "other.txt"), "--out", str(out), "--json", *WRITTEN]) == 0
    document = json.loads(capsys.readouterr().out)
    swaths = pyogrio.read_dataframe(out / "harvest.gpkg", layer="swaths")
    assert swaths.area_m2.sum() / 1e4 == pytest.approx(document["area_ha"], rel=1e-3)
    bounds = swaths.geometry.bounds
    assert set(np.round(bounds.minx)) == {-90.0, 150.0}
    assert set(np.round(bounds.miny)) == {40.0, -30.0}
    grid = pyogrio.read_dataframe(out / "harvest.gpkg", layer="grid")
    assert len(grid) > 200
    with rasterio.open(out / "yield.tif") as raster:
        assert raster.width * raster.height <= 4_000_000
        assert np.isfinite(raster.read(1)).any()


def test_a_wrong_position_is_far_away(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ag_leader(tmp_path / "field.txt", delay_s=LATE, seed=5)
    rows = (tmp_path / "field.txt").read_text().splitlines()
    for number in (300, 301, 900):
        rows[number] = ",".join(["12.5", "51.2", *rows[number].split(",")[2:]])
    (tmp_path / "field.txt").write_text("\n".join(rows))
    document, _ = mapped(capsys, tmp_path / "field.txt")
    assert document["points_by_reason"]["far away"] == 3


@settings(max_examples=30)
@given(
    st.lists(st.tuples(st.floats(-179.9, 179.9), st.floats(-75.0, 75.0)), min_size=1, max_size=4),
    st.integers(0, 2**32 - 1),
)
def test_places_come_back_from_the_plane(middles: list[tuple[float, float]], seed: int) -> None:
    rng = np.random.default_rng(seed)
    longitude = np.concatenate([east + rng.uniform(-0.01, 0.01, 20) for east, _ in middles])
    latitude = np.concatenate([north + rng.uniform(-0.01, 0.01, 20) for _, north in middles])
    longitude = (longitude + 180.0) % 360.0 - 180.0
    sites = Sites.about(longitude, latitude)
    back = sites.to_deg(*sites.to_m(longitude, latitude))
    assert np.abs((back[0] - longitude + 180.0) % 360.0 - 180.0).max() < 1e-8
    assert np.abs(back[1] - latitude).max() < 1e-8


def test_crops_have_thresholds_of_their_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Ten times the yield is no outlier where it is another crop's."""
    ag_leader(tmp_path / "one.txt", delay_s=LATE, seed=5)
    rows = [row.split(",") for row in (tmp_path / "one.txt").read_text().splitlines()]
    heavy = [[*row[:2], f"{10 * float(row[2]):.4f}", str(int(row[3]) + 50_000), *row[4:-1], '"Silage"'] for row in rows]
    moved = [[row[0], f"{float(row[1]) + 0.02:.8f}", *row[2:]] for row in heavy]
    (tmp_path / "both.txt").write_text("\n".join(",".join(row) for row in [*rows, *moved]))
    alone, _ = mapped(capsys, tmp_path / "one.txt")
    together, reported = mapped(capsys, tmp_path / "both.txt")
    assert together["points_by_reason"]["kept"] == pytest.approx(2 * alone["points_by_reason"]["kept"], rel=0.02)
    assert "2 crops (Corn, Silage)" in reported


def zipped(path: Path, members: dict[str, Path | bytes]) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content if isinstance(content, bytes) else content.read_bytes())
    return path


def test_all_that_a_zip_holds_is_read_or_named(harvests: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ag_leader(tmp_path / "field.txt", delay_s=LATE, seed=5)
    inner = zipped(tmp_path / "inner.zip", {"more/soy.zip": harvests / "deere_soybeans.zip"})
    tasks = {f"USB/TaskData/{file.name}": file for file in sorted((harvests / "isoxml").iterdir())}
    again = {f"old/TASKDATA/{file.name}": file for file in sorted((harvests / "isoxml").iterdir())}
    everything = zipped(
        tmp_path / "stick.zip",
        {
            **tasks,
            **again,
            "texts/FIELD.TXT": tmp_path / "field.txt",
            "inner.zip": inner,
            "manual.pdf": b"%PDF-1.4",
            "../../up.txt": b"x",
        },
    )
    points = {
        name: mapped(capsys, path)[0]["sources"][0]["points"]
        for name, path in (
            ("tasks", harvests / "isoxml"),
            ("text", tmp_path / "field.txt"),
            ("soy", harvests / "deere_soybeans.zip"),
        )
    }
    document, _ = mapped(capsys, everything)
    assert sorted(one["points"] for one in document["sources"]) == sorted([*points.values(), points["tasks"]])
    named = {skip["part"]: skip["why"] for one in document["sources"] for skip in one["skipped"]}
    assert "no known kind" in named["manual.pdf"]
    assert "up.txt" in named
    folder = tmp_path / "stick"
    folder.mkdir()
    with zipfile.ZipFile(everything) as archive:
        for name in archive.namelist():
            if not name.startswith(".."):
                archive.extract(name, folder)
    (folder / "__MACOSX").mkdir()
    (folder / "__MACOSX" / "x.txt").write_text("x")
    (folder / "Thumbs.db").write_bytes(b"\0")
    of_folder, _ = mapped(capsys, folder)
    assert [one["points"] for one in of_folder["sources"]] == [one["points"] for one in document["sources"]]
    assert of_folder["mass_kg"]["integrated"] == document["mass_kg"]["integrated"]


def test_a_zip_of_one_kind_is_read_as_that(harvests: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tasks = zipped(tmp_path / "t.zip", {f"TASKDATA/{file.name}": file for file in sorted((harvests / "isoxml").iterdir())})
    document, _ = mapped(capsys, tasks)
    assert [one["kind"] for one in document["sources"]] == ["ISO 11783-10 task data"]
    document, _ = mapped(capsys, harvests / "deere_soybeans.zip")
    assert [one["kind"] for one in document["sources"]] == ["John Deere Operations Center"]


@pytest.mark.parametrize("how", ["folder", "zip"])
def test_depth_and_number_are_bounded(how: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ag_leader(tmp_path / "field.txt", delay_s=LATE, seed=5, passes=2)
    if how == "zip":
        path = tmp_path / "field.txt"
        for level in range(12):
            path = zipped(tmp_path / f"{level}.zip", {path.name: path})
    else:
        path = tmp_path / "folder"
        inner = path.joinpath(*["f"] * 12)
        inner.mkdir(parents=True)
        shutil.copy(tmp_path / "field.txt", inner)
    assert cli.main(["map", str(path), "--out", "unused"]) == 2
    reported = capsys.readouterr().err.splitlines()
    assert "folders or zips deep" in reported[-1]


@pytest.mark.parametrize(
    ("text", "weighed_kg"),
    [
        ("Load;Weighed_kg\n<1>;30000,5\n", 30_000.5),
        ("load,Net weight [t]\n1,30\n", 30_000.0),
        ('load,weighed_kg\n"L1:<1>","30000,5"\n', 30_000.5),
        ("load,weighed_kg,sd_kg\r\n\r\n1,30000,\r\n,,\r\n", 30_000.0),
        ("\ufeffLOAD\tWEIGHED_KG\tSD_KG\n1\t30000\t100\n", 30_000.0),
    ],
)
def test_tickets_as_spreadsheets_write_them(
    text: str, weighed_kg: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ag_leader(tmp_path / "field.txt", delay_s=LATE, seed=5, passes=24)
    (tmp_path / "tickets.csv").write_text(text, encoding="utf-8")
    document, _ = mapped(capsys, tmp_path / "field.txt", "--tickets", tmp_path / "tickets.csv")
    assert document["mass_kg"]["corrected"] == pytest.approx(weighed_kg, abs=0.001)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("load,weighed\n1,30\n", "weighed has no unit"),
        ("1,30000\n2,20000\n", "has no column load"),
        ('load,weighed_kg\n1,"30,000"\n', "is '30,000'; expected a number"),
        ("load,weighed_kg\n1,\n", "is ''; expected a number"),
        ("load,weighed_kg\nx,1\n", "names a load that the harvest does not have"),
        ("\n", "is empty"),
        ("load,weighed_kg\n,\n", "has a header and no rows"),
        ("load,weighed_kg\n2-1,30000\n", "ends before it begins"),
    ],
)
def test_tickets_that_do_not_fit_are_one_line(text: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ag_leader(tmp_path / "field.txt", delay_s=LATE, seed=5, passes=2)
    (tmp_path / "tickets.csv").write_text(text, encoding="utf-8")
    words = ["map", str(tmp_path / "field.txt"), "--tickets", str(tmp_path / "tickets.csv"), "--out", "unused"]
    assert cli.main(words) == 2
    assert says in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize("rows", [1, 3])
def test_a_few_points_are_no_yield_and_no_nonsense(rows: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ag_leader(tmp_path / "field.txt", delay_s=LATE, seed=5, passes=2)
    few = (tmp_path / "field.txt").read_text().splitlines()[40 : 40 + rows]
    (tmp_path / "field.txt").write_text("\n".join(few))
    _, reported = mapped(capsys, tmp_path / "field.txt")
    assert "nan" not in reported
    assert "no yield: no point is kept" in reported


def test_a_cleaned_text_is_not_shifted_again(corn: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Where the data tell the delay, and where they do not: noise alone."""
    ag_leader(tmp_path / "noise.txt", delay_s=9, seed=3, pure_noise=True)
    for source, decision in ((corn, "estimated"), (tmp_path / "noise.txt", "cannot tell")):
        out = tmp_path / decision
        assert cli.main(["map", str(source), "--out", str(out), "--json", "--products", "agleader"]) == 0
        first = json.loads(capsys.readouterr().out)
        again, reported = mapped(capsys, out / "agleader_clean.txt")
        assert first["delay"]["flow_s"]["decision"] == decision
        assert f"flow delay of {first['delay']['flow_s']['value']:.1f} s taken out" in reported
        assert again["delay"]["flow_s"]["value"] == 0.0
        assert again["mass_kg"]["kept"] == pytest.approx(first["mass_kg"]["kept"], rel=0.03)
        assert again["crop"] == first["crop"]
        raw, _ = mapped(capsys, out / "agleader_raw.txt")
        assert raw["delay"]["flow_s"]["value"] == pytest.approx(first["delay"]["flow_s"]["value"], abs=0.05)


def test_a_mark_does_not_outweigh_the_data(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ag_leader(tmp_path / "field.txt", delay_s=LATE, seed=5)
    rows = (tmp_path / "field.txt").read_text().splitlines()
    (tmp_path / "field.txt").write_text("\n".join(f'{row},"flow delay of 3.0 s taken out"' for row in rows))
    document, _ = mapped(capsys, tmp_path / "field.txt")
    assert document["delay"]["flow_s"]["value"] == pytest.approx(LATE, abs=1.0)


def test_a_forage_harvester_is_no_combine(harvests: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What it does not tell is assumed by the kind of machine: only a forage harvester logs a length of cut (DDI 177)."""
    document, _ = mapped(capsys, harvests / "isoxml")
    assert document["delay"]["flow_s"]["decision"] == "cannot tell"
    assert document["delay"]["flow_s"]["value"] == 2.0
    shutil.copytree(harvests / "isoxml", tmp_path / "combine")
    for header in (tmp_path / "combine").glob("TLG*.xml"):
        header.write_text(header.read_text().replace('A="00B1"', 'A="EB00"'))
    document, _ = mapped(capsys, tmp_path / "combine")
    assert document["delay"]["flow_s"]["value"] == 12.0


@pytest.mark.parametrize("seed", range(4))
def test_grain_at_the_fields_edge_is_kept(seed: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A machine that does not smear, on ground that varies: there is no ramp to cut off, wherever the yield is low."""
    ag_leader(tmp_path / "field.txt", delay_s=0, seed=seed)
    rows = [row.split(",") for row in (tmp_path / "field.txt").read_text().splitlines()]
    for row in rows:
        share = 0.7 if (float(row[1]) - 40.0) * EARTH_M_DEG < 30.0 else 1.0
        row[2] = f"{share * float(row[2]):.4f}"
    (tmp_path / "field.txt").write_text("\n".join(",".join(row) for row in rows))
    document, _ = mapped(capsys, tmp_path / "field.txt", "--flow-delay", "0")
    mass = document["mass_kg"]
    assert mass["kept"] > 0.9 * mass["integrated"]


def test_task_data_of_two_machines_at_once(harvests: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same log again 300 m further, at the same times: by another device, or by one that is not named."""
    alone, _ = mapped(capsys, harvests / "isoxml")
    log = (harvests / "isoxml" / "TLG00006.bin").read_bytes()
    for device, other in (("another", "DVC-2"), ("untold", "DVC-1")):
        folder = tmp_path / device
        shutil.copytree(harvests / "isoxml", folder)
        north = int(300 / EARTH_M_DEG * 1e7)
        (folder / "TLG00007.bin").write_bytes(moved(log, (folder / "TLG00006.xml").read_text(), north))
        header = (folder / "TLG00006.xml").read_text()
        (folder / "TLG00007.xml").write_text(header.replace("DET-1", "DET-2") if device == "another" else header)
        task = (folder / "TASKDATA.XML").read_text()
        element = '<DET A="DET-2" B="1" C="1" E="0" F="0"/>'
        twin = f'<DVC A="{other}" B="Second" C="1" D="A00086000DF95589" F="00" G="00">{element}</DVC>'
        if device == "another":
            task = task.replace("</ISO11783_TaskData>", f"{twin}</ISO11783_TaskData>")
        (folder / "TASKDATA.XML").write_text(task)
        document, _ = mapped(capsys, folder)
        assert document["sources"][0]["points"] == 2 * alone["sources"][0]["points"]
        assert len(document["delay"]["machines"]) == 2
        assert document["points_by_reason"].get("duplicate", 0) == 2 * alone["points_by_reason"].get("duplicate", 0)
        assert document["mass_kg"]["integrated"] == pytest.approx(2 * alone["mass_kg"]["integrated"])
        assert document["area_ha"] == pytest.approx(2 * alone["area_ha"], rel=0.02)


def moved(log: bytes, header: str, north: int) -> bytes:
    """A log's records with every latitude raised; of each record: 6 bytes of time, north, east, status, the number of values."""
    assert '<PTN A="" B="" D=""/>' in header
    out, at = bytearray(log), 0
    while at + 16 <= len(out):
        latitude = int.from_bytes(out[at + 6 : at + 10], "little", signed=True) + north
        out[at + 6 : at + 10] = latitude.to_bytes(4, "little", signed=True)
        at += 16 + 5 * out[at + 15]
    return bytes(out)


@pytest.mark.parametrize(("source", "delay_s"), [("a table of process", 12.0), ("another program's map", 0.0)])
def test_a_record_of_the_machine_still_holds_the_delay(
    source: str, delay_s: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Where the data do not show a delay, as on a single pass: that of a combine, and none for points placed by others."""
    second = "mass_flow_kg_s" if source == "a table of process" else "flow_kg_s"
    header = f"time_s,{second},latitude_deg,longitude_deg,ground_speed_m_s" + (
        ",load_number,zero_mv,usable_for_calibration" if source == "a table of process" else ""
    )
    more = ",1,500.0,1" if source == "a table of process" else ""
    rows = [f"{1.7e9 + k:.1f},{6 + k % 5},{40 + 2e-5 * k:.7f},-88.2,2.2{more}" for k in range(120)]
    (tmp_path / "seconds.csv").write_text("\n".join([header, *rows]))
    document, _ = mapped(capsys, tmp_path / "seconds.csv", "--width", "6")
    assert document["delay"]["flow_s"]["decision"] == "cannot tell"
    assert document["delay"]["flow_s"]["value"] == delay_s


def test_columns_without_any_value_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = ["time_s,flow_kg_s,latitude_deg,longitude_deg,ground_speed_m_s", *(f"{1.7e9 + k},7,,,2.2" for k in range(30))]
    (tmp_path / "seconds.csv").write_text("\n".join(rows))
    assert cli.main(["map", "seconds.csv", "--width", "6", "--out", "unused"]) == 2
    assert "has no longitude_deg in any row" in capsys.readouterr().err


def test_places_that_are_not_finite_are_no_places() -> None:
    """As a table with a cell of 1e999 has them: no warning, and all others where they are without them."""
    longitude, latitude = np.array([7.0, np.inf, 7.001, 7.002, -np.inf]), np.array([50.0, 50.0, np.inf, 50.002, -np.inf])
    known = np.isfinite(longitude) & np.isfinite(latitude)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for plane in (Sites.about(longitude, latitude), Plane.about(longitude, latitude)):
            found = np.stack(plane.to_m(longitude, latitude))
            assert np.isfinite(found).all(axis=0).tolist() == known.tolist()
            assert found[:, known].tolist() == np.stack(plane.to_m(longitude[known], latitude[known])).tolist()

"""The verb `map` on real excerpts and synthetic fields: numbers, products opened by readers that are not ours, refusals."""

from __future__ import annotations

import csv
import json
import shutil
import sqlite3
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.file_limit import files_end_at
from tests.in_process import program
from tests.schema_check import problems
from tests.seconds import measured_second
from yieldmon import api
from yieldmon.cli import main as cli
from yieldmon.field import cleaning
from yieldmon.field.products import FILES, FORMATS, picture
from yieldmon.service.storage import ledger
from yieldmon.service.storage.batch import Action, Batch, Load, Ticket
from yieldmon.service.storage.store import Store
from yieldmon.units import Units, UnitSystem

from .synthetic import ag_leader

ROOT = Path(__file__).parents[2]


def mapped(capsys: pytest.CaptureFixture[str], out: Path, *words: str | Path) -> dict[str, Any]:
    code = cli.main(["map", *map(str, words), "--out", str(out), "--json"])
    reported = capsys.readouterr()
    assert code == 0, reported.err
    document: dict[str, Any] = json.loads(reported.out)
    assert problems(document, "map") == []
    return document


@pytest.fixture(scope="module")
def corn_map(corn: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """All products of the real corn, dated."""
    out = tmp_path_factory.mktemp("map")
    done = program("yieldmon.cli.main", "map", corn, "--out", out, "--json", "--date", "2001-10-10")
    assert done.returncode == 0, done.stderr
    return out, json.loads(done.stdout)


def test_mass_is_accounted_for_to_the_kilogram(corn: Path, corn_map: tuple[Path, dict[str, Any]]) -> None:
    document = corn_map[1]
    mass = document["mass_kg"]
    assert mass["kept"] + sum(mass["left_out_by_reason"].values()) == pytest.approx(mass["integrated"], abs=1.0)
    with corn.open(encoding="utf-8") as stream:
        by_hand = sum(float(row[2]) * 0.45359237 * float(row[4]) for row in csv.reader(stream))
    assert mass["integrated"] == pytest.approx(by_hand, abs=0.01)
    assert sum(document["points_by_reason"].values()) == document["sources"][0]["points"] == 6000
    assert document["delay"]["flow_s"]["decision"] == "estimated"
    assert set(document["agreement"]) >= {"no_shift", "shifted", "held_out"}


def test_vector_products_hold_the_same_masses(corn_map: tuple[Path, dict[str, Any]]) -> None:
    import geopandas
    import pyogrio

    out, document = corn_map
    points = geopandas.read_file(out / "harvest.gpkg", layer="points")
    assert len(points) == 6000
    assert str(points["time_utc"].dt.date.iloc[0]) == "2001-10-10"
    for reason, mass in document["mass_kg"]["left_out_by_reason"].items():
        if reason != "no place":
            assert points.loc[points.reason == reason, "mass_kg"].sum() == pytest.approx(mass, abs=0.1)
    assert points.loc[points.kept, "mass_kg"].sum() == pytest.approx(document["mass_kg"]["kept"], abs=0.1)
    swaths = geopandas.read_file(out / "harvest.gpkg", layer="swaths")
    on_ground = swaths.to_crs(swaths.estimate_utm_crs()).area
    assert on_ground.sum() == pytest.approx(1e4 * document["area_ha"], rel=0.002)
    assert (on_ground - swaths.area_m2).abs().max() < 0.05
    kept = geopandas.read_file(out / "points_shp.zip")
    assert kept.MASS_KG.sum() == pytest.approx(document["mass_kg"]["kept"], rel=1e-4)
    assert len(kept) == document["points_by_reason"]["kept"]
    assert {name for name, _ in pyogrio.list_layers(out / "harvest.gpkg")} == {"points", "swaths", "grid"}


def test_bushels_and_tonnes_agree(corn_map: tuple[Path, dict[str, Any]]) -> None:
    document = corn_map[1]
    # 1 bu of corn is 56 lb.
    assert document["yield_bu_ac"] == pytest.approx(document["yield_t_ha"] * 1000 / 56 / 0.45359237 * 0.40468564224, rel=1e-5)


def test_grid_by_rasterio(corn_map: tuple[Path, dict[str, Any]]) -> None:
    import geopandas
    import rasterio

    out, document = corn_map
    blocks = geopandas.read_file(out / "harvest.gpkg", layer="grid")
    with rasterio.open(out / "yield.tif") as raster:
        assert raster.crs.to_epsg() == 4326
        assert raster.count == 2
        assert raster.descriptions == ("yield_t_ha", "standard_error_t_ha")
        assert raster.units == ("t/ha", "t/ha")
        assert np.isnan(raster.nodata)
        places = blocks.geometry.representative_point()
        values = np.array(list(raster.sample([(p.x, p.y) for p in places])))
    assert values[:, 0] == pytest.approx(blocks.yield_t_ha.to_numpy(), rel=1e-5)
    assert np.nanmean(values[:, 0]) == pytest.approx(document["yield_t_ha"], rel=0.1)


def test_csv_and_texts(corn: Path, corn_map: tuple[Path, dict[str, Any]]) -> None:
    out, document = corn_map
    with (out / "points.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert sum(float(row["mass_kg"] or 0) for row in rows if row["kept"] == "1") == pytest.approx(
        document["mass_kg"]["kept"], rel=1e-5
    )
    with (out / "agleader_raw.txt").open(encoding="ascii") as stream:
        raw = list(csv.reader(stream))
    with corn.open(encoding="utf-8") as stream:
        original = list(csv.reader(stream))
    assert len(raw) == len(original)
    for mine, theirs in zip(raw[::500], original[::500], strict=True):
        assert float(mine[2]) == pytest.approx(float(theirs[2]), abs=1e-3)
        assert float(mine[0]) == pytest.approx(float(theirs[0]), abs=1e-8)
        assert int(mine[8]) == int(theirs[8])
    with (out / "agleader_clean.txt").open(encoding="ascii") as stream:
        clean = [float(row[2]) * 0.45359237 * float(row[4]) for row in csv.reader(stream)]
    assert sum(clean) == pytest.approx(document["mass_kg"]["kept"], rel=1e-4)


def test_texts_have_the_mass_of_a_log_whose_seconds_are_not_quite_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An interval of 1.004 s was written as 1."""
    rows = ["time (s),latitude,longitude,flow (kg/s),width (m),interval (s),moisture (%)"]
    rows += [f"{1.6e9 + 1.004 * k:.3f},{55.0 + 1.2e-5 * k:.7f},13.5,6.25,9.0,1.004,15" for k in range(300)]
    (tmp_path / "harvest.csv").write_text("\n".join(rows) + "\n")
    document = mapped(capsys, tmp_path / "out", tmp_path / "harvest.csv", "--products", "agleader", "--flow-delay", "0")
    for name, mass_kg in (("raw", document["mass_kg"]["integrated"]), ("clean", document["mass_kg"]["kept"])):
        with (tmp_path / "out" / f"agleader_{name}.txt").open(encoding="ascii") as stream:
            written = [float(row[2]) * 0.45359237 * float(row[4]) for row in csv.reader(stream)]
        assert sum(written) == pytest.approx(mass_kg, rel=2e-4)


@pytest.mark.isoxml
def test_task_data_by_isoxml(corn_map: tuple[Path, dict[str, Any]]) -> None:
    modules = ROOT / "out" / "node" / "node_modules"
    if not (shutil.which("node") and (modules / "isoxml").is_dir()):
        pytest.skip("needs node with isoxml (tools/isoxml)")
    out, document = corn_map
    script = ROOT / "tests" / "export" / "read_taskdata.cjs"
    done = subprocess.run(
        ["node", str(script), str(out / "taskdata.zip")],
        capture_output=True,
        text=True,
        check=True,
        env={"NODE_PATH": str(modules)},
    )
    found = json.loads(done.stdout)
    assert found["warnings"] == []
    totals = {int(one["ProcessDataDDI"], 16): one["ProcessDataValue"] for one in found["totals"]}
    assert totals[90] == round(document["mass_kg"]["integrated"])
    assert len(found["records"]) == 6000
    names = {info["DDINumber"] for info in found["valuesInfo"]}
    assert {67, 87, 90, 143} <= names


def test_task_data_come_back_the_same(
    corn_map: tuple[Path, dict[str, Any]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, document = corn_map
    again = mapped(capsys, tmp_path / "again", out / "taskdata.zip", "--products", "none")
    assert again["mass_kg"]["machine_total"] == pytest.approx(document["mass_kg"]["integrated"], rel=0.01)
    assert again["mass_kg"]["integrated"] == pytest.approx(again["mass_kg"]["machine_total"], rel=0.01)
    assert again["delay"]["flow_s"]["declared"] == pytest.approx(document["delay"]["flow_s"]["value"], abs=0.001)
    assert again["delay"]["flow_s"]["value"] == pytest.approx(document["delay"]["flow_s"]["value"], abs=0.5)
    assert again["area_ha"] == pytest.approx(document["area_ha"], rel=0.01)


@pytest.mark.parametrize("name", ["harvest.gpkg", "points.csv", "agleader_raw.txt"])
def test_products_are_sources(
    name: str, corn_map: tuple[Path, dict[str, Any]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, document = corn_map
    again = mapped(capsys, tmp_path / "again", out / name, "--products", "none", "--flow-delay", "0")
    expected = document["mass_kg"]["integrated"]
    if name != "agleader_raw.txt":
        expected -= document["mass_kg"]["left_out_by_reason"]["no place"]
    assert again["mass_kg"]["integrated"] == pytest.approx(expected, rel=1e-3)


def test_report_needs_no_network_and_escapes_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "field.txt"
    ag_leader(path, delay_s=9, seed=4, passes=12)
    mapped(capsys, tmp_path / "out", path, "--field", "</script><img src=x onerror=alert(1)>", "--products", "report")
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "http://" not in page.replace("http://www.w3.org/2000/svg", "")
    assert "https://" not in page
    assert "onerror=alert(1)>" not in page
    assert page.count("</script>") == 2
    data = page.split('id="data">')[1].split("</script>")[0]
    assert json.loads(data)["title"].startswith("</script>")


def test_picture_is_a_png(corn_map: tuple[Path, dict[str, Any]]) -> None:
    import rasterio

    with rasterio.open(corn_map[0] / "map.png") as image:
        pixels = image.read()
    assert pixels.shape == (3, 1000, 1400)
    assert pixels.std() > 20


@pytest.mark.parametrize(
    ("units", "words"),
    [
        (Units(), ("8.00", "12.5 t/ha", (100.0, "100 m"))),
        (Units(UnitSystem.US, 25.4012), ("127", "199 bu/ac", (152.4, "500 ft"))),
        (Units(UnitSystem.US), ("7,137", "11,152 lb/ac", (152.4, "500 ft"))),
    ],
)  # fmt: skip
def test_the_picture_is_in_the_units_asked_for(units: Units, words: tuple[str, str, tuple[float, str]]) -> None:
    ends = picture.scale_words(8.0, 12.5, units)
    length, beside = picture.bar(160.0, units)
    assert (*ends, (pytest.approx(length), beside)) == words
    assert set("".join((*ends, beside, picture.bar(5000.0, units)[1]))) <= picture.LETTERS


def test_picture_and_report_follow_the_units(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.txt"
    ag_leader(path, delay_s=9, seed=4, passes=12)
    pictures, pages = [], []
    for units in ("metric", "us"):
        mapped(capsys, tmp_path / units, path, "--crop", "corn", "--products", "report,picture", "--units", units)
        pictures.append((tmp_path / units / "map.png").read_bytes())
        page = (tmp_path / units / "report.html").read_text(encoding="utf-8")
        pages.append(json.loads(page.split('id="data">')[1].split("</script>")[0]))
    assert pictures[0] != pictures[1]
    metric, us = pages
    assert (metric["unit"]["name"], metric["unit"]["mass"]) == ("t/ha", "kg")
    assert (us["unit"]["name"], us["unit"]["mass"]) == ("bu/ac", "lb")
    yield_t_ha, yield_bu_ac = (float(page["numbers"][0][0].split()[0]) for page in pages)
    # A bushel of corn weighs 56 lb (US Warehouse Act), so 1 bu/ac is 0.0628 t/ha.
    assert yield_bu_ac == pytest.approx(yield_t_ha / 0.06277, rel=2e-3)
    shown = json.dumps([us["numbers"], us["totals"]])
    assert " ac" in shown
    assert " ha" not in shown


def test_known_synthetic_mass_and_delay(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "field.txt"
    mass = ag_leader(path, delay_s=14, seed=5)
    document = mapped(capsys, tmp_path / "out", path, "--products", "none")
    assert document["mass_kg"]["integrated"] == pytest.approx(mass, rel=1e-4)
    assert document["delay"]["flow_s"]["value"] == pytest.approx(14, abs=1)
    # 24 passes of 80 steps of 2 m, 6 m wide.
    assert document["area_ha"] == pytest.approx(24 * 80 * 12 / 1e4, rel=0.01)
    assert document["yield_t_ha"] == pytest.approx(10.0 * mass / (24 * 80 * 12), rel=0.03)


@pytest.mark.parametrize("kind", ["header always down", "header unknown"])
def test_turns_are_no_ground_that_was_cut(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "field.txt"
    ag_leader(path, delay_s=10, seed=5, turn_s=25, always_down=True, trickle_kg_s=0.1)
    if kind == "header unknown":
        names = "longitude,latitude,flow_lb_s,time_s,interval_s,distance_in,width_in\n"
        rows = [line.split(",")[:7] for line in path.read_text().splitlines()]
        path = tmp_path / "field.csv"
        path.write_text(names + "".join(",".join(row) + "\n" for row in rows))
    document = mapped(capsys, tmp_path / "out", path, "--products", "none")
    assert document["area_ha"] == pytest.approx(24 * 80 * 12 / 1e4, rel=0.02)
    assert document["yield_t_ha_low"] < document["yield_t_ha"] < document["yield_t_ha_high"]


def test_a_pause_within_a_log_is_no_way_that_was_cut(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "field.txt"
    ag_leader(path, delay_s=0, seed=3, passes=8)
    rows = [line.split(",") for line in path.read_text().splitlines()]
    middle = len(rows) // 2 + 20
    for row in rows[middle:]:
        row[1], row[3] = f"{float(row[1]) + 0.02:.8f}", str(float(row[3]) + 10_000.0)
    path.write_text("".join(",".join(row) + "\n" for row in rows))
    found = []
    for source, out in ((path, tmp_path / "out"), (tmp_path / "out" / "taskdata.zip", tmp_path / "again")):
        assert cli.main(["map", str(source), "--out", str(out), "--flow-delay", "0", "--products", "taskdata", "--json"]) == 0
        found.append(json.loads(capsys.readouterr().out))
    assert found[1]["area_ha"] == pytest.approx(found[0]["area_ha"], rel=0.01)
    assert found[1]["mass_kg"]["integrated"] == pytest.approx(found[0]["mass_kg"]["integrated"], rel=0.001)


def test_rows_given_twice_count_once(corn: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = corn.read_text().splitlines()
    path = tmp_path / "twice.txt"
    path.write_text("\n".join(line for line in lines for _ in range(2)) + "\n")
    once = mapped(capsys, tmp_path / "a", corn, "--products", "none")
    twice = mapped(capsys, tmp_path / "b", path, "--products", "none")
    assert twice["mass_kg"]["kept"] == pytest.approx(once["mass_kg"]["kept"], rel=0.01)
    assert twice["mass_kg"]["integrated"] == pytest.approx(2 * once["mass_kg"]["integrated"], rel=1e-6)
    assert twice["yield_t_ha"] == pytest.approx(once["yield_t_ha"], rel=0.01)
    assert twice["area_ha"] == pytest.approx(once["area_ha"], rel=0.001)


def test_tickets_scale_their_loads(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "field.txt"
    ag_leader(path, delay_s=9, seed=6)
    lines = path.read_text().splitlines()
    half = len(lines) // 2
    path.write_text("\n".join([*lines[:half], *(line.replace('"L1:<1>"', '"L2:<2>"') for line in lines[half:])]) + "\n")
    plain = mapped(capsys, tmp_path / "plain", path, "--products", "none")
    loads = {load["load"]: load["measured_kg"] for load in plain["loads"]}
    tickets = tmp_path / "tickets.csv"
    tickets.write_text(f"load,weighed_kg\nL1,{1.1 * loads['L1:<1>']:.1f}\n")
    document = mapped(capsys, tmp_path / "out", path, "--products", "none", "--tickets", tickets)
    first, second = document["loads"]
    assert first["factor"] == pytest.approx(1.1, rel=1e-4)
    assert second["factor"] == pytest.approx(1.1, rel=1e-4)
    assert second["factor_sd"] > first["factor_sd"]
    assert document["mass_kg"]["corrected"] == pytest.approx(1.1 * document["mass_kg"]["integrated"], rel=1e-4)
    assert document["mass_kg"]["low"] < document["mass_kg"]["corrected"] < document["mass_kg"]["high"]
    assert document["yield_t_ha"] == pytest.approx(1.1 * plain["yield_t_ha"], rel=0.02)


def store_of(path: Path) -> None:
    """Six passes of 100 s at 9 kg/s."""
    rows = []
    for number in range(1, 601):
        along = (number % 100) if (number // 100) % 2 == 0 else 99 - (number % 100)
        place = {
            "latitude_deg": 40.0 + 2.0 * along / 111_195.0,
            "longitude_deg": -88.25 + (number // 100) * 9.0 / 85_000.0,
        }
        rows.append(measured_second(number, 1_760_000_000.0 + number, 9.0, **place))
    with Store(path) as store:
        store.commit(
            [Batch(1, rows[-1].time_s, {}, tuple(rows), (Load(1, "north", "corn", rows[0].time_s, None, 5400.0, None),))]
        )


def test_a_daemons_store(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import geopandas

    store_of(tmp_path / "today.sqlite")
    document = mapped(capsys, tmp_path / "out", tmp_path / "today.sqlite", "--width", "9", "--products", "geopackage")
    assert document["mass_kg"]["integrated"] == pytest.approx(5400.0)
    assert document["mass_kg"]["machine_total"] == pytest.approx(5400.0)
    assert document["crop"] == "corn"
    points = geopandas.read_file(tmp_path / "out" / "harvest.gpkg", layer="points")
    assert points.field.iloc[0] == "north"
    assert "yield_sd_t_ha" in points


def test_loads_that_a_store_has_corrected_are_so_in_its_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "season.sqlite"
    store_of(path)
    with Store(path) as store:
        rows = [replace(row, load_number=1 + row.number // 151) for row in store.seconds()]
    path.unlink()
    masses = [sum(row.mass_kg for row in rows if row.load_number == n) for n in (1, 2, 3, 4)]
    loads = [Load(n, "north", "corn", None, None, masses[n - 1], None) for n in (1, 2, 3, 4)]
    tickets = (Ticket(0.0, 1, 2, 1.1 * (masses[0] + masses[1]), masses[0] + masses[1]),)
    actions = (
        Action(1, 0.0, ledger.TICKET, "root", {"ticket": 1, "std_dev_kg": 30.0}),
        Action(2, 0.0, ledger.REMEASURED, "", {"version": 2, "tickets": [1], "factors": {"3": 1.05}}),
    )
    with Store(path) as store:
        store.commit([Batch(1, rows[-1].time_s, {}, tuple(rows), tuple(loads), tickets=tickets, actions=actions)])
    document = mapped(capsys, tmp_path / "out", path, "--width", "9", "--products", "none")
    factors = {one["load"]: (one["factor"], one["weighed_kg"]) for one in document["loads"]}
    assert factors == {
        "1": (pytest.approx(1.1), pytest.approx(1.1 * masses[0])),
        "2": (pytest.approx(1.1), pytest.approx(1.1 * masses[1])),
        "3": (pytest.approx(1.05), None),
        "4": (1.0, None),
    }
    mass = document["mass_kg"]
    assert mass["corrected"] == pytest.approx(sum(load.corrected_mass_kg for load in api.read_loads(path)), abs=0.01)
    assert mass["integrated"] == pytest.approx(sum(masses), abs=0.01)
    assert document["loads"][0]["factor_sd"] * masses[0] == pytest.approx(30.0 * np.sqrt(masses[0] / sum(masses[:2])), rel=1e-4)
    # Tickets that are named count before the store's.
    file = tmp_path / "tickets.csv"
    file.write_text(f"load;weighed_t;std_dev_kg\n3-4;{1.2e-3 * (masses[2] + masses[3]):.6f};20\n")
    document = mapped(capsys, tmp_path / "out", path, "--width", "9", "--products", "none", "--tickets", file)
    assert [one["factor"] for one in document["loads"]] == pytest.approx([1.1, 1.1, 1.2, 1.2], rel=1e-5)
    assert document["loads"][3]["factor_sd"] * masses[3] == pytest.approx(20.0 * np.sqrt(masses[3] / sum(masses[2:])), rel=1e-4)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["nowhere.txt"], "no such file"),
        (["FILE", "--products", "png"], "--products"),
        (["FILE", "--without", "weather"], "--without"),
        (["FILE", "--width", "-1"], "--width"),
        (["FILE", "--column", "yield"], "--column"),
        (["FILE", "--date", "yesterday"], "--date"),
        (["FILE", "--tickets", "nowhere.csv"], "nowhere.csv"),
        (["FILE", "--out", "FILE"], "folder"),
    ],
)
def test_refusals_are_one_line(words: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "field.txt"
    ag_leader(path, delay_s=9, seed=1, passes=2)
    given = [str(path) if word == "FILE" else word for word in words]
    if "--out" not in given:
        given += ["--out", str(tmp_path / "out")]
    assert cli.main(["map", *given]) == 2
    reported = [line for line in capsys.readouterr().err.splitlines() if line.startswith("yieldmon: ")]
    assert len(reported) == 1
    assert says in reported[0]
    assert not (tmp_path / "out").exists()


def test_a_rule_that_is_off_gives_no_reason(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "field.txt"
    ag_leader(path, delay_s=9, seed=7, passes=12)
    on = mapped(capsys, tmp_path / "a", path, "--products", "none")
    off = mapped(capsys, tmp_path / "b", path, "--products", "none", "--without", "local outlier", "--without", "pass start")
    assert not {"local outlier", "pass start"} & set(off["points_by_reason"])
    assert off["points_by_reason"]["kept"] >= on["points_by_reason"]["kept"]


def test_a_map_that_cannot_be_written_leaves_the_earlier_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It left new points beside the other files of the map before."""
    path, out = tmp_path / "field.txt", tmp_path / "out"
    ag_leader(path, delay_s=9, seed=7, passes=12)
    words = ["map", str(path), "--out", str(out), "--products", "csv,agleader,taskdata"]
    assert cli.main(words) == 0
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    with files_end_at(len(before["points.csv"]) + 10_000):
        assert cli.main([*words[:-1], "csv,geopackage", "--width", "3"]) == 1
    assert f"{out / 'harvest.gpkg'}: " in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


def test_every_product_is_written(corn_map: tuple[Path, dict[str, Any]]) -> None:
    out, document = corn_map
    assert {Path(name).name for name in document["files"]} == {path.name for path in out.iterdir()}
    assert sorted(path.name for path in out.iterdir()) == sorted(name for kind in FORMATS for name in FILES[kind])
    with sqlite3.connect(out / "harvest.gpkg") as database:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)


def test_a_rule_that_takes_a_quarter_of_the_harvest_is_named() -> None:
    names = (cleaning.KEPT, "header up", "duplicate", "turn")
    cleaned = cleaning.Cleaned(np.repeat(np.arange(4, dtype=np.int8), [4, 3, 2, 1]), names)
    notes = cleaning.much_left_out(cleaned, {cleaning.KEPT: 40.0, "header up": 26.0, "duplicate": 25.0, "turn": 9.0})
    assert notes == (
        "26 % of the mass, 3 points, is left out as 'header up' (not harvesting)",
        "25 % of the mass, 2 points, is left out as 'duplicate' (time or place of another point); --without 'duplicate' keeps it",
    )

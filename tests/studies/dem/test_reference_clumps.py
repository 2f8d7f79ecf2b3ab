"""The campaign of clumped kernels as shipped: what the plan says, in agreement with mechanics, and readable by the page."""

from __future__ import annotations

import csv
import gzip
import json
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

from studies.dem import campaign
from tests.in_process import program

from .mechanics import assert_obeyed

ROOT = Path(__file__).parents[3]
DATA = ROOT / "tests" / "data"
CONDITION = ("paddle_mass_kg", "plate_angle_deg", "trial", "kernel")


def table(name: str) -> list[dict[str, str]]:
    with (DATA / name).open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.fixture(scope="module")
def rows() -> list[dict[str, str]]:
    return table("dem_clumps.csv")


def test_it_is_what_the_plan_says(rows: list[dict[str, str]]) -> None:
    path = ROOT / "studies/dem/campaigns" / "clumps.yaml"
    plan = campaign.parse(path.read_text(encoding="utf-8"), str(path))
    planned = {(f"{t.paddle_mass_kg:g}", str(t.seed), t.grain.kernel, t.throw_key()) for t in plan.throws}
    assert {(r["paddle_mass_kg"], r["trial"], r["kernel"], r["throw_key"]) for r in rows} <= planned
    assert len([r for r in rows if r["trial"] == "1"]) == 32
    assert {r["rolling_friction"] for r in rows} == {"0.01"}
    source = json.loads((DATA / "dem_clumps_provenance.json").read_text(encoding="utf-8"))
    assert source["source_sha256"] == plan.source_sha256
    assert {int(r["engine_version"]) for r in rows} == {source["engine_version"]}


def test_grains_are_counted_as_clumps(rows: list[dict[str, str]]) -> None:
    for row in rows:
        mass = 4.0e-4 if row["kernel"] == "clump" else 4.048e-4
        assert int(row["grains"]) == round(float(row["paddle_mass_kg"]) / mass)
    layers = defaultdict(int)
    for row in table("dem_clumps_layers.csv"):
        layers[row["paddle_mass_kg"], row["trial"], row["kernel"]] += int(row["grains"])
    assert all(layers[r["paddle_mass_kg"], r["trial"], r["kernel"]] == int(r["grains"]) for r in rows)


def test_the_rows_obey_mechanics(rows: list[dict[str, str]]) -> None:
    for row in rows:
        assert_obeyed(row)


def test_a_thin_stream_of_clumps_gives_less_and_turns_more_along_the_plate(rows: list[dict[str, str]]) -> None:
    """One kernel thick, clumps bounce less than spheres; and at a low plate they slide where spheres roll."""
    cell = {tuple(r[k] for k in CONDITION): r for r in rows}
    for angle in ("40", "55", "70", "90"):
        clump, sphere = (cell["0.2", angle, "1", kernel] for kernel in ("clump", "sphere"))
        assert float(clump["impact_ratio"]) < float(sphere["impact_ratio"]) - 0.1
    share = {}
    for kernel in ("clump", "sphere"):
        row = cell["0.2", "40", "1", kernel]
        share[kernel] = float(row["momentum_total_kg_m_s"]) / float(row["momentum_kg_m_s"]) - 1.0
    assert share["clump"] > share["sphere"] + 0.05


def test_the_histories_hold_the_same_impulse(rows: list[dict[str, str]]) -> None:
    impulse: dict[tuple[str, ...], float] = defaultdict(float)
    with gzip.open(DATA / "dem_clumps_forces.csv.gz", "rt", encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            impulse[tuple(row[n] for n in CONDITION)] += float(row["force_normal_n"]) * 1e-3
    assert len(impulse) == len(rows)
    for row in rows:
        assert impulse[tuple(row[n] for n in CONDITION)] == pytest.approx(float(row["momentum_kg_m_s"]), rel=1e-4)


def test_the_page_can_be_made_again(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    names = ("clump-heap", "clump-release", "clump-gain", "clump-impulse", "clump-published")
    page.write_text("\n".join(f"<!-- {n} -->\n<!-- /{n} -->" for n in names), encoding="utf-8")
    done = program("studies.dem.report", "clumps", "--page", page, "--pictures", tmp_path)
    assert done.returncode == 0, done.stderr
    text, shipped_page = page.read_text(encoding="utf-8"), (ROOT / "studies" / "dem" / "results.md").read_text(encoding="utf-8")
    for name in names:
        block = text.split(f"<!-- {name} -->\n")[1].split(f"<!-- /{name} -->")[0]
        assert block.startswith("|")
        assert block in shipped_page
    assert (tmp_path / "clumps.png").exists()


def test_the_grains_file_is_of_clumps() -> None:
    with np.load(DATA / "dem_clumps_grains.npz") as grains:
        loads = [float(m) for m in grains["paddle_mass_kg"]]
        assert loads == [0.2, 0.5, 0.9, 1.3]
        assert all(len(grains[f"along_mm_{load:g}"]) == round(load / 4.0e-4) for load in loads)

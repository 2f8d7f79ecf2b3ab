"""The reference campaign as shipped: whole, consistent, and read by what the page and the virtual combine need of it."""

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
from yieldmon.files import table
from yieldmon.physics.machine import RPM, Machine

from .mechanics import assert_obeyed

ROOT = Path(__file__).parents[3]
DATA = ROOT / "tests" / "data"


@pytest.fixture(scope="module")
def rows() -> list[dict[str, str]]:
    with (DATA / "dem_campaign.csv").open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_it_is_what_the_plan_says(rows: list[dict[str, str]]) -> None:
    path = ROOT / "studies/dem/campaigns" / "reference.yaml"
    plan = campaign.parse(path.read_text(encoding="utf-8"), str(path))
    planned = {(f"{t.paddle_mass_kg:g}", f"{t.contact.friction:g}", str(t.seed), t.throw_key()) for t in plan.throws}
    assert len(rows) >= 150
    assert {(r["paddle_mass_kg"], r["friction"], r["trial"], r["throw_key"]) for r in rows} <= planned
    assert len({(r["throw_key"], r["plate_angle_deg"]) for r in rows}) == len(rows)
    first_seed = [r for r in rows if r["trial"] == "1"]
    assert len(first_seed) == 100
    source = json.loads((DATA / "dem_campaign_provenance.json").read_text(encoding="utf-8"))
    assert source["source_sha256"] == plan.source_sha256
    assert {int(r["engine_version"]) for r in rows} == {source["engine_version"]}


def test_grain_ahead_of_the_paddle_leaves_level_half_way_to_the_tips_speed() -> None:
    """What the effect unpushed_layers says of free grain, and that grain at the paddle leaves otherwise."""
    tip_m_s = Machine().paddle_length_m * 400.0 * RPM
    with np.load(DATA / "dem_campaign_grains.npz") as grains:
        for load in grains["paddle_mass_kg"][1:]:
            along, ahead, radius, speed, below = (
                grains[f"{name}_{load:g}"].astype(float)
                for name in ("along_mm", "ahead_mm", "let_go_radius_mm", "speed_m_s", "below_horizontal_deg")
            )
            rho, lead = 1e-3 * radius / Machine().paddle_length_m, np.degrees(np.arctan2(ahead, along))
            inner = (rho > 0.75) & (rho < 0.9)
            free, carried = inner & (lead > 15.0), inner & (lead < 5.0)
            level = speed * np.cos(np.radians(below)) / tip_m_s
            assert np.mean(level[free]) == pytest.approx(np.mean(0.5 * (1.0 + rho[free])), rel=0.02)
            assert abs(np.mean(below[free])) < 4.0
            assert np.mean(below[carried]) > np.mean(below[free]) + 3.0


def test_the_outer_grain_of_a_deeper_heap_leaves_higher() -> None:
    """What the effect stream_rise is about; 0.9 deg of gravity's fall included."""
    with (DATA / "dem_campaign_layers.csv").open(encoding="utf-8", newline="") as stream:
        layers = [row for row in csv.DictReader(stream) if row["trial"] == "1" and row["elevator_speed_rpm"] == "400"]
    for friction in ("0.15", "0.3"):
        outer = [(float(r["paddle_mass_kg"]), float(r["below_horizontal_deg"])) for r in layers
                 if r["friction"] == friction and r["layer"] == "5"]  # fmt: skip
        below = [angle for _, angle in sorted(outer)]
        assert len(below) == 5
        assert below[0] > below[2] > below[4]
        assert below[4] < -1.0


def test_the_rows_obey_mechanics(rows: list[dict[str, str]]) -> None:
    for row in rows:
        assert_obeyed(row)


def test_more_grain_more_momentum(rows: list[dict[str, str]]) -> None:
    series: dict[tuple[str, ...], list[tuple[float, float]]] = defaultdict(list)
    for row in rows:
        key = tuple(row[k] for k in ("plate_angle_deg", "elevator_speed_rpm", "friction", "trial"))
        series[key].append((float(row["paddle_mass_kg"]), float(row["momentum_kg_m_s"])))
    for cells in series.values():
        momenta = [momentum for _, momentum in sorted(cells)]
        assert momenta == sorted(momenta)


def test_the_histories_hold_the_same_impulse(rows: list[dict[str, str]]) -> None:
    names = ("plate_angle_deg", "paddle_mass_kg", "elevator_speed_rpm", "friction", "trial")
    impulse: dict[tuple[float, ...], float] = defaultdict(float)
    with gzip.open(DATA / "dem_campaign_forces.csv.gz", "rt", encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            impulse[tuple(float(row[n]) for n in names)] += float(row["force_normal_n"]) * 1e-3
    assert len(impulse) == len(rows)
    for row in rows:
        assert impulse[tuple(float(row[n]) for n in names)] == pytest.approx(float(row["momentum_kg_m_s"]), rel=1e-4)


def test_the_verbs_read_it() -> None:
    data = table.load(DATA / "dem_campaign.csv")
    assert data.load == "paddle_mass_kg"
    assert data.reading == "momentum_kg_m_s"
    assert data.conditions(Machine()).paddle_mass_kg is not None


def test_the_page_can_be_made_again(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    names = ("heap", "release", "landing", "impact", "plate-friction", "plate-end")
    page.write_text("\n".join(f"<!-- {n} -->\n<!-- /{n} -->" for n in names), encoding="utf-8")
    chapters = ("heap", "release", "landing", "impact")
    done = program("studies.dem.report", *chapters, "--page", page, "--pictures", tmp_path)
    assert done.returncode == 0, done.stderr
    text = page.read_text(encoding="utf-8")
    shipped_page = (ROOT / "studies" / "dem" / "results.md").read_text(encoding="utf-8")
    for name in names:
        block = text.split(f"<!-- {name} -->\n")[1].split(f"<!-- /{name} -->")[0]
        assert block.startswith("|")
        assert block in shipped_page
    assert {p.name for p in tmp_path.glob("*.png")} == {"heap.png", "release.png", "landing.png", "impact.png"}

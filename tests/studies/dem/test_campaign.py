"""Plans from YAML, and a ledger that a kill cannot confuse."""

from __future__ import annotations

import csv
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from studies.dem import campaign, runner
from yieldmon.errors import InputError
from yieldmon.physics.machine import RPM

from . import fake_engine

CAMPAIGNS = Path(__file__).parents[3] / "studies" / "dem" / "campaigns"
PLAN = """
name: small
elevator_speed_rpm: [400, 500]
friction: [0.3, 0.15]
paddle_mass_kg: [0.2, 0.5]
plate_angle_deg: [40, 70, 90]
seed: [1, 2]
"""


@pytest.fixture
def engine_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "run_throw", fake_engine.run_throw)
    monkeypatch.setattr(runner, "engine_version", lambda: 0)


def test_the_plan_is_the_full_product_seeds_slowest() -> None:
    plan = campaign.parse(PLAN, "plan")
    assert plan.row_count == 48
    assert [t.seed for t in plan.throws] == [1] * 8 + [2] * 8
    assert {(t.paddle_mass_kg, round(t.elevator_speed_rad_s / RPM), t.contact.friction) for t in plan.throws} == {
        (m, s, f) for m in (0.2, 0.5) for s in (400, 500) for f in (0.3, 0.15)
    }
    keys = {campaign.row_key(t, a) for t in plan.throws for a in plan.plate_angles_rad}
    assert len(keys) == 48


def test_flows_become_paddle_loads() -> None:
    plan = campaign.parse("{mass_flow_kg_s: [12], elevator_speed_rpm: [400, 500], plate_angle_deg: 70}", "plan")
    assert [t.paddle_mass_kg for t in plan.throws] == pytest.approx([0.98679, 0.78943], rel=1e-4)


def test_geometry_comes_from_a_machine_file() -> None:
    plan = campaign.parse("{machine: sprocket-10, paddle_mass_kg: [0.5], plate_angle_deg: 70}", "plan")
    assert plan.throws[0].machine.sprocket_pitch_radius_m == pytest.approx(0.067)


def test_kernels_bring_their_own_values_and_the_plan_has_the_last_word() -> None:
    plan = campaign.parse(
        "{kernel: [clump, sphere], throw: {contact: {rolling_friction: 0.02}}, machine: sprocket-10, "
        "paddle_mass_kg: [0.2, 0.5], seed: [1, 2]}",
        "plan",
    )
    assert [t.grain.kernel for t in plan.throws] == ["clump", "sphere"] * 4
    assert {(t.grain.kernel, t.grain.mass_kg, t.time_step_s, t.contact.rolling_friction) for t in plan.throws} == {
        ("clump", 4.0e-4, 2.0e-5, 0.02),
        ("sphere", 4.048e-4, 3.0e-5, 0.02),
    }
    assert {t.machine.sprocket_pitch_radius_m for t in plan.throws} == {0.067}


@pytest.mark.parametrize("name", ["reference", "smoke", "clumps"])
def test_the_shipped_plans_are_good(name: str) -> None:
    path = CAMPAIGNS / f"{name}.yaml"
    plan = campaign.parse(path.read_text(encoding="utf-8"), str(path))
    assert plan.name == name


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("[1, 2]", "no keys"),
        ("{paddle_mass_kg: [0.2], angle: 3}", "angle is not a key"),
        ("{plate_angle_deg: [40]}", "exactly one of the two"),
        ("{paddle_mass_kg: [0.2], mass_flow_kg_s: [3]}", "exactly one of the two"),
        ("{paddle_mass_kg: []}", "paddle_mass_kg is []"),
        ("{paddle_mass_kg: [.nan]}", "paddle_mass_kg is [nan]"),
        ("{paddle_mass_kg: [heavy]}", "paddle_mass_kg is ['heavy']"),
        ("{paddle_mass_kg: [0.2], plate_angle_deg: [95]}", "plate_angle_deg holds 95"),
        ("{paddle_mass_kg: [0.2], friction: [-1]}", "contact.friction is -1"),
        ("{paddle_mass_kg: [0.2], throw: {contact: {frixion: 1}}}", "frixion: not a key of Contact"),
        ("{kernel: cube, paddle_mass_kg: [0.2]}", "kernel is cube, expected sphere or clump"),
        ("{machine: tractor, paddle_mass_kg: [0.2]}", "tractor"),
        ("{paddle_mass_kg: [0.2", "not YAML"),
    ],
)
def test_a_bad_plan_is_named_in_one_line(text: str, complaint: str) -> None:
    with pytest.raises(InputError) as caught:
        campaign.parse(text, "plan.yaml")
    assert str(caught.value).startswith("plan.yaml: ")
    assert complaint in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.usefixtures("engine_replaced")
def test_only_what_is_missing_is_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan, ledger = campaign.parse(PLAN, "plan"), campaign.Ledger(tmp_path)
    campaign.run(plan, ledger, 2, lambda text: None)
    first = ledger.read(plan)
    assert len(first) == 48
    gone = plan.throws[3], plan.plate_angles_rad[1]
    ledger.row_file(*gone).unlink()
    asked: list[tuple[str, tuple[float, ...]]] = []

    def noting(throw, angles, *args, **kwargs):  # type: ignore[no-untyped-def]
        asked.append((throw.throw_key(), tuple(angles)))
        fake_engine.run_throw(throw, angles, *args, **kwargs)

    monkeypatch.setattr(runner, "run_throw", noting)
    campaign.run(plan, ledger, 2, lambda text: None)
    assert asked == [(gone[0].throw_key(), (gone[1],))]
    assert ledger.read(plan) == first


def test_kill_9_loses_no_row_and_repeats_none(tmp_path: Path) -> None:
    plan_file = tmp_path / "plan.yaml"
    plan_file.write_text(PLAN, encoding="utf-8")
    command = [sys.executable, "-m", "tests.studies.dem.fake_engine", str(plan_file), str(tmp_path / "out")]
    done: list[str] = []
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[3]) as process:
        assert process.stdout is not None
        for line in process.stdout:
            done.append(line.strip())
            if len(done) == 7:
                process.send_signal(signal.SIGKILL)
                break
        done += [line.strip() for line in process.stdout]
    assert process.returncode == -signal.SIGKILL
    kept = {p.name for p in (tmp_path / "out" / "rows").glob("*.json")}
    assert set(done) <= kept
    assert len(kept) < 48
    again = subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parents[3], check=True).stdout.split()
    assert not set(again) & kept
    assert set(again) | kept == {f"{campaign.row_key(t, a)}.json" for t, a in _cells()}
    assert max(Counter(again).values()) == 1


def _cells():  # type: ignore[no-untyped-def]
    plan = campaign.parse(PLAN, "plan")
    return [(t, a) for t in plan.throws for a in plan.plate_angles_rad]


@pytest.mark.usefixtures("engine_replaced")
def test_a_row_half_written_does_not_count(tmp_path: Path) -> None:
    plan, ledger = campaign.parse(PLAN, "plan"), campaign.Ledger(tmp_path)
    ledger.row_file(plan.throws[0], plan.plate_angles_rad[0]).with_suffix(".part123").write_text("{", encoding="utf-8")
    assert len(ledger.missing(plan)) == 16
    assert ledger.read(plan) == []


def test_two_campaigns_cannot_share_a_folder(tmp_path: Path) -> None:
    ledger = campaign.Ledger(tmp_path)
    with ledger.alone(), pytest.raises(InputError, match="another campaign"), campaign.Ledger(tmp_path).alone():
        pass


@pytest.mark.usefixtures("engine_replaced")
def test_a_failing_throw_ends_the_campaign_and_keeps_the_rest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan, ledger = campaign.parse(PLAN, "plan"), campaign.Ledger(tmp_path)

    def breaking(throw, *args, **kwargs):  # type: ignore[no-untyped-def]
        if throw == plan.throws[2]:
            raise runner.EngineError("discrete-element engine: lost atoms")
        fake_engine.run_throw(throw, *args, **kwargs)

    monkeypatch.setattr(runner, "run_throw", breaking)
    with pytest.raises(runner.EngineError, match="lost atoms"):
        campaign.run(plan, ledger, 1, lambda text: None)
    assert len(ledger.read(plan)) == 6


@pytest.mark.usefixtures("engine_replaced")
def test_tables(tmp_path: Path) -> None:
    plan, ledger = campaign.parse(PLAN, "plan"), campaign.Ledger(tmp_path)
    campaign.run(plan, ledger, 1, lambda text: None)
    campaign.write_csv(tmp_path / "rows.csv", ledger.read(plan))
    with (tmp_path / "rows.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0])[:7] == [
        "plate_angle_deg",
        "paddle_mass_kg",
        "momentum_kg_m_s",
        "momentum_total_kg_m_s",
        "elevator_speed_rpm",
        "friction",
        "trial",
    ]
    assert float(rows[1]["plate_angle_deg"]) == 70.0
    # 200 steps of 3e-5 s at 0.2 N sin 70
    assert float(rows[1]["momentum_kg_m_s"]) == pytest.approx(200 * 3e-5 * 0.2 * 0.9396926, rel=1e-6)
    assert rows[0]["elevator_speed_rpm"] == "400"
    histories = campaign.history_rows(plan, ledger)
    cell = [h for h in histories if (h["plate_angle_deg"], h["paddle_mass_kg"], h["trial"]) == (70.0, 0.2, 1)][:8]
    assert min(float(h["time_s"]) for h in cell) == pytest.approx(0.004, abs=0.0011)
    assert len(campaign.layer_rows(plan, ledger)) == 16 * 6
    arrivals = campaign.arrival_rows(plan, ledger)
    cells = [(float(row["plate_angle_deg"]), int(row["trial"])) for row in rows]
    assert [(arrival["plate_angle_deg"], arrival["trial"]) for arrival in arrivals] == cells


def test_no_rows_is_an_error_not_an_empty_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no rows"):
        campaign.write_csv(tmp_path / "rows.csv", [])
    assert not (tmp_path / "rows.csv").exists()

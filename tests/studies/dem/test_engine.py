"""The engine itself: mechanics, crashes, a campaign killed for real. Skipped where LAMMPS is absent."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from studies.dem import campaign, checks, runner
from studies.dem.job import Throw

pytestmark = [pytest.mark.dem, pytest.mark.usefixtures("engine")]
ROOT = Path(__file__).parents[3]


SLOW = {
    "half_time_step",
    "repeatable",
    "thin_stream",
    "clump_does_not_roll",
    "clump_grains_conserved",
    "clump_half_time_step",
    "clump_repeatable",
    "clump_thin_stream",
}


@pytest.mark.parametrize(
    "check",
    [
        pytest.param(c, marks=[pytest.mark.slow] if c.__name__ in SLOW else [], id=c.__name__)
        for chosen in checks.CHECKS_OF.values()
        for c in chosen
    ],
)
def test_physics(check: object) -> None:
    result = check()  # type: ignore[operator]
    assert result.passed, f"{result.what}: {result.value:.4g}, at most {result.limit:g}"


def test_a_check_can_fail() -> None:
    """A bounce is distinguished from one of another restitution: 0.75 is not 0.70 to 0.002."""
    grains = checks.bounces(0.70, 2.0e-6, count=5)
    e = -grains["end_velocity_m_s"][:, 0] / grains["start_velocity_m_s"][:, 0]
    assert np.all(np.abs(e - 0.70) < 0.002)
    assert np.all(np.abs(e - 0.75) > 0.04)


def test_a_clumps_bounce_off_centre_is_not_a_spheres() -> None:
    """The central bounce's e is not what every orientation gives: off centre the clump takes up turning."""
    grains = checks.clump_bounces(checks.at_random(10), 2.0e-5)
    e = -grains["end_velocity_m_s"][:, 0] / grains["start_velocity_m_s"][:, 0]
    assert np.ptp(e) > 0.2
    assert np.mean(e) < 0.65


def test_the_parent_never_loads_the_engine(tmp_path: Path) -> None:
    runner.run_throw(Throw(paddle_mass_kg=0.004, settle_revolutions=0.1), [1.2], tmp_path, tmp_path)
    assert "lammps" not in sys.modules


def test_an_engine_that_dies_is_an_error_with_its_own_words(tmp_path: Path) -> None:
    heap = Throw(paddle_mass_kg=0.004)
    (tmp_path / f"heap-{heap.heap_key()}.restart").write_bytes(b"not a restart file")
    with pytest.raises(runner.EngineError, match=r"discrete-element engine: .*ERROR"):
        runner.run_throw(heap, [1.2], tmp_path / "out", tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("kernel", ["sphere", "clump"])
def test_smoke_campaign_killed_and_taken_up_again(kernel: str, tmp_path: Path) -> None:
    plan_file = tmp_path / "smoke.yaml"
    text = (ROOT / "studies/dem/campaigns/smoke.yaml").read_text(encoding="utf-8")
    plan_file.write_text(text if kernel == "sphere" else text + f"kernel: {kernel}\n", encoding="utf-8")
    plan = campaign.parse(plan_file.read_text(encoding="utf-8"), "smoke")
    command = [sys.executable, "-m", "studies.dem", "campaign", str(plan_file), "--out", str(tmp_path), "--jobs", "1"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if line.startswith("2/4 rows"):
                os.kill(process.pid, signal.SIGKILL)
    before = {p.name: p.stat().st_mtime_ns for p in (tmp_path / "rows").glob("*.json")}
    assert 2 <= len(before) < 4
    again = subprocess.run(command, check=False, capture_output=True, text=True)
    assert again.returncode == 0, again.stderr
    after = {p.name: p.stat().st_mtime_ns for p in (tmp_path / "rows").glob("*.json")}
    assert len(after) == 4
    assert before.items() <= after.items()
    rows = campaign.Ledger(tmp_path).read(plan)
    assert {row["kernel"] for row in rows} == {kernel}
    assert all(0.0 < float(row["momentum_kg_m_s"]) < 12.0 * float(row["paddle_mass_kg"]) for row in rows)
    assert json.loads((tmp_path / "smoke_provenance.json").read_text(encoding="utf-8"))["engine"] == "LAMMPS"
    assert (tmp_path / "smoke.csv").read_text(encoding="utf-8").startswith("plate_angle_deg,paddle_mass_kg,momentum_kg_m_s,")

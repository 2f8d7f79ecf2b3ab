"""kill -9 in the middle of a sweep, with a plate that moves and with one that is stuck: it ends at home, and totals stay."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from combine_service import PATIENT_BUS, adds_up, faults, grows, kill_and_wait, records, service, status, total_kg
from service_manager import eventually

pytestmark = [pytest.mark.systemd, pytest.mark.slow]

HOME_DEG = 70.0
SWEEP = """
sweep: {first_after_s: 0, steady_windows: 6, steady_cv: 0.2, flow_change: 0.5, flow_change_away: 2, signal_trend: 20,
        windows_per_step: 20, measure_timeout_s: 60, settle_s: 0.2, move_margin_s: 2.5, backoff_s: 1000, home_retry_s: 5,
        home_every: 1, angles_deg: [40]}
zero: {first_zero_windows: 1}
"""
SCENARIO = """
duration_s: 3600
flow:
  variation_pct: 1.5
  variation_time_s: 20
  pieces: [{kind: steady, duration_s: 5, flow_kg_s: 0}, {kind: steady, duration_s: 3600, flow_kg_s: 14}]
"""


@pytest.fixture(params=["", "faults: {actuator: [{kind: stuck, start_s: 45, end_s: 120}]}\n"], ids=["moving", "stuck"])
def stuck(request: pytest.FixtureRequest, daemon_command: Path, tmp_path: Path) -> Iterator[bool]:
    """Whether the plate of the combine that harvests, its daemon sweeping as soon as it can, gets stuck."""
    scenario = tmp_path / "scenario.yaml"
    scenario.write_text(SCENARIO + request.param, encoding="utf-8")
    with service(daemon_command, PATIENT_BUS + SWEEP), combine(daemon_command, scenario):
        yield bool(request.param)


@contextmanager
def combine(command: Path, scenario: Path) -> Iterator[None]:
    """The virtual combine on can0, in real time."""
    words = [str(command), "simulate", "--scenario", str(scenario), "-i", "socketcan", "-c", "can0"]
    with subprocess.Popen(words) as process:
        try:
            yield
        finally:
            process.kill()


def angle_deg() -> float:
    rows = status().get("windows", [])
    found = rows[-1]["plate_angle_deg"] if rows else None
    return HOME_DEG if found is None else float(found)


def test_the_plate_goes_home(stuck: bool) -> None:
    eventually(lambda: abs(angle_deg() - HOME_DEG) > 10.0, "a plate away from home in a sweep")
    if stuck:
        eventually(lambda: "PlateNotFollowing" in faults(), "the fault of a plate that is stuck")
        assert abs(angle_deg() - HOME_DEG) > 5.0, "it is stuck away from home"
    kept = records()[-1]
    kill_and_wait()
    assert total_kg() >= kept.total_kg
    eventually(lambda: abs(angle_deg() - HOME_DEG) < 0.6, "a plate at home")
    grows()
    assert records()[kept.number - 1] == kept, "a record that was written stays"
    adds_up(records())

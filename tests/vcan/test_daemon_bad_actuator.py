"""Plate sweeps on real SocketCAN against the virtual combine with an actuator that is stuck, slow, silent or lies."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest

from tests.vcan.drives import FLOW_KG_S, Drive, drive
from tests.vcan.nodes import DaemonNode
from yieldmon import frames
from yieldmon.engine.sweeps.sweep_inputs import SweepAbort
from yieldmon.frames import CommandMode

pytestmark = pytest.mark.vcan

HOME_DEG, LOWEST_DEG, HIGHEST_DEG = 70.0, 40.0, 90.0
TOLERANCE_DEG = 0.5 + 0.1
BACKOFF_S = 1000.0


def aborted(node: DaemonNode) -> bool:
    return node.status["sweep"]["state"] == "aborted"


def brought_home(node: DaemonNode) -> bool:
    """Left away from home by the abort, and fetched by the daemon later on."""
    status = node.status
    return status["sweep"]["aborted_because"] and abs(status["windows"][-1]["plate_angle_deg"] - HOME_DEG) < TOLERANCE_DEG


def faulty(kind: str, start_s: float, end_s: float = 1000.0) -> str:
    return f"faults: {{actuator: [{{kind: {kind}, start_s: {start_s}, end_s: {end_s}}}]}}\n"


def swept(channel: str, folder: Path, angles: str, faults: str, over=aborted) -> Drive:
    """One sweep that is aborted; what holds of each: a command in range, no gap in the mass flow, a long wait for the next."""
    done = drive(channel, folder, f"angles_deg: [{angles}]", over, faults)
    commands = [command.signals for command in done.of(frames.PLATE_ACTUATOR_COMMAND)]
    targets = [c["TargetPlateAngle"] for c in commands if c["CommandMode"] == CommandMode.GO_TO_ANGLE]
    assert LOWEST_DEG <= min(targets) <= max(targets) <= HIGHEST_DEG
    assert commands[-1]["CommandMode"] == CommandMode.RELEASE
    counters = done.values(frames.MASS_FLOW, "WindowCounter")
    assert {(b - a) % 256 for a, b in pairwise(counters)} == {1}
    assert [record.outcome for record in done.sweeps] == ["aborted"]
    assert 0.9 * BACKOFF_S < done.status["sweep"]["due_in_s"] <= BACKOFF_S
    assert "SweepAborted" in done.codes
    assert done.true_angles_deg[-1] == pytest.approx(HOME_DEG, abs=TOLERANCE_DEG)
    return done


def flow_went_on(done: Drive) -> None:
    """Each second of grain has its flow, also those of the sweep."""
    first = next(number for number, row in enumerate(done.rows) if row.sweep_step >= 0)
    flows = [row.mass_flow_kg_s for row in done.rows[first:]]
    assert None not in flows
    assert sum(flows) / len(flows) == pytest.approx(FLOW_KG_S, rel=0.1)


def test_stuck_away_from_home(vcan0: str, tmp_path: Path) -> None:
    """Not following; once it moves again the plate is fetched home."""
    done = swept(vcan0, tmp_path, "40, 90, 40, 90", faulty("stuck", 16.0, 40.0), brought_home)
    assert done.status["sweep"]["aborted_because"] == SweepAbort.NOT_FOLLOWING
    assert "PlateNotFollowing" in done.codes
    assert abs(done.true_angles_deg[35] - HOME_DEG) > 5.0, "it was stuck away from home"
    flow_went_on(done)


def test_implausible_feedback(vcan0: str, tmp_path: Path) -> None:
    """The plate never moves and its feedback says that it did: the force tells."""
    done = swept(vcan0, tmp_path, "65, 77", faulty("lying", 0.0))
    assert done.status["sweep"]["aborted_because"] == SweepAbort.FORCE_DOES_NOT_FOLLOW
    assert "PlateNotFollowing" in done.codes


@pytest.mark.slow
def test_slow(vcan0: str, tmp_path: Path) -> None:
    """A tenth of the rate: not following, and home all the same."""
    done = swept(vcan0, tmp_path, "60, 80", faulty("slow", 0.0))
    assert done.status["sweep"]["aborted_because"] == SweepAbort.NOT_FOLLOWING
    assert "PlateNotFollowing" in done.codes
    assert min(done.true_angles_deg) < HOME_DEG - 1.0, "it moved"
    flow_went_on(done)


@pytest.mark.slow
def test_silent(vcan0: str, tmp_path: Path) -> None:
    """Feedback ends in the middle of the sweep: the plate is sent home unseen, and no flow is made up for an unknown angle."""
    done = swept(vcan0, tmp_path, "40, 90, 40, 90", faulty("silent", 16.0))
    assert done.status["sweep"]["aborted_because"] == SweepAbort.FEEDBACK_STALE
    assert "PlateFeedbackStale" in done.codes
    assert abs(done.true_angles_deg[15] - HOME_DEG) > 5.0, "it was away from home"
    assert done.rows[-1].mass_flow_kg_s is None

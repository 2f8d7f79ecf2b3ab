"""`yieldmon run` on real SocketCAN, with candump as the witness: nominal traffic, and a sweep with a stuck actuator."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from tests.vcan.nodes import (
    PATIENCE_S,
    Command,
    DaemonNode,
    LeanCombine,
    Recorded,
    candump,
    daemon,
    eventually,
    read_back,
)
from yieldmon import frames
from yieldmon.engine.sweep import SweepAbort
from yieldmon.frames import CommandMode
from yieldmon.service.rows import SecondRow
from yieldmon.service.store import FaultEvent, SweepRecord

pytestmark = pytest.mark.vcan

HOME_DEG, LOWEST_DEG, HIGHEST_DEG = 70.0, 40.0, 90.0
#: What the sweep takes for home, and the noise of the feedback.
TOLERANCE_DEG = 0.5 + 0.1
SCENARIO = """
flow:
  pieces: [{kind: steady, duration_s: 8, flow_kg_s: 0}, {kind: steady, duration_s: 1000, flow_kg_s: 14}]
"""
NOMINAL_S = 61


@dataclass(frozen=True)
class Drive:
    """What a drive left behind: candump's log, the store, the last status, where the plate really is."""

    log: list[Recorded]
    rows: list[SecondRow]
    events: list[FaultEvent]
    sweeps: list[SweepRecord]
    status: dict[str, Any]
    true_deg: float = HOME_DEG

    def of(self, message: str) -> list[Recorded]:
        return [frame for frame in self.log if frame.message == message]

    @property
    def codes(self) -> set[str]:
        return {event.code for event in self.events if event.active}


def left_behind(node: DaemonNode, log: Path, status: dict[str, Any], true_deg: float = HOME_DEG) -> Drive:
    with node.store() as store:
        return Drive(read_back(log), store.seconds(), store.faults(), store.sweeps(), status, true_deg)


@pytest.fixture(scope="module")
def nominal(vcan0: str, tmp_path_factory: pytest.TempPathFactory) -> Drive:
    """A minute of the virtual combine's nominal traffic, recorded before and sent by can-utils' canplayer."""
    folder = tmp_path_factory.mktemp("nominal")
    (folder / "scenario.yaml").write_text(SCENARIO)
    words = ["simulate", "--scenario", str(folder / "scenario.yaml"), "--duration", str(NOMINAL_S)]
    Command([*words, "--log", str(folder / "combine.log")], folder / "simulate.txt", {}).finished()
    log = folder / "candump.log"
    with daemon(vcan0, folder) as node, candump(vcan0, log):
        player = ["canplayer", "-I", str(folder / "combine.log"), f"{vcan0}=can0"]
        subprocess.run(player, check=True, timeout=NOMINAL_S + PATIENCE_S)
        sent = len((folder / "combine.log").read_text().splitlines())
        eventually(lambda: node.status["bus"]["received"] >= sent, f"{sent} frames to be taken: {node.status['bus']}")
        status = node.status
    return left_behind(node, log, status)


def test_no_frame_and_no_sample_is_lost(nominal: Drive) -> None:
    sent = nominal.of(frames.IMPACT_SENSOR_SAMPLES)
    steps = {(b.signals["SampleCounter"] - a.signals["SampleCounter"]) % 256 for a, b in pairwise(sent)}
    assert steps == {1}
    bus = nominal.status["bus"]
    inputs = sum(1 for frame in nominal.log if frame.message in frames.INPUTS)
    assert (bus["received"], bus["dropped"], bus["kernel_drops"], bus["malformed"]) == (inputs, 0, 0, 0)
    assert sum(row.lost_frames + row.surplus_frames + row.repeated_frames for row in nominal.rows) == 0
    # FramesLost may show: it also tells of a player that paused for longer than a sample may be old.
    assert not nominal.codes & {"BusError", "OutputConflict", "ClockJumped"}


def test_mass_flow_comes_for_each_second(nominal: Drive) -> None:
    counters = [frame.signals["WindowCounter"] for frame in nominal.of(frames.MASS_FLOW)]
    assert len(counters) >= NOMINAL_S - 1
    assert {(b - a) % 256 for a, b in pairwise(counters)} == {1}
    ends = [row.time_s for row in nominal.rows]
    assert {round(b - a, 6) for a, b in pairwise(ends)} == {1.0}
    assert (nominal.status["bus"]["late"], nominal.status["bus"]["refused"]) == (0, 0)


def test_what_is_published_is_what_is_stored(nominal: Drive) -> None:
    published = [frame.signals["TotalMass"] for frame in nominal.of(frames.ACCUMULATED_MASS)]
    stored = [row.total_kg for row in nominal.rows]
    assert published == pytest.approx(stored[: len(published)], abs=0.06)
    assert stored[-1] == pytest.approx(14.0 * (NOMINAL_S - 8), rel=0.1)


def test_every_message_of_the_daemon_is_heard_and_decodes(nominal: Drive) -> None:
    assert {frame.message for frame in nominal.log} >= set(frames.OUTPUTS) - {frames.PLATE_ACTUATOR_COMMAND}


SWEEP = """
sweep: {first_after_s: 0, steady_windows: 2, steady_cv: 0.2, windows_per_step: 1, settle_s: 0.2, move_margin_s: 2.5,
        return_timeout_s: 6, backoff_s: 1000, angles_deg: [%s], home_rest_s: 60}
zero: {first_zero_windows: 1}
"""


def sweep(channel: str, folder: Path, angles: str, fault: str | None = None, begin_s: float = 0.0) -> Drive:
    """One sweep against the virtual actuator, from the first frame to the plate's release."""
    log = folder / "candump.log"
    with daemon(channel, folder, SWEEP % angles) as node, candump(channel, log):
        combine = LeanCombine(channel, fault, begin_s)
        over = ("updated", "not_learned", "aborted")
        eventually(lambda: node.status["sweep"]["state"] in over, "the end of the sweep")
        last = node.windows
        eventually(lambda: node.windows > last + 1, "two more windows")
        status, true_deg = node.status, combine.true_deg
        combine.end()
    done = left_behind(node, log, status, true_deg)
    commands = [command.signals for command in done.of(frames.PLATE_ACTUATOR_COMMAND)]
    targets = [c["TargetPlateAngle"] for c in commands if c["CommandMode"] == CommandMode.GO_TO_ANGLE]
    assert LOWEST_DEG <= min(targets) <= max(targets) <= HIGHEST_DEG
    assert {(b["CommandCounter"] - a["CommandCounter"]) % 256 for a, b in pairwise(commands)} == {1}
    return done


#: Fault, when it begins, angles of the sweep, why the sweep ends, fault told beside SweepAborted.
FAULTS = [
    pytest.param("stuck", 0, "60, 80", SweepAbort.NOT_FOLLOWING, "PlateNotFollowing", id="stuck"),
]


@pytest.mark.parametrize(("fault", "begin_s", "angles", "reason", "told"), FAULTS)
def test_a_sweep_with_a_bad_actuator(
    vcan0: str, tmp_path: Path, fault: str, begin_s: float, angles: str, reason: SweepAbort, told: str
) -> None:
    """It ends for the right reason, and the plate is let go at home."""
    done = sweep(vcan0, tmp_path, angles, fault, begin_s)
    assert done.status["sweep"]["aborted_because"] == reason
    assert {"SweepAborted", told} <= done.codes
    assert done.of(frames.PLATE_ACTUATOR_COMMAND)[-1].signals["CommandMode"] == CommandMode.RELEASE
    assert done.true_deg == pytest.approx(HOME_DEG, abs=TOLERANCE_DEG)

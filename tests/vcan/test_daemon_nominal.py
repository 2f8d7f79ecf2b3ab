"""`yieldmon run` and the virtual combine on real SocketCAN with a full plate sweep, and candump as the witness."""

from __future__ import annotations

from itertools import pairwise
from statistics import median

import pytest

from tests.vcan.drives import EMPTY_S, FLOW_KG_S, Drive, drive
from yieldmon import frames
from yieldmon.engine.settings import SweepSettings
from yieldmon.engine.sweeps.sweep import sweep_sequence
from yieldmon.frames import CommandMode, SweepState

pytestmark = pytest.mark.vcan

HOME_DEG, LOWEST_DEG, HIGHEST_DEG = 70.0, 40.0, 90.0
#: What the sweep takes for there, and the noise of the feedback.
TOLERANCE_DEG = 0.5 + 0.1
#: A minute of traffic at least.
LEAST_S = 60
#: The daemon's claim, before candump listens.
UNRECORDED_FRAMES = 10


@pytest.fixture(scope="module")
def nominal(vcan0: str, tmp_path_factory: pytest.TempPathFactory) -> Drive:
    """From the first frame, through a sweep over the default angles, to the seconds after it."""
    swept = ("updated", "not_learned", "aborted")
    return drive(
        vcan0,
        tmp_path_factory.mktemp("nominal"),
        "flow_change: 0.25",
        lambda node: node.status["sweep"]["state"] in swept and node.windows >= LEAST_S,
    )


def test_no_frame_and_no_sample_is_lost(nominal: Drive) -> None:
    counters = nominal.values(frames.IMPACT_SENSOR_SAMPLES, "SampleCounter")
    assert {(b - a) % 256 for a, b in pairwise(counters)} == {1}
    bus = nominal.status["bus"]
    assert (bus["dropped"], bus["kernel_drops"], bus["malformed"]) == (0, 0, 0)
    inputs = sum(1 for frame in nominal.log if frame.message in frames.INPUTS)
    # The status is as of the last window.
    # What it heard beside its inputs: echoes of its own frames, and the network's, more the longer a fault lasts.
    assert inputs - 600 < bus["received"] <= nominal.recorded + UNRECORDED_FRAMES
    assert sum(row.lost_frames + row.surplus_frames + row.repeated_frames for row in nominal.rows) == 0
    # The seconds in which the combine starts and ends lack a part.
    first_s, last_s = (next(f.time_s for f in log if f.message in frames.INPUTS) for log in (nominal.log, nominal.log[::-1]))
    assert min(row.coverage for row in nominal.rows if first_s + 2.5 < row.time_s < last_s) > 0.999
    reported = {event.code for event in nominal.events if event.active and first_s + 2.5 < event.time_s < last_s}
    assert not reported & {"FramesLost", "SensorMissing", "SpeedMissing", "PlateFeedbackStale", "ClockJumped"}
    assert not nominal.codes & {"BusError", "OutputConflict"}


def test_mass_flow_comes_for_each_second(nominal: Drive) -> None:
    counters = nominal.values(frames.MASS_FLOW, "WindowCounter")
    assert len(counters) >= LEAST_S
    assert {(b - a) % 256 for a, b in pairwise(counters)} == {1}
    assert {round(b.time_s - a.time_s, 6) for a, b in pairwise(nominal.rows)} == {1.0}
    harvested = [row.mass_flow_kg_s for row in nominal.rows if row.sweep_step >= 0]
    assert harvested == pytest.approx([FLOW_KG_S] * len(harvested), rel=0.25)
    assert (nominal.status["bus"]["late"], nominal.status["bus"]["refused"]) == (0, 0)


def test_what_is_published_is_what_is_stored(nominal: Drive) -> None:
    published = nominal.values(frames.ACCUMULATED_MASS, "TotalMass")
    stored = [row.total_kg for row in nominal.rows]
    # Nothing is sent before the address claim stands, which costs the first seconds.
    starts = [stored[unheard : unheard + len(published)] for unheard in range(3)]
    assert any(published[: len(part)] == pytest.approx(part, abs=0.06) for part in starts)
    # Before the combine's first frame and after its last one the daemon counts seconds, but no grain.
    sent_s = [frame.time_s for frame in nominal.log if frame.message in frames.INPUTS]
    harvest_s = min(nominal.rows[-1].time_s, sent_s[-1]) - sent_s[0] - EMPTY_S
    assert stored[-1] == pytest.approx(FLOW_KG_S * harvest_s, rel=0.1), f"{len(stored)} seconds, {harvest_s:.1f} of harvest"


def test_every_message_of_the_daemon_is_heard_and_decodes(nominal: Drive) -> None:
    assert {frame.message for frame in nominal.log} >= set(frames.OUTPUTS)


def test_the_sweep_runs_through_and_ends_at_home(nominal: Drive) -> None:
    assert [sweep.outcome for sweep in nominal.sweeps] in (["updated"], ["not_learned"]), nominal.status["sweep"]
    steps = {row.sweep_step for row in nominal.rows if row.sweep_step >= 0}
    defaults = SweepSettings()
    assert steps == set(range(len(sweep_sequence(defaults.angles_deg, HOME_DEG, defaults.home_every))))
    reported = nominal.values(frames.PLATE_ACTUATOR_FEEDBACK, "PlateAngle")
    assert min(reported) == pytest.approx(LOWEST_DEG, abs=TOLERANCE_DEG)
    assert max(reported) == pytest.approx(HIGHEST_DEG, abs=TOLERANCE_DEG)
    assert nominal.true_angles_deg[-1] == pytest.approx(HOME_DEG, abs=TOLERANCE_DEG)


def test_the_sweep_is_reported_throughout(nominal: Drive) -> None:
    states = nominal.values(frames.SELF_CALIBRATION_STATUS, "SweepState")
    assert len(states) == pytest.approx(len(nominal.of(frames.MASS_FLOW)), abs=1)
    assert SweepState.MEASURING in states
    assert not {SweepState.ABORTED, SweepState.RETURNING} & set(states)
    progress = nominal.values(frames.SELF_CALIBRATION_STATUS, "SweepProgress")
    assert progress == sorted(progress)
    assert (progress[0], progress[-1]) == (0.0, 100.0)


def test_the_plate_is_commanded_at_10_hz_and_within_its_range(nominal: Drive) -> None:
    sent = nominal.of(frames.PLATE_ACTUATOR_COMMAND)
    commands = [command.signals for command in sent]
    targets = [c["TargetPlateAngle"] for c in commands if c["CommandMode"] == CommandMode.GO_TO_ANGLE]
    assert LOWEST_DEG <= min(targets) <= max(targets) <= HIGHEST_DEG
    assert {(b["CommandCounter"] - a["CommandCounter"]) % 256 for a, b in pairwise(commands)} == {1}
    # The median: ticks that a busy machine's pauses left out are not sent later, and must not be.
    interval_s = median(b.time_s - a.time_s for a, b in pairwise(sent))
    assert interval_s == pytest.approx(0.1, rel=0.02)
    assert commands[-1]["CommandMode"] == CommandMode.RELEASE

"""The daemon on SocketCAN beside a tractor's recorded bus, at its pace and ten times that: nothing lost, wrong or answered.

YIELDMON_TRACTOR_LOG names another recording than the excerpt, in any form that `replay` reads.
"""

from __future__ import annotations

import math
import os
from functools import partial
from pathlib import Path

import pytest

from tests.vcan.drives import SCENARIO
from tests.vcan.nodes import Command, DaemonNode, candump, combine, daemon, eventually
from yieldmon.bus.log_files.logs import read_log
from yieldmon.network.identifier import Identifier

pytestmark = [pytest.mark.vcan, pytest.mark.slow]

EXCERPT = Path(__file__).parent.parent / "data" / "tractor_bus" / "in_gear_5s.log.gz"
RECORDING = os.environ.get("YIELDMON_TRACTOR_LOG") or str(EXCERPT)
US, EVERYBODY = 0x83, 0xFF
LEAST_WINDOWS = 25
NO_SWEEP = "sweep: {enabled: false}\n"
WRONG = {
    "FramesLost", "SensorMissing", "SpeedMissing", "PlateFeedbackStale", "ClockJumped", "BusError", "OutputConflict",
}  # fmt: skip


def another(node: DaemonNode, seen: int) -> bool:
    return node.windows > seen


@pytest.mark.parametrize("speed", [1, 10])
def test_a_tractors_bus_beside_ours(vcan0: str, tmp_path: Path, speed: int) -> None:
    log = tmp_path / "candump.log"
    recorded = list(read_log(RECORDING))
    windows = max(LEAST_WINDOWS, math.ceil((recorded[-1].timestamp - recorded[0].timestamp) / speed) + 6)
    words = ["replay", RECORDING, "-i", "socketcan", "-c", vcan0, "--speed", str(speed), "--loop"]
    with daemon(vcan0, tmp_path, NO_SWEEP) as node, candump(vcan0, log), combine(vcan0, tmp_path, SCENARIO):
        tractor = Command(words, tmp_path / "replay.txt", {})
        try:
            eventually(lambda: any(window["coverage"] > 0.999 for window in node.status["windows"]), "samples")
            last = node.windows + windows
            while (seen := node.windows) < last:
                eventually(partial(another, node, seen), "the end of the drive")
            status = node.status
        finally:
            tractor.process.terminate()
            tractor.process.join()
    bus = status["bus"]
    assert (bus["dropped"], bus["kernel_drops"], bus["malformed"]) == (0, 0, 0)
    with node.store() as store:
        rows, events = store.seconds(), store.faults()
    # The seconds in which combine and tractor start lack a part.
    begun = next(place for place, row in enumerate(rows) if row.coverage > 0.0)
    reported = {event.code for event in events if event.active and event.time_s > rows[begun + 5].time_s}
    assert not reported & WRONG
    # One of the tractor's own nodes sends from 0x83, too, in the recordings that are not the excerpt.
    assert ("NetworkFault" in reported) == any(m.arbitration_id & 0xFF == US for m in recorded if m.is_extended_id)
    rows = rows[begun + 5 : begun + windows]
    assert len(rows) == windows - 5
    assert sum(row.lost_frames + row.surplus_frames for row in rows) == 0
    assert min(row.coverage for row in rows) > 0.999
    theirs = {(m.arbitration_id, bytes(m.data)) for m in recorded}
    heard = [m for m in read_log(str(log)) if m.is_extended_id and (m.arbitration_id, bytes(m.data)) not in theirs]
    ours = [parts for parts in (Identifier.of(m.arbitration_id) for m in heard) if parts.source == US]
    assert ours
    assert {parts.destination for parts in ours} == {EVERYBODY}

"""Five foreign layouts of the virtual combine on real SocketCAN, in real time, each measured by configuration alone."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import can
import numpy as np
import pytest

from tests.service.bench import Bench, running, wait_for
from tests.signals.layouts import LAYOUTS, Layout
from yieldmon.frames import Frame
from yieldmon.physics.machine import Machine
from yieldmon.plant import scenario
from yieldmon.plant.combine import VirtualCombine

pytestmark = pytest.mark.vcan

DURATION_S, EMPTY_S, FLOW_KG_S = 17.0, 7.0, 12.0


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    pieces = [
        {"kind": "steady", "duration_s": EMPTY_S, "flow_kg_s": 0.0},
        {"kind": "steady", "duration_s": 1000.0, "flow_kg_s": FLOW_KG_S},
    ]
    document = {"duration_s": DURATION_S, "flow": {"pieces": pieces}}
    return list(VirtualCombine(scenario.from_mapping(document, "foreign"), Machine(), 3).frames_until(DURATION_S))


def play(bench: Bench, messages: Sequence[can.Message]) -> None:
    """Send at the messages' own pace."""
    begun_s = time.monotonic() - messages[0].timestamp
    for message in messages:
        wait_s = begun_s + message.timestamp - time.monotonic()
        if wait_s > 0.001:
            time.sleep(wait_s)
        bench.peer.send(message)


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.name)
def test_a_foreign_bus_is_measured(vcan0: str, layout: Layout, frames: list[Frame], tmp_path: Path) -> None:
    layout.write(tmp_path)
    messages = sorted(layout.messages(frames, 0.0), key=lambda message: message.timestamp)
    text = f"bus: {{interface: socketcan, channel: {vcan0}}}\n{layout.config}"
    with running(tmp_path, text, socketcan=vcan0) as bench:
        play(bench, messages)
        wait_for(lambda: bench.rows and bench.rows[-1]["number"] >= DURATION_S - 2.0, "the last seconds")
        flows = [row["mass_flow_kg_s"] for row in bench.rows[-5:-1]]
        stated = [row["std_dev_kg_s"] for row in bench.rows[-5:-1]]
        # What 10 Hz costs is in the standard deviation; every other layout measures as the native one does.
        allowed = 2.0 * np.mean(stated) if layout.name == "newtons" else 0.12 * FLOW_KG_S
        assert np.mean(flows) == pytest.approx(FLOW_KG_S, abs=allowed)
        assert not {"SensorMissing", "SpeedMissing", "PlateFeedbackStale", "PlateNotFollowing"} & set(bench.faults)
        assert bench.status["bus"]["malformed"] == 0

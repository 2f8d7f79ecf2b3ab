"""Time that goes on without frames of ours: only as far as the bus itself says, never ahead of frames still on their way."""

from __future__ import annotations

import threading
from collections import deque
from pathlib import Path

import can
import pytest

from tests.service.bench import CODEC, PATIENCE_S, START_S, running, traffic, wait_for
from yieldmon import frames
from yieldmon.frames import Frame
from yieldmon.service.config import configuration
from yieldmon.service.daemon import Daemon
from yieldmon.service.timeouts import Timeouts


class StarvedBus(can.BusABC):
    """Gives frames at once; at a None its reader gets no processor for a while, as the queues behind it do not know."""

    def __init__(self, script: list[can.Message | None], stall_s: float) -> None:
        super().__init__(channel="starved")
        self._script = deque(script)
        self._stall_s = stall_s

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        pass

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._script:
            threading.Event().wait(timeout or 0.0)
            return None, True
        message = self._script.popleft()
        if message is None:
            threading.Event().wait(self._stall_s)
            message = self._script.popleft()
        return message, True


def test_a_stall_of_the_receiver_is_no_jump_of_the_clock(tmp_path: Path):
    """The engine comes back first after a stall, before the frames that the kernel has kept: none is late for its window."""
    script: list[can.Message | None] = []
    for begin_s in (0.0, 2.5):
        moved = (frame._replace(time_s=START_S + frame.time_s) for frame in traffic(begin_s, 2.5, 0.0))
        script += [*(CODEC.encode(frame) for frame in moved), None]
    (tmp_path / "c.yaml").write_text("sweep: {enabled: false}")
    environment = {"STATE_DIRECTORY": str(tmp_path), "RUNTIME_DIRECTORY": str(tmp_path)}
    loaded = configuration.load(tmp_path / "c.yaml", environment)
    bus = StarvedBus(script[:-1], stall_s=4 * Timeouts().silence_s)
    daemon = Daemon(loaded, environment=environment, bus_factory=lambda: bus)
    thread = threading.Thread(target=daemon.run)
    thread.start()
    wait_for(lambda: len(daemon.snapshot.get("windows", [])) >= 4, "the windows of 5 s")
    rows = daemon.snapshot["windows"][:4]
    daemon.request_stop()
    thread.join(PATIENCE_S)
    assert [row["time_s"] - START_S for row in rows[1:]] == pytest.approx([2.1, 3.1, 4.1], abs=1e-6)
    assert {row["lost_frames"] for row in rows} == {0}
    assert not any("ClockJumped" in row["faults"] for row in rows)


def test_other_nodes_frames_alone_keep_time_going(tmp_path: Path):
    """Inputs silent on a bus that never is: what is missing is reported, and the watchdog fed."""
    forged = {"MassFlowRate": 9.0, "MassFlowStdDev": 0.1, "EstimateQuality": 0, "WindowCounter": 3}
    enough = threading.Event()

    with running(tmp_path, silence_s=Timeouts().silence_s) as bench:

        def babble() -> None:
            # More often than the engine's thread looks at an empty queue.
            while not enough.wait(0.002):
                bench.now_s += 0.02
                bench.peer.send(CODEC.encode(Frame(bench.now_s, frames.MASS_FLOW, forged)))

        bench.play(3, 0.0)
        idiot = threading.Thread(target=babble)
        idiot.start()
        try:
            wait_for(lambda: len(bench.rows) >= 8, "windows of a bus that only others use")
            assert {"SensorMissing", "SpeedMissing", "OutputConflict"} <= set(bench.faults)
        finally:
            enough.set()
            idiot.join()

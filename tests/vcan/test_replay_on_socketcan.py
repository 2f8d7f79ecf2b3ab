"""`yieldmon replay` onto real SocketCAN at a log's own pace, by the kernel's timestamps of an independent recorder."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.vcan.nodes import Command, candump
from yieldmon.bus.log_files.logs import read_log

pytestmark = pytest.mark.vcan

SPAN_S = 120.0
#: How far the replay's length may be from the log's, and any frame from its place.
TOLERANCE_S = 0.1


@pytest.mark.parametrize("frames_s", [20, pytest.param(300, marks=pytest.mark.slow)])
def test_a_log_of_120_s_takes_120_s(vcan0: str, tmp_path: Path, frames_s: int) -> None:
    frames_sent = round(SPAN_S * frames_s) + 1
    log, recording = tmp_path / "drive.log", tmp_path / "recorded.log"
    lines = (f"({1_700_000_000 + k / frames_s:.6f}) can0 18FF80{k % 256:02X}#{k:016X}\n" for k in range(frames_sent))
    log.write_text("".join(lines))
    with candump(vcan0, recording):
        replay = ["replay", str(log), "-i", "socketcan", "--map", f"can0={vcan0}"]
        Command(replay, tmp_path / "replay.txt", {}).finished()
    recorded = list(read_log(recording))
    assert [int.from_bytes(message.data, "big") for message in recorded] == list(range(frames_sent))
    assert recorded[-1].timestamp - recorded[0].timestamp == pytest.approx(SPAN_S, abs=TOLERANCE_S)
    late_s = [message.timestamp - recorded[0].timestamp - k / frames_s for k, message in enumerate(recorded)]
    assert max(map(abs, late_s)) < TOLERANCE_S

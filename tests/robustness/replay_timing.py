"""How well a replay keeps time on python-can's virtual bus, and how many frames a second it sends at most.

    python -m tests.robustness replay-timing [--seconds S] [--rate F] [--json]

A log of S seconds at F frames a second is written and replayed twice: at its own speed, where a frame's lateness is the time
from its deadline to the return of send(), and at `--speed 0`. A second node receives on a thread of its own and counts.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import threading
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.robustness replay-timing", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=120.0, metavar="S", help="length of the log (default: 120)")
    parser.add_argument("--rate", type=float, default=1000.0, metavar="F", help="frames a second (default: 1000)")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    options = parser.parse_args(arguments)
    if not (1.0 <= options.seconds <= 3600.0 and 1.0 <= options.rate <= 20000.0):
        parser.error("expected 1 to 3600 seconds and 1 to 20000 frames a second")
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "even.log"
        count = round(options.seconds * options.rate)
        write(log, count, options.rate)
        paced, fastest = replayed(log, 1.0), replayed(log, 0.0)
    document = {"load_average": os.getloadavg()[0], "frames": count, "log_s": (count - 1) / options.rate, "paced": paced}
    document["fastest"] = fastest
    if options.json:
        print(json.dumps(document, indent=2))
        return 0
    print(f"load average {document['load_average']:.1f} on {os.cpu_count()} cores")
    print(f"{count} frames, {document['log_s']:.3f} s of log, replayed in {paced['elapsed_s']:.3f} s")
    print(f"within 5 ms of their deadline: {paced['on_time_pct']:.3f} %; worst {paced['worst_ms']:.2f} ms late")
    print(f"--speed 0: {fastest['frames_per_s']:.0f} frames/s")
    print(f"received by the other node: {paced['received']} and {fastest['received']}")
    return 0


def write(path: Path, count: int, rate: float) -> None:
    """Sample frames at an even rate."""
    from yieldmon.bus.codec import Codec
    from yieldmon.frames import IMPACT_SENSOR_SAMPLES

    frame_id = Codec().layouts[IMPACT_SENSOR_SAMPLES].frame_id
    path.write_text("".join(f"({1_700_000_000 + k / rate:.6f}) can0 {frame_id:08X}#{k:016X}\n" for k in range(count)))


def replayed(log: Path, speed: float) -> dict[str, Any]:
    """The log on a virtual bus of its own."""
    import can

    from yieldmon.bus.log_files.log_notes import LogNotes
    from yieldmon.bus.log_files.logs import read_log
    from yieldmon.bus.replay import Progress, Schedule, Sender, replay

    channel, progress, received = f"replay-timing-{uuid.uuid4()}", Progress(), []
    ended = threading.Event()
    with can.Bus(channel, interface="virtual") as sending, can.Bus(channel, interface="virtual") as receiving:

        def receive() -> None:
            while (message := receiving.recv(0.2)) is not None or not ended.is_set():
                if message is not None:
                    received.append(message.timestamp)

        thread = threading.Thread(target=receive)
        thread.start()
        try:
            replay([read_log(log, LogNotes())], Sender({None: sending}).send, Schedule(speed), progress)
        finally:
            ended.set()
            thread.join()
    return {
        "elapsed_s": progress.elapsed_s,
        "on_time_pct": 100.0 * (1.0 - progress.late / progress.sent),
        "worst_ms": 1000.0 * progress.worst_lateness_s,
        "frames_per_s": progress.frames_per_s,
        "received": len(received),
    }

"""What a drive with the daemon on a real CAN interface left behind, for the tests to look at afterwards."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.vcan.nodes import DaemonNode, Recorded, candump, combine, daemon, eventually, read_back
from yieldmon.service.storage.batch import FaultEvent, SweepRecord
from yieldmon.service.storage.rows import SecondRow

EMPTY_S, FLOW_KG_S = 5, 14.0
#: Runs empty, so that the zero is learned, then harvests at a nearly steady flow.
SCENARIO = f"""
duration_s: 240
flow:
  variation_pct: 1.5
  variation_time_s: 20
  pieces: [{{kind: steady, duration_s: {EMPTY_S}, flow_kg_s: 0}}, {{kind: steady, duration_s: 1000, flow_kg_s: {FLOW_KG_S}}}]
"""
#: A sweep as soon as there is something to sweep, one window a step, and none after it.
SWEEP = """
sweep: {first_after_s: 0, steady_windows: 2, steady_cv: 0.2, windows_per_step: 1, settle_s: 0.2, move_margin_s: 2.5,
        backoff_s: 1000, home_retry_s: 5, %s}
zero: {first_zero_windows: 1}
"""


@dataclass(frozen=True)
class Drive:
    """candump's log, the number of its frames with the network's, the store, the last status, and the true plate angle of each
    second."""

    log: list[Recorded]
    recorded: int
    rows: list[SecondRow]
    events: list[FaultEvent]
    sweeps: list[SweepRecord]
    status: dict[str, Any]
    true_angles_deg: list[float]

    def of(self, message: str) -> list[Recorded]:
        return [frame for frame in self.log if frame.message == message]

    def values(self, message: str, signal: str) -> list[Any]:
        return [frame.signals[signal] for frame in self.of(message)]

    @property
    def codes(self) -> set[str]:
        """Faults that were reported at any time."""
        return {event.code for event in self.events if event.active}


def drive(channel: str, folder: Path, sweep: str, over: Callable[[DaemonNode], object], faults: str = "") -> Drive:
    """A drive of the virtual combine until `over` holds and two more seconds have passed.

    sweep: more settings of the sweep. faults: lines for the scenario.
    """
    log = folder / "candump.log"
    with daemon(channel, folder, SWEEP % sweep) as node, candump(channel, log):
        with combine(channel, folder, SCENARIO + faults):
            eventually(lambda: over(node), "the end of the drive")
            last = node.windows
            eventually(lambda: node.windows > last + 1, "two more windows")
        status = node.status
    with node.store() as store:
        rows, events, sweeps = store.seconds(), store.faults(), store.sweeps()
    with (folder / "truth.csv").open(encoding="utf-8", newline="") as stream:
        true_angles_deg = [float(row["plate_angle_deg"]) for row in csv.DictReader(stream)]
    return Drive(read_back(log), len(log.read_text().splitlines()), rows, events, sweeps, status, true_angles_deg)

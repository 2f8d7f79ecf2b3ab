"""Let the daemon live through a day, faster than time or in real time, and see that it neither grows nor drifts.

python -m tests.robustness soak --hours 24                simulated traffic through the daemon's own code as fast as it goes
python -m tests.robustness soak --hours 0.5 --real-time   the same by the clock

Every five minutes of bus time: an empty elevator, a load that ends and one that begins, a sweep, a ticket, two troubles (a silent
or saturated sensor, lost frames, a forged output, error frames, a lost interface, ...; every fourth sweep finds a plate that does
not move). The configuration is read anew in every fifth. The store may keep a quarter of the time and 4 MB.

Held, from the first tenth on: memory grows by less than 5 MB and no file stays open; windows end on the same fraction of every
second, one for each, but for one at a reload; the receiver drops nothing; every trouble shows its fault and every fault goes
again; sweeps end, loads and tickets are all there; the store adds up and stays within its bounds. Prints one JSON document, and
a line for each thing that did not hold.
"""

from __future__ import annotations

import argparse
import dataclasses
import gc
import json
import math
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.robustness.soak_machine import CYCLE_S, EXPECTED_FAULTS, STUCK_EVERY, MachineOnBus
from yieldmon.service.config import configuration
from yieldmon.service.daemon import Daemon
from yieldmon.service.operator.control_client import ask
from yieldmon.service.storage.batch import Batch
from yieldmon.service.storage.retention import Retention
from yieldmon.service.storage.store import Store
from yieldmon.service.timeouts import Timeouts

LIMIT_MB = 5.0
#: Room is made about once a minute, and in a hurry less often.
PRUNE_SLACK = 300
RELOAD_EVERY = 5
SIZE_MB = 4.0
EVENT_ROWS = 200
#: Seconds of a cycle at which the operator acts.
ZERO_AT_S, STOP_AT_S, START_AT_S, SWEEP_AT_S, TICKET_AT_S, STATUS_AT_S, RELOAD_AT_S = 5, 34, 36, 45, 150, 180, 215


class Witness:
    """Looks at every batch on its way to the store, and keeps no more than counts."""

    def __init__(self) -> None:
        self.windows = 0
        self.irregular = 0
        self.fractions = [1.0, 0.0]
        self.lost_frames = 0
        self.shown: set[str] = set()
        self.gone: set[str] = set()
        self.sweeps: dict[str, int] = {}
        self._last: tuple[int, float] | None = None

    def see(self, batch: Batch) -> None:
        for row in batch.seconds:
            if self._last is not None:
                number, time_s = self._last
                self.irregular += not (row.number == number + 1 and 0.999 < row.time_s - time_s < 1.001)
                self.fractions = [min(self.fractions[0], row.time_s % 1.0), max(self.fractions[1], row.time_s % 1.0)]
            self._last = row.number, row.time_s
            self.windows += 1
            self.lost_frames += row.lost_frames
        for event in batch.faults:
            (self.shown if event.active else self.gone).add(event.code)
        for sweep in batch.sweeps:
            self.sweeps[sweep.outcome] = self.sweeps.get(sweep.outcome, 0) + 1


class Operator:
    """Does in each cycle what an operator does, through the control socket and by SIGHUP's way."""

    def __init__(self, socket: Path, reload: Callable[[], None]) -> None:
        self._socket = socket
        self._reload = reload
        self._cycle = -1
        self._to_do: list[int] = []
        self.cycles = 0
        self.loads = 0
        self.tickets = 0
        self.reloads = 0

    def act(self, now_s: float) -> None:
        cycle = int(now_s / CYCLE_S)
        if cycle != self._cycle:
            self._cycle = cycle
            self.cycles += 1
            self._to_do = [ZERO_AT_S, STOP_AT_S, START_AT_S, SWEEP_AT_S, TICKET_AT_S, STATUS_AT_S, RELOAD_AT_S]
        while self._to_do and now_s % CYCLE_S >= self._to_do[0]:
            self._do(self._to_do.pop(0))

    def _do(self, what: int) -> None:
        if what == ZERO_AT_S:
            ask(self._socket, {"command": "zero"})
        elif what == STOP_AT_S:
            ask(self._socket, {"command": "load-stop"})
        elif what == START_AT_S:
            ask(self._socket, {"command": "load-start", "field": f"field {self._cycle}", "crop": "corn"})
            self.loads += 1
        elif what == SWEEP_AT_S:
            ask(self._socket, {"command": "sweep-start"})
        elif what == TICKET_AT_S:
            load = max(ask(self._socket, {"command": "loads", "all": True})["loads"][:-1], key=lambda load: load["number"])
            if load["mass_kg"] > 0.0:
                mass_kg = 1.01 * load["mass_kg"]
                ask(self._socket, {"command": "ticket", "first_load": load["number"], "mass_kg": mass_kg})
                self.tickets += 1
        elif what == STATUS_AT_S:
            ask(self._socket, {"command": "status"})
        elif self._cycle % RELOAD_EVERY == 0:
            self._reload()
            self.reloads += 1


def resident_mb() -> float:
    """Memory of this process, MB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def open_files() -> int:
    """Open descriptors of this process."""
    return len(os.listdir("/proc/self/fd"))


def live(folder: Path, hours: float, real_time: bool) -> dict[str, object]:
    """The figures of one run."""
    path = folder / "c.yaml"
    path.write_text("sweep: {min_flow_kg_s: 2}\n" + ("" if real_time else "bus: {transmit_max_age_s: 60}\n"))
    environment = {"STATE_DIRECTORY": str(folder), "RUNTIME_DIRECTORY": str(folder)}
    retention = Retention(record_hours=hours / 4.0, size_mb=SIZE_MB, event_rows=EVENT_ROWS)

    def load() -> configuration.Configuration:
        # Less than the file format lets anyone ask for, so that the bounds are reached.
        return dataclasses.replace(configuration.load(path, environment), retention=retention)

    machine = MachineOnBus(hours * 3600.0, real_time)
    daemon = Daemon(
        load(),
        load,
        environment=environment,
        bus_factory=machine.open_bus,
        timeouts=Timeouts() if real_time else Timeouts(silence_s=math.inf),
    )
    machine.backlog = lambda: daemon.receiver.waiting + 20 * daemon.writer.health().pending
    witness = Witness()
    submit = daemon.writer.submit

    def watched(batch: Batch) -> None:
        witness.see(batch)
        submit(batch)

    daemon.writer.submit = watched  # type: ignore[method-assign]
    thread = threading.Thread(target=daemon.run)
    begin_s, cpu_s = time.monotonic(), time.process_time()
    thread.start()
    daemon.started.wait()
    operator = Operator(daemon.configuration.socket_path, daemon.request_reload)
    before: tuple[float, int] | None = None
    most_mb = 0.0
    reported = 0.0
    while not machine.ended.wait(0.02):
        if not thread.is_alive():
            sys.exit("the daemon ended")
        operator.act(machine.now_s)
        if machine.now_s // 3600 > reported:
            reported += 1
            print(f"{reported:.0f} h, {resident_mb():.1f} MB, {time.monotonic() - begin_s:.0f} s", file=sys.stderr)
        if machine.now_s >= hours * 360.0:
            if before is None:
                gc.collect()
                before = resident_mb(), open_files()
            most_mb = max(most_mb, resident_mb())
    while daemon.receiver.waiting or daemon.writer.health().pending:
        time.sleep(0.1)
    gc.collect()
    after = resident_mb(), open_files()
    took_s, cpu_s = time.monotonic() - begin_s, time.process_time() - cpu_s
    status = dict(daemon.snapshot)
    daemon.request_stop()
    thread.join()
    assert before is not None, "too short"
    with Store(folder / "yieldmon.sqlite", retention) as store:
        rows, loads, tickets, size_mb = store.seconds(), store.loads(), store.tickets(), store.size_bytes() / 1e6
        versions = len(store.parameter_versions())
    kept_kg = math.fsum(row.mass_kg for row in rows[1:])
    return {
        "hours": hours,
        "real_time": real_time,
        "took_s": round(took_s, 1),
        "processor_s": round(cpu_s, 1),
        "windows": witness.windows,
        "irregular_windows": witness.irregular,
        "reloads": operator.reloads,
        "boundary_drift_s": round(witness.fractions[1] - witness.fractions[0], 6),
        "memory_mb": round(after[0], 1),
        "memory_growth_mb": round(after[0] - before[0], 2),
        "memory_growth_at_most_mb": round(most_mb - before[0], 2),
        "open_files_growth": after[1] - before[1],
        "frames_received": status["bus"]["received"],
        "frames_dropped": status["bus"]["dropped"],
        "frames_sent": status["bus"]["sent"],
        "frames_lost_on_purpose": witness.lost_frames,
        "interface_losses": status["bus"]["interface_losses"],
        "faults_missed": sorted({code.value for code in EXPECTED_FAULTS} - witness.shown),
        "faults_that_stayed": sorted(witness.shown - witness.gone),
        "faults_seen": len(witness.shown),
        "cycles": operator.cycles,
        "sweeps": witness.sweeps,
        "parameter_versions": versions,
        "loads": [operator.loads, len(loads) - 1],
        "tickets": [operator.tickets, len(tickets)],
        "records_kept": len(rows),
        "store_mb": round(size_mb, 2),
        "total_kg": round(rows[-1].total_kg, 1),
        "sum_error_kg": abs(rows[0].total_kg + kept_kg - rows[-1].total_kg),
        "mass_in_loads_pct": round(100.0 * math.fsum(load.mass_kg for load in loads) / rows[-1].total_kg, 2),
    }


def not_held(found: Mapping[str, Any]) -> Iterator[str]:
    """A line for each thing that did not hold."""
    sweeps, cycles, records = found["sweeps"], found["cycles"], found["hours"] / 4.0 * 3600.0
    held = {
        f"memory grew by {LIMIT_MB} MB or more": found["memory_growth_at_most_mb"] < LIMIT_MB,
        "files stayed open": found["open_files_growth"] <= 0,
        "windows are missing or doubled": found["irregular_windows"] <= found["reloads"],
        "window boundaries drift": found["boundary_drift_s"] < 1e-3,
        "frames were dropped": found["frames_dropped"] == 0,
        "troubles without their fault": not found["faults_missed"],
        "faults that never went": not found["faults_that_stayed"],
        "sweeps are missing": sweeps.get("updated", 0) + sweeps.get("not_learned", 0) >= cycles // 2,
        "neither sweeps nor tickets updated anything": found["parameter_versions"] > 1,
        "the stuck plate ended no sweep": sweeps.get("aborted", 0) >= cycles // STUCK_EVERY,
        "loads are missing": found["loads"][0] == found["loads"][1] >= cycles - 1,
        "tickets are missing": found["tickets"][0] == found["tickets"][1],
        "the store adds up to something else": found["sum_error_kg"] < 1e-6 * found["total_kg"],
        "mass is in no load": 95.0 < found["mass_in_loads_pct"] <= 100.0,
        "the store keeps more than it may": found["records_kept"] <= records + PRUNE_SLACK and found["store_mb"] < 1.1 * SIZE_MB,
    }
    yield from (line for line, holds in held.items() if not holds)


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 0 when everything held."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.robustness soak", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--real-time", action="store_true")
    args = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="yieldmon-soak-") as name:
        found = live(Path(name), args.hours, args.real_time)
    print(json.dumps(found))
    broken = list(not_held(found))
    for line in broken:
        print(line, file=sys.stderr)
    return 1 if broken else 0

"""Real steps of the system clock under the service, with frames and on a silent bus: it measures on, nothing twice.

The tests' own waiting and the combine's pace are by the monotonic clock, which nobody sets.
"""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from itertools import count, pairwise
from pathlib import Path

import pytest
from combine_service import (
    EMPTY_S,
    GRAIN_MV,
    GRAIN_S,
    STORE,
    adds_up,
    faults,
    grows,
    pid,
    records,
    service,
    status,
    total_kg,
)
from service_manager import UNIT, eventually, run, show

from tests.service.bench import CODEC, traffic
from yieldmon.service.storage.rows import SecondRow
from yieldmon.service.storage.store import Store

pytestmark = [pytest.mark.systemd, pytest.mark.slow]

HOUR_S = 3600.0
STALE_S = 5.0
"""From this age on the daemon calls its own answer stale."""
STEPS_S = (2.0 * HOUR_S, -5.0 * HOUR_S, -20.0 * 60.0)
SPARE_S = 300.0
"""More than a machine that is held up takes for anything here, and less than any of these steps."""
MOST_KG_S = 40.0
"""No combine harvests that much."""
_FRAME = struct.Struct("=IB3x8s")
_EXTENDED = 0x80000000


@cache
def _lap() -> list[tuple[float, bytes]]:
    """Times, s, and frames of a combine that runs empty and then harvests, as the kernel's socket takes them."""
    phases = ((0.0, EMPTY_S, 0.0), (float(EMPTY_S), GRAIN_S, GRAIN_MV))
    messages = [(frame.time_s, CODEC.encode(frame)) for phase in phases for frame in traffic(*phase)]
    return [(at_s, _FRAME.pack(m.arbitration_id | _EXTENDED, m.dlc, bytes(m.data).ljust(8, b"\0"))) for at_s, m in messages]


@contextmanager
def combine(*, empty_first: bool = False) -> Iterator[None]:
    """One that harvests round and round, whatever the system's clock says."""
    frames, ended = _lap(), threading.Event()
    skipped_s = 0.0 if empty_first else float(EMPTY_S)

    def drive() -> None:
        began_s = time.monotonic() - skipped_s
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as can0:
            can0.bind(("can0",))
            for lap in count():
                for at_s, frame in frames:
                    due_s = began_s + lap * (EMPTY_S + GRAIN_S) + at_s
                    if lap == 0 and at_s < skipped_s:
                        continue
                    if ended.wait(max(0.0, due_s - time.monotonic())):
                        return
                    can0.send(frame)

    thread = threading.Thread(target=drive)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


@pytest.fixture(scope="module", autouse=True)
def serving(daemon_command: Path) -> Iterator[None]:
    with service(daemon_command):
        yield


@pytest.fixture
def clock() -> Iterator[None]:
    """Put right again afterwards."""
    ahead_s = time.time() - time.monotonic()
    yield
    time.clock_settime(time.CLOCK_REALTIME, time.monotonic() + ahead_s)


def step(by_s: float) -> None:
    """The system's clock is set."""
    time.clock_settime(time.CLOCK_REALTIME, time.time() + by_s)


def jumps() -> int:
    """How often the service has said so."""
    with Store.reading(STORE) as store:
        return sum(event.code == "ClockJumped" and event.active for event in store.faults())


def measured_no_more_than(began_s: float, rows: list[SecondRow]) -> None:
    """Neither seconds nor mass for time that went by on the system's clock alone."""
    most_s = time.monotonic() - began_s + SPARE_S
    assert len(rows) <= most_s
    assert rows[-1].total_kg - rows[0].total_kg <= MOST_KG_S * most_s


def test_with_frames_on_the_bus(clock: None) -> None:
    began_s = time.monotonic()
    with combine(empty_first=True):
        eventually(lambda: total_kg() > 10.0, "some grain")
        before = pid()
        for by_s in STEPS_S:
            kept_kg, said = total_kg(), jumps()
            step(by_s)
            eventually(lambda said=said: jumps() > said, f"that the clock jumped by {by_s} s")
            grows()
            eventually(lambda: "ClockJumped" not in faults(), "the end of the fault")
            assert total_kg() > kept_kg
        rows = records()
    assert pid() == before
    adds_up(rows)
    measured_no_more_than(began_s, rows)
    stepped_s = [b.time_s - a.time_s for a, b in pairwise(rows)]
    for by_s in STEPS_S:
        assert min(abs(gap_s - by_s) for gap_s in stepped_s) < SPARE_S, "records carry the system's time, steps and all"


def test_on_a_silent_bus(clock: None) -> None:
    before = pid()
    with combine():
        grows()
    eventually(lambda: "SensorMissing" in faults(), "a fault for the silence")
    kept_kg = total_kg()
    step(-6.0 * HOUR_S)
    beyond_s = time.monotonic() + 3.0 * STALE_S
    eventually(lambda: time.monotonic() > beyond_s and status().get("stale") is False, "a fresh answer in the silence")
    assert pid() == before
    assert total_kg() == pytest.approx(kept_kg)
    with combine():
        grows()
    adds_up(records())


def test_a_stop_while_silent_after_a_step_back(clock: None) -> None:
    with combine():
        grows()
    eventually(lambda: "SensorMissing" in faults(), "a fault for the silence")
    step(-6.0 * HOUR_S)
    kept = records()[-1]
    run("systemctl", "stop", UNIT)
    assert show("Result") == "success"
    run("systemctl", "start", UNIT)
    eventually(lambda: bool(status()), "its first answer")
    assert total_kg() >= kept.total_kg
    with combine():
        grows()
    adds_up(records())

"""`yieldmon run` while its interface is pulled and put back again and again."""

from __future__ import annotations

import itertools
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import pytest
from can.interfaces.socketcan import SocketcanBus

from tests.service.bench import traffic
from tests.vcan.nodes import CODEC, PATIENCE_S, daemon, eventually
from yieldmon import frames
from yieldmon.bus.opening import open_bus

pytestmark = pytest.mark.vcan

CYCLES = 50
#: From the interface's return to the daemon's hearing and being heard.
RECOVERY_S = 2.0
#: Now and then the interface stays away until the daemon looks for it at its slowest pace.
LONG_S, LONG_EVERY = 2.5, 7
DELETED_EVERY = 5
#: The sensor looks for the interface this often.
RETRY_S = 0.05


def ip(*words: str) -> None:
    subprocess.run(["ip", "link", *words], check=True)


def away(channel: str, deleted: bool) -> None:
    ip(*(["delete", channel] if deleted else ["set", channel, "down"]))


def back(channel: str, deleted: bool) -> None:
    if deleted:
        ip("add", "dev", channel, "type", "vcan")
    ip("set", channel, "up")


@pytest.fixture
def pulled(vcan1: str) -> Iterator[str]:
    """An interface that may be pulled: whatever becomes of the test, it is there again afterwards."""
    yield vcan1
    if not Path("/sys/class/net", vcan1).exists():
        ip("add", "dev", vcan1, "type", "vcan")
    ip("set", vcan1, "up")


@contextmanager
def sensor(channel: str) -> Iterator[None]:
    """Nominal traffic on a thread, from the first moment that there is an interface for it."""
    stop = threading.Event()
    # One round of the sample counter, again and again.
    round_s = 256 * frames.SAMPLES_PER_FRAME * frames.SAMPLE_INTERVAL_S
    messages = [(frame.time_s, CODEC.encode(frame)) for frame in traffic(0.0, round_s, 0.0)]

    def due_s(number: int) -> float:
        rounds, place = divmod(number, len(messages))
        return rounds * round_s + messages[place][0]

    def body() -> None:
        begin_s, bus = time.monotonic(), None
        for number in itertools.count():
            if stop.wait(max(0.0, begin_s + due_s(number) - time.monotonic())):
                break
            try:
                bus = bus or SocketcanBus(channel)
                bus.send(messages[number % len(messages)][1])
            except (can.CanError, OSError):
                if bus is not None:
                    bus.shutdown()
                bus = None
                stop.wait(RETRY_S)
                # What could not be sent is not sent later.
                begin_s = time.monotonic() - due_s(number)
        if bus is not None:
            bus.shutdown()

    thread = threading.Thread(target=body)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join(PATIENCE_S)
    assert not thread.is_alive()


@pytest.mark.slow
def test_an_interface_pulled_and_put_back_50_times(pulled: str, tmp_path: Path, record_property) -> None:
    took_s = []
    with daemon(pulled, tmp_path) as node, sensor(pulled):
        eventually(lambda: node.windows > 1, "first windows")
        for cycle in range(-1, CYCLES):
            deleted = cycle % DELETED_EVERY == DELETED_EVERY - 1
            away(pulled, deleted)
            # Counted there: a line that repeats itself is not printed each time.
            losses = cycle + 2
            eventually(lambda n=losses: node.status["bus"]["interface_losses"] == n, f"loss {losses} counted", every_s=0.25)
            if cycle % LONG_EVERY == LONG_EVERY - 1:
                time.sleep(LONG_S)
            back(pulled, deleted)
            back_s = time.monotonic()
            with open_bus("socketcan", pulled, filters=CODEC.filters([frames.MASS_FLOW])) as witness:
                # The guest reads what a return needs from its disk the first time.
                timeout_s = RECOVERY_S if cycle >= 0 else PATIENCE_S
                assert witness.recv(timeout_s) is not None, f"cycle {cycle}: nothing heard of it\n{node.printed}"
            if cycle >= 0:
                took_s.append(time.monotonic() - back_s)
        assert "BusError" in node.faults
        eventually(lambda: "BusError" not in node.faults, "the fault's end")
        received = node.status["bus"]["received"]
        eventually(lambda: node.status["bus"]["received"] > received, "frames after the last return")
        assert node.status["bus"]["interface_losses"] == CYCLES + 1
    with node.store() as store:
        changes = [event.active for event in store.faults() if event.code == "BusError"]
    assert (changes[0], changes[-1]) == (True, False)
    record_property("slowest_return_s", round(max(took_s), 3))
    assert max(took_s) <= RECOVERY_S


def test_the_fault_comes_and_goes_with_the_interface(pulled: str, tmp_path: Path) -> None:
    with daemon(pulled, tmp_path) as node, sensor(pulled):
        eventually(lambda: node.windows > 1, "first windows")
        assert "BusError" not in node.faults
        away(pulled, deleted=False)
        eventually(lambda: "interface lost" in node.faults.get("BusError", ""), "the fault while the interface is away")
        back(pulled, deleted=False)
        eventually(lambda: "BusError" not in node.faults, "the fault's end")

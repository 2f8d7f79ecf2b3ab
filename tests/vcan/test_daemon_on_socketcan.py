"""The daemon on a real SocketCAN interface: pulled and put back, flooded, forged."""

from __future__ import annotations

import random
import resource
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import can
import pytest

from tests.service.bench import CODEC, Bench, running, traffic
from yieldmon import frames
from yieldmon.bus.opening import open_bus
from yieldmon.frames import CommandMode
from yieldmon.service.daemon import SILENCE_S

pytestmark = pytest.mark.vcan

#: Bounds a hang only; the emulated guest is several times slower than its host.
WAIT_S = 120.0


def eventually(condition, what: str) -> None:
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline, f"still waiting for: {what}"
        threading.Event().wait(0.02)


@contextmanager
def daemon_on(channel: str, folder: Path, more: str = "") -> Iterator[Bench]:
    text = f"bus: {{interface: socketcan, channel: {channel}, transmit_max_age_s: 10}}\n{more}"
    with running(folder, text, silence_s=SILENCE_S, socketcan=channel) as bench:
        yield bench


@contextmanager
def in_background(body) -> Iterator[None]:
    """Runs body(stop) on a thread until the block ends."""
    stop = threading.Event()
    thread = threading.Thread(target=body, args=(stop,))
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join(WAIT_S)
    assert not thread.is_alive()


def combine(channel: str):
    """Nominal traffic in real time, as far as the machine can; goes on when the interface comes back."""

    def body(stop: threading.Event) -> None:
        begin_s = time.monotonic()
        bus = None
        for frame in traffic(0.0, 3600.0, 0.0):
            if stop.wait(max(0.0, begin_s + frame.time_s - time.monotonic())):
                break
            try:
                bus = bus or can.Bus(channel, interface="socketcan")
                bus.send(CODEC.encode(frame))
            except (can.CanError, OSError):
                if bus is not None:
                    bus.shutdown()
                bus = None
        if bus is not None:
            bus.shutdown()

    return body


def ip(*words: str) -> None:
    subprocess.run(["ip", "link", *words], check=True)


def test_an_interface_pulled_and_put_back_50_times(vcan1: str, tmp_path: Path, record_property) -> None:
    slowest_s = 0.0
    with daemon_on(vcan1, tmp_path) as bench, in_background(combine(vcan1)):
        receiver = bench.daemon._receiver
        eventually(lambda: receiver.counters().received > 10, "first frames")
        for cycle in range(50):
            losses = receiver.counters().interface_losses
            if cycle % 5 == 4:
                ip("delete", vcan1)
            else:
                ip("set", vcan1, "down")
            eventually(lambda losses=losses: receiver.counters().interface_losses > losses, f"loss {cycle}")
            if cycle % 5 == 4:
                ip("add", "dev", vcan1, "type", "vcan")
            ip("set", vcan1, "up")
            back_s = time.monotonic()
            before = receiver.counters().received
            eventually(lambda before=before: receiver.counters().received > before, f"frames after return {cycle}")
            slowest_s = max(slowest_s, time.monotonic() - back_s)
        eventually(lambda: "BusError" in bench.faults, "BusError")
        windows = bench.rows[-1]["number"]
        eventually(lambda: bench.rows[-1]["number"] > windows + 1, "windows after the last return")
    record_property("slowest_return_s", round(slowest_s, 2))
    print(f"slowest return to frames: {slowest_s:.2f} s")


def test_receiving_never_blocks_on_an_error_that_sending_took(vcan1: str) -> None:
    with open_bus("socketcan", vcan1) as bus:
        ip("set", vcan1, "down")
        with pytest.raises(can.CanError):
            bus.send(can.Message(arbitration_id=1))
        with pytest.raises(OSError, match="temporarily unavailable"):
            bus.socket.recv(16)
        ip("set", vcan1, "up")


def forged(rng: random.Random) -> can.Message:
    """A frame with the id of one of our inputs and any data."""
    layout = CODEC.layouts[rng.choice(frames.INPUTS)]
    return can.Message(arbitration_id=layout.frame_id, data=rng.randbytes(rng.choice((0, 3, 8, 8, 8, 8))))


def babble(channel: str, make):
    def body(stop: threading.Event) -> None:
        with can.Bus(channel, interface="socketcan") as bus:
            while not stop.is_set():
                with suppress(can.CanError):
                    bus.send(make())

    return body


def test_babbling_idiots_change_nothing_but_faults(vcan0: str, tmp_path: Path) -> None:
    rng = random.Random(20261121)
    highest = can.Message(arbitration_id=0, is_extended_id=False, data=bytes(8))
    seconds = 10
    sweeping = "sweep: {first_after_s: 0, min_flow_kg_s: 0.1, steady_cv: 1.0, steady_windows: 2}"
    with daemon_on(vcan0, tmp_path, sweeping) as bench, in_background(combine(vcan0)):
        eventually(lambda: bench.rows, "the first window")
        bench.daemon._monitor.request_sweep()
        used_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        with in_background(babble(vcan0, lambda: highest)), in_background(babble(vcan0, lambda: forged(rng))):
            first = bench.rows[-1]["number"]
            eventually(lambda: bench.rows[-1]["number"] >= first + seconds, "windows under fire")
        grown_mb = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - used_kb) / 1024
        status = bench.status
        commands = bench.published(frames.PLATE_ACTUATOR_COMMAND)
    assert status["bus"]["malformed"] > 0
    assert {fault["code"] for fault in status["faults"]} & {"FramesLost", "SensorMissing", "SensorSaturated", "SpeedMissing"}
    assert grown_mb < 40.0
    for command in commands:
        assert command["CommandMode"] != CommandMode.GO_TO_ANGLE or 40.0 <= command["TargetPlateAngle"] <= 90.0


def test_our_message_from_cansend_is_a_conflict(vcan0: str, tmp_path: Path) -> None:
    identifier = CODEC.layouts[frames.MASS_FLOW].frame_id
    with daemon_on(vcan0, tmp_path) as bench, in_background(combine(vcan0)):
        eventually(lambda: bench.rows, "the first window")
        assert "OutputConflict" not in bench.faults, "our own frames are no conflict"

        def told() -> bool:
            subprocess.run(["cansend", vcan0, f"{identifier:08X}#0000000000000000"], check=True)
            return "OutputConflict" in bench.faults

        eventually(told, "OutputConflict")
        assert bench.faults["OutputConflict"] == "MassFlow from another node"

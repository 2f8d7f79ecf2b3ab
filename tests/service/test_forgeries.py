"""Other nodes that pass for the sensor or for the monitor: a fault within two seconds, and the mass counted apart."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from tests.service.bench import CODEC, START_S, Bench, running, traffic, wait_for
from yieldmon import frames
from yieldmon.frames import Frame
from yieldmon.service.storage.store import Store
from yieldmon.service.traffic.transmit import Transmitter

GRAIN_MV = 60.0


def louder(frame: Frame, factor: float = 1.5) -> Frame:
    samples = {f"Sample{k}" for k in range(frames.SAMPLES_PER_FRAME)}
    changed = {name: min(2000.0, round(2.0 * factor * float(frame.signals[name])) / 2.0) for name in samples}
    return frame._replace(signals={**frame.signals, **changed})


def forger_ahead(start_s: float, duration_s: float) -> Iterator[Frame]:
    """The same counters with half as much again, 1.5 ms before the sensor."""
    for frame in traffic(start_s, duration_s, GRAIN_MV):
        if frame.message == frames.IMPACT_SENSOR_SAMPLES:
            yield louder(frame)._replace(time_s=frame.time_s - 0.0015)
        yield frame


def now_and_then(start_s: float, duration_s: float) -> Iterator[Frame]:
    """A forged frame in twenty: too few to crowd anything."""
    for number, frame in enumerate(traffic(start_s, duration_s, GRAIN_MV)):
        if frame.message == frames.IMPACT_SENSOR_SAMPLES and number % 20 == 0:
            yield louder(frame, 3.0)._replace(time_s=frame.time_s - 0.0015)
        yield frame


def ten_times_the_rate(start_s: float, duration_s: float) -> Iterator[Frame]:
    """Counters that run on, at ten times a sensor's pace."""
    counter = 0
    for frame in traffic(start_s, duration_s, GRAIN_MV):
        if frame.message != frames.IMPACT_SENSOR_SAMPLES:
            yield frame
            continue
        for k in range(10):
            counter += 1
            signals = {**frame.signals, "SampleCounter": counter % 256}
            yield frame._replace(time_s=frame.time_s + 0.0004 * k, signals=signals)


@pytest.mark.parametrize("forgery", [forger_ahead, now_and_then, ten_times_the_rate])
def test_a_second_sensor_is_a_fault_and_its_mass_is_counted_apart(tmp_path: Path, forgery):
    with running(tmp_path) as bench:
        bench.play(14, 0.0)
        bench.play(6, GRAIN_MV)
        bench.played()
        before = bench.status["total"]
        assert before["contested_mass_kg"] == 0.0
        assert "FramesLost" not in bench.faults
        send(bench, forgery(bench.now_s, 4.0))
        bench.now_s += 4.0
        bench.played()
        after = bench.status["total"]
        assert "FramesLost" in bench.faults
        first = next(row for row in bench.rows if row["time_s"] > START_S + 20.2)
        assert first["time_s"] <= START_S + 22.2
        assert first["quality"] == "degraded"
        assert first["mass_kg"] == 0.0
        assert "FramesLost" in first["faults"]
    assert after["contested_mass_kg"] > 5.0
    assert after["mass_kg"] - before["mass_kg"] < 4.0, "what was measured before the first of them"
    with Store(tmp_path / "yieldmon.sqlite") as store:
        rows = store.seconds()
    assert sum(row.mass_kg for row in rows) == pytest.approx(rows[-1].total_kg)


def send(bench: Bench, forged: Iterator[Frame]) -> None:
    for frame in sorted(forged, key=lambda frame: frame.time_s):
        bench.peer.send(CODEC.encode(frame))


def test_a_copy_of_our_own_frame_beside_its_echo_is_another_node():
    """On a bus that shows us what we send: once is the echo, twice is a conflict."""
    sent: list[can.Message] = []
    transmitter = Transmitter(lambda message, timeout: sent.append(message), 100, 1.0, echo_s=10.0)
    transmitter.start()
    messages = [can.Message(arbitration_id=5, data=[n]) for n in range(61)]
    for message in messages:
        transmitter.submit(message)
    wait_for(lambda: len(sent) == 61, "the frames")
    assert all(transmitter.echoes.is_echo(message) for message in messages)
    assert not any(transmitter.echoes.is_echo(message) for message in messages)
    transmitter.stop()


def test_a_bus_that_shows_no_frame_of_ours_shows_anothers_copies():
    """Learnt from the first frames: none of them came back."""
    now_s, sent = [0.0], list[can.Message]()
    transmitter = Transmitter(lambda message, timeout: sent.append(message), 100, 100.0, clock=lambda: now_s[0])
    transmitter.start()
    first, later = ([can.Message(arbitration_id=5, data=[k, n]) for n in range(61)] for k in range(2))
    for message in first:
        transmitter.submit(message)
    wait_for(lambda: len(sent) == 61, "the first frames")
    now_s[0] = 2.0
    for message in later:
        transmitter.submit(message)
    wait_for(lambda: len(sent) == 122, "the frames")
    assert not any(transmitter.echoes.is_echo(message) for message in later)
    transmitter.stop()


def test_our_frames_repeated_verbatim_are_a_conflict_within_two_seconds(tmp_path: Path):
    with running(tmp_path) as bench:
        bench.play(14, 0.0)
        bench.played()
        # Until it is known that none of these comes back.
        wait_for(lambda: len(bench.heard()) > 61, "frames of ours")
        threading.Event().wait(1.1)
        bench.play(2, 0.0)
        bench.played()
        assert "OutputConflict" not in bench.faults
        for message in bench.heard()[-5:]:
            bench.peer.send(message)
        for _ in range(2):
            bench.play(1, 0.0)
            bench.played()
        assert "OutputConflict" in bench.faults

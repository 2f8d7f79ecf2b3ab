"""Every fault provoked for real, and seen on the bus (its bit and its DM1 code), in the status and in the store."""

from __future__ import annotations

import math
import sqlite3
import threading
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import lru_cache
from pathlib import Path

import can
import numpy as np
import pytest

from tests.network.peer import read
from tests.service.bench import CODEC, EMPTY_MV, GRAIN_MV, ZERO_MV, Bench, encoded, running, traffic, wait_for
from yieldmon import frames
from yieldmon.engine.faults import FAULTS, FaultCode
from yieldmon.engine.mass.totals import Totals
from yieldmon.files import parameter_file
from yieldmon.frames import CommandMode, Frame, ScaleStatus
from yieldmon.network import diagnostics
from yieldmon.network.reassembly import Reassembler
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.service.storage.store import Store

HOME_DEG, FLOW_KG_S = 70.0, 3.0
SHIPPED = parameter_file.load()
COMMAND_ID = CODEC.layouts[frames.PLATE_ACTUATOR_COMMAND].frame_id
C = FaultCode


def warm_up(bench: Bench) -> None:
    bench.play(14, EMPTY_MV)
    bench.play(4, GRAIN_MV)


def send(bench: Bench, duration_s: float, change: Callable[[Frame], Frame | None], force_mv: float = EMPTY_MV) -> None:
    """Traffic in which each frame is changed, or left out."""
    for frame in traffic(bench.now_s, duration_s, force_mv):
        changed = change(frame)
        if changed is not None:
            bench.peer.send(encoded(changed))
    bench.now_s += duration_s


def without(*messages: str) -> Callable[[Bench], None]:
    def provoke(bench: Bench) -> None:
        bench.play(3, EMPTY_MV)
        send(bench, 6, lambda frame: None if frame.message in messages else frame)

    return provoke


def widen_the_pulses(bench: Bench) -> None:
    """Pulses that last three quarters of a paddle's pass, which no heap of the model makes."""
    warm_up(bench)
    passes_hz = 400.0 / 60.0 * 2.0 * math.pi * Machine().sprocket_pitch_radius_m / Machine().paddle_spacing_m

    def change(frame: Frame) -> Frame:
        if frame.message != frames.IMPACT_SENSOR_SAMPLES:
            return frame
        times = {f"Sample{k}": frame.time_s + 0.001 * k for k in range(frames.SAMPLES_PER_FRAME)}
        wide = {name: ZERO_MV + (160.0 if (passes_hz * time) % 1.0 < 0.75 else 0.0) for name, time in times.items()}
        return frame._replace(signals={**frame.signals, **wide})

    send(bench, 20, change, GRAIN_MV)


def with_samples(value_mv: float, duration_s: float) -> Callable[[Bench], None]:
    samples = {f"Sample{k}": value_mv for k in range(frames.SAMPLES_PER_FRAME)}

    def change(frame: Frame) -> Frame:
        if frame.message != frames.IMPACT_SENSOR_SAMPLES:
            return frame
        return frame._replace(signals={**frame.signals, **samples})

    return lambda bench: send(bench, duration_s, change)


def drift(bench: Bench) -> None:
    bench.play(14, EMPTY_MV)
    for offset_mv in range(1, 12):

        def change(frame: Frame, offset_mv: int = offset_mv) -> Frame:
            if frame.message != frames.IMPACT_SENSOR_SAMPLES:
                return frame
            moved = {f"Sample{k}": frame.signals[f"Sample{k}"] + offset_mv for k in range(frames.SAMPLES_PER_FRAME)}
            return frame._replace(signals={**frame.signals, **moved})

        send(bench, 3, change)


def sweep_with_a_plate_that_stands(bench: Bench) -> None:
    warm_up(bench)
    bench.daemon.monitor.request_sweep()
    bench.play(25, GRAIN_MV)


def lose_frames(bench: Bench) -> None:
    bench.play(2, EMPTY_MV)

    def every_ninth_gone(frame: Frame) -> Frame | None:
        gone = frame.message == frames.IMPACT_SENSOR_SAMPLES and frame.signals["SampleCounter"] % 9 == 0
        return None if gone else frame

    send(bench, 4, every_ninth_gone)


def fail_the_scale(bench: Bench) -> None:
    for status in (ScaleStatus.STABLE, *[ScaleStatus.FAULT] * 5):
        bench.play(1, EMPTY_MV)
        scale = {"TankMass": 500.0, "TankScaleStatus": status.value}
        message = CODEC.encode(Frame(bench.now_s, frames.TANK_SCALE, scale))
        bench.peer.send(message)
    bench.play(2, EMPTY_MV)


def jump(bench: Bench) -> None:
    bench.play(3, EMPTY_MV)
    bench.now_s += 7200.0
    bench.play(3, EMPTY_MV)


def forge(bench: Bench) -> None:
    bench.play(2, EMPTY_MV)
    signals = {"MassFlowRate": 9.0, "MassFlowStdDev": 0.1, "EstimateQuality": 0, "WindowCounter": 3}
    # Said for three seconds of the machine's own time, in which a window has to close.
    for _ in range(4):
        bench.peer.send(CODEC.encode(Frame(bench.now_s, frames.MASS_FLOW, signals)))
        bench.play(1, EMPTY_MV)
        bench.played()


def lose_the_interface(bench: Bench) -> None:
    bench.play(2, EMPTY_MV)
    bench.played()
    lost = bench.daemon.receiver.bus
    assert lost is not None
    lost.shutdown()
    wait_for(lambda: bench.daemon.receiver.bus not in (None, lost), "the interface's return")
    # The address is claimed anew.
    claims = 0x18EEFF83
    wait_for(lambda: sum(m.arbitration_id == claims for m in bench.heard()) > 1, "another claim")
    wait_for(lambda: bench.status["network"]["address"], "the address")
    bench.play(3, EMPTY_MV)


def weigh_a_third_too_much(bench: Bench) -> None:
    bench.play(14, EMPTY_MV)
    bench.played()
    monitor = bench.daemon.monitor
    monitor.start_load()
    bench.play(20, GRAIN_MV)
    bench.played()
    load = monitor.open_load
    assert load is not None
    monitor.ticket(load.number, 1.33 * load.measured_kg, 1.0)
    bench.play(4, GRAIN_MV)


def lock_the_store(bench: Bench) -> None:
    bench.play(3, EMPTY_MV)
    blocker = sqlite3.connect(bench.daemon.configuration.store_path, isolation_level=None)
    blocker.execute("BEGIN IMMEDIATE")
    bench.play(2, EMPTY_MV)
    wait_for(lambda: bench.daemon.writer.health().failing, "the failing to be noticed")
    bench.play(4, EMPTY_MV)
    wait_for(lambda: "StoreFailing" in bench.faults, "the fault")
    blocker.execute("ROLLBACK")
    blocker.close()


def overrun(bench: Bench) -> None:
    """Frames faster than the engine takes them, into a queue of the smallest size."""
    bench.play(2, EMPTY_MV)
    bench.played()
    burst = [CODEC.encode(frame) for frame in traffic(bench.now_s, 30.0, EMPTY_MV)]
    for message in burst:
        bench.peer.send(message)
    bench.now_s += 30.0
    wait_for(lambda: bench.daemon.receiver.counters().dropped > 0, "the queue to run over")
    wait_for(lambda: not bench.daemon.receiver.waiting, "what is left of it to be worked off")
    bench.play(3, EMPTY_MV)


def silence_the_scale(bench: Bench) -> None:
    scale = {"TankMass": 500.0, "TankScaleStatus": ScaleStatus.STABLE.value}
    bench.play(1, EMPTY_MV)
    bench.peer.send(CODEC.encode(Frame(bench.now_s, frames.TANK_SCALE, scale)))
    bench.play(17, EMPTY_MV)


def age(bench: Bench) -> None:
    """The parameters are a minute short of an hour old at the start, which took less than that minute."""
    bench.play(20, EMPTY_MV)
    bench.played()
    assert C.CALIBRATION_OLD not in bench.faults
    bench.play(45, EMPTY_MV)


def leave_the_calibrated_speeds(bench: Bench) -> None:
    warm_up(bench)
    bench.played()
    assert C.FLOW_OUTSIDE_CALIBRATION not in bench.faults
    bench.play(4, GRAIN_MV, speed_rpm=300.0)


class PlateNode:
    """An actuator that follows its commands, and grain whose force follows the angle as `force_at` (deg) says, home being 1."""

    def __init__(self, force_at: Callable[[float], float]) -> None:
        self._force_at = force_at
        self._angle_deg = self._target_deg = HOME_DEG

    def play(self, bench: Bench, duration_s: float) -> None:
        """Traffic in steps of half a second, each answered before the next."""
        for number, frame in enumerate(traffic(bench.now_s, duration_s, GRAIN_MV)):
            if frame.message == frames.PLATE_ACTUATOR_FEEDBACK:
                moving = abs(self._target_deg - self._angle_deg) > 0.1
                frame = frame._replace(signals={"PlateAngle": self._angle_deg, "ActuatorState": int(moving)})  # noqa: PLW2901
            elif frame.message == frames.IMPACT_SENSOR_SAMPLES:
                share = self._force_at(self._angle_deg)
                samples = {
                    name: max(0.0, round(2.0 * (ZERO_MV + share * (frame.signals[name] - ZERO_MV))) / 2.0)
                    for name in (f"Sample{k}" for k in range(frames.SAMPLES_PER_FRAME))
                }
                frame = frame._replace(signals={**frame.signals, **samples})  # noqa: PLW2901
            bench.peer.send(encoded(frame))
            if number % 25 == 24:
                self._angle_deg += min(max(self._target_deg - self._angle_deg, -2.0), 2.0)
            if number % 125 == 124:
                self._obey(bench, frame.time_s)
        bench.now_s += duration_s

    def _obey(self, bench: Bench, time_s: float) -> None:
        daemon = bench.daemon
        wait_for(lambda: (daemon.newest_bus_s or 0.0) >= time_s, "the engine")
        wait_for(lambda: not daemon.transmitter.waiting, "its commands")
        while (received := bench.peer.recv(0)) is not None:
            bench.seen.append(received)
            if received.arbitration_id != COMMAND_ID:
                continue
            command = CODEC.decode(received).signals
            mode = command["CommandMode"]
            if mode != CommandMode.RELEASE.value:
                self._target_deg = HOME_DEG if mode == CommandMode.GO_HOME.value else command["TargetPlateAngle"]


def as_the_model_says(angle_deg: float) -> float:
    """Force at an angle over that at home, by the shipped parameters at the flow that GRAIN_MV is."""
    conditions = Conditions(
        plate_angle_rad=np.radians([angle_deg, HOME_DEG]), elevator_speed_rad_s=400.0 * RPM, mass_flow_kg_s=FLOW_KG_S
    )
    force = ForwardModel(Machine(), SHIPPED.effects).force(conditions, SHIPPED.values)
    return float(force[0] / force[1])


def as_no_model_says(angle_deg: float) -> float:
    """A plate that loses a tenth of the force in the middle of its range."""
    return as_the_model_says(angle_deg) * (1.0 - 0.1 * math.exp(-(((angle_deg - 55.0) / 4.0) ** 2)))


def sweep(count: int, force_at: Callable[[float], float]) -> Callable[[Bench], None]:
    """Whole sweeps, one after the other."""

    def provoke(bench: Bench) -> None:
        table = np.array([force_at(float(angle)) for angle in range(38, 93)])
        # Asked for with each frame of samples, of which many come at one angle.
        plate = PlateNode(lru_cache(lambda angle: float(np.interp(angle, np.arange(38.0, 93.0), table))))
        warm_up(bench)
        for number in range(1, count + 1):
            bench.daemon.monitor.request_sweep()
            for _ in range(120):
                plate.play(bench, 1.0)
                if bench.status["sweep"]["sweeps"] == number and bench.status["sweep"]["state"] in ("updated", "not_learned"):
                    break
            assert bench.status["sweep"]["aborted_because"] is None
        plate.play(bench, 3.0)

    return provoke


def harvest_a_lifetime(bench: Bench) -> None:
    """A monitor that has measured 410,000 t so far."""
    monitor = bench.daemon.monitor
    monitor.restore(replace(monitor.snapshot(), totals=Totals(total_kg=4.1e8)))
    bench.play(3, EMPTY_MV)


def hostile(identifier: int, datas: Callable[[int], bytes]) -> Callable[[Bench], None]:
    """A node that sends one thing 300 times a second, beside the traffic."""

    def provoke(bench: Bench) -> None:
        warm_up(bench)
        for second in range(6):
            for k in range(300):
                data = datas(300 * second + k)
                bench.peer.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=True, timestamp=bench.now_s))
            bench.play(1, EMPTY_MV)

    return provoke


HIGHER_NAME = (1 << 63 | 255 << 40 | 127 << 49 | 7 << 60 | 5).to_bytes(8, "little")
contest_the_address = hostile(0x18EEFF83, lambda k: HIGHER_NAME)
flood_with_requests = hostile(0x18EA8317, lambda k: bytes.fromhex("E5FE00"))
begin_sessions = hostile(0x1CECFF17, lambda k: bytes.fromhex("20F906FFFFDAFE00"))
speak_as_we_do = hostile(0x18FF2083, lambda k: bytes(8))


@dataclass(frozen=True)
class Case:
    provoke: Callable[[Bench], None]
    configuration: str = ""
    bus: str = ""
    silence_s: float = float("inf")


SWEEP = "sweep: {min_flow_kg_s: 0.1, steady_cv: 1.0, move_margin_s: 1}"
SHORT_SWEEP = """sweep: {first_after_s: 100000, interval_s: 100000, min_flow_kg_s: 0.1, steady_cv: 0.2, angles_deg: [40, 55, 90],
        home_every: 1, signal_trend: 20, windows_per_step: 1, steady_windows: 3}"""
QUICK_ZERO = "faults: {zero_missing_s: 5}"
PROVOKED: dict[FaultCode, tuple[Case, ...]] = {
    C.SENSOR_MISSING: (Case(without(frames.IMPACT_SENSOR_SAMPLES)),),
    C.SENSOR_STUCK: (Case(with_samples(120.0, 9)),),
    C.SENSOR_SATURATED: (Case(with_samples(4000.0, 4)),),
    C.ZERO_MISSING: (Case(lambda bench: bench.play(14, GRAIN_MV), QUICK_ZERO),),
    C.ZERO_DRIFTED: (Case(drift, "zero: {drift_limit_mv: 3, max_rate_mv_s: 10, follow_time_s: 1}"),),
    C.SPEED_MISSING: (Case(without(frames.ELEVATOR_SPEED)),),
    C.SPEED_OUT_OF_RANGE: (Case(lambda bench: bench.play(5, EMPTY_MV, speed_rpm=200.0)),),
    C.PLATE_NOT_FOLLOWING: (Case(sweep_with_a_plate_that_stands, SWEEP),),
    C.PLATE_FEEDBACK_STALE: (Case(without(frames.PLATE_ACTUATOR_FEEDBACK)),),
    C.SWEEP_ABORTED: (Case(sweep_with_a_plate_that_stands, SWEEP),),
    C.CALIBRATION_OLD: (Case(age, "parameter_file: nearly_old.yaml\nfaults: {calibration_old_s: 3600}"),),
    C.FLOW_OUTSIDE_CALIBRATION: (Case(leave_the_calibrated_speeds),),
    C.NOT_IDENTIFIABLE: (Case(sweep(1, as_the_model_says), SHORT_SWEEP),),
    C.MODEL_DISAGREES: (Case(sweep(4, as_no_model_says), SHORT_SWEEP),),
    C.STORE_FAILING: (Case(lock_the_store),),
    C.FRAMES_LOST: (Case(lose_frames), Case(overrun, bus="receive_queue_frames: 1000")),
    C.CLOCK_JUMPED: (Case(jump),),
    C.BUS_ERROR: (Case(lose_the_interface),),
    C.OUTPUT_CONFLICT: (Case(forge),),
    C.SCALE_FAULT: (Case(fail_the_scale), Case(silence_the_scale)),
    C.NETWORK_FAULT: (Case(contest_the_address), Case(flood_with_requests), Case(begin_sessions), Case(speak_as_we_do)),
    C.MASS_NEAR_END: (Case(harvest_a_lifetime),),
    C.SCALE_DISAGREES: (Case(weigh_a_third_too_much),),
    C.WAVEFORM_CONTRADICTS: (Case(widen_the_pulses, "waveform: {enabled: true, contradiction_windows: 5}"),),
}
CASES = [pytest.param(code, case, id=f"{code.value}-{n}") for code, cases in PROVOKED.items() for n, case in enumerate(cases)]


def test_no_fault_is_left_out():
    """A new code needs a provocation here, and a row in the table."""
    assert set(PROVOKED) == set(FaultCode) == set(FAULTS)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """With the parameter file that a case names."""
    nearly_an_hour_ago = datetime.now(UTC) - timedelta(seconds=3540)
    nearly_old = replace(SHIPPED, provenance={**SHIPPED.provenance, "date": nearly_an_hour_ago.isoformat()})
    parameter_file.save(nearly_old, tmp_path / "nearly_old.yaml")
    return tmp_path


def trouble_codes(bench: Bench) -> set[tuple[int, int]]:
    """(suspect parameter number, failure mode) of the daemon's DM1 messages so far, of however many frames."""
    bench.published(frames.ACTIVE_DIAGNOSTICS)
    listener = Reassembler()
    whole = [p for m in bench.seen for p in listener.feed(m.arbitration_id, bytes(m.data), 0.0)]
    return {(code.spn, code.fmi) for p in whole if p.group == diagnostics.DM1 for code in read(p.data)}


@pytest.mark.parametrize(("code", "case"), CASES)
def test_fault_is_on_the_bus_in_status_and_in_the_store(folder, code, case):
    with ExitStack() as stack:
        text = f"{case.configuration}\nbus: {{transmit_max_age_s: 60, {case.bus}}}"
        bench = stack.enter_context(running(folder, text, silence_s=case.silence_s, retry_s=0.05))
        shown: dict[str, str] = {}
        watching = threading.Event()

        def watch() -> None:
            last = None
            while not watching.wait(0.001):
                if bench.daemon.snapshot is not last:
                    last = bench.daemon.snapshot
                    shown.update((fault["code"], fault["detail"]) for fault in last["faults"])

        watcher = threading.Thread(target=watch)
        watcher.start()
        stack.callback(watcher.join)
        stack.callback(watching.set)
        case.provoke(bench)
        said = frames.YIELD_MONITOR_STATUS
        wait_for(lambda: any(s[code.value] == 1 for s in bench.published(said)), f"{code.value} on the bus")
        wait_for(lambda: code.value in shown, f"{code.value} in the status")
        definition = FAULTS[code]
        wait_for(lambda: (definition.spn, definition.fmi) in trouble_codes(bench), "the trouble code")
    with Store(folder / "yieldmon.sqlite") as store:
        assert (code.value, True) in [(event.code, event.active) for event in store.faults()]


def test_dm1_can_be_switched_off(tmp_path):
    text = "diagnostics: {dm1_enabled: false}\nbus: {transmit_max_age_s: 60}"
    with running(tmp_path, text) as bench:
        bench.play(4, EMPTY_MV)
        wait_for(lambda: len(bench.published(frames.YIELD_MONITOR_STATUS)) >= 3, "status frames")
        assert bench.published(frames.ACTIVE_DIAGNOSTICS) == []

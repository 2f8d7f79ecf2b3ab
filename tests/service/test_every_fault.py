"""Every fault provoked for real, and seen on the bus (its bit and its DM1 code), in the status and in the store."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from tests.plant_sweeps import STRONG, shown_force, sweep_windows
from tests.service.bench import CODEC, Bench, running, traffic, wait_for
from yieldmon import frames
from yieldmon.engine.faults import FAULTS, FaultCode
from yieldmon.engine.records import CalibrationOutcome
from yieldmon.files import parameter_file
from yieldmon.frames import Frame, ScaleStatus
from yieldmon.service.store import Store

EMPTY_MV, GRAIN_MV = 0.0, 60.0
C = FaultCode


def warm_up(bench: Bench) -> None:
    bench.play(14, EMPTY_MV)
    bench.play(4, GRAIN_MV)


def send(bench: Bench, duration_s: float, change: Callable[[Frame], Frame | None], force_mv: float = EMPTY_MV) -> None:
    """Traffic in which each frame is changed, or left out."""
    for frame in traffic(bench.now_s, duration_s, force_mv):
        changed = change(frame)
        if changed is not None:
            bench.peer.send(CODEC.encode(changed))
    bench.now_s += duration_s


def without(*messages: str) -> Callable[[Bench], None]:
    def provoke(bench: Bench) -> None:
        bench.play(3, EMPTY_MV)
        send(bench, 6, lambda frame: None if frame.message in messages else frame)

    return provoke


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
    bench.daemon._monitor.request_sweep()
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
    bench.peer.send(CODEC.encode(Frame(bench.now_s, frames.MASS_FLOW, signals)))
    wait_for(lambda: "conflict" in bench.daemon._conditions._conditions, "the forged frame to be seen")
    bench.play(3, EMPTY_MV)


def lose_the_interface(bench: Bench) -> None:
    bench.play(2, EMPTY_MV)
    bench.played()
    lost = bench.daemon._receiver.bus
    assert lost is not None
    lost.shutdown()
    wait_for(lambda: bench.daemon._receiver.bus not in (None, lost), "the interface's return")
    bench.play(3, EMPTY_MV)


def lock_the_store(bench: Bench) -> None:
    bench.play(3, EMPTY_MV)
    blocker = sqlite3.connect(bench.daemon.configuration.store_path, isolation_level=None)
    blocker.execute("BEGIN IMMEDIATE")
    bench.play(2, EMPTY_MV)
    wait_for(lambda: bench.daemon._writer.health().failing, "the failing to be noticed")
    bench.play(4, EMPTY_MV)
    wait_for(lambda: "StoreFailing" in bench.faults, "the fault")
    blocker.execute("ROLLBACK")
    blocker.close()


def teach(**outcome: object) -> Callable[[Bench], None]:
    """What a calibrator may say at the end of a sweep; the sweep itself has its tests with the engine."""

    def provoke(bench: Bench) -> None:
        bench.play(2, EMPTY_MV)
        bench.played()
        bench.daemon._monitor._outcome = CalibrationOutcome(estimator=None, reason="as taught by the test", **outcome)
        bench.play(3, EMPTY_MV)

    return provoke


def sweeps_that_no_parameters_explain(bench: Bench) -> None:
    """The windows of twelve sweeps, handed to the engine as at the end of each; whole sweeps have their tests with the engine."""
    bench.play(2, EMPTY_MV)
    bench.played()
    monitor = bench.daemon._monitor
    for seed in range(12):
        force = shown_force(monitor.machine, STRONG)
        windows = sweep_windows(monitor.machine, force, flow_kg_s=8.0 + 2.0 * (seed % 6), seed=seed)
        monitor.disagreement.add(windows, monitor.estimator.parameters)
    bench.play(3, EMPTY_MV)


@dataclass(frozen=True)
class Case:
    provoke: Callable[[Bench], None]
    configuration: str = ""
    silence_s: float = float("inf")


SWEEP = "sweep: {min_flow_kg_s: 0.1, steady_cv: 1.0, move_margin_s: 1}"
PROVOKED = {
    C.SENSOR_MISSING: Case(without(frames.IMPACT_SENSOR_SAMPLES)),
    C.SENSOR_STUCK: Case(with_samples(120.0, 9)),
    C.SENSOR_SATURATED: Case(with_samples(4000.0, 4)),
    C.ZERO_DRIFTED: Case(drift, "zero: {drift_limit_mv: 3, max_rate_mv_s: 10, follow_time_s: 1}"),
    C.SPEED_MISSING: Case(without(frames.ELEVATOR_SPEED)),
    C.SPEED_OUT_OF_RANGE: Case(lambda bench: bench.play(5, EMPTY_MV, speed_rpm=200.0)),
    C.PLATE_NOT_FOLLOWING: Case(sweep_with_a_plate_that_stands, SWEEP),
    C.PLATE_FEEDBACK_STALE: Case(without(frames.PLATE_ACTUATOR_FEEDBACK)),
    C.SWEEP_ABORTED: Case(sweep_with_a_plate_that_stands, SWEEP),
    C.CALIBRATION_OLD: Case(lambda bench: bench.play(4, EMPTY_MV), "parameter_file: old.yaml"),
    C.FLOW_OUTSIDE_CALIBRATION: Case(warm_up, "parameter_file: narrow.yaml"),
    C.NOT_IDENTIFIABLE: Case(teach(identifiable=False)),
    C.MODEL_DISAGREES: Case(sweeps_that_no_parameters_explain),
    C.STORE_FAILING: Case(lock_the_store),
    C.FRAMES_LOST: Case(lose_frames),
    C.CLOCK_JUMPED: Case(jump),
    C.BUS_ERROR: Case(lose_the_interface),
    C.OUTPUT_CONFLICT: Case(forge),
    C.SCALE_FAULT: Case(fail_the_scale),
}


def test_no_fault_is_left_out():
    assert set(PROVOKED) == set(FAULTS)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """With the parameter files that some cases name."""
    shipped = parameter_file.load()
    old = replace(shipped, provenance={**shipped.provenance, "date": "2020-10-01"})
    narrow = replace(shipped, calibrated=replace(shipped.calibrated, mass_flow_kg_s=(0.0, 0.1)))
    parameter_file.save(old, tmp_path / "old.yaml")
    parameter_file.save(narrow, tmp_path / "narrow.yaml")
    return tmp_path


def trouble_codes(bench: Bench) -> set[tuple[int, int]]:
    """(suspect parameter number, failure mode) of the daemon's DM1 frames so far."""
    return {
        (int(s["SuspectParameterHigh"]) << 16 | int(s["SuspectParameterLow"]), int(s["FailureMode"]))
        for s in bench.published(frames.ACTIVE_DIAGNOSTICS)
    }


@pytest.mark.parametrize("code", list(PROVOKED), ids=lambda code: code.value)
def test_fault_is_on_the_bus_in_status_and_in_the_store(folder, code):
    case = PROVOKED[code]
    with ExitStack() as stack:
        text = f"{case.configuration}\nbus: {{transmit_max_age_s: 60}}"
        bench = stack.enter_context(running(folder, text, silence_s=case.silence_s))
        shown: dict[str, str] = {}
        watching = threading.Event()

        def watch() -> None:
            while not watching.wait(0.001):
                shown.update(bench.faults)

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

"""The virtual combine on five foreign buses, measured by configuration alone: in `process`, frame by frame, and by the daemon."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from tests.service.bench import running
from tests.signals.layouts import COUNTS, LAYOUTS, LONG, Layout
from yieldmon.bus.codec import Codec
from yieldmon.engine.faults import FaultCode
from yieldmon.frames import EstimateQuality, Frame
from yieldmon.physics.machine import Machine
from yieldmon.plant import scenario
from yieldmon.plant.combine import VirtualCombine
from yieldmon.service.assembly import monitor_of
from yieldmon.service.config import configuration
from yieldmon.service.logs.bulk_processing import process_in_bulk
from yieldmon.service.logs.processing import process_logs
from yieldmon.service.storage.rows import SecondRow

DURATION_S = 70.0
START_S = 1_790_000_000.0
FLOW_KG_S = 12.0
SCENARIO = {
    "duration_s": DURATION_S,
    "flow": {
        "pieces": [
            {"kind": "steady", "duration_s": 14, "flow_kg_s": 0},
            {"kind": "steady", "duration_s": 1000, "flow_kg_s": FLOW_KG_S},
        ]
    },
}
# Share of the flow, of a second and of the mass, that the layout's rate may cost beyond the native layout's own scatter.
SECOND, MASS = {"newtons": 0.35}, {"newtons": 0.06}


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    combine = VirtualCombine(scenario.from_mapping(SCENARIO, "layouts"), Machine(), 3)
    return list(combine.frames_until(DURATION_S))


def written(path: Path, messages: list[can.Message]) -> Path:
    with can.Logger(str(path)) as logger:
        for message in sorted(messages, key=lambda each: each.timestamp):
            logger.on_message_received(message)
    return path


@pytest.fixture(scope="module")
def native(frames: list[Frame], tmp_path_factory: pytest.TempPathFactory) -> tuple[list[SecondRow], float]:
    codec, folder = Codec(), tmp_path_factory.mktemp("native")
    messages = []
    for frame in frames:
        message = codec.encode(frame)
        message.timestamp, message.channel = START_S + frame.time_s, "can0"
        messages.append(message)
    config = folder / "native.yaml"
    config.write_text("sweep: {enabled: false}\n")
    rows, monitor = measured(process_in_bulk, written(folder / "native.log", messages), config)
    return rows, monitor.totals.total_kg


def measured(how: Callable[..., Any], log: Path, config: Path) -> tuple[list[SecondRow], Any]:
    loaded = configuration.load(config)
    monitor, rows = monitor_of(loaded), []
    how([log], monitor, Codec(), rows.append, signals=loaded.signals)
    return rows, monitor


@pytest.mark.parametrize("layout", [*LAYOUTS, LONG], ids=lambda layout: layout.name)
def test_a_foreign_bus_is_measured_by_configuration_alone(
    layout: Layout, frames: list[Frame], native: tuple[list[SecondRow], float], tmp_path: Path
) -> None:
    config = layout.write(tmp_path)
    log = written(tmp_path / "foreign.log", list(layout.messages(frames, START_S)))
    rows, monitor = measured(process_in_bulk, log, config)
    assert len(rows) == len(native[0])
    assert {code for code in FaultCode if monitor.faults.occurrences(code)} == set()
    ours = np.array([row.mass_flow_kg_s for row in rows[20:]], dtype=float)
    theirs = np.array([row.mass_flow_kg_s for row in native[0][20:]], dtype=float)
    assert np.abs(ours - theirs).max() <= SECOND.get(layout.name, 0.03) * FLOW_KG_S
    assert monitor.totals.total_kg == pytest.approx(native[1], rel=MASS.get(layout.name, 0.002))
    assert {row.quality for row in rows[20:]} == {int(EstimateQuality.OK)}
    scores = (ours - FLOW_KG_S) / np.array([row.std_dev_kg_s for row in rows[20:]], dtype=float)
    assert np.abs(scores).mean() < 1.5
    one_by_one, other = measured(process_logs, log, config)
    assert one_by_one == rows
    assert repr(other.snapshot()) == repr(monitor.snapshot())


@pytest.mark.parametrize("layout", [*LAYOUTS, LONG], ids=lambda layout: layout.name)
def test_the_daemon_measures_it_too(layout: Layout, frames: list[Frame], tmp_path: Path) -> None:
    layout.write(tmp_path)
    until_s = 34.0
    with running(tmp_path, f"bus: {{transmit_max_age_s: 60}}\n{layout.config}", start_s=START_S) as bench:
        messages = layout.messages([frame for frame in frames if frame.time_s < until_s], START_S)
        for message in sorted(messages, key=lambda each: each.timestamp):
            bench.peer.send(message)
        bench.now_s = START_S + math.floor(until_s - 0.5)
        bench.played()
        assert bench.faults == {}
        flows = [row["mass_flow_kg_s"] for row in bench.rows[-5:]]
        assert np.mean(flows) == pytest.approx(FLOW_KG_S, rel=0.2 if layout.name == "newtons" else 0.05)


def test_a_fixed_plate_wants_no_feedback_and_no_sweep(frames: list[Frame], tmp_path: Path) -> None:
    """The combine's own frames without those of the plate, which is bolted on at its home angle."""
    codec, messages = Codec(), []
    for frame in frames:
        if frame.message != "PlateActuatorFeedback":
            message = codec.encode(frame)
            message.timestamp, message.channel = START_S + frame.time_s, "can0"
            messages.append(message)
    log = written(tmp_path / "fixed.log", messages)
    config = tmp_path / "fixed.yaml"
    config.write_text("plate: {fixed_angle_deg: 70}\nsweep: {first_after_s: 0}\n")
    rows, monitor = measured(process_in_bulk, log, config)
    assert {code for code in FaultCode if monitor.faults.occurrences(code)} == set()
    assert {row.quality for row in rows[20:]} == {int(EstimateQuality.OK)}
    assert [row.plate_angle_deg for row in rows] == pytest.approx([70.0] * len(rows))
    assert monitor.totals.total_kg == pytest.approx(FLOW_KG_S * (DURATION_S - 15.0), rel=0.06)
    config.write_text("sweep: {first_after_s: 0}\n")
    _, unmapped = measured(process_in_bulk, log, config)
    assert unmapped.faults.occurrences(FaultCode.PLATE_FEEDBACK_STALE)


def test_two_impact_sensors_carry_the_plate_together(
    frames: list[Frame], native: tuple[list[SecondRow], float], tmp_path: Path
) -> None:
    """Each has half of the voltage; the second one is configuration and nothing else."""
    COUNTS.write(tmp_path)
    dbc = (tmp_path / "counts.dbc").read_text()
    second = dbc.replace("BO_ 801 Bridge", "BO_ 803 Bridge2").partition("BO_ 803")[2].partition("BO_ ")[0]
    (tmp_path / "counts.dbc").write_text(f"{dbc}\nBO_ 803{second}")
    line = "{{dbc: counts.dbc, message: {}, signal: Counts, unit: counts, scale: 0.03125, rate_hz: 100}}"
    config = tmp_path / "two.yaml"
    impact = f"impact_voltage: [{line.format('Bridge')}, {line.format('Bridge2')}]"
    rest = [text for text in COUNTS.config.splitlines() if "impact_voltage" not in text]
    config.write_text("\n".join([*rest, f"  {impact}"]) + "\n")
    messages = []
    for message in COUNTS.messages(frames, START_S):
        messages.append(message)
        if message.arbitration_id == 0x321:
            messages.append(can.Message(**{**vars_of(message), "arbitration_id": 0x323}))
    rows, monitor = measured(process_in_bulk, written(tmp_path / "two.log", messages), config)
    assert monitor.totals.total_kg == pytest.approx(native[1], rel=0.002)
    assert {code for code in FaultCode if monitor.faults.occurrences(code)} == set()
    one_by_one, _ = measured(process_logs, tmp_path / "two.log", config)
    assert one_by_one == rows


def vars_of(message: can.Message) -> dict[str, Any]:
    return {"timestamp": message.timestamp, "data": message.data, "is_extended_id": False, "channel": "can0"}

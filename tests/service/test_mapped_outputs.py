"""Foreign nodes on the daemon's bus: an actuator that obeys commands of its own layout, a display that decodes our flow.

The peers decode with cantools, by DBC files that the daemon does not ship.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import can
import cantools
import pytest

from tests.service.bench import CODEC, EMPTY_MV, GRAIN_MV, START_S, Bench, running, traffic, wait_for
from yieldmon import frames
from yieldmon.frames import Frame
from yieldmon.service.operator.control_client import ask

HOME_DEG, AWAY_DEG = 70.0, 60.0
SWEEP = """bus: {transmit_max_age_s: 60}
sweep: {min_flow_kg_s: 0.1, steady_cv: 1.0, angles_deg: [60], home_every: 1, move_margin_s: 5, windows_per_step: 2,
        steady_windows: 3, first_after_s: 100000, interval_s: 100000}
"""
DISPLAY_DBC = """VERSION ""
NS_ :
BS_:
BU_: Display
BO_ 2566870014 Grain: 8 Display
 SG_ Flow : 7|16@0+ (0.01,0) [0|600] "t/h" Display
 SG_ Load : 16|16@1+ (0.01,0) [0|600] "t" Display
 SG_ Good : 32|3@1+ (1,0) [0|7] "" Display
 SG_ Saturated : 36|2@1+ (1,0) [0|1] "" Display
 SG_ Moisture : 48|16@1+ (0.1,-10) [-10|6415.5] "%" Display
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_ "VFrameFormat" BO_ 2566870014 3;
"""
DISPLAY = """
    mass_flow: {dbc: display.dbc, message: Grain, signal: Flow}
    load_mass: {dbc: display.dbc, message: Grain, signal: Load}
    estimate_quality: {dbc: display.dbc, message: Grain, signal: Good, values: {0: 1, 1: 0, 2: 2, 3: 2, 4: 2, 5: 1, 6: 7}}
    fault_sensor_saturated: {dbc: display.dbc, message: Grain, signal: Saturated}
    moisture: {dbc: display.dbc, message: Grain, signal: Moisture}
"""
#: CANopen process data of node 0x11: control word, position in hundredths of a degree from home, state.
CANOPEN_DBC = """VERSION ""
NS_ :
BS_:
BU_: Drive
BO_ 529 RPDO1: 6 Drive
 SG_ Control : 0|16@1+ (1,0) [0|65535] "" Drive
 SG_ Position : 16|32@1- (0.01,0) [0|0] "deg" Drive
BO_ 401 TPDO1: 6 Drive
 SG_ State : 0|16@1+ (1,0) [0|65535] "" Drive
 SG_ Position : 16|32@1- (0.01,0) [0|0] "deg" Drive
"""
CANOPEN = """
    plate_target_angle: {dbc: drive.dbc, message: RPDO1, signal: Position, unit: deg, offset: -70, constants: {Control: 15}}
"""
CANOPEN_FEEDBACK = "{dbc: drive.dbc, message: TPDO1, signal: Position, offset: 70}"
#: J1939 proprietary B: per mille of the stroke, big-endian, mode and counter; feedback in rad.
PROPRIETARY_DBC = """VERSION ""
NS_ :
BS_:
BU_: Drive
BO_ 2566849534 Order: 8 Drive
 SG_ Stroke : 7|16@0+ (0.1,0) [0|100] "" Drive
 SG_ Mode : 20|4@1+ (1,0) [0|15] "" Drive
 SG_ Count : 24|4@1+ (1,0) [0|15] "" Drive
BO_ 2566849826 Report: 8 Drive
 SG_ Turned : 8|16@1+ (0.0001,0) [0|3.2] "rad" Drive
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_ "VFrameFormat" BO_ 2566849534 3;
BA_ "VFrameFormat" BO_ 2566849826 3;
"""
PROPRIETARY = """
    plate_target_angle: {dbc: drive.dbc, message: Order, signal: Stroke, unit: deg, scale: 2, offset: -80}
    plate_command_mode: {dbc: drive.dbc, message: Order, signal: Mode, values: {0: 1, 1: 9, 2: 10}}
    plate_command_counter: {dbc: drive.dbc, message: Order, signal: Count}
"""
PROPRIETARY_FEEDBACK = "{dbc: drive.dbc, message: Report, signal: Turned}"


class Drive:
    """A foreign actuator; subclasses say how it hears and reports."""

    command: str
    report: str

    def __init__(self, dbc: str) -> None:
        self.database = cantools.database.load_string(dbc, "dbc")
        self.angle_deg = self.target_deg = HOME_DEG
        self.heard: list[dict[str, Any]] = []

    def hear(self, message: can.Message) -> None:
        layout = self.database.get_message_by_name(self.command)
        mask = 0x3FFFF00 if layout.is_extended_frame else 0x7FF
        if message.is_extended_id == layout.is_extended_frame and not (message.arbitration_id ^ layout.frame_id) & mask:
            self.heard.append(dict(layout.decode(bytes(message.data), decode_choices=False)))
            self.obey(self.heard[-1])

    def obey(self, signals: dict[str, Any]) -> None:
        raise NotImplementedError

    def reports(self, time_s: float) -> can.Message:
        layout = self.database.get_message_by_name(self.report)
        data = layout.encode(self.says(), padding=True)
        return can.Message(timestamp=time_s, arbitration_id=layout.frame_id, is_extended_id=layout.is_extended_frame, data=data)

    def says(self) -> dict[str, float]:
        raise NotImplementedError


class CanopenDrive(Drive):
    command, report = "RPDO1", "TPDO1"

    def obey(self, signals: dict[str, Any]) -> None:
        assert signals["Control"] == 15
        self.target_deg = HOME_DEG + signals["Position"]

    def says(self) -> dict[str, float]:
        return {"State": 0, "Position": round(self.angle_deg - HOME_DEG, 2)}


class ProprietaryDrive(Drive):
    command, report = "Order", "Report"

    def obey(self, signals: dict[str, Any]) -> None:
        # 1: released, the stroke then says that it is not available.
        assert (signals["Mode"] == 1) == (signals["Stroke"] > 6425.5)
        if signals["Mode"] in (9, 10):
            self.target_deg = (signals["Stroke"] + 80.0) / 2.0

    def says(self) -> dict[str, float]:
        return {"Turned": round(self.angle_deg * 0.017453292519943295, 4)}


def play(bench: Bench, drive: Drive, duration_s: float, force_mv: float) -> None:
    """Traffic in steps of half a second, each answered before the next; the drive's reports in place of the native ones."""
    for number, frame in enumerate(traffic(bench.now_s, duration_s, force_mv)):
        message = CODEC.encode(frame)
        if frame.message == frames.PLATE_ACTUATOR_FEEDBACK:
            message = drive.reports(frame.time_s)
        bench.peer.send(message)
        if number % 14 == 13:
            drive.angle_deg += min(max(drive.target_deg - drive.angle_deg, -2.0), 2.0)
        if number % 140 == 139:
            listen(bench, drive, frame)
    bench.now_s += duration_s


def listen(bench: Bench, drive: Drive, last: Frame) -> None:
    wait_for(lambda: (bench.daemon.newest_bus_s or 0.0) >= last.time_s, "the engine")
    wait_for(lambda: not bench.daemon.transmitter.waiting, "its commands")
    while (received := bench.peer.recv(0)) is not None:
        bench.seen.append(received)
        drive.hear(received)


@pytest.mark.parametrize(
    ("kind", "dbc", "command", "feedback"),
    [
        (CanopenDrive, CANOPEN_DBC, CANOPEN, CANOPEN_FEEDBACK),
        (ProprietaryDrive, PROPRIETARY_DBC, PROPRIETARY, PROPRIETARY_FEEDBACK),
    ],
    ids=["CANopen", "proprietary B"],
)
def test_a_foreign_plate_follows_and_a_foreign_display_shows_the_flow(
    kind: type[Drive], dbc: str, command: str, feedback: str, tmp_path: Path
) -> None:
    (tmp_path / "drive.dbc").write_text(dbc)
    (tmp_path / "display.dbc").write_text(DISPLAY_DBC)
    signals = f"signals:\n  plate_angle: {feedback}\n  actuator_state: null\n"
    outputs = f"outputs:\n  shipped: false\n  signals:{command.rstrip()}{DISPLAY}"
    drive = kind(dbc)
    with running(tmp_path, SWEEP + signals + outputs) as bench:
        play(bench, drive, 12.5, EMPTY_MV)
        play(bench, drive, 6.0, GRAIN_MV)
        assert drive.angle_deg == HOME_DEG
        ask(bench.daemon.configuration.socket_path, {"command": "sweep-start"})
        lowest_deg = HOME_DEG
        for _ in range(60):
            play(bench, drive, 1.0, GRAIN_MV)
            lowest_deg = min(lowest_deg, drive.angle_deg)
            if lowest_deg < HOME_DEG and drive.angle_deg == drive.target_deg == HOME_DEG:
                break
        play(bench, drive, 2.0, GRAIN_MV)
        bench.played()
        assert lowest_deg == pytest.approx(AWAY_DEG, abs=0.06)
        assert drive.angle_deg == pytest.approx(HOME_DEG, abs=0.06)
        assert "PlateNotFollowing" not in bench.faults
        if "Count" in drive.heard[0]:
            counts = [signals["Count"] for signals in drive.heard]
            assert all((after - before) % 16 == 1 for before, after in pairwise(counts))
        # Nothing of the shipped layout is sent.
        ours = {CODEC.layouts[name].frame_id for name in frames.OUTPUTS if name != frames.ACTIVE_DIAGNOSTICS}
        assert not [m for m in bench.heard() if m.arbitration_id in ours]
        display = cantools.database.load_string(DISPLAY_DBC, "dbc").get_message_by_name("Grain")
        shown = [
            display.decode(bytes(m.data), decode_choices=False)
            for m in bench.heard()
            if m.is_extended_id and m.arbitration_id == 0x18FF5383
        ]
        last = bench.rows[-1]
        assert last["mass_flow_kg_s"] > 1.0
        assert shown[-1]["Flow"] == pytest.approx(3.6 * last["mass_flow_kg_s"], abs=0.01)
        assert shown[-1]["Load"] == pytest.approx(last["load_kg"] / 1000.0, abs=0.005)
        assert shown[-1]["Moisture"] == pytest.approx(15.5)
        assert (shown[-1]["Good"], shown[-1]["Saturated"]) in ((1, 0), (2, 0))
        # Before the grain: flow not available, quality "not harvesting".
        assert (round(100 * shown[5]["Flow"]), shown[5]["Good"]) == (0xFFFF, 0)


def test_another_node_with_a_mapped_identifier_is_a_conflict(tmp_path: Path) -> None:
    (tmp_path / "display.dbc").write_text(DISPLAY_DBC)
    text = f"bus: {{transmit_max_age_s: 60}}\nnetwork: {{enabled: false}}\noutputs:\n  signals:{DISPLAY}"
    with running(tmp_path, text) as bench:
        bench.play(3, EMPTY_MV)
        bench.played()
        assert bench.faults.get("OutputConflict") is None
        wait_for(lambda: bench.published("MassFlow"), "a flow on the bus")
        forged = can.Message(timestamp=START_S + 3.0, arbitration_id=0x18FF5383, is_extended_id=True, data=bytes(8))
        bench.peer.send(forged)
        for _ in range(2):
            bench.play(1, EMPTY_MV)
            bench.played()
        assert bench.faults["OutputConflict"] == "Grain from another node"


def test_outputs_that_change_with_the_service_running_wait_for_a_restart(tmp_path: Path) -> None:
    (tmp_path / "display.dbc").write_text(DISPLAY_DBC)
    with running(tmp_path) as bench:
        bench.play(1, EMPTY_MV)
        for section, text in (
            ("outputs", f"outputs:\n  signals:{DISPLAY}"), ("signals", "signals: {test_weight: null}"),
        ):  # fmt: skip
            before = bench.status["configuration"]["reloads"]
            (tmp_path / "c.yaml").write_text(f"bus: {{transmit_max_age_s: 60}}\n{text}")
            bench.daemon.request_reload()
            wait_for(lambda before=before: bench.status["configuration"]["reloads"] > before, "the reload")
            said = bench.status["configuration"]["reload"]
            expected = "changed while the service runs; expected a restart, since the bus is filtered for it"
            assert said == f"refused: {section}: {expected}"

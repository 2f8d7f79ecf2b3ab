"""What `yieldmon signals` finds: on a tractor's bus that nobody here made, and on buses whose content is known."""

from __future__ import annotations

import json
import re
import struct
from math import hypot
from pathlib import Path

import can
import pytest

from studies.sample_rates.__main__ import harvest, measured
from tests.schema_check import problems
from tests.signals.layouts import COUNTS, MULTIPLEXED, NEWTONS, NODE_NAME, OTHER_NAME, PROPRIETARY, Layout
from yieldmon.cli.main import main
from yieldmon.physics.machine import Machine
from yieldmon.plant import scenario
from yieldmon.plant.combine import VirtualCombine
from yieldmon.service.config import configuration
from yieldmon.service.config.mapping_notes import aliasing_pct

# The first 464 frames of start1.log, TractorHacking/CAN-data, MIT licence, converted from its CSV.
TRACTOR = Path(__file__).parents[1] / "data" / "tractor_bus.log"


def survey(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict:
    assert main(["signals", *arguments, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert problems(found, "signals") == []
    return found


def test_a_tractors_bus(capsys: pytest.CaptureFixture[str]) -> None:
    found = survey(capsys, str(TRACTOR))
    assert sum(message["frames"] for message in found["messages"]) == len(TRACTOR.read_text().splitlines())
    assert len({message["pgn"] for message in found["messages"]}) == 37
    assert {node["address"]: node["name"] for node in found["nodes"]} == {
        0: "0x200200000429F556",
        3: "0x200203000430744D",
        6: "0x20000E000430744D",
        23: "0x2002130004246E0C",
        71: "0x200234000430744D",
    }
    names = {message["pgn"]: message["name"] for message in found["messages"]}
    assert names[61444] == "EEC1"
    assert names[65262] == "Engine Temperature 1"
    assert all(names.values())
    assert {"message": "EEC1", "signal": "EngineSpeed"}.items() <= found["candidates"]["elevator_speed"][0].items()
    assert "impact_voltage" not in found["candidates"]


def drive(layout: Layout, folder: Path) -> Path:
    combine = VirtualCombine(scenario.from_mapping({"duration_s": 6.0}, "survey"), Machine(), 2)
    path = folder / f"{layout.name}.log"
    with can.Logger(str(path)) as logger:
        for message in sorted(layout.messages(combine.frames_until(6.0), 1.79e9), key=lambda each: each.timestamp):
            logger.on_message_received(message)
    layout.write(folder)
    return path


@pytest.mark.parametrize(
    ("layout", "quantity", "message", "signal", "rate_hz"),
    [
        (COUNTS, "impact_voltage", "Bridge", "Counts", 100.0),
        (COUNTS, "elevator_speed", "EEC1", "EngineSpeed", 10.0),
        (COUNTS, "plate_angle", "Linear", "Tilt", 20.0),
        (NEWTONS, "impact_force", "Force", "Force", 10.0),
        (MULTIPLEXED, "impact_voltage", "Everything", "Voltage", 250.0),
        (MULTIPLEXED, "elevator_speed", "Everything", "Speed", 10.0),
        (PROPRIETARY, "elevator_speed", "PropB02", "ShaftSpeed", 10.0),
    ],
)
def test_signals_that_could_serve(
    layout: Layout, quantity: str, message: str, signal: str, rate_hz: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = survey(capsys, str(drive(layout, tmp_path)), "--dbc", str(tmp_path / f"{layout.name}.dbc"))
    first = found["candidates"][quantity][0]
    assert (first["message"], first["signal"]) == (message, signal)
    assert first["rate_hz"] == pytest.approx(rate_hz, rel=0.05)


def test_a_multiplexer_is_no_sensor(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, dbc = drive(MULTIPLEXED, tmp_path), tmp_path / "impact.dbc"
    dbc.write_text(MULTIPLEXED.dbc.replace("Everything", "ImpactAndSpeed"))
    candidates = survey(capsys, str(log), "--dbc", str(dbc))["candidates"]
    assert [one["signal"] for one in candidates["impact_voltage"]] == ["Voltage"]


def test_a_written_mapping_stands_the_check_against_its_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, mapping = drive(MULTIPLEXED, tmp_path), tmp_path / "mapping.yaml"
    survey(capsys, str(log), "--dbc", str(tmp_path / "multiplexed.dbc"), "--write", str(mapping))
    assert main(["check-config", str(mapping), "--log", str(log), "--json"]) == 0
    seen = json.loads(capsys.readouterr().out)["signals"]
    assert seen["impact"]["rate_hz"] == pytest.approx(250.0, rel=0.02)
    assert 380.0 < seen["elevator_speed"]["low"] < 420.0
    assert seen["plate_angle"]["first"][0] == pytest.approx(70.0, abs=0.2)
    assert seen["moisture"]["values"] == 0
    assert main(["signals", str(log), "--write", str(mapping)]) == 2
    assert "exists already" in capsys.readouterr().err


def test_a_written_mapping_names_shipped_files_without_their_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mapping = tmp_path / "map.yaml"
    assert main(["signals", str(TRACTOR), "--write", str(mapping)]) == 0
    said = capsys.readouterr().out
    assert "{manufacturer_code: 33, function: 3, function_instance: 0, ecu_instance: 0, identity_number: 1078349}" in said
    text = mapping.read_text()
    assert "dbc: j1939.dbc, message: EEC1" in text
    assert text.index("a guess") < text.index("ratio: 0.2")
    assert main(["check-config", str(mapping)]) == 0
    # One of the owner's own comes before it.
    (tmp_path / "j1939.dbc").write_text(COUNTS.dbc.replace("EEC1", "EEC9"))
    assert main(["check-config", str(mapping)]) == 2
    assert "EEC1 is not in j1939.dbc" in capsys.readouterr().err


HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_: Node\n'
MANY = HEAD + "BO_ 512 Samples: 24 Node\n" + "".join(
    f' SG_ S{k} : {16 * k}|16@1+ (0.1,0) [0|6553.5] "mV" Node\n' for k in range(12)
)  # fmt: skip
INPUTS = (
    HEAD
    + """BO_ 512 AnalogInputs: 4 Node
 SG_ Input1 : 0|16@1+ (0.1,0) [0|6553.5] "mV" Node
 SG_ Input2 : 16|16@1+ (0.1,0) [0|6553.5] "mV" Node
"""
)
RATIO = (
    HEAD
    + """BO_ 512 Bridge: 2 Node
 SG_ Strain : 0|16@1- (0.0001,0) [-3|3] "mV/V" Node
"""
)
APART = (
    HEAD
    + """BO_ 512 Board: 4 Node
 SG_ A1 : 0|16@1+ (0.1,0) [0|6553.5] "mV" Node
 SG_ A2 : 16|16@1+ (0.1,0) [0|6553.5] "mV" Node
"""
)
ELSEWHERE = (
    HEAD
    + """BO_ 2566848784 Machine: 8 Node
 SG_ Shaft : 0|16@1+ (0.1,0) [0|6553.5] "rpm" Node
"""
)
NAMELESS = (
    HEAD
    + """BO_ 513 Werte: 4 Node
 SG_ Drehzahl : 0|16@1+ (0.1,0) [0|6553.5] "1/min" Node
 SG_ Fuellung : 16|16@1+ (0.1,0) [0|100] "%" Node
VAL_ 513 Drehzahl 0 "Stillstand" 65535 "SNA" 65534 "Error" ;
"""
)

STATE = (
    HEAD
    + """BO_ 516 Plate: 1 Node
 SG_ ActuatorState : 0|4@1+ (1,0) [0|3] "" Node
VAL_ 516 ActuatorState 2 "fault" ;
"""
)
GRAD = (
    HEAD
    + """BO_ 516 Plate: 2 Node
 SG_ PlateAngle : 0|16@1+ (0.1,0) [0|6553.5] "Grad" Node
"""
)
HEADER = (
    HEAD
    + """BO_ 516 Switches: 1 Node
 SG_ Header : 0|2@1+ (1,0) [0|3] "" Node
VAL_ 516 Header 0 "down" 1 "up" 3 "SNA" ;
"""
)
RECEIVER = (
    HEAD
    + """BO_ 514 Nav: 8 Node
 SG_ lat : 0|32@1- (1e-7,0) [-90|90] "deg" Node
 SG_ lon : 32|32@1- (1e-7,0) [-180|180] "deg" Node
BO_ 515 Board: 4 Node
 SG_ force : 0|16@1+ (0.1,0) [0|6553.5] "N" Node
 SG_ volts : 16|16@1+ (0.1,0) [0|6553.5] "mV" Node
"""
)
GAUGE = (
    HEAD
    + """BO_ 512 ForceBox: 8 Node
 SG_ CH1 : 0|16@1+ (1,0) [0|65535] "" Node
 SG_ RollCnt : 16|8@1+ (1,0) [0|255] "" Node
BO_ 513 VehiclePosition: 8 Node
 SG_ Latitude : 0|32@1- (1e-7,0) [-90|90] "deg" Node
 SG_ Longitude : 32|32@1- (1e-7,0) [-180|180] "deg" Node
"""
)
PAGES = (
    HEAD
    + """BO_ 512 Node: 4 Node
 SG_ Page M : 0|16@1+ (1,0) [0|65535] "" Node
 SG_ Bridge m0 : 16|16@1+ (1,0) [0|65535] "" Node
 SG_ SupplyVolts m1 : 16|16@1+ (0.1,0) [0|6553.5] "mV" Node
"""
)
OWN_NUMBERS = (
    HEAD
    + """BO_ 517 Adc: 4 Node
 SG_ Raw : 0|16@1+ (1,0) [0|65535] "{unit}" Node
 SG_ {shaft} : 16|16@1+ (1,0) [0|65535] "" Node
"""
)


PARTS = (
    HEAD
    + """BO_ 512 Inputs: 8 Node
 SG_ BatteryVoltage : 0|16@1+ (0.1,0) [0|6553.5] "mV" Node
 SG_ GrainForce : 16|16@1+ (0.1,0) [0|6553.5] "mV" Node
BO_ 513 Speeds: 8 Node
 SG_ TailingsElevatorSpeed : 0|16@1+ (0.1,0) [0|6553.5] "rpm" Node
 SG_ CleanGrainElevatorSpeed : 16|16@1+ (0.1,0) [0|6553.5] "rpm" Node
 SG_ RotorSpeed : 32|16@1+ (0.1,0) [0|6553.5] "rpm" Node
BO_ 514 Angles: 8 Node
 SG_ ChopperPlateAngle : 0|16@1+ (0.1,0) [0|6553.5] "deg" Node
 SG_ ImpactPlateAngle : 16|16@1+ (0.1,0) [0|6553.5] "deg" Node
"""
)
"""A combine's other shafts, plates and voltages before its elevator's."""
PERIOD = (
    HEAD
    + """BO_ 513 Counter: 4 Node
 SG_ CyclePeriod : 0|16@1+ (0.1,0) [0|6553.5] "ms" Node
 SG_ PulsePeriod : 16|16@1+ (0.1,0) [0|6553.5] "ms" Node
"""
)
TWO_CELLS = (
    HEAD
    + """BO_ 512 CellLeft: 2 Node
 SG_ Cell : 0|16@1+ (0.1,0) [0|6553.5] "mV" Node
BO_ 513 CellRight: 2 Node
 SG_ Cell : 0|16@1+ (0.1,0) [0|6553.5] "mV" Node
BO_ 514 Shafts: 4 Node
 SG_ SpeedA : 0|16@1+ (0.1,0) [0|6553.5] "rpm" Node
 SG_ SpeedB : 16|16@1+ (0.1,0) [0|6553.5] "rpm" Node
"""
)


AMPLIFIER = (
    HEAD
    + "BO_ 512 Amplifier: 8 Node\n"
    + "".join(f' SG_ CH{k + 1} : {16 * k}|16@1+ ({{scale}},0) [0|6553.5] "{{unit}}" Node\n' for k in range(4))
)
"""Four channels of one frame."""


def words(*values: float) -> bytes:
    return b"".join(round(10.0 * value).to_bytes(2, "little") for value in values)


def written(folder: Path, dbc: str, frames: list[tuple[int, bytes]], capsys: pytest.CaptureFixture[str]) -> str:
    """The mapping that is proposed for frames 10 ms apart: (identifier, data), 29 bits from 2048 on."""
    (folder / "node.dbc").write_text(dbc)
    with can.Logger(str(folder / "node.log")) as logger:
        for place, (identifier, data) in enumerate(frames):
            logger.on_message_received(
                can.Message(1.79e9 + 0.01 * place, identifier, identifier > 0x7FF, is_fd=len(data) > 8, data=data, channel="can0")
            )
    words = ["signals", str(folder / "node.log"), "--dbc", str(folder / "node.dbc"), "--write", str(folder / "map.yaml")]
    assert main(words) == 0
    capsys.readouterr()
    return (folder / "map.yaml").read_text()


@pytest.mark.parametrize("unit", ["mV", ""])
@pytest.mark.parametrize(
    ("moves", "first", "found"),
    [(60, "CH3", "CH3 moved most"), (10, "CH3", "all moved alike, so the first is a guess")],
)
def test_channels_of_one_frame_are_one_proposal(unit: str, moves: int, first: str, found: str, tmp_path, capsys) -> None:
    """The one that moves most, and the others with their ranges, not four sensors one by one."""
    frames = [(512, words(*(500.0 + k % 8, 500.0 + k % 9, 500.0 + k % moves, 500.0 + k % 7))) for k in range(600)]
    text = written(tmp_path, AMPLIFIER.format(unit=unit, scale=0.1 if unit else 1), frames, capsys)
    proposals = [line for line in text.splitlines() if "impact_voltage: {" in line]
    assert len(proposals) == 1
    assert f"message: Amplifier, signal: {first}, rate_hz: 100" in proposals[0]
    (channels,) = [line for line in text.splitlines() if "# Channels of Amplifier: CH3 " in line]
    assert re.findall(r"CH\d", channels.partition(";")[0]) == ["CH3", "CH2", "CH1", "CH4"]
    assert channels.endswith(f"; {found}.")
    assert "Strike the plate while recording: the channel that moves is the impact sensor's." in text


@pytest.mark.parametrize(
    ("dbc", "frames", "proposed"),
    [
        pytest.param(
            MANY,
            [(512, words(*(500.0 + (k + place) % 9 for k in range(12)))) for place in range(200)],
            ["signals: [S0, S1, S2, S3, S4, S5, S6, S7, S8, S9, S10, S11], rate_hz: 1200}"],
            id="more than ten samples",
        ),
        pytest.param(
            MANY,
            [
                (512, words(*(500.0 + (k + place // 20) % 9 for k in range(12)))) if place % 20 == 0 else (513, b"")
                for place in range(2000)
            ],
            ["S11], rate_hz: 60}"],
            id="fewer than ten messages a second with many samples",
        ),
        pytest.param(
            INPUTS,
            [(512, words(2900.0 + place % 2, 500.0 + 3 * (place % 90))) for place in range(200)],
            ["impact_voltage: {dbc: node.dbc, message: AnalogInputs, signal: Input2, rate_hz: 100}"],
            id="inputs of a module",
        ),
        pytest.param(
            PAGES,
            [(512, words(place % 50 == 0 and 0.1, 500.0 + 3 * (place % 90))) for place in range(400)],
            ["impact_voltage: {dbc: node.dbc, message: Node, signal: Bridge, rate_hz: 98"],
            id="a page that is sent too rarely",
        ),
        pytest.param(
            APART,
            [(512, words(2900.0 + place % 2, 500.0 + 3 * (place % 90))) for place in range(200)],
            ["signal: A2, rate_hz: 100}"],
            id="values that cannot be one sensor's",
        ),
        pytest.param(
            PARTS,
            [
                (
                    512 + place % 3,
                    (words(1300 + 80 * (place % 7), 20 + place % 90, 0, 0), words(380, 400, 900, 0), words(50, 70, 0, 0))[
                        place % 3
                    ],
                )
                for place in range(300)
            ],
            [
                "  impact_voltage: {dbc: node.dbc, message: Inputs, signal: GrainForce",
                "  elevator_speed: {dbc: node.dbc, message: Speeds, signal: CleanGrainElevatorSpeed}",
                "# or elevator_speed: {dbc: node.dbc, message: Speeds, signal: TailingsElevatorSpeed, ratio: 0.2}",
                "# or elevator_speed: {dbc: node.dbc, message: Speeds, signal: RotorSpeed, ratio: 0.2}",
                "  plate_angle: {dbc: node.dbc, message: Angles, signal: ImpactPlateAngle}",
            ],
            id="other parts of the machine",
        ),
        pytest.param(
            PERIOD,
            [(513, words(20.0, 37.5))] * 50,
            [
                "# pulses_per_turn is a guess",
                "  elevator_speed: {dbc: node.dbc, message: Counter, signal: PulsePeriod, pulses_per_turn: 1}",
                "# plate_angle: nothing on this bus looks like it",
            ],
            id="the time between pulses",
        ),
        pytest.param(
            TWO_CELLS,
            [
                (512 + place % 3, (words(50 + place % 40), words(50 + place % 40), words(400, 390))[place % 3])
                for place in range(300)
            ],
            [
                "# CellLeft.Cell and CellRight.Cell fit alike: the first is a guess.",
                "# Two cells under one plate: map both, in a list; they are added.",
                "# Shafts.SpeedA and Shafts.SpeedB fit alike: the first is a guess.",
            ],
            id="two of each that look alike",
        ),
        pytest.param(
            ELSEWHERE,
            [(0x18FF0177, words(400.0, 0, 0, 0))] * 50,
            ["elevator_speed: {dbc: node.dbc, message: Machine, signal: Shaft, source: 119}"],
            id="another address than the DBC's",
        ),
        pytest.param(
            ELSEWHERE,
            [(0x0CFF0110, words(400.0, 0, 0, 0))] * 50,
            ["elevator_speed: {dbc: node.dbc, message: Machine, signal: Shaft, source: 16}"],
            id="another priority than the DBC's",
        ),
        pytest.param(
            ELSEWHERE,
            [
                (0x18EEFF77, NODE_NAME.to_bytes(8, "little")),
                *[(0x18FF0177, words(400.0, 0, 0, 0))] * 20,
                (0x18EEFF78, NODE_NAME.to_bytes(8, "little")),
                *[(0x18FF0178, words(400.0, 0, 0, 0))] * 20,
                (0x18EEFF79, OTHER_NAME.to_bytes(8, "little")),
                *[(0x18FF0179, words(3.0, 0, 0, 0)), (0x18FF0178, words(400.0, 0, 0, 0))] * 5,
            ],
            [
                "  elevator_speed: {",
                "function: 128,",
                f"identity_number: {NODE_NAME & 0x1FFFFF}}}}}",
                "# or elevator_speed: {",
                "source: 121}",
            ],
            id="a node that moved",
        ),
        pytest.param(
            NAMELESS,
            [(513, words(400.0, 60.0))] * 50,
            [
                "signals: {}",
                "# or elevator_speed: {dbc: node.dbc, message: Werte, signal: Drehzahl, not_available: [65534, 65535]}",
            ],
            id="no name says it",
        ),
        pytest.param(
            RATIO,
            [(512, words(1000.0 + 10.0 * (place % 40))) for place in range(100)],
            [
                "# The scale is a guess: volts that feed the bridge (if `setup` was given mV/V: unit: mV, no scale).",
                "impact_voltage: {dbc: node.dbc, message: Bridge, signal: Strain",
                "scale: 5}",
            ],
            id="a bridge's ratio",
        ),
        pytest.param(
            STATE,
            [(516, bytes([place % 3])) for place in range(100)],
            ["actuator_state: {dbc: node.dbc, message: Plate, signal: ActuatorState}"],
            id="a state that is a fault",
        ),
        pytest.param(
            GRAD,
            [(516, (600 + place % 100).to_bytes(2, "little")) for place in range(100)],
            [
                "# The unit is a guess: degrees (if the DBC means gradians: unit: deg, scale: 0.9).",
                "plate_angle: {dbc: node.dbc, message: Plate, signal: PlateAngle, unit: deg}",
            ],
            id="degrees or gradians",
        ),
        pytest.param(
            HEADER,
            [(516, bytes([place % 2])) for place in range(100)],
            ["header_down: {dbc: node.dbc, message: Switches, signal: Header, values: {0: 1, 1: 0}}"],
            id="a switch that is 1 when the header is up",
        ),
        pytest.param(
            RECEIVER,
            [(514 + place % 2, words(50.0 + place % 40, 12.0, 0, 0)) for place in range(100)],
            ["impact_force: {dbc: node.dbc, message: Board, signal: force", "  latitude: {", "  longitude: {"],
            id="short names, and a voltage that stands",
        ),
        pytest.param(
            GAUGE,
            [
                (512, (500 + place % 40).to_bytes(2, "little") + bytes([place // 2 % 256]) + bytes(5))
                if place % 2 == 0
                else (513, (480_000_000).to_bytes(4, "little") + (90_000_000).to_bytes(4, "little"))
                for place in range(200)
            ],
            ["  impact_voltage: {dbc: node.dbc, message: ForceBox, signal: CH1", "  latitude: {", "  longitude: {"],
            id="no counter of messages for samples, and no place for the plate's",
        ),
        *(
            pytest.param(
                OWN_NUMBERS.format(unit=unit, shaft=shaft),
                [(517, words(50.0 + 7 * place % 40, 1.0 * place)) for place in range(100)],
                proposed,
                id=f"{shaft}, {unit or 'no unit'}",
            )
            for unit, shaft, proposed in (
                (
                    "",
                    "X",
                    ["signals: {}", "by their rates", "# or impact_voltage: {", "Raw, rate_hz: 100, unit: counts, scale: 0.1}"],
                ),
                (
                    "%",
                    "X",
                    ["signals: {}", "by their rates", "# or impact_voltage: {", "Raw, rate_hz: 100, unit: counts, scale: 0.1}"],
                ),
                ("degC", "HallSensor", ["# pulses_per_turn is a guess", "signal: HallSensor, pulses_per_turn: 1}"]),
            )
        ),
        *(
            pytest.param(
                INPUTS.replace("mV", unit).replace("Input1", name).replace("Input2", "Other2").replace("AnalogInputs", message),
                [(512, words(20.0 + place % 40, 0.0)) for place in range(100)],
                proposed,
                id=f"{name} in {unit}",
            )
            for unit, message, name, proposed in (
                ("kg", "LoadCell", "Weight", ["  impact_force: {", "signal: Weight, rate_hz: 100, unit: kgf}"]),
                (
                    "Hz",
                    "Pulse",
                    "Frequency",
                    ["# pulses_per_turn is a guess", "  elevator_speed: {", "signal: Frequency, pulses_per_turn: 1}"],
                ),
                ("lbs", "Plate", "Reading", ["  impact_force: {", "signal: Reading, rate_hz: 100, unit: lbf}"]),
                ("kg", "Node7", "Kraft", ["  impact_force: {", "signal: Kraft, rate_hz: 100, unit: kgf}"]),
                ("kg", "Node7", "Reading", ["by their rates it could be", "  # or impact_force: {", "rate_hz: 100, unit: kgf}"]),
                ("kg", "GrainTank", "Weight", ["nothing on this bus looks like an impact", "  tank_mass: {", "signal: Weight}"]),
            )
        ),
    ],
)
def test_what_is_proposed(
    dbc: str, frames: list[tuple[int, bytes]], proposed: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = written(tmp_path, dbc, frames, capsys)
    places = [text.index(part) for part in proposed]
    assert places == sorted(places)
    assert text.count("moisture:") == 0
    main(["check-config", str(tmp_path / "map.yaml"), "--json"])
    assert json.loads(capsys.readouterr().out)["problems"] == []


@pytest.mark.parametrize(
    ("dbc", "first", "second", "guesses"),
    [
        (TWO_CELLS, words(50.0), words(51.0), ["elevator_speed", "impact_voltage"]),
        (INPUTS, words(50.0, 51.0), words(52.0, 53.0), ["impact_voltage"]),
        (INPUTS, words(50.0, 51.0), words(52.0, 91.0), []),
        (NAMELESS.replace("513 Werte", "512 Werte"), words(400.0, 60.0), words(410.0, 60.0), ["elevator_speed"]),
        (RATIO, words(50.0), words(51.0), []),
    ],
)
def test_guesses_are_told(dbc: str, first: bytes, second: bytes, guesses: list[str], tmp_path: Path, capsys) -> None:
    frames = [(512 + place % 2 * ("513 Cell" in dbc), (first, second)[place // 2 % 2]) for place in range(400)]
    frames += [(514, words(400.0, 390.0))] * 100 if "514" in dbc else []
    written(tmp_path, dbc, frames, capsys)
    words_of = [str(tmp_path / "node.log"), "--dbc", str(tmp_path / "node.dbc")]
    assert survey(capsys, *words_of)["guesses"] == guesses
    assert main(["signals", *words_of]) == 0
    said = capsys.readouterr().out
    assert re.findall(r"^(\w+) \(the first is a guess\): ", said, re.MULTILINE) == guesses


@pytest.mark.parametrize(("kind", "frames"), [("J1939PG", 50), ("ExtendedCAN", 0)])
def test_priority_is_no_part_of_a_j1939_message(
    kind: str, frames: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    formats = f"""BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "{kind}";
"""
    written(tmp_path, ELSEWHERE + formats, [(0x0CFF0110, words(400.0, 0, 0, 0))] * 50, capsys)
    config = tmp_path / "c.yaml"
    config.write_text("signals: {elevator_speed: {dbc: node.dbc, message: Machine, signal: Shaft}}")
    main(["check-config", str(config), "--log", str(tmp_path / "node.log"), "--json"])
    assert json.loads(capsys.readouterr().out)["signals"]["elevator_speed"]["values"] == frames


def test_damage_of_a_log_is_reported_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    log = tmp_path / "damaged.log"
    log.write_text(TRACTOR.read_text() + "no frame\n" * 30)
    assert main(["signals", str(log)]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 4
    assert "30 damaged records" in lines[-1]
    assert caplog.records == []


def test_two_files_of_one_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for layout, folder in ((COUNTS, "one"), (MULTIPLEXED, "two")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "node.dbc").write_text(layout.dbc)
    one, two = (str(tmp_path / folder / "node.dbc") for folder in ("one", "two"))
    logs = {layout.name: str(drive(layout, tmp_path)) for layout in (COUNTS, MULTIPLEXED)}
    mapping = tmp_path / "one" / "map.yaml"
    found = survey(capsys, logs["counts"], "--dbc", one, "--dbc", two, "--write", str(mapping))
    assert found["candidates"]["impact_voltage"][0]["dbc"] == one
    assert "impact_voltage: {dbc: node.dbc, message: Bridge" in mapping.read_text()
    found = survey(capsys, logs["multiplexed"], "--dbc", one, "--dbc", two)
    assert found["candidates"]["impact_voltage"][0]["dbc"] == two


def test_samples_that_no_cell_gives_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = drive(MULTIPLEXED, tmp_path)
    config = tmp_path / "wrong.yaml"
    config.write_text(MULTIPLEXED.config.replace("mux: 0,", "mux: 0, unit: V,"))
    assert main(["check-config", str(config), "--log", str(log)]) == 2
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1
    assert f"{log}: impact: 4" in error
    assert "within 16000 mV" in error


def test_a_source_by_its_whole_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As `yieldmon signals` prints it."""
    log = drive(PROPRIETARY, tmp_path)
    config = tmp_path / "named.yaml"
    values = {}
    for name in (f"0x{NODE_NAME:016X}", "{identity_number: 0x42}", f"0x{OTHER_NAME:016X}"):
        config.write_text(PROPRIETARY.config.replace("{identity_number: 0x42}", name))
        main(["check-config", str(config), "--log", str(log), "--json"])
        values[name] = json.loads(capsys.readouterr().out)["signals"]["elevator_speed"]["values"]
    assert list(values.values()) == [60, 60, 0]


def test_a_rate_that_is_not_the_recorded_one_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = drive(COUNTS, tmp_path)
    config = tmp_path / "wrong.yaml"
    config.write_text(COUNTS.config.replace("rate_hz: 100", "rate_hz: 50"))
    assert main(["check-config", str(config), "--log", str(log)]) == 2
    error = capsys.readouterr().err
    assert "100 samples per second; expected 50" in error


def test_what_a_slow_sensor_costs_is_reported_before(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check-config", str(NEWTONS.write(tmp_path)), "--json"]) == 0
    notes = " ".join(json.loads(capsys.readouterr().out)["notes"])
    assert "10 samples per second" in notes
    assert "at 300 rpm" in notes
    assert "fixed at 70 deg" in notes


@pytest.mark.parametrize("rpm", [400.0, 500.0])
def test_what_is_reported_covers_what_10_hz_samples_cost(rpm: float, tmp_path: Path) -> None:
    """Of the virtual combine: scatter about the mean and the mean's own error, of the true flow."""
    stated = aliasing_pct(configuration.load(NEWTONS.write(tmp_path)))[f"{rpm:g}"]
    for seed in (1, 2):
        frames, mass_kg = harvest(rpm, 60, 12.0, seed)
        found = measured(frames, 10, mass_kg)
        share = 1.0 + found["mass_error_pct"] / 100.0
        assert 5.0 < hypot(found["scatter_pct"] * share, found["mass_error_pct"]) <= stated


ERRORS_ONLY = (
    "date Sam Sep 30 15:06:13.191 2017\nbase hex  timestamps absolute\n   2.501000 1 ErrorFrame\n   3.501000 1 ErrorFrame\n"
)


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("errors.asc", ERRORS_ONLY, "no data frame; expected a bus or log with traffic"),
        ("empty.log", "***BUSMASTER Ver 2.4.0***\n***PROTOCOL CAN***\n", "no data frame; expected a bus or log with traffic"),
        ("other.log", "time level\n12.5 notice\n", "expected a CAN log as its name says: lines of candump, BUSMASTER, CanKing"),
        ("other.csv", "time,voltage\n12.5,3.1\n", "export others as .asc or .trc"),
    ],
)
def test_a_log_without_a_data_frame_is_refused_in_a_line(name, text, says, tmp_path, capsys) -> None:
    """Error frames or a head only, and other programs' files under an ending that is read."""
    (tmp_path / name).write_text(text)
    assert main(["signals", str(tmp_path / name)]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert says in line


def test_identifiers_that_lack_their_mark_and_names_of_values_that_lack_their_signal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As some car and sensor makers' files have them; each made the whole file useless."""
    dbc = (
        'VERSION ""\nBU_: A\nBO_ 419361024 Cell: 8 A\n SG_ Signal : 0|32@1- (1,0) [0|0] "mV" A\n'
        'BO_ 291 Short: 2 A\n SG_ Speed : 0|16@1+ (0.125,0) [0|0] "rpm" A\n'
        'CM_ SG_ 419361024 Signal "bridge";\nSIG_VALTYPE_ 419361024 Signal : 1;\n'
        'VAL_ 291 Gear 1 "low;\n gear" 0 "none" ;\nVAL_ 291 Speed 0 "rest" ;\nVAL_ 7 Gone 1 "on" ;\n'
    )
    (tmp_path / "maker.dbc").write_text(dbc)
    value = struct.pack("<f", 12.5).hex()
    lines = [
        f"(1700000000.{i:02d}0000) can0 18FEF100#{value}00000000\n(1700000000.{i:02d}5000) can0 123#800C\n" for i in range(50)
    ]
    (tmp_path / "a.log").write_text("".join(lines))
    found = survey(capsys, str(tmp_path / "a.log"), "--dbc", str(tmp_path / "maker.dbc"))
    cell = next(message for message in found["messages"] if message["name"] == "Cell")
    assert (cell["id"], cell["signals"]["Signal"]["last"]) == ("0x18FEF100", 12.5)
    short = next(message for message in found["messages"] if message["name"] == "Short")
    assert short["signals"]["Speed"]["last"] == 0.125 * 0x0C80


def test_of_two_angles_that_only_their_unit_names_the_faster_comes_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "m.dbc").write_text(
        'VERSION ""\nNS_ :\nBS_:\nBU_: N\nBO_ 256 Fixes: 2 N\n SG_ North : 0|16@1+ (0.01,0) [0|90] "deg" N\n'
        'BO_ 257 Feedback: 2 N\n SG_ Value : 0|16@1+ (0.01,0) [0|180] "deg" N\n'
    )
    log = tmp_path / "a.log"
    lines = [(0.05 * k, 257, 7000) for k in range(200)] + [(1.0 * k, 256, 4006) for k in range(10)]
    log.write_text("".join(f"({t:.6f}) can0 {i:03X}#{v.to_bytes(2, 'little').hex()}\n" for t, i, v in sorted(lines)))
    assert main(["signals", str(log), "--dbc", str(tmp_path / "m.dbc")]) == 0
    assert "plate_angle (the first is a guess): Feedback.Value (20.0 Hz), Fixes.North" in capsys.readouterr().out

"""`check-config --log` says what a recording has in place of a mapped quantity's frames."""

from __future__ import annotations

from pathlib import Path

import can
import pytest

from yieldmon.cli.main import main

DBC = """VERSION ""
NS_ :
BS_:
BU_: N
BO_ 417 Narrow: 2 N
 SG_ V : 0|16@1+ (0.1,0) [0|0] "rpm" N
BO_ 2147484066 Wide: 2 N
 SG_ V : 0|16@1+ (0.1,0) [0|0] "rpm" N
BO_ 2566849278 Group: 2 N
 SG_ V : 0|16@1+ (0.1,0) [0|0] "rpm" N
BO_ 2365522449 Own: 2 N
 SG_ V : 0|16@1+ (0.1,0) [0|0] "rpm" N
"""
# Proprietary A of node 17 to another address than those of the recording, and to one of them.
DBC += """BO_ 2565865233 Everyone: 2 N
 SG_ V : 0|16@1+ (0.1,0) [0|0] "rpm" N
"""
DATA = (4000).to_bytes(2, "little")
FRAMES = [
    (417, True, DATA), (0x18EF0511, True, DATA), (0x18EF0711, True, bytes(2)),
    (418, False, DATA), (0x18FF0211, True, DATA), (0x18FF0212, True, DATA),
    *((0x18EEFF00 | address, True, (0x2000800000000000 | number).to_bytes(8, "little")) for address, number in ((1, 7), (2, 8))),
]  # fmt: skip


@pytest.mark.parametrize(
    ("mapped", "said"),
    [
        ("message: Narrow", "it comes with a 29-bit identifier, the DBC gives it 11 bits"),
        ("message: Wide", "it comes with an 11-bit identifier, the DBC gives it 29 bits"),
        ("message: Group, source: 5", "it comes from 17, 18 only"),
        ("message: Own", "it comes with priority 6, the DBC gives it 3; with `source: 17` any will do"),
        ("message: Everyone", "it is sent to address 5, 7, by the DBC to 255; with `source: 17` any will do"),
        ("message: Group, source: {identity_number: 9}", "no node with that NAME claims an address"),
        ("message: Group, source: {function: 128}", "nodes 1, 2 all fit that NAME"),
        ("message: Group, source: {identity_number: 7}", "it comes from 17, 18 only"),
    ],
)
def test_what_comes_instead_is_reported(mapped: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "bus.log"
    with can.Logger(str(log)) as logger:
        for number, (identifier, extended, data) in enumerate(FRAMES * 3):
            logger.on_message_received(
                can.Message(timestamp=0.1 * number, arbitration_id=identifier, is_extended_id=extended, data=data, channel="can0")
            )
    (tmp_path / "a.dbc").write_text(DBC)
    config = tmp_path / "c.yaml"
    config.write_text(f"signals:\n  elevator_speed: {{dbc: a.dbc, {mapped}, signal: V}}\n")
    assert main(["check-config", str(config), "--log", str(log)]) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "elevator_speed" in line]
    assert f"bus.log: elevator_speed: no frame of it: {said}; expected" in line


def test_a_node_that_sends_to_two_addresses_is_not_taken_for_two(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, numbers = tmp_path / "bus.log", range(60)
    with can.Logger(str(log)) as logger:
        for number in numbers:
            identifier, data = ((0x18EF0511, DATA), (0x18EF0711, (2000).to_bytes(2, "little")))[number % 2]
            logger.on_message_received(can.Message(timestamp=0.1 * number, arbitration_id=identifier, data=data, channel="can0"))
    config = tmp_path / "c.yaml"
    config.write_text("signals:\n  elevator_speed: {dbc: a.dbc, message: Everyone, source: 17, signal: V}\n")
    (tmp_path / "a.dbc").write_text(DBC)
    assert main(["check-config", str(config), "--log", str(log)]) == 2
    said = (
        "expected the values for one address: 0x18EF0511 or 0x18EF0711 as the message's identifier in the DBC, without `source`"
    )
    assert said in capsys.readouterr().err
    config.write_text("signals:\n  elevator_speed: {dbc: a.dbc, message: Everyone, signal: V}\n")
    (tmp_path / "a.dbc").write_text(DBC.replace("2565865233", str(0x98EF0511)))
    assert main(["check-config", str(config), "--log", str(log)]) == 2
    assert "elevator_speed" not in capsys.readouterr().err


@pytest.mark.parametrize(("state", "told"), [(0x7F, True), (0x05, False)])
def test_a_canopen_node_that_waits_to_be_started_is_named(
    state: int, told: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "bus.log"
    log.write_text("".join(f"({second}.0) can0 {0x700 + 0x21:03X}#{state if second else 0:02X}\n" for second in range(4)))
    (tmp_path / "a.dbc").write_text(DBC)
    config = tmp_path / "c.yaml"
    config.write_text("signals:\n  elevator_speed: {dbc: a.dbc, message: Narrow, signal: V}\n")
    assert main(["check-config", str(config), "--log", str(log)]) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "elevator_speed" in line]
    said = "no frame of it: CANopen node 33 waits to be started (`cansend can0 000#0121`, or its maker's setting to start itself)"
    assert (said in line) == told
    assert main(["signals", str(log)]) == 0
    named = "CANopen node 33 waits to be started (`cansend can0 000#0121`" if told else "CANopen node 33 is operational\n"
    assert named in capsys.readouterr().out


@pytest.mark.parametrize(
    ("scale", "said"),
    [
        ("scale: 100", "no usable value: it decodes to 40000 rpm; expected values that it can have; look at signal, unit, scale"),
        ("not_available: [4000]", "no usable value; expected"),
    ],
)
def test_what_cannot_be_true_is_reported_with_its_value(
    scale: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "bus.log"
    with can.Logger(str(log)) as logger:
        for number in range(5):
            message = can.Message(timestamp=0.1 * number, arbitration_id=417, is_extended_id=False, data=DATA, channel="can0")
            logger.on_message_received(message)
    (tmp_path / "a.dbc").write_text(DBC)
    config = tmp_path / "c.yaml"
    config.write_text(f"signals:\n  elevator_speed: {{dbc: a.dbc, message: Narrow, signal: V, {scale}}}\n")
    assert main(["check-config", str(config), "--log", str(log)]) == 2
    assert f"bus.log: elevator_speed: {said}" in capsys.readouterr().err
    assert main(["process", str(log), "--config", str(config), "--out", str(tmp_path / "x.csv")]) == 2
    assert "no impact sensor" in capsys.readouterr().err

"""Multiplexers below multiplexers, and values that share a signal: as cantools reads them; what `signals` writes of them."""

from __future__ import annotations

import struct
from pathlib import Path

import can
import cantools
import numpy as np
import pytest
from cantools.database.errors import DecodeError
from hypothesis import given, settings
from hypothesis import strategies as st

from yieldmon.bus.bulk import block_of
from yieldmon.bus.databases import MessageBits, load_messages
from yieldmon.cli.main import main
from yieldmon.physics.machine import Machine
from yieldmon.service.config.configuration import load
from yieldmon.signals.binding import Binding
from yieldmon.signals.decoding import MapDecoder
from yieldmon.signals.mapping import build

DBC = """VERSION ""
NS_ :
BS_:
BU_: N
BO_ 1000 All: 8 N
 SG_ Page M : 7|8@0+ (1,0) [0|0] "" N
 SG_ Sub m1M : 15|4@0+ (1,0) [0|0] "" N
 SG_ Voltage m2 : 23|16@0- (0.25,0) [0|0] "mV" N
 SG_ Angle m3 : 23|32@0- (1,0) [0|0] "rad" N
 SG_ ShaftSpeed m0 : 15|16@0+ (0.1,0) [0|0] "rpm" N
BO_ 2566856702 Weigh: 4 N
 SG_ Force1 : 0|16@1+ (1,0) [0|0] "N" N
 SG_ Force2 : 16|16@1+ (1,0) [0|0] "N" N
SG_MUL_VAL_ 1000 Sub Page 1-1, 4-4;
SG_MUL_VAL_ 1000 Voltage Sub 2-2, 5-6;
SG_MUL_VAL_ 1000 Angle Sub 3-3;
SG_MUL_VAL_ 1000 ShaftSpeed Page 0-0;
SIG_VALTYPE_ 1000 Angle : 1;
"""
DATABASE = cantools.database.load_string(DBC, "dbc")
BOUND = {
    "Voltage": ("grain_temperature", 5, "degC"),
    "Angle": ("plate_angle", 3, "deg"),
    "ShaftSpeed": ("elevator_speed", 0, "rpm"),
}


@pytest.fixture(scope="module")
def messages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, MessageBits]:
    path = tmp_path_factory.mktemp("pages") / "pages.dbc"
    path.write_text(DBC)
    return load_messages(path)


@settings(max_examples=80)
@given(
    frames=st.lists(st.tuples(st.integers(0, 5), st.integers(0, 7), st.binary(min_size=6, max_size=6)), min_size=1, max_size=20)
)
def test_pages_below_pages_as_cantools_reads_them(frames: list[tuple[int, int, bytes]], messages: dict[str, MessageBits]) -> None:
    sent = [bytes([page, sub << 4]) + rest for page, sub, rest in frames]
    for signal, (quantity, mux, unit) in BOUND.items():
        bindings = [Binding("test", quantity, "pages.dbc", "All", (signal,), unit=unit, mux=(mux,))]
        expected = []
        for data in sent:
            try:
                found = DATABASE.decode_message("All", data)
            except DecodeError:
                continue
            # The binding is for one of the values that the DBC gives the signal.
            if signal in found and mux == found["Sub" if signal != "ShaftSpeed" else "Page"]:
                expected.append(found[signal])
        decoder = MapDecoder(build(bindings, lambda _name: messages, Machine()))
        singly = [frame.signals[quantity] for data in sent for frame in decoder.decode(0.0, 1000, False, data)]
        known = [float("nan") if isinstance(value, str) or not isinstance(value, float) else value for value in singly]
        assert known == pytest.approx(expected, nan_ok=True)
        block = block_of([can.Message(arbitration_id=1000, is_extended_id=False, data=data) for data in sent])
        columns, _ = decoder.decode_block(block.time_s, block.can_id, block.length, block.payload)
        in_block = columns[0].signals[quantity] if columns else np.empty(0)
        assert in_block.tolist() == pytest.approx(known, nan_ok=True)


def test_a_signal_of_several_pages_may_be_taken_from_all_of_them(tmp_path: Path, messages: dict[str, MessageBits]) -> None:
    """One page had to be chosen, and the samples of the others went."""
    (tmp_path / "pages.dbc").write_text(DBC)
    (tmp_path / "c.yaml").write_text(
        "signals:\n  impact_voltage: {dbc: pages.dbc, message: All, signal: Voltage, rate_hz: 100, mux: [6, 0x2]}\n"
    )
    bindings = load(tmp_path / "c.yaml").signals.bindings
    sent = [bytes([page, sub << 4]) + struct.pack(">h", 4 * number) + bytes(4) for number, (page, sub) in enumerate(
        [(1, 2), (1, 5), (4, 6), (1, 3), (0, 2), (4, 2)]
    )]  # fmt: skip
    decoder = MapDecoder(build(bindings, lambda _name: messages, Machine()))
    taken = [value for data in sent for frame in decoder.decode(0.0, 1000, False, data) for value in frame.signals.values()]
    assert taken == [0.0, 2.0, 5.0]
    block = block_of([can.Message(arbitration_id=1000, is_extended_id=False, data=data) for data in sent])
    ((column,), _) = decoder.decode_block(block.time_s, block.can_id, block.length, block.payload)
    assert [values.tolist() for values in column.signals.values()] == [taken]


def written(folder: Path, frames: list[tuple[float, int, bytes]]) -> str:
    (folder / "pages.dbc").write_text(DBC)
    with can.Logger(str(folder / "bus.log")) as logger:
        for at_s, identifier, data in frames:
            extended = identifier > 0x7FF
            message = can.Message(timestamp=at_s, arbitration_id=identifier, is_extended_id=extended, data=data, channel="can0")
            logger.on_message_received(message)
    files = [str(folder / name) for name in ("bus.log", "pages.dbc", "map.yaml")]
    assert main(["signals", files[0], "--dbc", files[1], "--write", files[2]]) == 0
    return (folder / "map.yaml").read_text()


def test_the_page_that_comes_most_is_written(tmp_path: Path) -> None:
    frames = []
    for number in range(500):
        page = bytes([1, 0x20 if number % 10 == 0 else 0x50])
        frames.append((0.01 * number, 1000, page + struct.pack(">h", number) + bytes(4)))
    text = written(tmp_path, frames)
    assert "\n  impact_voltage: {dbc: pages.dbc, message: All, signal: Voltage, rate_hz: 90, mux: 5}\n" in text
    # Whether each page has a sensor of its own the bus does not show.
    assert (
        "\n  # Voltage comes with mux 2, 5. A sensor each: take one. One sensor in all:"
        "\n  # impact_voltage: {dbc: pages.dbc, message: All, signal: Voltage, rate_hz: 100, mux: [2, 5]}\n"
    ) in text
    for line in text.splitlines():
        (tmp_path / "all.yaml").write_text(f"signals:\n  {line[4:]}\n")
        if line.startswith("  # impact_voltage: {"):
            assert load(tmp_path / "all.yaml").signals.bindings[0].mux == (2, 5)


def test_each_sender_is_written_by_itself_and_no_line_twice(tmp_path: Path) -> None:
    frames = []
    for number in range(500):
        frames.append((0.01 * number, 0x18FF1F44, struct.pack("<HH", number, number + 1)))
        if number % 10 == 0:
            frames.append((0.01 * number + 0.001, 0x18FF1F45, bytes(4)))
    lines = [line.strip() for line in written(tmp_path, frames).splitlines() if "Weigh" in line]
    entry = "impact_force: {dbc: pages.dbc, message: Weigh, signals: [Force1, Force2], rate_hz: "
    assert lines == [f"{entry}200, source: 68}}", f"# or {entry}20, source: 69}}"]


VALID = """VERSION ""
NS_ :
BS_:
BU_: N
BO_ 23 gnss_speed: 5 N
 SG_ Speed : 1|20@1+ (0.001,0) [0|1048.575] "m/s" N
 SG_ SpeedAccuracy : 21|19@1+ (0.001,0) [0|524.287] "m/s" N
 SG_ SpeedValid : 0|1@1+ (1,0) [0|1] "" N
"""


@pytest.mark.parametrize(("valid", "expected"), [({}, [7.2, 0.0, 9.0]), ({"SpeedValid": (1,)}, [7.2, 9.0])])
def test_what_another_signal_calls_invalid_is_no_value(
    valid: dict[str, tuple[int, ...]], expected: list[float], tmp_path: Path
) -> None:
    """A receiver without a fix sends 0 m/s (CSS Electronics' public DBC of its loggers)."""
    (tmp_path / "gnss.dbc").write_text(VALID)
    messages = load_messages(tmp_path / "gnss.dbc")
    sent = [(raw << 1 | flag).to_bytes(5, "little") for raw, flag in ((2000, 1), (0, 0), (2500, 1))]
    decoder = MapDecoder(
        build([Binding("test", "ground_speed", "gnss.dbc", "gnss_speed", ("Speed",), valid=valid)], lambda _: messages, Machine())
    )
    singly = [frame.signals["ground_speed"] for data in sent for frame in decoder.decode(0.0, 23, False, data)]
    block = block_of([can.Message(arbitration_id=23, is_extended_id=False, data=data) for data in sent])
    columns, _ = decoder.decode_block(block.time_s, block.can_id, block.length, block.payload)
    assert singly == pytest.approx(expected)
    assert np.concatenate([column.signals["ground_speed"] for column in columns]) == pytest.approx(expected)


def test_a_signal_that_says_what_is_valid_is_proposed(tmp_path: Path) -> None:
    (tmp_path / "gnss.dbc").write_text(VALID)
    (tmp_path / "a.log").write_text("".join(f"({place}.0) can0 017#A10F000000\n" for place in range(1, 20)))
    words = ["signals", str(tmp_path / "a.log"), "--dbc", str(tmp_path / "gnss.dbc"), "--write", str(tmp_path / "c.yaml")]
    assert main(words) == 0
    assert (
        "ground_speed: {dbc: gnss.dbc, message: gnss_speed, signal: Speed, valid: {SpeedValid: 1}}"
        in (tmp_path / "c.yaml").read_text()
    )
    assert main(["check-config", str(tmp_path / "c.yaml")]) == 0

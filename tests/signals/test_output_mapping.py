"""Published quantities in messages of other DBC files: bits as cantools reads them, and one line for what does not fit."""

from __future__ import annotations

import math
import random
import re
import struct
from pathlib import Path

import cantools
import pytest

from tests.plant_sweeps import window
from yieldmon.bus.databases import load_messages
from yieldmon.cli.main import main
from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.results import PlateCommand, WindowResult
from yieldmon.engine.settings import TotalsSettings
from yieldmon.frames import NOT_AVAILABLE, Frame
from yieldmon.physics.machine import Machine
from yieldmon.resources import shipped
from yieldmon.service.traffic.mapped_outputs import STALE_S, MappedOutputs
from yieldmon.signals.mapping import default_map
from yieldmon.signals.output_mapping import OutputBinding, build
from yieldmon.signals.packing import Packing, packed

DBC = f"""VERSION ""
NS_ :
BS_:
BU_: Node
BO_ 529 Drive: 8 Node
 SG_ Control : 0|16@1+ (1,0) [0|65535] "" Node
 SG_ Position : 16|16@1- (0.01,0) [0|0] "deg" Node
 SG_ Mode : 32|4@1+ (1,0) [0|15] "" Node
 SG_ Small : 40|8@1+ (0.1,0) [0|25.5] "deg" Node
 SG_ Warm : 48|8@1+ (1,10) [10|265] "kg/s" Node
 SG_ Bit : 56|1@1+ (1,0) [0|1] "" Node
BO_ 768 Pages: 4 Node
 SG_ Page M : 0|8@1+ (1,0) [0|255] "" Node
 SG_ Flow m1 : 8|16@1+ (0.01,0) [0|655] "t/h" Node
 SG_ Load m2 : 8|16@1+ (0.01,0) [0|655] "t" Node
BO_ 1792 Long: 24 Node
 SG_ Sum : 0|16@1+ (1,0) [0|65535] "kg" Node
BO_ {0x98FF53FE} Ours: 8 Node
 SG_ Flow : 0|16@1+ (0.01,0) [0|600] "t/h" Node
 SG_ Count : 16|4@1+ (1,0) [0|15] "" Node
BO_ {0x98FF1683} LikeMassFlow: 8 Node
 SG_ Flow : 0|16@1+ (0.01,0) [0|600] "t/h" Node
BO_ {0x98EAFFFE} LikeRequest: 8 Node
 SG_ Flow : 0|16@1+ (0.01,0) [0|600] "t/h" Node
BO_ 802 Tilt: 2 Node
 SG_ Angle : 0|16@1+ (0.01,0) [0|600] "deg" Node
BO_ 803 Grain: 4 Node
 SG_ Moisture : 0|16@1+ (0.1,0) [0|6553] "%" Node
 SG_ Dry : 16|16@1+ (0.01,0) [0|655] "kg/s" Node
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_ "VFrameFormat" BO_ {0x98FF53FE} 3;
"""
ANGLE = "plate_target_angle: {dbc: d.dbc, message: Drive, signal: Position}"
MODE = "plate_command_mode: {dbc: d.dbc, message: Drive, signal: Mode}"
FLOW = "mass_flow: {dbc: d.dbc, message: Ours, signal: Flow}"

CASES = {
    "unknown quantity": (FLOW.replace("mass_flow", "mass_flwo"), "mass_flwo", "unknown quantity", "mass_flow"),
    "unknown key": (FLOW.replace("}", ", rate_hz: 10}"), "mass_flow.rate_hz", "unknown key", "period_ms"),
    "no entry": ("mass_flow: null", "mass_flow", "None", "dbc, message"),
    "no message": (FLOW.replace("message: Ours, ", ""), "mass_flow.message", "missing", "name of a message"),
    "unknown message": (FLOW.replace("Ours", "Our"), "mass_flow.message", "Our is not in d.dbc", "Ours"),
    "unknown signal": (FLOW.replace("signal: Flow", "signal: Flo"), "mass_flow.signal", "Flo is not in Ours", "Flow"),
    "unknown file": (FLOW.replace("d.dbc", "e.dbc"), "e.dbc", "No such file", "DBC"),
    "wrong unit": (FLOW.replace("}", ", unit: kg}"), "mass_flow.unit", "'kg'", "t/h"),
    "unit of the DBC": (FLOW.replace("Ours, signal: Flow", "Tilt, signal: Angle"), "mass_flow.unit", "'deg'", "kg/s"),
    "one signal twice": (f"{FLOW}\n    dry_mass_flow: {{dbc: d.dbc, message: Ours, signal: Flow}}",
                         "dry_mass_flow.signal", "mass_flow", "of its own"),
    "multi-packet": ("load_mass: {dbc: d.dbc, message: Long, signal: Sum}", "load_mass.message", "24 bytes", "one frame"),
    "multiplexer missing": ("mass_flow: {dbc: d.dbc, message: Pages, signal: Flow}", "mass_flow.mux", "missing", "Page"),
    "another page": ("mass_flow: {dbc: d.dbc, message: Pages, signal: Flow, mux: 2}", "mass_flow.mux", "2", "1, the multiplexer"),
    "no multiplexer": (FLOW.replace("}", ", mux: 2}"), "mass_flow.mux", "2", "no multiplexer"),
    "source of 11 bits": (ANGLE.replace("}", ", source: own}"), "plate_target_angle.source", "11-bit", "29-bit"),
    "source not claimed": (FLOW.replace("}", ", source: 0x27}"), "mass_flow.source", "39", "own"),
    "source that is none": (FLOW.replace("}", ", source: 300}"), "mass_flow.source", "300", "0 to 253"),
    "period": (FLOW.replace("}", ", period_ms: 5}"), "mass_flow.period_ms", "5", "50 to 10000 ms"),
    "two periods": (f"{ANGLE.replace('}', ', period_ms: 100}')}\n    {MODE}", "command_mode.period_ms", "not that of", "same"),
    "angles do not fit": (ANGLE.replace("Position", "Small"), "plate_target_angle.signal", "0 to 25.5 deg", "40 to 90 deg"),
    "range too narrow": (ANGLE.replace("}", ", range: [50, 80]}"), "plate_target_angle.range", "carries", "40 to 90 deg"),
    "range upside down": (ANGLE.replace("}", ", range: [80, 50]}"), "plate_target_angle.range", "[80", "smaller first"),
    "no zero": ("mass_flow: {dbc: d.dbc, message: Drive, signal: Warm}", "mass_flow.signal", "10 to 265", "0 in it"),
    "scale": (FLOW.replace("}", ", scale: 0}"), "mass_flow.scale", "0", "other than 0"),
    "code too large": (MODE.replace("Mode}", "Bit}"), "plate_command_mode.values", "code 2 would be raw value 2", "0, 1, 2"),
    "code left out": (MODE.replace("}", ", values: {0: 1, 1: 2}}"), "plate_command_mode.values", "code 2", "0, 1, 2"),
    "code unknown": (MODE.replace("}", ", values: {0: 1, 1: 2, 2: 3, 7: 4}}"), "plate_command_mode.values", "code 7", "0, 1, 2"),
    "codes of a number": (FLOW.replace("}", ", values: {0: 1}}"), "mass_flow.values", "{0: 1}", "no codes"),
    "scale of a code": (MODE.replace("}", ", scale: 2}"), "plate_command_mode.scale", "2", "whole number"),
    "not available": (ANGLE.replace("}", ", not_available: 65536}"), "plate_target_angle.not_available", "65536", "-32768 to"),
    "not available, unsigned": (FLOW.replace("}", ", not_available: -1}"), "mass_flow.not_available", "-1", "0 to 65535"),
    "constant unknown": (ANGLE.replace("}", ", constants: {Contol: 1}}"), "plate_target_angle.constants", "Contol", "Control"),
    "constant out of range": (ANGLE.replace("}", ", constants: {Control: -1}}"), "constants.Control", "-1", "0 to 65535"),
    "constant that is bound": (f"{ANGLE}\n    {MODE.replace('}', ', constants: {Position: 1}}')}", "constants.Position",
                               "plate_target_angle", "no quantity"),
    "constant in two ways": (f"{ANGLE.replace('}', ', constants: {Control: 1}}')}\n    "
                             f"{MODE.replace('}', ', constants: {Control: 2}}')}", "command_mode.constants.Control", "2", "1"),
    "shipped identifier": (FLOW.replace("Ours", "LikeMassFlow"), "mass_flow.message", "MassFlow", "outputs.shipped: false"),
    "the network's": (FLOW.replace("Ours", "LikeRequest"), "mass_flow.message", "request", "its own group"),
    "an input's": (f"{ANGLE.replace('Drive', 'Tilt').replace('Position', 'Angle')}\nsignals:\n"
                   "  plate_angle: {dbc: d.dbc, message: Tilt, signal: Angle}",
                   "plate_target_angle.message", "input Tilt", "not taken in"),
    "a bolted plate": (f"{ANGLE}\nplate: {{fixed_angle_deg: 70}}", "target_angle", "plate.fixed_angle_deg", "one of the two"),
}  # fmt: skip


@pytest.fixture
def dbc(tmp_path: Path) -> Path:
    (tmp_path / "d.dbc").write_text(DBC)
    return tmp_path / "d.dbc"


@pytest.mark.parametrize("name", CASES)
def test_one_line_names_the_key(name: str, dbc: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text, *wanted = CASES[name]
    path = dbc.with_name("c.yaml")
    path.write_text(f"outputs:\n  signals:\n    {text}\n")
    assert main(["check-config", str(path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    for part in wanted:
        assert part in line


@pytest.mark.parametrize("text", [FLOW, ANGLE, f"{ANGLE}\n    {MODE}"])
def test_what_is_sent_is_reported(text: str, dbc: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = dbc.with_name("c.yaml")
    path.write_text(f"outputs:\n  signals:\n    {text}\n")
    assert main(["check-config", str(path)]) == 0
    said = capsys.readouterr().out
    for line in text.splitlines():
        assert f"{line.split(':')[0].strip()} goes to " in said
    assert (" kg/s" in said) == ("mass_flow" in text)


def test_signals_are_packed_as_cantools_reads_them(tmp_path: Path) -> None:
    draw = random.Random(7)
    for number in range(60):
        bits, little, signed = draw.randint(2, 32), draw.random() < 0.5, draw.random() < 0.5
        start = draw.randint(0, 64 - bits) if little else draw.choice([7, 15, 23])
        scale, offset = draw.choice([1.0, 0.01, 0.125, -0.5]), draw.choice([0.0, -40.0, 3.5])
        sign = "-" if signed else "+"
        line = f' SG_ S : {start}|{bits}@{int(little)}{sign} ({scale},{offset}) [0|0] "" Node'
        path = tmp_path / f"{number}.dbc"
        path.write_text(f'VERSION ""\nNS_ :\nBS_:\nBU_: Node\nBO_ 100 M: 8 Node\n{line}\n')
        signal = load_messages(path)["M"].signals["S"]
        theirs = cantools.database.load_file(path).get_message_by_name("M")
        packing = Packing(signal, signal.scale, signal.offset, -math.inf, math.inf)
        low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
        for raw in (low, high, draw.randint(low, high), draw.randint(low, high)):
            value = raw * scale + offset
            found = packing.raw(value)
            assert found is not None
            assert theirs.decode(packed(8, False, [(signal, found)]))["S"] == pytest.approx(value)
        for beyond in (low - 1, high + 1):
            assert packing.raw(beyond * scale + offset) is None


def outputs(dbc: Path, *bindings: OutputBinding) -> MappedOutputs:
    made = build(bindings, lambda name: load_messages(dbc if name else shipped("dbc/yieldmon.dbc")), Machine(), default_map())
    return MappedOutputs(made, TotalsSettings())


def command(target: float | object) -> PlateCommand:
    signals = {"TargetPlateAngle": target, "CommandMode": 1, "CommandCounter": 0}
    return PlateCommand((Frame(0.0, "PlateActuatorCommand", signals),))  # type: ignore[arg-type]


def sent(bound: MappedOutputs, *targets: float | object, now_s: float = 0.0) -> list[bytes]:
    return [bytes(item.message.data) for item in bound.take([command(target) for target in targets], Totals(), now_s)]


def test_no_value_is_no_frame_where_the_signal_cannot_say_so(dbc: Path) -> None:
    binding = OutputBinding("here", "plate_target_angle", "d.dbc", "Drive", "Position")
    assert [data[2:4] for data in sent(outputs(dbc, binding), 70.0, NOT_AVAILABLE, -327.69, 40.0)] == [
        (7000).to_bytes(2, "little"), (4000).to_bytes(2, "little")
    ]  # fmt: skip
    for raw in (0x8000, -0x8000):
        said = OutputBinding("here", "plate_target_angle", "d.dbc", "Drive", "Position", not_available=raw)
        assert [data[2:4].hex() for data in sent(outputs(dbc, said), 70.0, NOT_AVAILABLE, 400.0)] == ["581b", "0080", "0080"]


@pytest.mark.parametrize(
    ("values", "not_available", "sent_raw"),
    [({}, 15, [0, 1, 2]), ({0: 4, 1: 5, 2: 6}, 15, [4, 5, 6]), ({0: 4, 2: 6}, 15, [4, 15, 6]), ({1: 5}, 9, [9, 5, 9])],
)
def test_codes_without_a_raw_value_are_sent_as_not_available(
    dbc: Path, values: dict[int, int], not_available: int, sent_raw: list[int]
) -> None:
    angle = OutputBinding("here", "plate_target_angle", "d.dbc", "Drive", "Position")
    mode = OutputBinding("here", "plate_command_mode", "d.dbc", "Drive", "Mode", values=values, not_available=not_available)
    frames = [
        PlateCommand((Frame(0.0, "PlateActuatorCommand", {"TargetPlateAngle": 70.0, "CommandMode": code, "CommandCounter": 0}),))
        for code in range(3)
    ]
    found = [bytes(item.message.data) for item in outputs(dbc, angle, mode).take(frames, Totals(), 0.0)]
    assert [data[4] & 0xF for data in found] == sent_raw


def test_frames_with_a_period_repeat_the_newest_value_until_it_is_old(dbc: Path) -> None:
    binding = OutputBinding("here", "plate_target_angle", "d.dbc", "Drive", "Position", period_s=0.1, not_available=0x8000)
    bound = outputs(dbc, binding)
    assert bound.poll(0.0) == []
    assert sent(bound, 70.0) == []
    times = [0.01 * k for k in range(round(100 * STALE_S) + 50)]
    found = [(at_s, bytes(item.message.data)[2:4].hex()) for at_s in times for item in bound.poll(at_s)]
    assert [at_s for at_s, _ in found] == pytest.approx([0.1 * k for k in range(len(found))], abs=0.011)
    assert {data for at_s, data in found if at_s < STALE_S - 0.01} == {"581b"}
    assert {data for at_s, data in found if at_s > STALE_S + 0.01} == {"0080"}


def test_a_counter_counts_the_frames_that_carry_it(dbc: Path) -> None:
    angle = OutputBinding("here", "plate_target_angle", "d.dbc", "Drive", "Position")
    count = OutputBinding("here", "frame_counter", "d.dbc", "Drive", "Mode")
    found = sent(outputs(dbc, angle, count), *([70.0, NOT_AVAILABLE] * 20))
    assert [data[4] for data in found] == [k % 16 for k in range(20)]


@pytest.mark.parametrize(
    ("value", "expected"),
    [(25.4, 254), (25.5, 255), (25.55, 255), (25.56, 255), (26.0, 255), (-0.0, 0), (-0.04, 0), (math.nan, 255), (-0.06, 255)],
)
def test_what_a_signal_cannot_carry_is_not_available_also_by_rounding(dbc: Path, value: float, expected: int) -> None:
    """25.55 would round to 256; no frame at all was sent then."""
    bits = load_messages(dbc)["Drive"].signals["Small"]
    packing = Packing(bits, 0.1, 0.0, -math.inf, math.inf, not_available=255)
    assert packing.raw(value) == expected


def test_a_counter_begins_anew_where_the_range_of_the_dbc_ends(dbc: Path) -> None:
    """As AUTOSAR's profile 1, which has fifteen values in four bits."""
    lines = dbc.read_text().splitlines()
    place = next(number for number, line in enumerate(lines) if line.strip().startswith("SG_ Mode"))
    lines[place] = re.sub(r"\[[^]]*\]", "[0|14]", lines[place])
    dbc.write_text("\n".join(lines) + "\n")
    angle = OutputBinding("here", "plate_target_angle", "d.dbc", "Drive", "Position")
    count = OutputBinding("here", "frame_counter", "d.dbc", "Drive", "Mode")
    assert [data[4] for data in sent(outputs(dbc, angle, count), *([70.0] * 20))] == [k % 15 for k in range(20)]


@pytest.mark.parametrize(
    ("flow_kg_s", "moisture_pct", "expected"),
    [
        (8.0, 20.0, (200, round(100 * 8.0 * (1.0 - 0.2) / (1.0 - 0.155)))),
        (NOT_AVAILABLE, 20.0, (200, 0xFFFF)),
        (8.0, math.nan, (0xFFFF, 0xFFFF)),
    ],
)
def test_a_second_brings_moisture_and_dry_mass_flow_where_they_are_known(
    dbc: Path, flow_kg_s: float, moisture_pct: float, expected: tuple[int, int]
) -> None:
    """Dry mass is that at the moisture of trade, 15.5 %."""
    bound = outputs(
        dbc,
        OutputBinding("here", "moisture", "d.dbc", "Grain", "Moisture", not_available=0xFFFF),
        OutputBinding("here", "dry_mass_flow", "d.dbc", "Grain", "Dry", not_available=0xFFFF),
    )
    second = WindowResult(window(moisture_pct=moisture_pct), (Frame(0.0, "MassFlow", {"MassFlowRate": flow_kg_s}),))
    (item,) = bound.take([second], Totals(), 0.0)
    assert struct.unpack("<HH", item.message.data) == expected

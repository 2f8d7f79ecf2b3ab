"""What is wrong with a mapping is said in one line: file, key, what was expected."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.signals.layouts import COUNTS, MULTIPLEXED, PROPRIETARY
from yieldmon.cli.main import main
from yieldmon.resources import shipped

IMPACT = "impact_voltage: {dbc: counts.dbc, message: Bridge, signal: Counts, unit: counts, scale: 0.1, rate_hz: 100}"
OVERLAP = COUNTS.dbc.replace("SG_ Counts : 23|16@0+", "SG_ Counts : 15|16@0+")

TWIN = 'BO_ {} {}: 4 Analog\n SG_ X : 0|8@1+ (1,0) [0|0] "deg" Analog\n'
FILES = {
    "other.dbc": COUNTS.dbc.replace("Linear", "Lineal"),
    "twins.dbc": COUNTS.dbc + TWIN.format(801, "Twin"),
    "names.dbc": COUNTS.dbc + TWIN.format(901, "Linear"),
    "grad.dbc": COUNTS.dbc.replace('"deg"', '"Grad"'),
    "beyond.dbc": COUNTS.dbc.replace("SG_ Tilt : 7|", "SG_ Tilt : 15|"),
    "marks.dbc": COUNTS.dbc.replace("BO_ 802 ", "BO_ 1075054137 "),
    "nested.dbc": """VERSION ""
NS_ :
BS_:
BU_: N
BO_ 1024 Nested: 8 N
 SG_ Page M : 0|8@1+ (1,0) [0|0] "" N
 SG_ Sub m1M : 8|8@1+ (1,0) [0|0] "" N
 SG_ Deep m2 : 16|16@1+ (0.1,0) [0|0] "mV" N
SG_MUL_VAL_ 1024 Sub Page 1-1;
SG_MUL_VAL_ 1024 Deep Sub 2-2, 5-6;
""",
}
CASES = {
    "wrong unit": (
        "plate_angle: {dbc: counts.dbc, message: Linear, signal: Tilt, unit: kPa}", "plate_angle.unit", "'kPa'", "deg",
    ),
    "degrees or gradians": (
        "plate_angle: {dbc: counts.dbc, message: Linear, signal: Tilt, unit: grad}",
        "plate_angle.unit", "'grad' (degrees in some languages and gradians of 0.9 degrees in others); expected one of deg",
    ),
    "degrees or gradians in the DBC": (
        "plate_angle: {dbc: grad.dbc, message: Linear, signal: Tilt}",
        "plate_angle.unit", "is 'Grad' in the DBC (degrees in some languages", "expected one of deg",
    ),
    "unit of the DBC": ("plate_angle: {dbc: counts.dbc, message: EEC1, signal: EngineSpeed}", "plate_angle.unit", "'rpm'", "deg"),
    "impact without a unit": (
        "impact_voltage: {dbc: counts.dbc, message: Bridge, signal: Counts, rate_hz: 100}",
        "impact_voltage.unit", "missing", "mV",
    ),
    "counts without a scale": (
        "impact_voltage: {dbc: counts.dbc, message: Bridge, signal: Counts, rate_hz: 100, unit: counts}",
        "impact_voltage.scale", "is missing, or 1; expected", "with unit counts (where it is 1: unit mV)",
    ),
    "a bridge's ratio without a scale": (
        "impact_voltage: {dbc: counts.dbc, message: Bridge, signal: Counts, rate_hz: 100, unit: mV/V}",
        "impact_voltage.scale", "missing", "volts that feed the bridge, with unit mV/V",
    ),
    "unknown message": (IMPACT.replace("Bridge", "Brigde"), "impact_voltage.message", "Brigde", "Bridge"),
    "unknown signal": (IMPACT.replace("signal: Counts", "signal: Count"), "impact_voltage.signal", "Count", "Counts"),
    "half a quantity": ("speed: {value: 70}", "speed", "unknown quantity", "elevator_speed or ground_speed"),
    "unknown quantity": ("plate_angel: {value: 70}", "plate_angel", "unknown quantity", "plate_angle"),
    "unknown key": (IMPACT.replace("rate_hz", "rate"), "impact_voltage.rate", "unknown key", "rate_hz"),
    "valid by no signal": (
        "plate_angle: {dbc: counts.dbc, message: Linear, signal: Tilt, valid: {Tild: 1}}",
        "plate_angle.valid", "Tild is not in", "Tilt",
    ),
    "valid by no raw value": (
        "plate_angle: {dbc: counts.dbc, message: Linear, signal: Tilt, valid: {Tilt: [1, 99999]}}",
        "plate_angle.valid", "99999", "to 65535",
    ),
    "valid by itself": (
        "plate_angle: {dbc: counts.dbc, message: Linear, signal: Tilt, valid: {Tilt: 1}}",
        "plate_angle.valid", "Tilt is the signal itself; expected another signal of the message", "range",
    ),
    "impact valid by itself": (
        IMPACT.replace("}", ", valid: {Counts: 1}}"), "impact_voltage.valid", "Counts is the signal itself", "another signal",
    ),
    "valid by a word": (
        "plate_angle: {dbc: counts.dbc, message: Linear, signal: Tilt, valid: Tilt}",
        "plate_angle.valid", "'Tilt'", "{SpeedValid: 1}",
    ),
    "no rate": (IMPACT.replace(", rate_hz: 100", ""), "impact_voltage.rate_hz", "missing", "10 to 5000"),
    "too slow": (IMPACT.replace("100}", "5}"), "impact_voltage.rate_hz", "5", "10 to 5000"),
    "too fast": (IMPACT.replace("100}", "6000}"), "impact_voltage.rate_hz", "6000", "10 to 5000"),
    "no such file": (IMPACT.replace("counts.dbc", "none.dbc"), "none.dbc", "No such file", "DBC"),
    "multiplexer missing": (
        "plate_angle: {dbc: multiplexed.dbc, message: Everything, signal: Angle}", "plate_angle.mux", "missing", "2",
    ),
    "no multiplexer": (IMPACT.replace("}", ", mux: 3}"), "impact_voltage.mux", "3", "Bridge has no multiplexer"),
    "one signal twice": (
        f"{IMPACT}\n  test_weight: {{dbc: counts.dbc, message: Bridge, signal: Counts}}",
        "test_weight.signal", "impact_voltage", "own",
    ),
    "a source without addresses": (IMPACT.replace("}", ", source: any}"), "impact_voltage.source", "11-bit", "29-bit"),
    "a source that is none": (IMPACT.replace("}", ", source: 300}"), "impact_voltage.source", "300", "0 to 253"),
    "a NAME of 65 bits": (IMPACT.replace("}", ", source: 0x1FFFFFFFFFFFFFFFF}"), "impact_voltage.source", "0x1FF", "253"),
    "an identity of 22 bits": (
        IMPACT.replace("}", ", source: {identity_number: 2097152}}"), "source.identity_number", "2097152", "NAME",
    ),
    "a rate and a spacing": (IMPACT.replace("}", ", spacing_ms: 10}"), "impact_voltage.spacing_ms", "with rate_hz", "one of"),
    "a NAME that is none": (IMPACT.replace("}", ", source: {function: 999}}"), "source.function", "999", "NAME"),
    "a range upside down": (IMPACT.replace("}", ", range: [5, 1]}"), "impact_voltage.range", "5", "smaller first"),
    "a constant that cannot be": ("elevator_speed: {value: -4}", "elevator_speed.value", "-4", "rpm"),
    "volts and newtons": (f"{IMPACT}\n  impact_force: {{dbc: counts.dbc, message: Linear, signal: Tilt, unit: N, rate_hz: 10}}",
                          "signals", "impact_voltage and impact_force", "one of the two"),
    "longer than any transport": (
        "moisture: {dbc: counts.dbc, message: Long, signal: Water}", "moisture.message", "1800 bytes", "at most 1785 bytes",
    ),
    "longer than CAN FD": (
        "moisture: {dbc: counts.dbc, message: Short, signal: Water}", "moisture.message", "80 bytes", "at most 64 bytes",
    ),
    "a text": ("moisture: {dbc: counts.dbc, message: Text, signal: Maker}", "moisture.signal", "80 bits", "within eight bytes"),
    "one signal by two files": (
        "plate_angle: {dbc: counts.dbc, message: Linear, signal: Tilt}\n"
        "  elevator_speed: {dbc: other.dbc, message: Lineal, signal: Tilt, unit: rpm}",
        "elevator_speed.signal", "bound to plate_angle as Linear.Tilt", "own",
    ),
    "one signal from any and from the DBC's any": (
        "elevator_speed: {dbc: proprietary.dbc, message: PropB02, signal: ShaftSpeed}\n"
        "  ground_speed: {dbc: proprietary.dbc, message: PropB02, signal: ShaftSpeed, unit: km/h, source: any}",
        "ground_speed.signal", "bound to elevator_speed", "own",
    ),
    "a counter that is a sample": (IMPACT.replace("}", ", counter: Counts}"), "impact_voltage.signal", "Counts", "own"),
    "one identifier twice": (
        "plate_angle: {dbc: twins.dbc, message: Twin, signal: X}",
        "plate_angle.message", "Bridge and Twin have one identifier", "0x321",
    ),
    "one name twice": (
        "plate_angle: {dbc: names.dbc, message: Linear, signal: X}", "plate_angle.message", "Linear is not in",
        "Linear 0x322, Linear 0x385",
    ),
    "a signal beyond the message": ("plate_angle: {dbc: beyond.dbc, message: Linear, signal: Tilt}", "beyond.dbc", "Tilt", "fit"),
    "more than 29 bits": (
        "plate_angle: {dbc: marks.dbc, message: Linear, signal: Tilt}",
        "marks.dbc", "more than 29 bits", "Linear",
    ),
    "the null address": (
        "elevator_speed: {dbc: counts.dbc, message: EEC1, signal: EngineSpeed, source: 0xFE}",
        "elevator_speed.source", "0xFE", "253",
    ),
    "a NAME's field twice": (
        "elevator_speed: {dbc: counts.dbc, message: EEC1, signal: EngineSpeed, source: {function: 3, function: 4}}",
        "c.yaml:2", "function", "twice",
    ),
    "a quantity twice": (f"{IMPACT}\n  {IMPACT}", "c.yaml:3", "impact_voltage", "twice"),
    "a page that cannot be": (
        "plate_angle: {dbc: multiplexed.dbc, message: Everything, signal: Page, unit: deg, mux: 0x100}",
        "plate_angle.mux", "256", "0 to 255",
    ),
    "another page": (
        "plate_angle: {dbc: multiplexed.dbc, message: Everything, signal: Angle, mux: 1}", "plate_angle.mux", "1", "expected 2",
    ),
    "samples of two pages": (
        "impact_voltage: {dbc: multiplexed.dbc, message: Everything, signals: [Voltage, Angle], mux: 0, rate_hz: 100}",
        "impact_voltage.mux", "0", "Angle",
    ),
    "a page below a page": (
        "impact_voltage: {dbc: nested.dbc, message: Nested, signal: Deep, rate_hz: 100}",
        "impact_voltage.mux", "missing", "2 or 5 or 6", "(Sub)",
    ),
    "a page that does not hold it": (
        "impact_voltage: {dbc: nested.dbc, message: Nested, signal: Deep, rate_hz: 100, mux: [2, 3]}",
        "impact_voltage.mux", "2 or 3", "2 or 5 or 6", "several of them as a list",
    ),
    "no page": (IMPACT.replace("}", ", mux: []}"), "impact_voltage.mux", "[]", "a list of them"),
    "a page below 0": (IMPACT.replace("}", ", mux: [1, -1]}"), "impact_voltage.mux", "-1", "from 0 on"),
    "a factor of 0": (IMPACT.replace("0.1", "0"), "impact_voltage.scale", "0", "other than 0"),
    "a decimal comma": (IMPACT.replace("0.1", '"0,1"'), "impact_voltage.scale", "'0,1'", "number"),
    "a rate with its unit": (IMPACT.replace("100}", "100 Hz}"), "impact_voltage.rate_hz", "100 Hz", "10 to 5000 Hz"),
    "a spacing of no rate": (
        IMPACT.replace("rate_hz: 100", "spacing_ms: 0.1"),
        "impact_voltage.spacing_ms", "0.1", "0.2 to 100 ms",
    ),
    "a range of no angle": (
        "plate_angle: {dbc: counts.dbc, message: Linear, signal: Tilt, range: [500, 900]}", "plate_angle.range", "500", "deg",
    ),
    "raw values that cannot be": (
        "plate_angle: {dbc: counts.dbc, message: Linear, signal: Tilt, not_available: [0x10000]}",
        "plate_angle.not_available", "65536", "-32768 to 65535",
    ),
    "one raw value": (
        "plate_angle: {dbc: counts.dbc, message: Linear, signal: Tilt, not_available: 255}",
        "plate_angle.not_available", "255", "[255]",
    ),
    "a code that is none": (
        "header_down: {dbc: counts.dbc, message: Bridge, signal: Spare, values: {0: 7}}",
        "header_down.values", "7", "cutting height",
    ),
    "codes of an angle": (
        "plate_angle: {dbc: counts.dbc, message: Linear, signal: Tilt, values: {0: 1}}", "plate_angle.values", "0: 1", "states",
    ),
    "a range of pulses": (
        "elevator_speed: {dbc: counts.dbc, message: Bridge, signal: Spare, pulses_per_turn: 60, range: [0, 900]}",
        "elevator_speed.range", "pulses_per_turn", "no such key",
    ),
    "nothing to measure": ("impact_voltage: null", "impact_voltage", "null", "a signal"),
    "no sensor at all": ("impact_voltage: []", "impact_voltage", "an empty list", "at least one"),
    "no angle": ("plate_angle: null", "plate_angle", "null", "plate.fixed_angle_deg"),
    "a constant angle": ("plate_angle: {value: 70}", "plate_angle.value", "70", "plate.fixed_angle_deg"),
    "an elevator that stands": ("elevator_speed: {value: 0}", "elevator_speed.value", "0", "rpm"),
    "the engine's constant speed": ("elevator_speed: {value: 2000, ratio: 0.2}", "elevator_speed.ratio", "together with value"),
    "a constant out of a file": ("elevator_speed: {value: 400, dbc: counts.dbc}", "elevator_speed.dbc", "together with value"),
    "pulses in kilograms": (
        "elevator_speed: {dbc: counts.dbc, message: Bridge, signal: Spare, pulses_per_turn: 60, unit: kg}",
        "elevator_speed.unit", "'kg'", "rpm",
    ),
    **{
        f"{key} of a speed": (
            f"elevator_speed: {{dbc: counts.dbc, message: EEC1, signal: EngineSpeed, {key}: {value}}}",
            f"elevator_speed.{key}", value, "no such key here; it belongs to impact samples",
        )
        for key, value in (("rate_hz", "5"), ("spacing_ms", "1000"), ("time_constant_s", "50"), ("status", "'Spare'"))
    },
    "a speed in the wrong unit": (
        "elevator_speed: {dbc: counts.dbc, message: Linear, signal: Tilt, scale: 0.001, unit: rpm}",
        "elevator_speed.signal", "Tilt as mapped can say -0.23768 to 0.41767 rpm", "250 to 599 rpm of the upper shaft",
        "unit, scale, offset",
    ),
    "a speed with a wrong offset": (
        "elevator_speed: {dbc: counts.dbc, message: EEC1, signal: EngineSpeed, offset: -9000}",
        "elevator_speed.signal", "-9000 to -808.125 rpm", "250 to 599 rpm",
    ),
    "a speed in steps that pass over the useful": (
        "elevator_speed: {dbc: counts.dbc, message: Bridge, signal: Spare, scale: 1000, unit: rpm}",
        "elevator_speed.signal", "0 to 6.5535e+07 rpm", "250 to 599 rpm",
    ),
    "a period of no speed": (
        "elevator_speed: {dbc: counts.dbc, message: Bridge, signal: Spare, unit: s}",
        "elevator_speed.signal", "0.000915541 to 60 rpm", "250 to 599 rpm",
    ),
    "a range of speeds at which nothing is measured": (
        "elevator_speed: {dbc: counts.dbc, message: EEC1, signal: EngineSpeed, range: [600, 3000]}",
        "elevator_speed.range", "[600, 3000]", "250 to 599 rpm",
    ),
    "a plate in grads of another zero": (
        "plate_angle: {dbc: counts.dbc, message: Linear, signal: Tilt, scale: 0.001, unit: deg}",
        "plate_angle.signal", "-0.23768 to 0.41767 deg", "40 to 90 deg",
    ),
    "voltages beyond the cell": (
        IMPACT.replace("}", ", range: [4000, 9000]}"), "impact_voltage.range", "[4000, 9000]", "-4000 to 4000 mV",
    ),
    "forces beyond the cell": (
        "impact_force: {dbc: counts.dbc, message: Bridge, signal: Counts, unit: kN, rate_hz: 100, range: [1800, 9000]}",
        "impact_force.range", "[1800, 9000]", "-1779.2 to 1779.2 N",
    ),
    "an offset beyond the cell": (
        IMPACT.replace("}", ", offset: 8000}"), "impact_voltage.signal", "8000 to 14553.5 mV", "unit, scale and offset",
    ),
    "a voltage too fine to tell grain": (
        IMPACT.replace("0.1", "0.00001"), "impact_voltage.signal", "0 to 0.65535 mV", "apart by 2.25 mV or more",
    ),
    "moisture below nothing": (
        "moisture: {dbc: counts.dbc, message: Bridge, signal: Spare, unit: '%', offset: -99999}",
        "moisture.signal", "-99999 to -34464 %", "what moisture can be",
    ),
    "a filter of an angle": (
        "plate_angle: {dbc: counts.dbc, message: Linear, signal: Tilt, time_constant_s: 0.5}",
        "plate_angle.time_constant_s", "0.5", "impact samples",
    ),
}  # fmt: skip


def said(capsys: pytest.CaptureFixture[str], path: Path) -> str:
    assert main(["check-config", str(path)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    return lines[0]


@pytest.mark.parametrize("name", CASES)
def test_one_line_names_the_key(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text, *wanted = CASES[name]
    COUNTS.write(tmp_path)
    with (tmp_path / "counts.dbc").open("a") as file:
        for head in ("2566849534 Long: 1800", "900 Short: 80"):
            file.write(f'BO_ {head} Analog\n SG_ Water : 160|16@1+ (0.01,0) [0|100] "%" Analog\n')
        file.write('BO_ 2566849790 Text: 20 Analog\n SG_ Maker : 0|80@1+ (1,0) [0|0] "%" Analog\n')
    MULTIPLEXED.write(tmp_path)
    PROPRIETARY.write(tmp_path)
    for file_name, content in FILES.items():
        (tmp_path / file_name).write_text(content)
    path = tmp_path / "c.yaml"
    path.write_text(f"signals:\n  {text}\n")
    line = said(capsys, path)
    for part in wanted:
        assert part in line


@pytest.mark.parametrize(
    ("content", "wanted"),
    [
        (OVERLAP.encode(), "overlap"),
        (COUNTS.dbc.encode("utf-16"), "UTF-16"),
        (b'VERSION "\x81\x8d"\n' + COUNTS.dbc.encode(), "Windows-1252"),
        (b"no DBC at all", "DBC"),
        (b"", "DBC"),
    ],
    ids=["overlapping signals", "another encoding", "no encoding", "no DBC", "empty"],
)
def test_a_dbc_that_cannot_be_used(content: bytes, wanted: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "counts.dbc").write_bytes(content)
    path = tmp_path / "c.yaml"
    path.write_text(f"signals:\n  {IMPACT}\n")
    line = said(capsys, path)
    assert "counts.dbc" in line
    assert wanted in line


def test_each_quantity_s_mistake_has_a_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One was shown, and the next when that was mended."""
    (tmp_path / "counts.dbc").write_bytes(COUNTS.dbc.encode())
    path = tmp_path / "c.yaml"
    speed, angle = "{dbc: counts.dbc, message: Shaft, signal: Tuns}", "{dbc: none.dbc, message: Angle, signal: Deg}"
    wrong = IMPACT.replace("unit: counts", "unit: kN")
    path.write_text(f"signals:\n  {wrong}\n  elevator_speed: {speed}\n  plate_angle: {angle}\n  moisture: {angle}\n")
    assert main(["check-config", str(path)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert [word in line for word, line in zip(("impact_voltage", "elevator_speed", "none.dbc"), lines, strict=True)] == [
        True
    ] * 3


@pytest.mark.parametrize("suffix", ["kcd", "SYM", "arxml"])
def test_a_database_of_another_format_is_told_how_to_become_a_dbc(
    suffix: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / f"counts.{suffix}").write_text("<xml/>")
    path = tmp_path / "c.yaml"
    path.write_text(f"signals:\n  {IMPACT.replace('counts.dbc', f'counts.{suffix}')}\n")
    expected = f"is not a DBC file; expected a DBC file; `cantools convert counts.{suffix} counts.dbc` makes one"
    assert expected in said(capsys, path)


@pytest.mark.parametrize(
    "signals",
    [" SG_ A : 0|16@1+ (1,0) [0|1] \"\" X\n SG_ B : 8|16@1+ (1,0) [0|1] \"\" X\n", ' SG_ A : 56|16@1+ (1,0) [0|1] "" X\n',
     ' SG_ A : 0|16@1+ (0,0) [0|1] "" X\n'],
    ids=["overlapping", "beyond its message", "a factor of 0"],
)  # fmt: skip
def test_a_message_that_nothing_uses_may_contradict_itself(
    signals: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    COUNTS.write(tmp_path)
    with (tmp_path / "counts.dbc").open("a") as file:
        file.write(f"BO_ 1999 Odd: 8 X\n{signals}\n")
    path = tmp_path / "c.yaml"
    path.write_text(f"signals:\n  {IMPACT}\n")
    assert main(["check-config", str(path)]) == 0
    log = tmp_path / "a.log"
    log.write_text("".join(f"({100 + 0.1 * n:.6f}) can0 7CF#0102030405060708\n" for n in range(50)))
    capsys.readouterr()
    assert main(["signals", str(log), "--dbc", str(tmp_path / "counts.dbc")]) == 0
    reported = capsys.readouterr()
    assert "counts.dbc: message ignored: " in reported.err
    assert "Odd" in reported.err or "A has factor 0" in reported.err
    path.write_text(f"signals:\n  {IMPACT.replace('Bridge', 'Odd')}\n")
    assert "signals fit, do not overlap" in said(capsys, path)


@pytest.mark.parametrize(
    "numbers", ["(0,0) [0|1]", "(1e400,0) [0|1]", "(1,1e400) [0|1]", "(1,0) [0|1e400]", f"(1,0) [0|1{'0' * 400}]"]
)
def test_a_dbc_with_numbers_that_are_none(numbers: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "counts.dbc").write_text(COUNTS.dbc.replace("(0.125,0) [0|8031.875]", numbers))
    path = tmp_path / "c.yaml"
    path.write_text(COUNTS.config)
    line = said(capsys, path)
    assert "counts.dbc: EngineSpeed has factor" in line
    assert "factor other than 0" in line


def test_latin_letters_in_a_dbc_are_read_as_makers_write_them(tmp_path: Path) -> None:
    (tmp_path / "counts.dbc").write_bytes(COUNTS.dbc.replace('"deg"', '"°"').encode("cp1252"))
    path = tmp_path / "c.yaml"
    path.write_text(COUNTS.config)
    assert main(["check-config", str(path)]) == 0


def test_a_plate_is_fixed_or_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    COUNTS.write(tmp_path)
    path = tmp_path / "c.yaml"
    path.write_text("plate: {fixed_angle_deg: 70}\nsignals:\n  plate_angle: {dbc: counts.dbc, message: Linear, signal: Tilt}\n")
    assert "plate.fixed_angle_deg" in said(capsys, path)


def test_a_bolted_plate_may_say_that_it_has_no_feedback(tmp_path: Path) -> None:
    path = tmp_path / "y.yaml"
    path.write_text("plate: {fixed_angle_deg: 70}\nsignals: {plate_angle: null, actuator_state: null}\n")
    assert main(["check-config", str(path)]) == 0


@pytest.mark.parametrize("angle_deg", [40, 55, 63, 90, 150])
def test_a_plate_may_be_bolted_on_at_any_angle(angle_deg: float, tmp_path: Path) -> None:
    """The shipped machine's cell is none the worse for a plate on which little presses."""
    path = tmp_path / "c.yaml"
    path.write_text(f"plate: {{fixed_angle_deg: {angle_deg}}}\n")
    assert main(["check-config", str(path)]) == 0


@pytest.mark.parametrize("factor", [1.0 / 9.80665, 1.0, 4.4482216, 9.80665], ids=["kgf", "N", "of pounds", "of kilograms"])
def test_a_cell_in_a_wrong_unit_is_found(factor: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    machine = shipped("config/machines/sprocket-8.yaml").read_text()
    (tmp_path / "machine.yaml").write_text(machine.replace("gain_n_per_mv: 0.4448", f"gain_n_per_mv: {0.4448 * factor:.6g}"))
    path = tmp_path / "c.yaml"
    path.write_text("machine_file: machine.yaml\n")
    if factor == 1.0:
        assert main(["check-config", str(path)]) == 0
    else:
        assert "machine.yaml: sensor: gain_n_per_mv" in said(capsys, path)


@pytest.mark.parametrize(("speed_rpm", "valid"), [(40, False), (249, False), (250, True), (400, True), (599, True), (600, False)])
def test_a_constant_speed_is_one_at_which_flow_is_measured(
    speed_rpm: int, valid: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(f"signals:\n  elevator_speed: {{value: {speed_rpm}}}\n")
    if valid:
        assert main(["check-config", str(path)]) == 0
    else:
        assert f"signals.elevator_speed.value: {speed_rpm}; expected 250 to 599 rpm" in said(capsys, path)


@pytest.mark.parametrize("unit", ["RPM", "U/min", "Rpm", "min^-1"])
def test_a_unit_is_known_however_a_maker_spells_it(unit: str, tmp_path: Path) -> None:
    (tmp_path / "own.dbc").write_text(
        f'VERSION ""\nNS_ :\nBS_:\nBU_: N\nBO_ 300 Shaft: 2 N\n SG_ Turns : 0|16@1+ (0.5,0) [0|0] "{unit}" N\n'
    )
    path = tmp_path / "c.yaml"
    path.write_text("signals:\n  elevator_speed: {dbc: own.dbc, message: Shaft, signal: Turns}\n")
    assert main(["check-config", str(path)]) == 0


def test_what_can_never_measure_is_refused_where_it_would_be_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, log = tmp_path / "c.yaml", tmp_path / "a.log"
    path.write_text("signals:\n  elevator_speed: {value: 40}\n")
    log.write_text("".join(f"({100 + 0.1 * n:.6f}) can0 7CF#0102030405060708\n" for n in range(50)))
    assert main(["process", str(log), "--config", str(path), "--out", str(tmp_path / "o.csv")]) == 2
    assert "signals.elevator_speed.value: 40; expected 250 to 599 rpm" in capsys.readouterr().err

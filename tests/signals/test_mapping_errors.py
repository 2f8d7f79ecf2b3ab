"""What is wrong with a mapping is said in one line: file, key, what was expected."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.signals.layouts import COUNTS, MULTIPLEXED
from yieldmon.cli.main import main

IMPACT = "impact_voltage: {dbc: counts.dbc, message: Bridge, signal: Counts, unit: counts, scale: 0.1, rate_hz: 100}"
OVERLAP = COUNTS.dbc.replace("SG_ Counts : 23|16@0+", "SG_ Counts : 15|16@0+")

CASES = {
    "wrong unit": (
        "plate_angle: {dbc: counts.dbc, message: Linear, signal: Tilt, unit: kPa}", "plate_angle.unit", "'kPa'", "deg",
    ),
    "unit of the DBC": ("plate_angle: {dbc: counts.dbc, message: EEC1, signal: EngineSpeed}", "plate_angle.unit", "'rpm'", "deg"),
    "impact without a unit": (
        "impact_voltage: {dbc: counts.dbc, message: Bridge, signal: Counts, rate_hz: 100}",
        "impact_voltage.unit", "missing", "mV",
    ),
    "counts without a scale": (
        "impact_voltage: {dbc: counts.dbc, message: Bridge, signal: Counts, rate_hz: 100, unit: counts}",
        "impact_voltage.scale", "missing", "millivolts per count",
    ),
    "unknown message": (IMPACT.replace("Bridge", "Brigde"), "impact_voltage.message", "Brigde", "Bridge"),
    "unknown signal": (IMPACT.replace("signal: Counts", "signal: Count"), "impact_voltage.signal", "Count", "Counts"),
    "unknown quantity": ("plate_angel: {value: 70}", "plate_angel", "unknown quantity", "plate_angle"),
    "unknown key": (IMPACT.replace("rate_hz", "rate"), "impact_voltage.rate", "unknown key", "rate_hz"),
    "no rate": (IMPACT.replace(", rate_hz: 100", ""), "impact_voltage.rate_hz", "missing", "10 to 2000"),
    "too slow": (IMPACT.replace("100}", "5}"), "impact_voltage.rate_hz", "5", "10 to 2000"),
    "too fast": (IMPACT.replace("100}", "5000}"), "impact_voltage.rate_hz", "5000", "10 to 2000"),
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
    "nothing to measure": ("impact_voltage: null", "impact_voltage", "null", "a signal"),
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


@pytest.mark.parametrize(
    "numbers", ["(0,0) [0|1]", "(1e400,0) [0|1]", "(1,1e400) [0|1]", "(1,0) [0|1e400]", f"(1,0) [0|1{'0' * 400}]"]
)
def test_a_dbc_with_numbers_that_are_none(numbers: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "counts.dbc").write_text(COUNTS.dbc.replace("(0.125,0) [0|8031.875]", numbers))
    path = tmp_path / "c.yaml"
    path.write_text(f"signals:\n  {IMPACT}\n")
    line = said(capsys, path)
    assert "counts.dbc: EEC1.EngineSpeed" in line
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

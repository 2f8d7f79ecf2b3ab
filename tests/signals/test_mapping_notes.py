"""What is reported about a mapping before it is used."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from yieldmon.cli.main import main
from yieldmon.service.config import configuration
from yieldmon.service.config.mapping_notes import notes

DBC = """\
VERSION ""
BU_: Cell
BO_ 257 CellData: 4 Cell
 SG_ Force0 : 0|16@1- (0.1,0) [0|0] "N" Cell
 SG_ Force1 : 16|16@1- (0.1,0) [0|0] "N" Cell
"""


@pytest.mark.parametrize(("quantity", "unit", "reported"), [("impact_force", "N", True), ("impact_voltage", "mV", False)])
def test_a_force_from_the_bus_says_that_the_gain_of_the_machine_file_does_not_act(
    tmp_path: Path, quantity: str, unit: str, reported: bool
) -> None:
    """The gain that `setup` finds with hung weights would be lost without a word."""
    (tmp_path / "cell.dbc").write_text(DBC)
    binding = f"{{dbc: cell.dbc, message: CellData, signals: [Force0, Force1], rate_hz: 500, unit: {unit}}}"
    (tmp_path / "c.yaml").write_text(f"plate: {{fixed_angle_deg: 70}}\nsignals:\n  {quantity}: {binding}\n")
    found = [note for note in notes(configuration.load(tmp_path / "c.yaml")) if "gain_n_per_mv" in note]
    assert len(found) == reported
    assert all("(0.4448) does not apply to it" in note and "bind impact_voltage with unit: mV" in note for note in found)


OWN_DBC = """\
VERSION ""
BU_: Node
BO_ 2566857045 Analog: 8 Node
 SG_ In1 : {start}|16@{order}+ (1,0) [0|65535] "" Node
"""
PASS_HZ = 12.0
BEYOND = (
    "mV; a cell of 4000 mV (full_scale_mv of the machine file) counts as saturated from there on: look at unit, scale, sign and"
)


def _recording(folder: Path, least: float, most: float, rate_hz: int = 100) -> Path:
    """Counts of paddle passes, big-endian in the first two bytes, on a bus with a frame of a maker's own."""
    rng = np.random.default_rng(5)
    lines = []
    for number in range(20 * rate_hz):
        pulse = max(0.0, math.sin(2.0 * math.pi * PASS_HZ * number / rate_hz))
        counts = round(least + (most - least) * pulse + rng.normal(0.0, 24.0))
        lines.append(f"({1760000000.0 + number / rate_hz:.6f}) can0 18FF2155#{counts:04X}FFFFFFFFFFFF")
        lines.append(f"({1760000000.0 + number / rate_hz:.6f}) can0 1A1#{number % 256:02X}")
    (folder / "d.log").write_text("\n".join(lines) + "\n")
    return folder / "d.log"


@pytest.mark.parametrize(
    ("rate_hz", "order", "least", "most", "scale", "told"),
    [
        (100, (7, 0), 4000, 12000, "0.125", ""),
        (500, (7, 0), 4000, 12000, "0.125", ""),
        (500, (7, 0), 4000, 4000, "0.125", ""),
        (100, (0, 1), 4000, 12000, "0.125", BEYOND),
        (100, (0, 1), 4000, 12000, "-0.05, offset: 1600", BEYOND),
        (500, (0, 1), 4000, 12000, "0.05", "of its range from one sample to the next, as no force does: look at start bit, byte"),
        (100, (7, 0), 4000, 12000, "1.25", BEYOND),
    ],
)
def test_bytes_in_the_wrong_order_and_counts_beyond_the_cell_are_said(
    rate_hz, order, least, most, scale, told: str, tmp_path, capsys
) -> None:
    start, at = order
    (tmp_path / "own.dbc").write_text(OWN_DBC.format(start=start, order=at))
    binding = f"{{dbc: own.dbc, message: Analog, signal: In1, rate_hz: {rate_hz}, unit: counts, scale: {scale}}}"
    (tmp_path / "c.yaml").write_text(
        f"plate: {{fixed_angle_deg: 70}}\nsignals:\n  elevator_speed: {{value: 400}}\n  impact_voltage: {binding}\n"
    )
    log = _recording(tmp_path, least, most, rate_hz)
    assert main(["check-config", str(tmp_path / "c.yaml"), "--log", str(log)]) == 0
    said = [line for line in "".join(capsys.readouterr()).splitlines() if line.startswith("note: impact")]
    assert len(said) == bool(told)
    assert all(told in line for line in said)


def test_where_no_sensor_is_named_the_frames_that_could_be_one_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = _recording(tmp_path, 4000, 12000)
    assert main(["signals", str(log), "--write", str(tmp_path / "m.yaml")]) == 0
    assert "# By their rate these could be one: 0x1A1 (100 Hz), 0x18FF2155 (100 Hz).\n" in (tmp_path / "m.yaml").read_text()
    (tmp_path / "own.dbc").write_text(OWN_DBC.format(start=7, order=0))
    words = ["signals", str(log), "--dbc", str(tmp_path / "own.dbc"), "--write", str(tmp_path / "n.yaml")]
    assert main(words) == 0
    text = (tmp_path / "n.yaml").read_text()
    assert "could be one" not in text
    assert "# The scale is a guess: mV per count (if `setup` was given counts: unit: mV, no scale);" in text


def test_a_guess_is_told_beside_the_first_entry_that_has_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = _recording(tmp_path, 4000, 12000)
    rng = np.random.default_rng(6)
    log.write_text(re.sub("1A1#..", lambda _: f"1A1#{rng.integers(2000, 9000):04X}", log.read_text()))
    in_mv = OWN_DBC.format(start=7, order=0).replace('(1,0) [0|65535] ""', '(0.125,0) [0|8191.875] "mV"')
    (tmp_path / "own.dbc").write_text(in_mv + 'BO_ 417 Board: 2 Node\n SG_ Ch1 : 7|16@0+ (1,0) [0|65535] "" Node\n')
    assert main(["signals", str(log), "--dbc", str(tmp_path / "own.dbc"), "--write", str(tmp_path / "n.yaml")]) == 0
    text = (tmp_path / "n.yaml").read_text()
    first, guess, counts = (text.index(part) for part in ("impact_voltage: {", "# The scale is a guess", "unit: counts"))
    assert first < guess < counts

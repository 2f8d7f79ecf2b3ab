"""A shaft's speed as makers send it, and raw values that a DBC's table says are none: one by one and in blocks."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from yieldmon.cli.main import main
from yieldmon.service.config import configuration
from yieldmon.signals.decoding import MapDecoder

DBC = """\
VERSION ""
BU_: Node
BO_ 256 Shaft: 4 Node
 SG_ Value : 0|{bits}@1+ ({scale},0) [{low}|{high}] "{unit}" Node
"""
RPM = 400.0
PERIOD_S = 0.1


def decoded(folder: Path, dbc: str, binding: str, raws: list[int]) -> list[float]:
    """The speeds of frames 0.1 s apart with these raw values, nan for none."""
    (folder / "shaft.dbc").write_text(dbc, encoding="utf-8")
    entry = f"{{dbc: shaft.dbc, message: Shaft, signal: Value{binding}}}"
    (folder / "c.yaml").write_text(f"plate: {{fixed_angle_deg: 70}}\nsignals: {{elevator_speed: {entry}}}\n", encoding="utf-8")
    signals = configuration.load(folder / "c.yaml").signals
    one_by_one, found = MapDecoder(signals), []
    for number, raw in enumerate(raws):
        (frame,) = one_by_one.decode(PERIOD_S * number, 256, False, raw.to_bytes(4, "little"))
        value = frame.signals["elevator_speed"]
        found.append(value if isinstance(value, float) else math.nan)
    count = len(raws)
    columns = (PERIOD_S * np.arange(count), np.full(count, 256, np.uint32), np.full(count, 4, np.uint8))
    (group,), _ = MapDecoder(signals).decode_block(*columns, np.array(raws, np.uint64))
    assert np.array_equal(group.signals["elevator_speed"], found, equal_nan=True)
    return found


def counts(pulses_per_turn: float, turns_at: int, rpm: float = RPM) -> list[int]:
    return [int(pulses_per_turn * rpm / 60.0 * PERIOD_S * number) % turns_at for number in range(200)]


@pytest.mark.parametrize(
    ("bits", "high", "turns_at"),
    [(8, 255, 256), (8, 0, 256), (8, 250, 251), (8, 250, 256), (16, 9999, 10_000), (4, 14, 15), (32, 4_294_967_295, 1 << 32)],
)
def test_a_counter_of_pulses_turns_where_the_range_ends_unless_it_counts_on(
    bits: int, high: int, turns_at: int, tmp_path: Path
) -> None:
    """J1939 has 251 values in eight bits, and some senders use all 256 whatever their DBC says."""
    pulses_per_turn = 12 if bits > 4 else 3
    dbc = DBC.format(bits=bits, scale=1, low=0, high=high, unit="")
    found = decoded(tmp_path, dbc, f", pulses_per_turn: {pulses_per_turn}", counts(pulses_per_turn, turns_at))
    assert math.isnan(found[0])
    assert found[10:] == pytest.approx([RPM] * 190, rel=1e-9)


def test_a_count_of_pulses_has_the_factor_of_its_dbc(tmp_path: Path) -> None:
    dbc = DBC.format(bits=16, scale=0.5, low=0, high=0, unit="")
    assert decoded(tmp_path, dbc, ", pulses_per_turn: 12", counts(24, 1 << 16))[10:] == pytest.approx([RPM] * 190)


@pytest.mark.parametrize("pulses_per_turn", [1, 2, 3])
def test_a_shaft_with_few_pulses_has_a_speed_that_does_not_leap(pulses_per_turn: int, tmp_path: Path) -> None:
    """With one magnet a speed of half a second was 360 or 480 rpm, as where two nodes send it, and all mass was contested."""
    dbc = DBC.format(bits=16, scale=1, low=0, high=0, unit="")
    raws = counts(pulses_per_turn, 1 << 16, 397.0)
    found = decoded(tmp_path, dbc, f", pulses_per_turn: {pulses_per_turn}", raws + raws[-1:] * 30)
    turning = np.array(found[30:200])
    assert np.ptp(turning) < 50.0
    assert turning.mean() == pytest.approx(397.0, rel=0.005)
    assert found[-1] == 0.0


@pytest.mark.parametrize("bits", [8, 16, 32])
def test_a_counter_that_runs_down_or_to_and_fro(bits: int, tmp_path: Path) -> None:
    """It was no speed, or 4 million rpm."""
    dbc = DBC.format(bits=bits, scale=1, low=0, high=0, unit="")
    falling = [-count % (1 << bits) for count in counts(12, 1 << 32)]
    standing = [(falling[-1] - number % 2) % (1 << bits) for number in range(40)]
    found = decoded(tmp_path, dbc, ", pulses_per_turn: 12", falling + standing)
    assert found[10:200] == pytest.approx([RPM] * 190, rel=1e-9)
    assert max(found[-20:]) <= 50.0


@pytest.mark.parametrize(("pulses_per_turn", "usable"), [(400, True), (500, False)])
def test_a_counter_that_may_turn_twice_between_frames_gives_no_speed(pulses_per_turn: int, usable: bool, tmp_path: Path) -> None:
    """With 500 pulses per turn, 256 values and frames 0.1 s apart 560 rpm were 253 rpm."""
    dbc = DBC.format(bits=8, scale=1, low=0, high=0, unit="")
    found = decoded(tmp_path, dbc, f", pulses_per_turn: {pulses_per_turn}", counts(pulses_per_turn, 256, 560.0))
    assert not np.any(np.isfinite(found)) or usable


@pytest.mark.parametrize(
    ("scale", "unit", "binding", "raw"),
    [
        (1, "us", ", pulses_per_turn: 4", 37_500),
        (1, "µs", ", pulses_per_turn: 4, ratio: 0.5", 18_750),
        (0.01, "ms", ", range: [100, 900]", 15_000),
        (1, "", ", unit: us, pulses_per_turn: 4", 37_500),
        (1, "", ", unit: s, scale: 0.001", 150),
        (0.1, "Hz", ", pulses_per_turn: 60", 4000),
        (0.1, "", ", unit: Hz, pulses_per_turn: 60, ratio: 0.5", 8000),
    ],
)
def test_a_shaft_by_the_time_between_pulses_or_their_frequency(
    scale: float, unit: str, binding: str, raw: int, tmp_path: Path
) -> None:
    dbc = DBC.format(bits=32, scale=scale, low=0, high=0, unit=unit)
    found = decoded(tmp_path, dbc, binding, [raw, 0, 2 * raw])
    standing, other = (0.0, 2.0) if "Hz" in unit + binding else (math.nan, 0.5)
    assert found == pytest.approx([RPM, standing, other * RPM], nan_ok=True)


@pytest.mark.parametrize(
    ("unit", "binding", "problem"),
    [
        ("rpm", ", pulses_per_turn: 60", "pulses_per_turn: Value is in rpm; expected no such key for a speed"),
        ("kg", "", "'kg' in the DBC; expected one of rpm"),
        ("", ", pulses_per_turn: 60, unit: rad/s", "unit: 'rad/s'; expected no unit or rpm, which a counter of pulses becomes"),
    ],
)
def test_what_is_no_shaft_is_refused_in_a_line(
    unit: str, binding: str, problem: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "shaft.dbc").write_text(DBC.format(bits=16, scale=1, low=0, high=0, unit=unit))
    entry = f"{{dbc: shaft.dbc, message: Shaft, signal: Value{binding}}}"
    (tmp_path / "c.yaml").write_text(f"plate: {{fixed_angle_deg: 70}}\nsignals: {{elevator_speed: {entry}}}\n")
    assert main(["check-config", str(tmp_path / "c.yaml")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert problem in line


SOUND = ("No error", "NoFault", "not invalid", "without error", "error-free", "Fehlerfrei", "kein Fehler", "Default")
"""Names of raw values that are measurements."""


@pytest.mark.parametrize(
    ("names", "unusable"),
    [
        ('1022 "Error" 1023 "SNA"', [1022, 1023]),
        ('1023 "Signal not available"', [1023]),
        ('1022 "Sensorfehler" 1023 "ungueltig"', [1022, 1023]),
        ('1022 "Fault" 1023 "Default fault"', [1022, 1023]),
        *((f'0 "{name}" 1000 "Max"', []) for name in SOUND),
    ],
)
def test_a_raw_value_that_the_dbc_names_none_is_none(names: str, unusable: list[int], tmp_path: Path) -> None:
    dbc = DBC.format(bits=10, scale=1, low=0, high=1023, unit="rpm") + f"VAL_ 256 Value {names} ;\n"
    raws = [0, 400, 1022, 1023]
    expected = [math.nan if raw in unusable else float(raw) for raw in raws]
    assert decoded(tmp_path, dbc, "", raws) == pytest.approx(expected, nan_ok=True)


def test_of_a_signed_signal_it_is_named_by_its_number_or_by_its_bits(tmp_path: Path) -> None:
    for named in (-1, 65535):
        dbc = DBC.format(bits=16, scale=1, low=0, high=0, unit="rpm").replace("@1+", "@1-") + f'VAL_ 256 Value {named} "SNA" ;\n'
        assert decoded(tmp_path, dbc, "", [400, 65535]) == pytest.approx([400.0, math.nan], nan_ok=True)

"""A mapping held against a recording: each figure of what was seen, and limits met exactly."""

from __future__ import annotations

import struct
from dataclasses import replace
from math import radians
from pathlib import Path

import numpy as np
import pytest

from yieldmon.errors import InputError
from yieldmon.service.config import configuration
from yieldmon.service.config.configuration import Configuration
from yieldmon.service.config.mapping_notes import notes
from yieldmon.service.logs.mapping_check import RATE_TOLERANCE, problems, remarks
from yieldmon.service.logs.quantities_seen import QuantitySeen, seen_in

DBC = """\
VERSION ""
NS_ :
BS_:
BU_: Cell
BO_ 257 CellData: 4 Cell
 SG_ Volt0 : 0|16@1- (0.1,0) [0|0] "mV" Cell
 SG_ Volt1 : 16|16@1- (0.1,0) [0|0] "mV" Cell
BO_ 2566849793 WideCell: 4 Cell
 SG_ Volt0 : 0|16@1- (0.1,0) [0|0] "mV" Cell
BO_ 258 Shaft: 2 Cell
 SG_ Turns : 0|16@1+ (0.5,0) [0|0] "rpm" Cell
BO_ 259 Short: 8 Cell
 SG_ Flow : 0|16@1+ (0.01,0) [0|600] "kg/s" Cell
 SG_ Whole : 16|32@1+ (0.5,-10) [0|0] "kg" Cell
BO_ 2566898449 Long: 8 Cell
 SG_ Load : 0|16@1+ (1,0) [0|0] "kg" Cell
 SG_ Grain : 16|16@1+ (-0.002,100) [0|0] "%" Cell
 SG_ Number : 32|16@1+ (1,0) [0|0] "" Cell
"""
J1939 = """\
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_ "VFrameFormat" BO_ 2566898449 3;
"""
CELL = "{dbc: own.dbc, message: CellData, signals: [Volt0, Volt1], rate_hz: 500}"
WIDE = "{dbc: own.dbc, message: WideCell, signal: Volt0, rate_hz: 500"
SHAFT = "{dbc: own.dbc, message: Shaft, signal: Turns}"


def load(folder: Path, more: str = "", cell: str = CELL, attributes: str = "") -> Configuration:
    (folder / "own.dbc").write_text(DBC + attributes)
    text = f"plate: {{fixed_angle_deg: 70}}\nsignals:\n  impact_voltage: {cell}\n  elevator_speed: {SHAFT}\n{more}"
    (folder / "c.yaml").write_text(text)
    return configuration.load(folder / "c.yaml")


def log_of(folder: Path, *rows: tuple[float, int, bytes]) -> Path:
    lines = [f"({time_s:.6f}) can0 {identifier:03X}#{data.hex().upper()}" for time_s, identifier, data in sorted(rows)]
    (folder / "a.log").write_text("\n".join(lines) + "\n")
    return folder / "a.log"


def test_what_a_recording_shows_of_each_quantity(tmp_path: Path) -> None:
    """Six frames of two samples 2 ms apart, the last of a frame at its time; one frame of the middle is missing."""
    millivolts = [(10.0, 20.0), (30.0, -5.5), (7.0, 8.0), (9.0, 11.0), (600.5, 12.0), (13.0, 14.0)]
    at_s = [100.0, 100.004, 100.008, 100.016, 100.020, 100.024]
    cell = [
        (time_s, 257, struct.pack("<hh", *(round(10 * mv) for mv in both))) for time_s, both in zip(at_s, millivolts, strict=True)
    ]
    turns = [(100.0, 400.0), (100.1, 30_000.0), (100.35, 410.0), (100.4, 390.5)]
    shaft = [(time_s, 258, struct.pack("<H", round(2 * rpm))) for time_s, rpm in turns]
    seen, incomplete = seen_in(load(tmp_path), log_of(tmp_path, *cell, *shaft))
    assert incomplete == 0
    assert {name for name, entry in seen.items() if entry.values} == {"impact", "elevator_speed"}
    flat = [mv for both in millivolts for mv in both]
    assert seen["impact"].rate_hz == pytest.approx(11 / 0.026, rel=1e-9)
    assert seen["impact"].largest_gap_s == pytest.approx(0.006, rel=1e-6)
    assert seen["impact"].first == pytest.approx(flat[:5])
    impact = replace(seen["impact"], rate_hz=None, largest_gap_s=None, first=())
    assert impact == QuantitySeen("mV", 12, 12, None, -5.5, 600.5, None, (), (-5.5, 600.5))
    assert seen["elevator_speed"].rate_hz == pytest.approx(3 / 0.4, rel=1e-6)
    assert seen["elevator_speed"].largest_gap_s == pytest.approx(0.35, rel=1e-6), "without the one that no elevator turns at"
    speed = replace(seen["elevator_speed"], rate_hz=None, largest_gap_s=None)
    assert speed == QuantitySeen("rpm", 4, 3, None, 390.5, 410.0, None, (400.0, 410.0, 390.5), (390.5, 30_000.0))


def test_one_value_has_no_rate_and_none_at_all_has_no_figure(tmp_path: Path) -> None:
    config = load(tmp_path)
    cell = [(100.0 + 0.004 * k, 257, struct.pack("<hh", 10, 20)) for k in range(3)]
    alone, _ = seen_in(config, log_of(tmp_path, *cell, (100.0, 258, struct.pack("<H", 800))))
    assert alone["elevator_speed"] == QuantitySeen("rpm", 1, 1, None, 400.0, 400.0, None, (400.0,), (400.0, 400.0))
    none, _ = seen_in(config, log_of(tmp_path, *cell))
    assert none["elevator_speed"] == QuantitySeen("rpm", 0, 0, None, None, None, None, (), None)
    ((where, problem, expected),) = problems(config, none, str(tmp_path / "a.log"))
    assert (where, problem, expected) == (f"{tmp_path / 'a.log'}: elevator_speed", "no frame of it", "frames that are mapped")


@pytest.mark.parametrize(
    ("second_rpm", "seconds", "told"), [(None, 20, False), (160.0, 20, True), (160.0, 8, False), (401.0, 20, False)]
)
def test_two_nodes_that_send_one_quantity_are_told(tmp_path: Path, second_rpm: float | None, seconds: int, told: bool) -> None:
    """The mapping passed, and the recording gave 0 kg. Of a second node that speaks for a part of the time only, the daemon says
    it when it comes."""
    config = load(tmp_path)
    cell = [(100.0 + 0.004 * k, 257, struct.pack("<hh", 10, 20)) for k in range(250)]
    shaft = [(100.0 + 0.1 * k, 258, struct.pack("<H", 800 + k % 3)) for k in range(200)]
    if second_rpm is not None:
        shaft += [(100.05 + 0.1 * k, 258, struct.pack("<H", round(2 * second_rpm))) for k in range(10 * seconds)]
    log = log_of(tmp_path, *cell, *shaft)
    seen, _ = seen_in(config, log)
    found = [problem for where, problem, _ in problems(config, seen, str(log)) if where.endswith(": elevator_speed")]
    assert found == (["leaps between 160 and 401 rpm, as if two nodes sent it"] if told else [])


@pytest.mark.parametrize(
    ("counted", "interval_s", "said"),
    [
        (lambda k: 8 * k % 256, 0.02, []),
        (
            lambda k: 200 * k % 256,
            0.8,
            ["a counter of 256 values may turn twice, and is not used: 60 pulses per turn need one every 0.73 s"],
        ),
        (
            lambda k: (40, 41, 40)[k % 3],
            0.1,
            ["pulses counted from 0 in each frame are a frequency: unit Hz, `scale` the frames per"],
        ),
    ],
)
def test_pulses_that_are_no_count_that_goes_on_are_told(counted, interval_s: float, said: list[str], tmp_path: Path) -> None:
    dbc = DBC.replace('Turns : 0|16@1+ (0.5,0) [0|0] "rpm"', 'Turns : 0|8@1+ (1,0) [0|255] ""')
    (tmp_path / "own.dbc").write_text(dbc)
    shaft = SHAFT.replace("}", ", pulses_per_turn: 60}")
    (tmp_path / "c.yaml").write_text(
        f"plate: {{fixed_angle_deg: 70}}\nsignals:\n  impact_voltage: {CELL}\n  elevator_speed: {shaft}\n"
    )
    config = configuration.load(tmp_path / "c.yaml")
    cell = [(100.0 + 0.004 * k, 257, struct.pack("<hh", 10, 20)) for k in range(250)]
    log = log_of(tmp_path, *cell, *((100.0 + interval_s * k, 258, bytes([counted(k), 0])) for k in range(60)))
    seen, _ = seen_in(config, log)
    told = [*remarks(config, seen), *(expected for _, _, expected in problems(config, seen, str(log)))]
    found = [line for line in told if "pulses " in line]
    assert len(found) == len(said)
    assert all(part in line for part, line in zip(said, found, strict=True))


@pytest.mark.parametrize(
    ("count", "said"),
    [
        (lambda k: k % 16, ""),
        (lambda k: k % 15, "impact's counter runs from 0 to 14 and not from 0 to 15: give it the range [0|14] in the DBC"),
        (lambda k: 1 + k % 15, "impact's counter runs from 1 to 15 and not from 0 to 15: leave `counter` out"),
        (
            lambda k: 4 * k % 16,
            "impact's counter goes on by 4 from one frame to the next: it counts no frames, so leave `counter` out",
        ),
        (
            lambda k: (6 * k + k // 30) % 16,
            "impact's counter goes on by 6 from one frame to the next: it counts no frames, so leave",
        ),
        (lambda k: 7, "impact's counter goes on by 0 from one frame to the next: it counts no frames, so leave `counter` out"),
    ],
)
def test_a_counter_that_counts_no_frames_is_told(count, said: str, tmp_path: Path) -> None:
    (tmp_path / "own.dbc").write_text(DBC.replace('Volt1 : 16|16@1- (0.1,0) [0|0] "mV"', 'Count : 16|4@1+ (1,0) [0|15] ""', 1))
    cell = CELL.replace("signals: [Volt0, Volt1]", "signal: Volt0, counter: Count")
    (tmp_path / "c.yaml").write_text(f"plate: {{fixed_angle_deg: 70}}\nsignals:\n  impact_voltage: {cell}\n")
    config = configuration.load(tmp_path / "c.yaml")
    seen, _ = seen_in(
        config, log_of(tmp_path, *((100.0 + 0.002 * k, 257, struct.pack("<hH", k % 9, count(k))) for k in range(300)))
    )
    found = [line for line in remarks(config, seen) if "counter" in line]
    assert len(found) == bool(said)
    assert all(line.startswith(said) for line in found)


@pytest.mark.parametrize(
    ("second", "told"), [((0.0, 900.0), True), ((9.0, 909.0), True), ((0.0, 927.0), False), ((4500.0, 5400.0), False)]
)
def test_one_sensor_in_two_messages_is_told(second: tuple[float, float], told: bool, tmp_path: Path) -> None:
    """Its force counted twice."""
    (tmp_path / "own.dbc").write_text(DBC)
    cells = f"[{CELL}, {WIDE}}}]"
    (tmp_path / "c.yaml").write_text(f"plate: {{fixed_angle_deg: 70}}\nsignals:\n  impact_voltage: {cells}\n")
    config = configuration.load(tmp_path / "c.yaml")
    seen = impact(config)
    seen["impact 2"] = replace(seen["impact"], low=second[0], high=second[1])
    assert any("have the same range, and their forces add up" in line for line in remarks(config, seen)) is told


def impact(config: Configuration, **figures: float) -> dict[str, QuantitySeen]:
    good = QuantitySeen("mV", 9, 9, 500.0, 0.0, 900.0, 0.002, (0.0,), (0.0, 900.0))
    speed = QuantitySeen("rpm", 9, 9, 10.0, 400.0, 400.0, 0.1, (400.0,), (400.0, 400.0))
    return {"impact": replace(good, **figures), "elevator_speed": speed}


@pytest.mark.parametrize(
    ("figures", "found"),
    [
        ({}, ()),
        ({"low": 1.0, "high": 9.0}, ()),
        ({"low": 1.001, "high": 9.0}, ("mV",)),
        ({"low": -9.0, "high": -1.0}, ()),
        ({"low": -9.0, "high": -1.001}, ("mV",)),
        ({"low": -9.0, "high": 9.0}, ()),
        ({"rate_hz": 500.0 * (0.999 + RATE_TOLERANCE)}, ()),
        ({"rate_hz": 500.0 * (1.001 + RATE_TOLERANCE)}, ("samples per second",)),
        ({"rate_hz": 500.0 * (1.001 - RATE_TOLERANCE)}, ()),
        ({"rate_hz": 500.0 * (0.999 - RATE_TOLERANCE)}, ("samples per second",)),
        ({"low": 1.001, "high": 9.0, "rate_hz": 100.0}, ("mV", "samples per second")),
    ],
)
def test_samples_are_held_against_the_cell_and_the_stated_rate(
    figures: dict[str, float], found: tuple[str, ...], tmp_path: Path
) -> None:
    """low, high: in the most that a cell of this machine can say."""
    config = load(tmp_path)
    most_mv = config.engine.windows.plausible_full_scales * config.machine.sensor.full_scale_mv
    scaled = {key: value * most_mv if key in ("low", "high") else value for key, value in figures.items()}
    told = problems(config, impact(config, **scaled), "a.log")
    assert [next(text for text in ("mV", "samples per second") if problem.endswith(text)) for _, problem, _ in told] == list(
        found
    )
    assert all(where == "a.log: impact" for where, _, _ in told)


@pytest.mark.parametrize(
    ("decoded", "told"),
    [((1e9, 2e9), "no usable value: it decodes to 1e+09 to 2e+09 rpm"), ((7.0, 7.0), "no usable value: it decodes to 7 rpm")],
)
def test_values_that_an_input_cannot_have_are_said(decoded: tuple[float, float], told: str, tmp_path: Path) -> None:
    config = load(tmp_path)
    seen = impact(config)
    seen["elevator_speed"] = QuantitySeen("rpm", 9, 0, 10.0, None, None, None, (), decoded)
    ((where, problem, expected),) = problems(config, seen, "a.log")
    assert (where, problem) == ("a.log: elevator_speed", told)
    assert expected == "values that it can have; look at signal, unit, scale, ratio, pulses_per_turn and range"


@pytest.mark.parametrize(
    ("low_deg", "high_deg", "wrong"),
    [(1.22, 1.23, True), (35.1, 35.2, False), (34.0, 34.9, True), (30.0, 70.0, False), (94.9, 95.0, False), (95.1, 96.0, True)],
)
def test_a_plate_that_is_never_at_an_angle_of_the_machine_is_a_mistake(
    low_deg: float, high_deg: float, wrong: bool, tmp_path: Path
) -> None:
    config = load(tmp_path)
    turning = replace(
        config, machine=replace(config.machine, min_plate_angle_rad=radians(40.0), max_plate_angle_rad=radians(90.0))
    )
    seen = impact(config) | {
        "plate_angle": QuantitySeen("deg", 9, 9, 10.0, low_deg, high_deg, 0.1, (low_deg,), (low_deg, high_deg))
    }
    told = problems(turning, seen, "a.log")
    assert [where for where, _, _ in told] == ["a.log: plate_angle"] * wrong
    assert all(expected.startswith("angles from 40 to 90 deg") for _, _, expected in told)


@pytest.mark.parametrize(
    ("name", "unit", "low", "high", "said"),
    [
        ("elevator_speed", "rpm", 6.4, 6.7, True),
        ("elevator_speed", "rpm", 0.0, 400.0, False),
        ("elevator_speed", "rpm", 900.0, 950.0, True),
        ("moisture", "%", 0.14, 0.16, True),
        ("moisture", "%", 0.0, 14.0, False),
    ],
)
def test_what_is_doubtful_is_said(name: str, unit: str, low: float, high: float, said: bool, tmp_path: Path) -> None:
    config = load(tmp_path)
    seen = impact(config) | {name: QuantitySeen(unit, 9, 9, 10.0, low, high, 0.1, (low,), (low, high))}
    told = remarks(config, seen)
    assert len(told) == said
    assert all(text.startswith(f"{name} is never ") for text in told)
    assert problems(config, seen, "a.log") == []


@pytest.mark.parametrize(("width_m", "said"), [(None, 1), (9.1, 0)], ids=["no width", "a width"])
def test_a_speed_without_the_headers_width_gives_no_yield(width_m: float | None, said: int, tmp_path: Path) -> None:
    config = load(tmp_path)
    machine = replace(config.machine, implement=replace(config.machine.implement, working_width_m=width_m))
    seen = impact(config) | {"ground_speed": QuantitySeen("m/s", 9, 9, 10.0, 0.0, 2.1, 0.1, (0.0,), (0.0, 2.1))}
    told = remarks(replace(config, machine=machine), seen)
    assert [("area and yield stay unknown" in text, "working_width_m" in text) for text in told] == [(True, True)] * said


OUTPUTS = """\
outputs:
  signals:
    mass_flow: {dbc: own.dbc, message: Short, signal: Flow, period_ms: 250, range: [0, 500]}
    total_mass: {dbc: own.dbc, message: Short, signal: Whole, period_ms: 250, not_available: 4294967295}
    load_mass: {dbc: own.dbc, message: Long, signal: Load}
    moisture: {dbc: own.dbc, message: Long, signal: Grain}
    load_number: {dbc: own.dbc, message: Long, signal: Number}
"""


SILENT = "; without a value no frame is sent"


@pytest.mark.parametrize(
    ("attributes", "source", "kg", "pct", "silent"),
    [("", "11", 65535, "-31.07", SILENT), (J1939, "xx", 64255, "-28.51", "")],
    ids=["plain", "J1939"],
)
def test_notes_say_where_a_quantity_goes_and_what_it_can_carry(
    attributes: str, source: str, kg: int, pct: str, silent: str, tmp_path: Path
) -> None:
    """Ranges by hand, the smaller of `range` and what the bits hold: 65535 steps of 1 kg and of -0.002 %, 64255 in
    J1939, which has a raw value for what is not known."""
    told = [note for note in notes(load(tmp_path, OUTPUTS, attributes=attributes)) if " goes to " in note]
    assert told == [
        f"mass_flow goes to Short.Flow (0x103), every 250 ms, from 0 to 500 kg/s{SILENT}",
        "total_mass goes to Short.Whole (0x103), every 250 ms, from -10 to 2.14748e+09 kg",
        f"load_mass goes to Long.Load (0x18FFC3{source}), with each new value, from 0 to {kg} kg{silent}",
        f"moisture goes to Long.Grain (0x18FFC3{source}), with each new value, from {pct} to 100 %{silent}",
        f"load_number goes to Long.Number (0x18FFC3{source}), with each new value",
    ]


@pytest.mark.parametrize(
    ("quantity", "keys", "said"),
    [
        ("moisture", "signal: Load, unit: '%'", "moisture is Load in kg, taken as % number for number"),
        ("moisture", "signal: Load, unit: '%', scale: 0.01", None),
        ("moisture", "signal: Grain, unit: '%'", None),
        ("tank_mass", "signal: Load, unit: lb", "tank_mass is Load in kg, taken as lb number for number"),
        ("tank_mass", "signal: Load, unit: lb, scale: 2.2046", None),
        ("tank_mass", "signal: Load, unit: kilogram", None),
        ("tank_mass", "signal: Number, unit: kg", None),
    ],
)
def test_another_unit_than_the_dbcs_is_said(quantity: str, keys: str, said: str | None, tmp_path: Path) -> None:
    told = [
        note for note in notes(load(tmp_path, f"  {quantity}: {{dbc: own.dbc, message: Long, {keys}}}\n")) if quantity in note
    ]
    mend = "leave `unit` out" if quantity == "tank_mass" else "give `scale` and `offset`"
    assert told == ([] if said is None else [f"{said}: if the DBC's unit is right, {mend}"])


@pytest.mark.parametrize(
    ("unit", "keys", "said"),
    [
        (
            "V",
            "unit: mV",
            "impact_voltage is Volt0 in V, taken as mV number for number: if the DBC's unit is right, leave `unit` out",
        ),
        (
            "mV",
            "unit: V",
            "impact_voltage is Volt0 in mV, taken as V number for number: if the DBC's unit is right, leave `unit` out",
        ),
        ("V", "unit: mV, scale: 1000", None),
        ("V", "scale: 1", None),
        ("N", "unit: mV", None),
        ("", "unit: mV", None),
    ],
)
def test_another_unit_of_an_impact_sensor_is_said(unit: str, keys: str, said: str | None, tmp_path: Path) -> None:
    """Volts taken as millivolts gave a valid configuration and no mass."""
    load(tmp_path, cell=CELL)
    (tmp_path / "own.dbc").write_text(DBC.replace('"mV"', f'"{unit}"'))
    path = tmp_path / "c.yaml"
    path.write_text(path.read_text().replace("rate_hz: 500", f"rate_hz: 500, {keys}"))
    assert [note for note in notes(configuration.load(path)) if "number for number" in note] == ([] if said is None else [said])


@pytest.mark.parametrize(("high_mv", "said"), [(1.12, True), (1.13, False)])
def test_an_impact_sensor_that_no_grain_met_is_said(high_mv: float, said: bool, tmp_path: Path) -> None:
    """0.5 N by the shipped gain of 0.4448 N/mV."""
    config = load(tmp_path)
    told = remarks(config, impact(config, low=0.0, high=high_mv))
    assert ["less than any grain's" in note for note in told] == [True] * said


@pytest.mark.parametrize(
    ("floor_mv", "step_mv", "said"),
    [(0.0, 0.1, True), (-4.0, 0.1, True), (-99.0, 0.1, False), (-99.0, 8.0, False)],
    ids=["at the zero", "below the zero", "nowhere", "nowhere, in coarse steps"],
)
def test_an_impact_sensor_whose_vibration_is_cut_off_below_is_said(
    floor_mv: float, step_mv: float, said: bool, tmp_path: Path
) -> None:
    """Noise of 3 mV about 0 between pulses; in the steps of an 8-bit converter most of it is one value, not the lowest."""
    config = load(tmp_path, cell=WIDE.replace("WideCell", "CellData") + "}")
    noise = np.random.default_rng(5).normal(0.0, 3.0, 3000) + np.where(np.arange(3000) % 80 < 10, 60.0, 0.0)
    shown = np.maximum(np.round(noise / step_mv) * step_mv, floor_mv)
    rows = [(1.0 + 0.002 * k, 0x101, struct.pack("<hh", round(10.0 * value), 0)) for k, value in enumerate(shown)]
    told = [note for note in remarks(config, seen_in(config, log_of(tmp_path, *rows))[0]) if "lowest value" in note]
    share = f"{100.0 * np.mean(shown == floor_mv):.0f} %"
    assert [note.split(":")[0] for note in told] == [
        f"impact is at its lowest value, {floor_mv:g} mV, in {share} of its samples"
    ] * said


BITS = {
    "identity_number": 21, "manufacturer_code": 11, "ecu_instance": 3, "function_instance": 5, "function": 8, "vehicle_system": 7,
    "vehicle_system_instance": 4, "industry_group": 3,
}  # fmt: skip
"""Of each field of a NAME (SAE J1939-81)."""


@pytest.mark.parametrize("field", BITS)
def test_fields_of_a_name_take_what_their_bits_hold(field: str, tmp_path: Path) -> None:
    whole = 2 ** BITS[field]
    for value in (0, 1, whole - 1):
        load(tmp_path, cell=f"{WIDE}, source: {{{field}: {value}}}}}")
    for value in (-1, whole):
        with pytest.raises(InputError, match=field):
            load(tmp_path, cell=f"{WIDE}, source: {{{field}: {value}}}}}")


BEYOND = (
    "elevator_speed goes from 400 to 600 rpm, beyond 550 where the DBC's range of Turns ends: raw values that mean none are "
    "`not_available`, or outside `range`"
)
LARGEST = (
    "elevator_speed comes with Turns at its largest raw value, 65535, which is 32767.5 rpm: where that means no value, "
    "not_available: [65535]"
)


@pytest.mark.parametrize(("rpm", "told"), [(500.0, []), (600.0, [BEYOND])])
def test_values_beyond_the_range_of_the_dbc_are_told(rpm: float, told: list[str], tmp_path: Path) -> None:
    config = load(tmp_path)
    (tmp_path / "own.dbc").write_text(DBC.replace('(0.5,0) [0|0] "rpm"', '(0.5,0) [0|550] "rpm"'))
    config = configuration.load(tmp_path / "c.yaml")
    seen = impact(config)
    seen["elevator_speed"] = replace(seen["elevator_speed"], decoded=(400.0, rpm))
    assert [text for text in remarks(config, seen) if "DBC's range" in text] == told


@pytest.mark.parametrize(
    ("raw", "bound", "told"), [(1100, "", []), (65535, "", [LARGEST]), (65535, ", not_available: [65535]", [])]
)
def test_a_largest_raw_value_is_asked_about(raw: int, bound: str, told: list[str], tmp_path: Path) -> None:
    """In a DBC that is not J1939's nothing else says that it means no value."""
    load(tmp_path)
    config = configuration.load(_with(tmp_path / "c.yaml", "signal: Turns", f"signal: Turns{bound}"))
    shaft = [(100.0 + 0.1 * k, 258, struct.pack("<H", raw if k % 2 else 800)) for k in range(40)]
    seen, _ = seen_in(config, log_of(tmp_path, *shaft))
    assert [text for text in remarks(config, seen) if "largest raw value" in text] == told


def test_frames_that_are_shorter_than_the_dbc_says_are_named(tmp_path: Path) -> None:
    config = load(tmp_path)
    cell = [(100.0 + 0.004 * k, 257, b"\x0a\x00\x14") for k in range(250)]
    log = log_of(tmp_path, *cell, *((100.0 + 0.1 * k, 258, struct.pack("<H", 800)) for k in range(10)))
    seen, _ = seen_in(config, log)
    (problem,) = [problem for where, problem, _ in problems(config, seen, str(log)) if where.endswith(": impact")]
    assert problem == "no frame of it: its frames have 3 bytes, the DBC gives it 4"


def _with(path: Path, old: str, new: str) -> Path:
    path.write_text(path.read_text().replace(old, new))
    return path

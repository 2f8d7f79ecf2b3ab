"""The shipped DBC against the vocabulary, and against what stock cantools makes of it."""

from __future__ import annotations

from enum import Enum

import cantools
import pytest

from yieldmon import frames
from yieldmon.bus.layout import error_raw, largest_valid_raw, load_layouts, smallest_not_available_raw
from yieldmon.engine.faults import FaultCode
from yieldmon.errors import InputError
from yieldmon.resources import shipped

DATABASE = cantools.database.load_file(shipped("dbc/yieldmon.dbc"))

#: The signals that outside tools rely on, with their units.
SIGNALS = {
    "ImpactSensorSamples": {**{f"Sample{k}": "mV" for k in range(4)}, "SampleCounter": None, "SensorStatus": None},
    "ElevatorSpeed": {"ElevatorSpeed": "rpm"},
    "PlateActuatorFeedback": {"PlateAngle": "deg", "ActuatorState": None},
    "GrainCondition": {"Moisture": "%", "GrainTemperature": "degC", "TestWeight": "kg/m3"},
    "TankScale": {"TankMass": "kg", "TankScaleStatus": None},
    "PlateActuatorCommand": {"TargetPlateAngle": "deg", "CommandMode": None, "CommandCounter": None},
    "MassFlow": {"MassFlowRate": "kg/s", "MassFlowStdDev": "kg/s", "EstimateQuality": None, "WindowCounter": None},
    "AccumulatedMass": {"LoadMass": "kg", "TotalMass": "kg", "LoadNumber": None},
    "MassStdDev": {"LoadMassStdDev": "kg", "TotalMassStdDev": "kg"},
    "SelfCalibrationStatus": {
        "SweepState": None,
        "SweepProgress": "%",
        "Friction": None,
        "ImpactGain": None,
        "CalibrationAge": "min",
    },
    "YieldMonitorStatus": {"OperatingState": None, **dict.fromkeys(code.value for code in FaultCode)},
    "HarvestState": {"HeaderDown": None, "WorkState": None},
    "GrainTank": {"Unloading": None},
    "GrainKernels": {"ThousandKernelWeight": "g"},
    "VehiclePosition": {"Latitude": "deg", "Longitude": "deg"},
    "VehicleDirectionSpeed": {"CompassBearing": "deg", "NavigationSpeed": "km/h"},
    "ActiveDiagnostics": dict.fromkeys(
        (
            "ProtectLamp",
            "AmberWarningLamp",
            "RedStopLamp",
            "MalfunctionLamp",
            "SuspectParameterLow",
            "FailureMode",
            "SuspectParameterHigh",
            "OccurrenceCount",
            "ConversionMethod",
        )
    ),
}

CODES = {
    ("ImpactSensorSamples", "SensorStatus"): frames.SensorStatus,
    ("PlateActuatorFeedback", "ActuatorState"): frames.ActuatorState,
    ("PlateActuatorCommand", "CommandMode"): frames.CommandMode,
    ("TankScale", "TankScaleStatus"): frames.ScaleStatus,
    ("MassFlow", "EstimateQuality"): frames.EstimateQuality,
    ("SelfCalibrationStatus", "SweepState"): frames.SweepState,
    ("YieldMonitorStatus", "OperatingState"): frames.OperatingState,
    ("HarvestState", "HeaderDown"): frames.HeaderDown,
    ("HarvestState", "WorkState"): frames.WorkState,
    ("GrainTank", "Unloading"): frames.Unloading,
    **{("YieldMonitorStatus", fault): Enum("FaultState", {"OFF": 0, "ON": 1}) for fault in (code.value for code in FaultCode)},
}

#: Physical ranges that a machine needs: (message, signal, smallest, largest, coarsest step).
RANGES = [
    ("ImpactSensorSamples", "Sample0", 0.0, 4000.0, 0.5),
    ("ElevatorSpeed", "ElevatorSpeed", 0.0, 1000.0, 0.125),
    ("PlateActuatorFeedback", "PlateAngle", 0.0, 180.0, 0.01),
    ("GrainCondition", "Moisture", 0.0, 100.0, 0.01),
    ("GrainCondition", "GrainTemperature", -40.0, 100.0, 0.1),
    ("GrainCondition", "TestWeight", 0.0, 2000.0, 0.1),
    ("GrainKernels", "ThousandKernelWeight", 0.0, 2000.0, 0.1),
    ("TankScale", "TankMass", -500.0, 30_000.0, 1.0),
    ("PlateActuatorCommand", "TargetPlateAngle", 0.0, 180.0, 0.01),
    ("MassFlow", "MassFlowRate", 0.0, 60.0, 0.001),
    ("MassFlow", "MassFlowStdDev", 0.0, 60.0, 0.001),
    # A day of 16 h at 100 t/h in one load; 10,000 h of a life at 42 t/h.
    ("AccumulatedMass", "LoadMass", 0.0, 1_600_000.0, 0.1),
    ("AccumulatedMass", "TotalMass", 0.0, 420_000_000.0, 0.1),
    ("MassStdDev", "LoadMassStdDev", 0.0, 100_000.0, 0.01),
    ("MassStdDev", "TotalMassStdDev", 0.0, 10_000_000.0, 0.01),
    ("SelfCalibrationStatus", "SweepProgress", 0.0, 100.0, 0.5),
    ("SelfCalibrationStatus", "Friction", 0.0, 2.0, 0.0001),
    ("SelfCalibrationStatus", "ImpactGain", 0.0, 10.0, 0.001),
    ("SelfCalibrationStatus", "CalibrationAge", 0.0, 365 * 24 * 60, 1.0),
    ("VehiclePosition", "Latitude", -90.0, 90.0, 1e-7),
    ("VehiclePosition", "Longitude", -180.0, 180.0, 1e-7),
    ("VehicleDirectionSpeed", "NavigationSpeed", 0.0, 60.0, 0.01),
]


def test_messages_are_the_vocabulary() -> None:
    assert {message.name for message in DATABASE.messages} == {*frames.INPUTS, *frames.OUTPUTS} == set(SIGNALS)


@pytest.mark.parametrize("message", SIGNALS)
def test_signals_and_units(message: str) -> None:
    found = {signal.name: signal.unit for signal in DATABASE.get_message_by_name(message).signals}
    assert found == SIGNALS[message]


@pytest.mark.parametrize(("message", "signal"), CODES)
def test_value_table_is_the_enumeration(message: str, signal: str) -> None:
    choices = DATABASE.get_message_by_name(message).get_signal_by_name(signal).choices
    table = {raw: str(name) for raw, name in choices.items() if str(name) not in ("SignalError", "SignalNotAvailable")}
    assert table == {code.value: code.name.title().replace("_", "") for code in CODES[message, signal]}
    assert len(choices) == len(table) + 2


def test_every_value_table_has_an_enumeration() -> None:
    lamps = {("ActiveDiagnostics", f"{lamp}Lamp") for lamp in ("Protect", "AmberWarning", "RedStop", "Malfunction")}
    coded = {(message.name, signal.name) for message in DATABASE.messages for signal in message.signals if signal.choices}
    assert coded == set(CODES) | lamps


def test_value_tables_stand_on_unscaled_signals_only() -> None:
    scaled = [s.name for m in DATABASE.messages for s in m.signals if s.choices and (s.scale, s.offset) != (1, 0)]
    assert scaled == []


@pytest.mark.parametrize(("message", "signal", "smallest", "largest", "step"), RANGES)
def test_range_and_resolution(message: str, signal: str, smallest: float, largest: float, step: float) -> None:
    found = DATABASE.get_message_by_name(message).get_signal_by_name(signal)
    assert found.minimum <= smallest
    assert found.maximum >= largest
    assert found.scale <= step


def test_every_message_has_what_a_reader_needs() -> None:
    for message in DATABASE.messages:
        assert message.is_extended_frame
        assert message.length == 8
        assert message.protocol == "j1939"
        assert message.cycle_time, message.name
        assert message.comment, message.name
        assert message.senders, message.name
        assert all(signal.comment and signal.receivers for signal in message.signals), message.name


def test_identifiers_are_j1939() -> None:
    """Own frames in the proprietary-B groups with their node's address; standard groups by their published numbers."""
    addresses = {node.name: node.dbc.attributes["NmStationAddress"].value for node in DATABASE.nodes}
    standard = {"VehiclePosition": 65267, "VehicleDirectionSpeed": 65256, "ActiveDiagnostics": 65226}
    groups = {}
    for message in DATABASE.messages:
        assert message.frame_id & 0xFF == addresses[message.senders[0]], message.name
        groups[message.name] = message.frame_id >> 8 & 0x3FFFF
    assert {name: groups[name] for name in standard} == standard
    own = [group for name, group in groups.items() if name not in standard]
    assert all(0xFF00 <= group <= 0xFFFF for group in own)
    assert len(set(groups.values())) == len(groups)


def test_maximum_is_the_largest_valid_raw_value() -> None:
    """The DBC's own ranges and the J1939 rule in the code say the same, signal by signal."""
    for layout in load_layouts().values():
        message = DATABASE.get_message_by_name(layout.name)
        for signal in layout.signals:
            maximum = message.get_signal_by_name(signal.name).maximum
            assert maximum == pytest.approx(signal.raw_max * signal.scale + signal.offset, rel=1e-9), signal.name


@pytest.mark.parametrize(
    ("bits", "valid", "error", "not_available"),
    [
        # SAE J1939-71 table 1 (1, 2 and 4 bytes) and table 2 (two bits); 13 bits by the leading eight.
        (8, 0xFA, 0xFE, 0xFF),
        (16, 0xFAFF, 0xFE00, 0xFF00),
        (32, 0xFAFFFFFF, 0xFE000000, 0xFF000000),
        (2, 0b01, 0b10, 0b11),
        (4, 0xD, 0xE, 0xF),
        (13, 0x1F5F, 0x1FC0, 0x1FE0),
    ],
)
def test_raw_ranges(bits: int, valid: int, error: int, not_available: int) -> None:
    assert (largest_valid_raw(bits), error_raw(bits), smallest_not_available_raw(bits)) == (valid, error, not_available)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("nonsense", "DBC"),
        ('VERSION ""\nBU_: A\nBO_ 5 M: 8 A\n SG_ S : 0|8@1+ (1,0) [0|0] "" A\n', "11-bit"),
        ('VERSION ""\nBU_: A\nBO_ 2147483653 M: 8 A\n SG_ S : 7|8@0+ (1,0) [0|0] "" A\n', "big-endian"),
        ('VERSION ""\nBU_: A\nBO_ 2147483653 M: 8 A\n SG_ S : 0|8@1- (1,0) [0|0] "" A\n', "signed"),
        ('VERSION ""\nBU_: A\nBO_ 2147483653 M: 64 A\n SG_ S : 0|8@1+ (1,0) [0|0] "" A\n', "64 bytes"),
    ],
)
def test_unusable_dbc_is_an_input_error(tmp_path, text: str, problem: str) -> None:
    path = tmp_path / "other.dbc"
    path.write_text(text)
    with pytest.raises(InputError, match=problem) as caught:
        load_layouts(path)
    assert str(path) in str(caught.value)


def test_missing_dbc_is_an_input_error(tmp_path) -> None:
    with pytest.raises(InputError, match="No such file"):
        load_layouts(tmp_path / "absent.dbc")

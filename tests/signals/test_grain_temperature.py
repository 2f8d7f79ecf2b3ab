"""Grain temperature: from the shipped DBC's message and from a maker's own, into the records of a processed log."""

from __future__ import annotations

import csv
import struct
from pathlib import Path

import can
import pytest

from yieldmon.bus.codec import Codec
from yieldmon.cli.main import main
from yieldmon.frames import NOT_AVAILABLE, Frame, Value

MAKER = """VERSION ""
NS_ :
BS_:
BU_: Probe
BO_ 800 Probe: 2 Probe
 SG_ Temperature : 0|16@1+ (0.01,0) [0|600] "K" Probe
"""
MAPPED = """\
signals:
  grain_temperature: {dbc: maker.dbc, message: Probe, signal: Temperature, unit: degC, offset: -273.15}
"""
BEGIN_S, SECONDS = 1_790_000_000.0, 6


def shipped(at_s: float, value: Value) -> can.Message:
    return Codec().encode(Frame(at_s, "GrainCondition", {"Moisture": 15.0, "GrainTemperature": value, "TestWeight": 720.0}))


def probe(at_s: float, degc: float) -> can.Message:
    return can.Message(
        timestamp=at_s, arbitration_id=800, is_extended_id=False, data=struct.pack("<H", round(100.0 * (degc + 273.15)))
    )


def recorded(folder: Path, conditions: list[can.Message], settings: str, maker: str = MAKER) -> list[str]:
    """The column of the seconds after the first two."""
    log, configuration, codec = folder / "a.log", folder / "y.yaml", Codec()
    configuration.write_text(settings)
    (folder / "maker.dbc").write_text(maker)
    messages = list(conditions)
    for k in range(250 * SECONDS):
        at_s = BEGIN_S + 0.004 * k
        samples: dict[str, Value] = {f"Sample{i}": 150.0 for i in range(4)}
        messages.append(
            codec.encode(Frame(at_s, "ImpactSensorSamples", {**samples, "SampleCounter": k % 256, "SensorStatus": 0}))
        )
        if k % 10 == 0:
            messages.append(codec.encode(Frame(at_s, "ElevatorSpeed", {"ElevatorSpeed": 400.0})))
            messages.append(codec.encode(Frame(at_s, "PlateActuatorFeedback", {"PlateAngle": 70.0, "ActuatorState": 0})))
    with can.CanutilsLogWriter(log) as writer:
        for message in sorted(messages, key=lambda each: each.timestamp):
            message.channel = "can0"
            writer.on_message_received(message)
    assert main(["process", str(log), "--config", str(configuration), "--out", str(folder / "out.csv")]) == 0
    rows = list(csv.DictReader((folder / "out.csv").read_text().splitlines()))
    return [row["grain_temperature_degc"] for row in rows[2:]]


def test_of_the_shipped_message(tmp_path: Path) -> None:
    reported = [shipped(BEGIN_S + 0.5 * k, 21.5) for k in range(2 * SECONDS)]
    found = recorded(tmp_path, reported, "{}")
    assert found
    assert {float(value) for value in found} == {21.5}


@pytest.mark.parametrize("value", [NOT_AVAILABLE, 250.0, -200.0], ids=["not available", "too hot", "too cold"])
def test_a_value_that_cannot_be_true_is_not_recorded(value: Value, tmp_path: Path) -> None:
    reported = [shipped(BEGIN_S + 0.5 * k, value) for k in range(2 * SECONDS)]
    assert set(recorded(tmp_path, reported, "{}")) == {""}


def test_of_a_probe_with_a_dbc_of_its_own(tmp_path: Path) -> None:
    """The maker's is used, and the shipped message, which comes as well, is not."""
    reported = [probe(BEGIN_S + 0.5 * k, 18.25) for k in range(2 * SECONDS)]
    reported += [shipped(BEGIN_S + 0.25 + 0.5 * k, 40.0) for k in range(2 * SECONDS)]
    found = recorded(tmp_path, reported, MAPPED)
    assert found
    assert [float(value) for value in found] == pytest.approx([18.25] * len(found))


@pytest.mark.parametrize("unit", ["K", "degK", "°F", "deg F"])
def test_a_dbc_s_unit_converts_by_itself(unit: str, tmp_path: Path) -> None:
    maker, degc = (MAKER, 18.25) if "K" in unit else (MAKER.replace("(0.01,0) [0|600]", "(0.018,-459.67) [-460|620]"), 18.25)
    reported = [probe(BEGIN_S + 0.5 * k, degc) for k in range(2 * SECONDS)]
    settings = "signals:\n  grain_temperature: {dbc: maker.dbc, message: Probe, signal: Temperature}\n"
    found = recorded(tmp_path, reported, settings, maker.replace('"K"', f'"{unit}"'))
    assert [float(value) for value in found] == pytest.approx([degc] * len(found), abs=1e-6)

"""Factory monitors: PySOBUS's own test vectors, and files that cannot be used."""

from __future__ import annotations

import doctest
import json
from pathlib import Path

import pytest

from yieldmon.bus import factory_monitor
from yieldmon.bus.factory_monitor import FactoryMonitor
from yieldmon.errors import InputError
from yieldmon.network.navigation import Quantity, read
from yieldmon.network.reassembly import Reassembler
from yieldmon.resources import shipped

DATA = Path(__file__).parent.parent / "data" / "factory_flow"
#: PySOBUS's names -> ours.
FLOW_NAMES = {"Grain Flow": "factory_mass_flow", "Grain Moisture": "factory_moisture"}
PLACE_NAMES = {
    "Latitude": (Quantity.LATITUDE, 1.0),
    "Longitude": (Quantity.LONGITUDE, 1.0),
    "Compass Bearing": (Quantity.COURSE, 1.0),
    "Navigation-Based Vehicle Speed": (Quantity.SPEED, 1 / 3.6),
}


def vectors() -> list[tuple[str, dict[str, float] | None]]:
    lines = [line.split("\t") for name in ("jd.txt", "case.txt") for line in (DATA / name).read_text().splitlines()]
    return [(frame, json.loads(values)) for _time, frame, _group, values in lines]


def test_flow_as_pysobus_reads_it() -> None:
    monitor, judged = FactoryMonitor(), 0
    for frame, values in vectors():
        expected = {FLOW_NAMES[k]: v for k, v in (values or {}).items() if k in FLOW_NAMES}
        assert monitor.decode(int(frame[:8], 16), bytes.fromhex(frame[8:])) == pytest.approx(expected)
        judged += len(expected)
    assert judged == 4


def test_position_as_pysobus_reads_it() -> None:
    listener, judged = Reassembler(), 0
    for frame, values in vectors():
        found = {
            r.quantity: r.value
            for payload in listener.feed(int(frame[:8], 16), bytes.fromhex(frame[8:]), 0.0)
            for r in read(payload)
        }
        for name, value in (values or {}).items():
            if name in PLACE_NAMES:
                quantity, factor = PLACE_NAMES[name]
                assert found[quantity] == pytest.approx(value * factor, abs=1e-9)
                judged += 1
    assert judged == 10


@pytest.mark.parametrize(
    ("identifier", "data", "expected"),
    [
        (0x18FF6990, "401F31000305341A", {"factory_mass_flow": 8.0, "factory_moisture": 12.83}),
        (0x18FF6990, "FFFF31000305341A", {"factory_moisture": 12.83}),
        (0x18FF6991, "401F31000305341A", {}),
        (0x18FFD0F0, "401FFFFFFFFFFFFF", {"factory_mass_flow": 8.0}),
        (0x18FFC3A4, "0305401F0000FFFF", {"factory_mass_flow": 8.0, "factory_moisture": 12.83}),
        (0x18FFC3A4, "0305401F", {}),
        (0x10EFFFD3, "4F092003C8040102", {"factory_mass_flow": 8.0, "factory_moisture": 12.24}),
        (0x18EF26D3, "4F092003C8040102", {"factory_mass_flow": 8.0, "factory_moisture": 12.24}),
        (0x10EFFFD3, "50092003C8040102", {}),
        (0x10EFFFD4, "4F092003C8040102", {}),
    ],
)
def test_layouts(identifier: int, data: str, expected: dict[str, float]) -> None:
    assert FactoryMonitor().decode(identifier, bytes.fromhex(data)) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"kg/s"', '"t/h"', "unit 't/h'; expected 'kg/s'"),
        ('"factory_mass_flow"', '"flow"', "quantity 'flow'; expected one of factory_mass_flow, factory_moisture"),
        ("0|16@1+ (0.001", "0|16@1- (0.001", "signed, float or big-endian"),
        ("BO_ ", "BO ", "DBC file"),
    ],
)
def test_files_that_cannot_be_used(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = tmp_path / "mine.dbc"
    path.write_text(shipped("dbc/factory_case.dbc").read_text().replace(old, new))
    with pytest.raises(InputError, match=f"mine.dbc.*{said}"):
        FactoryMonitor([path])


def test_documentation_holds() -> None:
    assert doctest.testmod(factory_monitor).failed == 0

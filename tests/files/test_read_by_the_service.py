"""Files that the service reads as a user of its own: for everybody to read, whatever the umask of whoever wrote them."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from yieldmon.files import flow_curve_file, moisture_file, parameter_file, pulse_shape_file

CURVE = """
estimator: table
format: 1
elevator_speed_rpm: 400
relative_std_dev: 0.03
calibrated_range: {mass_flow_kg_s: [2, 30], elevator_speed_rpm: [350, 450], plate_angle_deg: [60, 70]}
columns: [{plate_angle_deg: 60, force_n: [10, 20], mass_flow_kg_s: [6, 12]}]
"""


def _curve(path: Path) -> None:
    source = path.with_name("source.yaml")
    source.write_text(CURVE)
    flow_curve_file.save(flow_curve_file.load(source), path)


SAVED: dict[str, Callable[[Path], None]] = {
    "parameters": lambda path: parameter_file.save(parameter_file.load(), path),
    "moisture": lambda path: moisture_file.save(moisture_file.load(), path),
    "pulse shape": lambda path: pulse_shape_file.save(pulse_shape_file.load(), path, source="here"),
    "flow curve": _curve,
}


@pytest.fixture(params=[0o022, 0o027, 0o077])
def umask(request: pytest.FixtureRequest) -> Iterator[None]:
    before = os.umask(request.param)
    yield
    os.umask(before)


@pytest.mark.parametrize("kind", SAVED)
def test_for_everybody_to_read(umask: None, kind: str, tmp_path: Path) -> None:
    path = tmp_path / "file.yaml"
    for _ in range(2):
        SAVED[kind](path)
        assert path.stat().st_mode & 0o777 == 0o644
        path.chmod(0o600)  # the second time in the place of one that nobody else could read

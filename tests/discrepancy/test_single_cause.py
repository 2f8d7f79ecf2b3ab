"""What many machines share by a law that is not the library's is named by the one effect whose law it is, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from studies.fleet_diagnosis.__main__ import calibrated, day_of, shown
from yieldmon.files import parameter_file
from yieldmon.fleet.diagnosis import POLICY, FleetDiagnosis, MachineSweeps, diagnose
from yieldmon.physics.machine import Machine

MACHINE, SHIPPED = Machine(), parameter_file.load()
FEW = ("chain_slip", "heap_shape", "miss_capture", "plate_angle_offset", "release_angle", "stream_spread")


def fleet_with(effects: dict[str, dict[str, float]], machines: int = 8) -> list[MachineSweeps]:
    """Machines alike, by the virtual combine's physics: three days of twelve sweeps each."""
    force = shown(MACHINE, effects)
    parameters = calibrated(MACHINE, SHIPPED, force)
    return [
        MachineSweeps(
            f"m{number}", MACHINE, parameters,
            tuple(day_of(MACHINE, force, np.random.default_rng([911, number, day])) for day in range(3)),
        )
        for number in range(machines)
    ]  # fmt: skip


@pytest.fixture(scope="module")
def fanned() -> list[MachineSweeps]:
    """The combine's grain leaves in seven directions evenly over 24 deg, as no law of single tables has it."""
    return fleet_with({"stream_spread": {"half_width_deg": 12.0}})


def found_of(fleet: list[MachineSweeps], monkeypatch: pytest.MonkeyPatch, asked: tuple[str, ...]) -> FleetDiagnosis:
    monkeypatch.setattr("yieldmon.discrepancy.machines.fleet.library", lambda _frame: asked)
    return diagnose(fleet, POLICY)


def test_a_fan_that_is_even_is_a_fan(fanned: list[MachineSweeps], monkeypatch: pytest.MonkeyPatch) -> None:
    found = found_of(fanned, monkeypatch, FEW)
    assert found.shared == "effect"
    assert [item.effect for item in found.model] == ["stream_spread"]
    [sd_rad] = [value for name, value in found.model[0].values.items() if name.endswith("spread_rad")]
    assert np.degrees(sd_rad) == pytest.approx(12.0 / np.sqrt(3.0), rel=0.1)
    assert all(verdict.verdict == "none" for verdict in found.machines)


def test_a_fan_that_is_not_in_the_library_gets_no_others_name(
    fanned: list[MachineSweeps], monkeypatch: pytest.MonkeyPatch
) -> None:
    others = tuple(name for name in FEW if name != "stream_spread")
    found = found_of(fanned, monkeypatch, others)
    assert (found.shared, found.model) == ("unknown", ())

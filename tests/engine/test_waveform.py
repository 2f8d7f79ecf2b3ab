"""The waveform beside the mean force, through the monitor, on the virtual combine's frames."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from yieldmon.engine.monitor import Monitor
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.results import records_in
from yieldmon.engine.settings import EngineSettings, SweepSettings, WaveformSettings
from yieldmon.estimation.channel_combination import combine
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.frames import Frame
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.plant.combine import VirtualCombine
from yieldmon.plant.scenario import from_mapping

MACHINE = Machine()
VALUES = {"friction": 0.2, "density": 1100.0, "shape_ratio": 2.0, "restitution": 0.55, "gravity.acceleration_m_s2": 9.81}
PARAMETERS = ParameterSet(VALUES, ("friction", "density", "restitution"), np.diag([0.02**2, 22.0**2, 0.08**2]))
FLOW_KG_S = 8.0


@cache
def traffic() -> tuple[Frame, ...]:
    pieces = [{"kind": "steady", "duration_s": 12, "flow_kg_s": 0}, {"kind": "steady", "duration_s": 20, "flow_kg_s": FLOW_KG_S}]
    return tuple(VirtualCombine(from_mapping({"duration_s": 26, "flow": {"pieces": pieces}}, "test"), seed=5).frames_until(26.0))


def harvested(**settings: object) -> list[WindowRecord]:
    """Records of the last ten seconds."""
    waveform = replace(WaveformSettings(), **settings)  # type: ignore[arg-type]
    engine = replace(EngineSettings(), sweep=replace(SweepSettings(), enabled=False), waveform=waveform)
    monitor = Monitor(engine, MACHINE, OpenLoop(ForwardModel(MACHINE, PARAMETERS.effects), PARAMETERS))
    return [r for frame in traffic() for r in records_in(monitor.feed(frame))][-10:]


def test_is_off_unless_asked_for_and_then_changes_nothing_else() -> None:
    plain, seen = harvested(), harvested(enabled=True)
    assert all(np.isnan(r.shape_flow_kg_s) and np.isnan(r.kernel_flow_kg_s) for r in plain)
    assert [(r.mass_flow_kg_s, r.mass_kg) for r in seen] == [(r.mass_flow_kg_s, r.mass_kg) for r in plain]


def test_shape_gives_the_flow_beside_the_mean_force() -> None:
    records = harvested(enabled=True)
    flows = np.array([r.shape_flow_kg_s for r in records])
    sds = np.array([r.shape_std_dev_kg_s for r in records])
    assert np.all(np.abs(flows - FLOW_KG_S) < 3.0 * sds)
    assert flows.mean() == pytest.approx(FLOW_KG_S, rel=0.06)
    assert not any(r.faults for r in records)


def test_a_slow_cell_hides_the_kernels() -> None:
    """The virtual combine's 8 ms cell: a thousand-kernel weight is told, and still no flow is published from kernels."""
    assert all(np.isnan(r.kernel_flow_kg_s) for r in harvested(enabled=True, thousand_kernel_weight_g=350.0))


def test_the_switch_counts_and_publishes_both_together() -> None:
    apart, both = harvested(enabled=True), harvested(enabled=True, combine=True)
    for one, other in zip(apart, both, strict=True):
        low, high = sorted((one.mass_kg, one.shape_flow_kg_s * one.duration_s))
        assert 0.97 * low < other.mass_kg < 1.03 * high
    assert [r.mass_kg for r in both] != [r.mass_kg for r in apart]


@pytest.mark.parametrize(("mean_sd", "shape_sd", "nearer"), [(0.10, 0.01, "shape"), (0.01, 0.10, "mean")])
def test_the_combination_leans_on_the_surer(mean_sd: float, shape_sd: float, nearer: str) -> None:
    sure = replace(PARAMETERS, covariance=np.diag([1e-6, 1.0, 1e-6]))
    found = combine(8.0, mean_sd, 9.0, shape_sd, exponent=0.75, parameters=sure)
    assert abs(found.mass_flow_kg_s - (9.0 if nearer == "shape" else 8.0)) < 0.1
    assert found.relative_sd <= min(mean_sd, shape_sd) * 1.01
    assert found.z == pytest.approx(np.log(9.0 / 8.0) / np.hypot(mean_sd, shape_sd), rel=0.02)


def test_without_a_shape_the_mean_force_stands() -> None:
    found = combine(8.0, 0.05, float("nan"), float("nan"), exponent=0.75, parameters=PARAMETERS)
    assert (found.mass_flow_kg_s, found.relative_sd, found.weight) == (8.0, 0.05, 0.0)

"""Effects that the estimators do not know, in the virtual combine, seen by the monitor: covered, or contradicted?"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from yieldmon.engine.faults import FaultCode
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.results import records_in
from yieldmon.engine.settings import EngineSettings, SweepSettings, WaveformSettings
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.plant.combine import VirtualCombine
from yieldmon.plant.scenario import from_mapping

DURATION_S = 75.0
CASES: dict[str, dict[str, Any]] = {
    "none": {},
    "plate friction 0.15": {"effects": {"plate_friction": {"friction": 0.15}}},
    "stream spread 12 deg": {"effects": {"stream_spread": {"half_width_deg": 12.0}}},
    "leakage 0.2": {"effects": {"paddle_leakage": {"share_at_full": 0.2}}},
    "restitution 15 % lower": {"crop": {"restitution": 0.4675}},
    "density 15 % lower": {"crop": {"bulk_density_kg_m3": 935.0}},
}


def harvested(case: dict[str, Any], flow_kg_s: float, seed: int) -> dict[str, Any]:
    """One steady harvest with the estimators' parameters those of the virtual combine without the case."""
    pieces = [{"kind": "steady", "duration_s": 15, "flow_kg_s": 0}, {"kind": "steady", "duration_s": 80, "flow_kg_s": flow_kg_s}]
    scenario = from_mapping({"duration_s": DURATION_S, "flow": {"pieces": pieces}, **case}, "case")
    machine = Machine()
    values = {"friction": 0.2, "density": 1100.0, "shape_ratio": 2.0, "restitution": 0.55, "gravity.acceleration_m_s2": 9.81}
    covariance = np.diag([0.02**2, 22.0**2, 0.08**2])
    parameters = ParameterSet(values, ("friction", "density", "restitution"), covariance)
    settings = replace(
        EngineSettings(), sweep=replace(SweepSettings(), enabled=False), waveform=replace(WaveformSettings(), enabled=True)
    )
    monitor = Monitor(settings, machine, OpenLoop(ForwardModel(machine, parameters.effects), parameters))
    combine = VirtualCombine(scenario, machine=machine, seed=seed)
    records = [r for frame in combine.frames_until(DURATION_S) for r in records_in(monitor.feed(frame))]
    late = [r for r in records if r.time_s > 30.0]
    truth = float(combine.truth.columns["mass_flow_kg_s"][30:].mean())
    mean, shape = (float(np.nanmean([getattr(r, name) for r in late])) for name in ("mass_flow_kg_s", "shape_flow_kg_s"))
    mean_sd, shape_sd = (float(np.nanmean([getattr(r, name) for r in late])) for name in ("std_dev_kg_s", "shape_std_dev_kg_s"))
    return {
        "flow_kg_s": flow_kg_s, "mean_force_error_pct": round(100.0 * (mean / truth - 1.0), 1),
        "mean_force_sd_pct": round(100.0 * mean_sd / mean, 1), "shape_error_pct": round(100.0 * (shape / truth - 1.0), 1),
        "shape_sd_pct": round(100.0 * shape_sd / shape, 1),
        "contradiction": any(FaultCode.WAVEFORM_CONTRADICTS in r.faults for r in late),
    }  # fmt: skip


def report(seed: int) -> list[dict[str, Any]]:
    """A row for each case and flow."""
    return [{"case": name, **harvested(case, flow, seed)} for name, case in CASES.items() for flow in (8.0, 16.0)]

"""What the daemon says of kernel noise behind slow and fast cells: virtual combine with kernels, through the monitor."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from yieldmon.engine.monitor import Monitor
from yieldmon.engine.settings import EngineSettings, SweepSettings, WaveformSettings
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files import pulse_shape_file
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.plant.combine import VirtualCombine
from yieldmon.plant.scenario import from_mapping

CELLS_S = (0.0002, 0.001, 0.003, 0.008)
EMPTY_S, END_S, FLOW_KG_S, KERNELS_G = 20.0, 60.0, 8.0, 350.0
VALUES = {"friction": 0.2, "density": 1100.0, "shape_ratio": 2.0, "restitution": 0.55, "gravity.acceleration_m_s2": 9.81}
PARAMETERS = ParameterSet(VALUES, ("friction", "density", "restitution"), np.diag([0.02**2, 22.0**2, 0.08**2]))


def verdict(response_s: float, seed: int) -> dict[str, Any]:
    """The last window's, after 40 s of grain behind 20 s of the empty machine; weight of kernels told by frames."""
    pieces = [
        {"kind": "steady", "duration_s": EMPTY_S, "flow_kg_s": 0},
        {"kind": "steady", "duration_s": END_S, "flow_kg_s": FLOW_KG_S},
    ]
    scenario = {
        "duration_s": END_S, "flow": {"pieces": pieces}, "kernels": {"thousand_kernel_weight_g": KERNELS_G},
        "frames": {"kernel_weight": True}, "sensor": {"response_s": response_s},
    }  # fmt: skip
    waveform = replace(WaveformSettings(), shape=pulse_shape_file.load(), enabled=True)
    engine = replace(EngineSettings(), sweep=replace(SweepSettings(), enabled=False), waveform=waveform)
    machine = replace(Machine(), sensor=replace(Machine().sensor, response_s=response_s))
    monitor = Monitor(engine, machine, OpenLoop(ForwardModel(machine, PARAMETERS.effects), PARAMETERS))
    for frame in VirtualCombine(from_mapping(scenario, "verdicts"), seed=seed).frames_until(END_S):
        monitor.feed(frame)
    seen = monitor.waveform
    assert seen is not None
    flow = seen.kernels_kg_s
    return {
        "cell_ms": 1e3 * response_s, "verdict": seen.kernels.name.lower(), "says": seen.kernels_reason,
        "flow_kg_s": round(flow, 2) if np.isfinite(flow) else None,
        "sd_kg_s": round(seen.kernels_std_dev_kg_s, 2) if np.isfinite(flow) else None,
    }  # fmt: skip


def report(seed: int) -> list[dict[str, Any]]:
    """A row for each cell; the true flow is 8 kg/s."""
    return [verdict(cell, seed) for cell in CELLS_S]

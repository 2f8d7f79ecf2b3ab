"""What the daemon says of kernel noise behind slow and fast cells: virtual combine with kernels, through the monitor."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from yieldmon.engine.monitor import Monitor
from yieldmon.engine.results import windows_in
from yieldmon.engine.settings import EngineSettings, SweepSettings, WaveformSettings
from yieldmon.engine.waveform.waveform_reading import NOTHING
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files import pulse_shape_file
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.plant.combine import VirtualCombine
from yieldmon.plant.scenario import from_mapping

CELLS_S = (0.0002, 0.001, 0.003, 0.008)
EMPTY_S, END_S, KERNELS_G = 20.0, 80.0, 350.0
FLOWS_KG_S = {"steady": (8.0,), "steps of 5 s": (6.0, 12.0, 9.0, 5.0)}
NOISE_RATIO = 1.12
"""Of kernels in discrete elements, at 1 kHz behind a cell of 0.2 ms (kernels.json)."""
VALUES = {"friction": 0.2, "density": 1100.0, "shape_ratio": 2.0, "restitution": 0.55, "gravity.acceleration_m_s2": 9.81}
PARAMETERS = ParameterSet(VALUES, ("friction", "density", "restitution"), np.diag([0.02**2, 22.0**2, 0.08**2]))


def verdict(response_s: float, flows_kg_s: tuple[float, ...], seed: int) -> dict[str, Any]:
    """The last window's, and the mass of a minute of grain behind 20 s of the empty machine; weight of kernels from frames."""
    step_s = 5.0 * len(flows_kg_s)
    harvest = {"kind": "step", "duration_s": step_s, "flows_kg_s": list(flows_kg_s)}
    pieces = [{"kind": "steady", "duration_s": EMPTY_S, "flow_kg_s": 0}, *[harvest] * round((END_S - EMPTY_S) / step_s)]
    scenario = {
        "duration_s": END_S, "flow": {"pieces": pieces},
        "kernels": {"thousand_kernel_weight_g": KERNELS_G, "noise_ratio": NOISE_RATIO},
        "frames": {"kernel_weight": True}, "sensor": {"response_s": response_s},
    }  # fmt: skip
    waveform = replace(WaveformSettings(), shape=pulse_shape_file.load(), enabled=True)
    engine = replace(EngineSettings(), sweep=replace(SweepSettings(), enabled=False), waveform=waveform)
    machine = replace(Machine(), sensor=replace(Machine().sensor, response_s=response_s))
    monitor = Monitor(engine, machine, OpenLoop(ForwardModel(machine, PARAMETERS.effects), PARAMETERS))
    combine = VirtualCombine(from_mapping(scenario, "verdicts"), seed=seed)
    by_kernels, true_kg_s, seen = 0.0, 0.0, NOTHING
    for frame in combine.frames_until(END_S):
        for window in windows_in(monitor.feed(frame)):
            seen = window.waveform
            if np.isfinite(seen.kernels_kg_s):
                by_kernels += seen.kernels_kg_s
                true_kg_s += float(combine.truth.columns["mass_flow_kg_s"][-1])
    told = by_kernels > 0.0
    return {
        "cell_ms": 1e3 * response_s, "verdict": seen.kernels.name.lower(), "says": seen.kernels_reason,
        "flow_error_pct": round(100.0 * (by_kernels / true_kg_s - 1.0), 1) if told else None,
        "sd_pct": round(100.0 * seen.kernels_std_dev_kg_s / seen.kernels_kg_s, 1) if told else None,
    }  # fmt: skip


def report(seed: int) -> list[dict[str, Any]]:
    """A row for each cell and way to harvest."""
    return [
        {"flow": name, **verdict(cell, flows, seed + number)}
        for name, flows in FLOWS_KG_S.items()
        for cell in CELLS_S
        for number in range(2)
    ]

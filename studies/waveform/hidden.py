"""Effects that the estimators do not know, seen by the monitor: does the shape's deviation cover its error, or is it shown?

Two sources: the virtual combine with an effect more, and trains of discrete-element pulses.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from studies.waveform.fill import MACHINE, histories
from yieldmon import frames
from yieldmon.engine.faults import FaultCode
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.results import windows_in
from yieldmon.engine.settings import EngineSettings, SweepSettings, WaveformSettings
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files import pulse_shape_file
from yieldmon.frames import Frame
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.plant.combine import VirtualCombine
from yieldmon.plant.scenario import from_mapping

EMPTY_S, DURATION_S, LATE_S = 12.0, 55.0, 25.0
FLOWS_KG_S = (10.0,)
CASES: dict[str, dict[str, Any]] = {
    "none": {},
    "plate friction 0.15": {"effects": {"plate_friction": {"friction": 0.15}}},
    "plate friction 0.3": {"effects": {"plate_friction": {"friction": 0.3}}},
    "stream spread 3 deg": {"effects": {"stream_spread": {"half_width_deg": 3.0}}},
    "stream spread 6 deg": {"effects": {"stream_spread": {"half_width_deg": 6.0}}},
    "stream spread 12 deg": {"effects": {"stream_spread": {"half_width_deg": 12.0}}},
    "leakage 0.2": {"effects": {"paddle_leakage": {"share_at_full": 0.2}}},
    "leakage 0.4": {"effects": {"paddle_leakage": {"share_at_full": 0.4}}},
    "restitution 15 % lower": {"crop": {"restitution": 0.4675}},
    "density 15 % lower": {"crop": {"bulk_density_kg_m3": 935.0}},
    "shape ratio 3, not 2": {"crop": {"shape_ratio": 3.0}},
}
WAYS = {"as shipped": (1.0, 0.2), "stretch 1.00 calibrated": (1.0, 0.03)}
"""Stretch and its relative deviation."""


def judged(
    traffic: list[Frame], truth_kg_s: float, machine: Machine, values: dict[str, float], stretch: tuple[float, float]
) -> dict[str, Any]:
    """What the monitor says of one steady harvest, by mean force, shape and both together; None where it gives no flow.

    covered: the shape's error is at most two of its own deviations; silently_wrong: it is not, and no contradiction is shown;
    together_silently_wrong: the same of both together, which `combine` publishes, or of the mean force where these say nothing.
    """
    sd = {"friction": 0.02, "density": 0.02 * values["density"], "restitution": 0.08}
    parameters = ParameterSet(values, tuple(sd), np.diag([v**2 for v in sd.values()]))
    waveform = replace(WaveformSettings(), shape=pulse_shape_file.load(), enabled=True, stretch=stretch[0], stretch_sd=stretch[1])
    settings = replace(EngineSettings(), sweep=replace(SweepSettings(), enabled=False), waveform=waveform)
    monitor = Monitor(settings, machine, OpenLoop(ForwardModel(machine, parameters.effects), parameters))
    windows = [window for frame in traffic for window in windows_in(monitor.feed(frame))]
    latest = [window for window in windows if window.record.time_s > LATE_S]
    late = [window.record for window in latest]

    def mean(name: str) -> float:
        found = np.array([getattr(r, name) for r in late], dtype=float)
        return float(np.nanmean(found)) if np.isfinite(found).any() else float("nan")

    flow, shape = mean("mass_flow_kg_s"), mean("shape_flow_kg_s")
    relative = mean("shape_std_dev_kg_s") / shape
    error = float(np.log(shape / truth_kg_s))
    # As `combine` publishes it: the mean force alone where the channels contradict each other or say nothing.
    by_window = [
        (w.waveform.combined_kg_s, w.waveform.combined_std_dev_kg_s)
        if np.isfinite(w.waveform.combined_kg_s)
        else (w.record.mass_flow_kg_s, w.record.std_dev_kg_s)
        for w in latest
    ]
    together, together_sd = (float(v) for v in np.nanmean(by_window, axis=0))
    wrong = abs(together - truth_kg_s) > 2.0 * together_sd
    shown = any(FaultCode.WAVEFORM_CONTRADICTS in r.faults for r in late)
    agreeing = windows[-1].waveform.stretch
    return {
        "mean_force_error_pct": _pct(flow / truth_kg_s - 1.0), "mean_force_sd_pct": _pct(mean("std_dev_kg_s") / flow),
        "shape_error_pct": _pct(shape / truth_kg_s - 1.0), "shape_sd_pct": _pct(relative),
        "together_error_pct": _pct(together / truth_kg_s - 1.0), "together_sd_pct": _pct(together_sd / together),
        "covered": bool(abs(error) <= 2.0 * relative) if np.isfinite(error) else None, "contradiction": shown,
        "silently_wrong": bool(np.isfinite(error) and abs(error) > 2.0 * relative and not shown),
        "together_silently_wrong": bool(wrong and not shown),
        "stretch_by_mean_force": round(agreeing, 3) if np.isfinite(agreeing) else None,
    }  # fmt: skip


def _pct(value: float) -> float | None:
    return round(100.0 * value, 1) if np.isfinite(value) else None


def virtual_combine(seed: int) -> Iterator[dict[str, Any]]:
    """Parameters are those of the virtual combine without the effect."""
    values = {"friction": 0.2, "density": 1100.0, "shape_ratio": 2.0, "restitution": 0.55, "gravity.acceleration_m_s2": 9.81}
    for name, case in CASES.items():
        for flow in FLOWS_KG_S:
            pieces = [
                {"kind": "steady", "duration_s": EMPTY_S, "flow_kg_s": 0},
                {"kind": "steady", "duration_s": DURATION_S, "flow_kg_s": flow},
            ]
            scenario = from_mapping({"duration_s": DURATION_S, "flow": {"pieces": pieces}, **case}, "case")
            combine = VirtualCombine(scenario, machine=Machine(), seed=seed)
            traffic = list(combine.frames_until(DURATION_S))
            truth = float(combine.truth.columns["mass_flow_kg_s"][int(LATE_S) :].mean())
            for way, stretch in WAYS.items():
                yield {"hidden": name, "flow_kg_s": flow, "way": way, **judged(traffic, truth, Machine(), values, stretch)}


def dem_traffic(load_kg: float, rpm: float, friction: float, angle_deg: float, seed: int) -> list[Frame]:
    """A train of one discrete-element pulse, 7 % scatter of its size, cell of 8 ms, 3 mV of noise; empty at first."""
    history = histories()[rpm, friction, load_kg, angle_deg]
    rng = np.random.default_rng([seed, int(1000 * load_kg), int(rpm), int(100 * friction), int(angle_deg)])
    count = round(DURATION_S * 1000.0)
    force = np.zeros(count + 2000)
    every_s = MACHINE.paddle_spacing_m / MACHINE.paddle_speed_m_s(rpm * RPM)
    for start in np.arange(EMPTY_S, DURATION_S, every_s):
        place = start + history[:, 0]
        low = np.floor(1000.0 * place).astype(int)
        share = 1000.0 * place - low
        size = 1.0 + 0.07 * rng.standard_normal()
        np.add.at(force, low, size * (1.0 - share) * history[:, 1])
        np.add.at(force, low + 1, size * share * history[:, 1])
    frequency = np.fft.rfftfreq(force.size, 1e-3)
    felt = np.fft.irfft(np.fft.rfft(force) / (1.0 + 2j * np.pi * frequency * 0.008) ** 2, force.size)[:count]
    samples_mv = 500.0 + felt / MACHINE.sensor.gain_n_per_mv + 3.0 * rng.standard_normal(count)
    out = []
    for number, four in enumerate(np.maximum(samples_mv, 0.0).reshape(-1, 4)):
        at_s = 0.004 * number + 0.004
        volts = {f"Sample{k}": float(v) for k, v in enumerate(four)}
        out.append(Frame(at_s, frames.IMPACT_SENSOR_SAMPLES, {**volts, "SampleCounter": number % 256, "SensorStatus": 0}))
        if number % 25 == 0:
            out.append(Frame(at_s, frames.ELEVATOR_SPEED, {"ElevatorSpeed": rpm}))
        if number % 12 == 0:
            out.append(Frame(at_s, frames.PLATE_ACTUATOR_FEEDBACK, {"PlateAngle": angle_deg, "ActuatorState": 0}))
    return out


def discrete_elements(seed: int) -> Iterator[dict[str, Any]]:
    """Gain of the mean force and stretch are calibrated at 0.9 kg, 400 rpm, home; then load, speed and friction differ."""
    values = {"friction": 0.3, "density": 710.0, "shape_ratio": 2.9, "restitution": 0.3, "gravity.acceleration_m_s2": 9.81}
    home = (0.9, 400.0, 0.3, 70.0)
    traffic = dem_traffic(*home, seed)
    model = ForwardModel(MACHINE, ("gravity",))
    history = histories()[home[1], home[2], home[0], home[3]]
    impulse = float(history[:, 1].sum() * 1e-3)
    expected = float(model.paddle_momentum(Conditions(np.deg2rad(70.0), 400.0 * RPM, paddle_mass_kg=np.array(0.9)), values))
    values["restitution"] = (1.0 + values["restitution"]) * impulse / expected - 1.0
    first = judged(traffic, _flow(*home[:2]), MACHINE, values, (1.0, 0.2))
    found = float(first["stretch_by_mean_force"])
    for load, rpm, friction, angle in (
        home, (0.5, 400.0, 0.3, 70.0), (1.3, 400.0, 0.3, 70.0), (0.9, 400.0, 0.15, 70.0), (0.5, 400.0, 0.15, 70.0),
        (1.3, 400.0, 0.15, 70.0), (0.9, 500.0, 0.3, 70.0), (1.3, 500.0, 0.3, 70.0), (0.2, 400.0, 0.3, 70.0),
        (1.8, 400.0, 0.3, 70.0),
    ):  # fmt: skip
        traffic = dem_traffic(load, rpm, friction, angle, seed)
        for way, stretch in {"as shipped": (1.0, 0.2), f"stretch {found:.2f} calibrated": (found, 0.03)}.items():
            row = judged(traffic, _flow(load, rpm), MACHINE, values, stretch)
            yield {"load_kg": load, "rpm": rpm, "friction": friction, "angle_deg": angle, "way": way, **row}


def _flow(load_kg: float, rpm: float) -> float:
    return load_kg * MACHINE.paddle_speed_m_s(rpm * RPM) / MACHINE.paddle_spacing_m


def report(seed: int) -> dict[str, Any]:
    """Both tables, and how many places are silently wrong."""
    tables = {"virtual_combine": list(virtual_combine(seed)), "discrete_elements": list(discrete_elements(seed))}
    kinds = ("silently_wrong", "together_silently_wrong")
    silent = {k: {name: f"{sum(r[k] for r in rows)} of {len(rows)}" for name, rows in tables.items()} for k in kinds}
    return {**silent, **tables}

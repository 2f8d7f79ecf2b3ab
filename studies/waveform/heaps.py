"""Heaps of another cross-section than the one that was calibrated, through the monitor: covered as published, or shown?

Slide, throw, plate and cell are this module's own. The machine is calibrated at each flow on a wedge: gain so that the mean
force is right, stretch as `status` says it. Then the cross-section, or the scatter of the stream, is another.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yieldmon import frames
from yieldmon.engine.faults import FaultCode
from yieldmon.engine.monitor import Monitor
from yieldmon.engine.results import WindowResult, windows_in
from yieldmon.engine.settings import EngineSettings, SweepSettings, WaveformSettings
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files import pulse_shape_file
from yieldmon.frames import Frame
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel

Array = NDArray[np.float64]
LENGTH_M, WIDTH_M, SPROCKET_M, GAPS_M = 0.16, 0.21, 0.0541, (0.1656, 0.2071)
PLATE_X_M, PLATE_Y_M, PLATE_M, PLATE_RAD = 0.4, -0.16, 0.1887, float(np.deg2rad(70.0))
RPM, SPEED_RAD_S, FRICTION, DENSITY, RESTITUTION, CELL_S = 400.0, 400.0 * np.pi / 30.0, 0.2, 1100.0, 0.55, 0.008
G_M_S2, STEP_S, GRAINS, EMPTY_S = 9.81, 1e-4, 8000, 12.0


@dataclass(frozen=True)
class Stream:
    """heap: "wedge", "round" (its surface is the wedge's to the power of `place`), "layer" (from the radius `place` of the
    paddle's length to the tip) or "ridge" (a roof of half width 0.3 about that radius). ratio: opening angle of the wedge at the
    tip over its depth. direction_sd_deg, speed_sd: scatter of the grain as it leaves the tip."""

    heap: str = "wedge"
    place: float = 0.35
    ratio: float = 2.0
    direction_sd_deg: float = 0.0
    speed_sd: float = 0.0


WEDGE = Stream()
CASES = {
    "nothing": WEDGE,
    "h_f 3, 2 calibrated": Stream(ratio=3.0),
    "surface bent outwards": Stream("round", 0.5),
    "surface bent inwards": Stream("round", 2.0),
    "direction of grain scatters by 6 deg": Stream(direction_sd_deg=6.0),
    "by 10 deg": Stream(direction_sd_deg=10.0),
    "speed of grain scatters by 10 %": Stream(speed_sd=0.1),
    "layer from 0.35 of the paddle": Stream("layer", 0.35),
    "layer from 0.6": Stream("layer", 0.6),
    "ridge about 0.85": Stream("ridge", 0.85),
    "ridge about 0.7": Stream("ridge", 0.7),
    "ridge about 0.6": Stream("ridge", 0.6),
}
FLOWS_KG_S = (4.0, 8.0, 14.0)


def _grain(stream: Stream, share: float) -> tuple[Array, Array]:
    """Radius over the paddle's length and angle ahead of the paddle; share: mass over density, width and squared length."""
    rho = (np.arange(4000) + 0.5) / 4000.0
    if stream.heap == "layer":
        ahead = np.where(rho > stream.place, share / ((1.0 - stream.place) * rho), 0.0)
    elif stream.heap == "ridge":
        ahead = np.maximum(0.0, 1.0 - np.abs(rho - stream.place) / 0.3) / rho
        ahead = ahead * share / (ahead * rho).mean()
    else:
        power = stream.place if stream.heap == "round" else 1.0
        low, high = 0.0, 1.0
        for _ in range(50):
            inner = 0.5 * (low + high)
            depth = 1.0 - inner
            ahead = stream.ratio * depth * (np.maximum(rho - inner, 0.0) / depth) ** power
            low, high = (inner, high) if (ahead * rho).mean() > share else (low, inner)
    whole = np.cumsum(ahead * rho)
    radius = np.interp((np.arange(GRAINS) + 0.5) / GRAINS, whole / whole[-1], rho)
    return radius, np.interp(radius, rho, ahead) * (np.arange(GRAINS) * 0.6180339887498949 % 1.0)


def _thrown(rho: Array, ahead: Array, stream: Stream, rng: np.random.Generator) -> tuple[Array, Array]:
    """Time of arrival after the paddle points up, s, and level impulse per mass, m/s; 0 for what misses the plate."""
    pull, turn, step = G_M_S2 / (LENGTH_M * SPEED_RAD_S**2), 0.0, 0.004
    left, speed, gone = np.zeros(rho.size), np.zeros(rho.size), np.zeros(rho.size, dtype=bool)
    out_speed = speed.copy()
    while turn < 3.5 and not gone.all():
        angle = 1.5 * np.pi + turn
        rate = rho - 2.0 * FRICTION * speed + pull * (np.sin(angle) + FRICTION * np.cos(angle))
        middle = speed + 0.5 * step * rate
        half = rho + 0.5 * step * speed
        rate = half - 2.0 * FRICTION * middle + pull * (np.sin(angle + 0.5 * step) + FRICTION * np.cos(angle + 0.5 * step))
        further, faster = rho + step * middle, speed + step * rate
        now = ~gone & (further >= 1.0)
        part = np.where(now, (1.0 - rho) / np.maximum(further - rho, 1e-12), 0.0)
        left, out_speed = np.where(now, turn + part * step, left), np.where(now, speed + part * (faster - speed), out_speed)
        gone, rho, speed, turn = gone | now, further, faster, turn + step
    sin, cos, tip = np.sin(1.5 * np.pi + left), np.cos(1.5 * np.pi + left), LENGTH_M * SPEED_RAD_S
    x, y, vx, vy = LENGTH_M * cos, LENGTH_M * sin, tip * (out_speed * cos - sin), tip * (out_speed * sin + cos)
    off_rad, size = (
        np.deg2rad(stream.direction_sd_deg) * rng.standard_normal(x.size),
        1.0 + stream.speed_sd * rng.standard_normal(x.size),
    )
    vx, vy = size * (vx * np.cos(off_rad) - vy * np.sin(off_rad)), size * (vx * np.sin(off_rad) + vy * np.cos(off_rad))
    nx, ny = np.sin(PLATE_RAD), -np.cos(PLATE_RAD)
    into, off = vx * nx + vy * ny, (x - PLATE_X_M) * nx + (y - PLATE_Y_M) * ny
    flight = -2.0 * off / (into + np.sqrt(np.maximum(into**2 - 2.0 * G_M_S2 * ny * off, 0.0)))
    hit_x, hit_y = x + vx * flight - PLATE_X_M, y + vy * flight + 0.5 * G_M_S2 * flight**2 - PLATE_Y_M
    hits = gone & (into > 0.0) & (hit_x * np.cos(PLATE_RAD) + hit_y * np.sin(PLATE_RAD) <= PLATE_M)
    push = (1.0 + RESTITUTION) * np.maximum(into + G_M_S2 * flight * ny, 0.0) * np.sin(PLATE_RAD)
    return left / SPEED_RAD_S + flight - ahead / SPEED_RAD_S, np.where(hits, push, 0.0)


def traffic(stream: Stream, flow_kg_s: float, duration_s: float, seed: int) -> list[Frame]:
    """Frames of a steady harvest after 12 s of an empty machine."""
    rng, speed = np.random.default_rng(seed), SPEED_RAD_S * SPROCKET_M
    count = round(1000.0 * duration_s)
    force, pulses = np.zeros(10 * count + 20_000), []
    for gap in GAPS_M:
        load_kg = flow_kg_s * gap / speed
        when, push = _thrown(*_grain(stream, load_kg / (DENSITY * WIDTH_M * LENGTH_M**2)), stream, rng)
        places = ((when + 0.1) / STEP_S).astype(int)
        pulses.append(np.bincount(places[push > 0.0], push[push > 0.0] * load_kg / GRAINS, 4000)[:4000] / STEP_S)
    place_s, number = EMPTY_S, 0
    while place_s < duration_s - 0.5:
        at = round((place_s - 0.1) / STEP_S)
        force[at : at + 4000] += pulses[number % 2] * (1.0 + 0.07 * rng.standard_normal())
        number += 1
        place_s += GAPS_M[number % 2] / speed
    turns = 2j * np.pi * np.fft.rfftfreq(force.size, STEP_S)
    felt = np.fft.irfft(np.fft.rfft(force) / (1.0 + turns * CELL_S) ** 2, force.size)[: 10 * count].reshape(-1, 10).mean(axis=1)
    samples_mv = np.maximum(500.0 + felt / 0.4448 + 3.0 * rng.standard_normal(count), 0.0)
    out = []
    for four, volts in enumerate(samples_mv.reshape(-1, 4)):
        at_s = 0.004 * (four + 1)
        named = {f"Sample{k}": float(v) for k, v in enumerate(volts)}
        out.append(Frame(at_s, frames.IMPACT_SENSOR_SAMPLES, {**named, "SampleCounter": four % 256, "SensorStatus": 0}))
        if four % 25 == 0:
            out.append(Frame(at_s, frames.ELEVATOR_SPEED, {"ElevatorSpeed": RPM}))
        if four % 12 == 0:
            out.append(Frame(at_s, frames.PLATE_ACTUATOR_FEEDBACK, {"PlateAngle": np.rad2deg(PLATE_RAD), "ActuatorState": 0}))
    return out


MACHINE = Machine()
VALUES = {
    "friction": FRICTION,
    "density": DENSITY,
    "shape_ratio": 2.0,
    "restitution": RESTITUTION,
    "gravity.acceleration_m_s2": 9.81,
}


def known(restitution: float) -> ParameterSet:
    """What the monitor knows of the grain."""
    values = {**VALUES, "restitution": restitution}
    return ParameterSet(values, ("friction", "density", "restitution"), np.diag([0.02**2, 22.0**2, 0.02**2]))


def seen(traffic: list[Frame], parameters: ParameterSet, stretch: tuple[float, float]) -> list[WindowResult]:
    """What a monitor that publishes all channels together says of the last windows, when a fault has had its time to be shown."""
    waveform = replace(
        WaveformSettings(), shape=pulse_shape_file.load(), enabled=True, combine=True, stretch=stretch[0], stretch_sd=stretch[1]
    )
    settings = replace(EngineSettings(), sweep=replace(SweepSettings(), enabled=False), waveform=waveform)
    monitor = Monitor(settings, MACHINE, OpenLoop(ForwardModel(MACHINE, parameters.effects), parameters))
    windows = [window for frame in traffic for window in windows_in(monitor.feed(frame))]
    return [window for window in windows if window.record.time_s > 47.0]


def calibrated(flow_kg_s: float, seed: int) -> tuple[ParameterSet, tuple[float, float]]:
    """Parameters and stretch with which the wedge is right at a flow."""
    parameters, frames_ = known(RESTITUTION), traffic(WEDGE, flow_kg_s, 52.0, seed)
    for _ in range(4):
        windows = seen(frames_, parameters, (1.0, 0.2))
        off = float(np.mean([w.waveform.mean_kg_s for w in windows])) / flow_kg_s
        if abs(off - 1.0) < 0.003:
            break
        parameters = known((1.0 + parameters.values["restitution"]) * off**0.6 - 1.0)
    return parameters, (windows[-1].waveform.stretch, 0.03)


def report(seed: int) -> list[dict[str, Any]]:
    """A row for each flow and stream; silent: the published error is beyond two stated deviations and no contradiction shown."""
    rows = []
    for flow in FLOWS_KG_S:
        parameters, stretch = calibrated(flow, seed)
        for name, stream in CASES.items():
            windows = seen(traffic(stream, flow, 52.0, seed + 1), parameters, stretch)
            mean, mean_sd, shape, shape_sd, published, sd = (
                float(np.mean(v)) if np.all(np.isfinite(v)) else float("nan")
                for v in (
                    [w.waveform.mean_kg_s for w in windows], [w.waveform.mean_std_dev_kg_s for w in windows],
                    [w.record.shape_flow_kg_s for w in windows], [w.record.shape_std_dev_kg_s for w in windows],
                    [w.record.mass_flow_kg_s for w in windows], [w.record.std_dev_kg_s for w in windows],
                )
            )  # fmt: skip
            shown = any(FaultCode.WAVEFORM_CONTRADICTS in w.record.faults for w in windows)
            rows.append(
                {
                    "flow_kg_s": flow, "stream": name,
                    "mean_force_error_pct": _pct(mean / flow - 1.0), "mean_force_sd_pct": _pct(mean_sd / mean),
                    "shape_error_pct": _pct(shape / flow - 1.0), "shape_sd_pct": _pct(shape_sd / shape),
                    "published_error_pct": _pct(published / flow - 1.0), "published_sd_pct": _pct(sd / published),
                    "contradiction": windows[-1].waveform.contradiction, "verdict": windows[-1].waveform.shape.name,
                    "silent": bool(abs(published - flow) > 2.0 * sd and not shown),
                }
            )  # fmt: skip
    return rows


def _pct(value: float) -> float | None:
    return round(100.0 * value, 1) if np.isfinite(value) else None

"""Windows of plate sweeps with the virtual combine's physics, which shares no formula with the model under test."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache

import numpy as np
from numpy.typing import NDArray

from studies.facility.mean_force import shown_force_n
from yieldmon.engine.records import WindowRecord
from yieldmon.engine.settings import SweepSettings
from yieldmon.engine.sweeps.sweep import sweep_sequence
from yieldmon.frames import EstimateQuality, OperatingState
from yieldmon.physics.machine import RPM, Machine
from yieldmon.plant import scenario
from yieldmon.plant.pulse_table import Condition, Detail, PulseTable

Array = NDArray[np.float64]
Force = Callable[[Array, Array], Array]
"""Force, N, from flow, kg/s, and plate angle as the feedback tells it, rad, at 400 rpm."""

Effects = Mapping[str, Mapping[str, float]]
NONE: Effects = {}
STRONG: Effects = {"plate_friction": {"friction": 0.2}}
MACHINE = Machine()
SPEED_RAD_S = 400.0 * RPM
PADDLES_PER_S = 12.16
PADDLE_SCATTER = 0.07
MOISTURE_PCT = 15.0
STEP_S = 5.0
"""Travel, settling and two windows."""


def shown_force(machine: Machine, effects: Effects) -> Force:
    """What the cell of a machine with these effects (and gravity) shows in steady flow."""
    return _shown_force(machine, tuple((name, tuple(values.items())) for name, values in effects.items()))


@cache
def _shown_force(machine: Machine, effects: tuple[tuple[str, tuple[tuple[str, float], ...]], ...]) -> Force:
    scene = scenario.from_mapping({"effects": {"gravity": "on", **{n: dict(v) for n, v in effects}}}, "test")
    moisture = scene.crop.moisture_pct
    grain = scene.crop.grain.at_moisture(moisture, scene.effects.moisture_dependence)
    # The mean force follows from impulses alone, unless the cell is not linear; shapes take most of the time.
    detail = Detail(shapes=scene.effects.cell_nonlinearity is not None)
    table = PulseTable(machine, [Condition(moisture, grain, scene.effects)], detail)

    def force(flow_kg_s: Array, angle_rad: Array) -> Array:
        speed = np.full(flow_kg_s.shape, SPEED_RAD_S)
        return shown_force_n(table, scene.effects, flow_kg_s, angle_rad, speed, scene.sensor.response_s, moisture)

    return force


def sweep_windows(
    machine: Machine,
    force: Force,
    *,
    flow_kg_s: float,
    seed: int,
    angles_deg: tuple[float, ...] = SweepSettings().angles_deg,
    start_s: float = 0.0,
    sweep_id: int = 1,
    wander: float = 0.03,
) -> list[WindowRecord]:
    """The usable windows of one sweep: two a step, paddle scatter of 7 %, flow that wanders by `wander` within 20 s."""
    rng = np.random.default_rng([seed, 20261121])
    home_deg = float(np.degrees(machine.home_plate_angle_rad))
    sequence = np.array(sweep_sequence(angles_deg, home_deg, 2))
    step = np.repeat(np.arange(sequence.size), 2)
    time_s = start_s + STEP_S * step + np.tile([STEP_S - 1.0, STEP_S], sequence.size)
    angle = np.radians(sequence[step])
    keep = np.exp(-np.diff(time_s, prepend=time_s[0]) / 20.0)
    noise = rng.standard_normal(time_s.size)
    level = np.zeros(time_s.size)
    state = rng.standard_normal()
    for i, k in enumerate(keep):
        state = k * state + np.sqrt(1.0 - k**2) * noise[i]
        level[i] = state
    flow = flow_kg_s * np.exp(wander * level)
    clean = force(flow, angle)
    sd = PADDLE_SCATTER / np.sqrt(PADDLES_PER_S) * clean
    shown = clean + sd * rng.standard_normal(time_s.size)
    return [
        window(
            time_s=float(time_s[i]), plate_angle_rad=float(angle[i]), force_n=float(shown[i]), force_std_dev_n=float(sd[i]),
            sweep_id=sweep_id, sweep_step=int(step[i]),
        )
        for i in range(time_s.size)
    ]  # fmt: skip


def window(**given: float) -> WindowRecord:
    """A usable window with what is given, and plain values for the rest."""
    values = dict.fromkeys(WindowRecord.__dataclass_fields__, 0.0) | {
        "window": 1, "duration_s": 1.0, "coverage": 1.0, "elevator_speed_rad_s": SPEED_RAD_S, "plate_still": True,
        "moisture_pct": MOISTURE_PCT, "quality": EstimateQuality.SWEEPING, "operating_state": OperatingState.SWEEPING,
        "load_number": 1, "lost_frames": 0, "surplus_frames": 0, "repeated_frames": 0, "usable_for_calibration": True,
        "parameter_version": 1, "faults": (),
    } | given  # fmt: skip
    return WindowRecord(**values)  # type: ignore[arg-type]

"""What of flow, density, impact gain and friction the plate's observables determine, alone and together, and what a sweep adds.

Fisher information of relative changes at one load. Mean: the mean force of a minute at home. Contrast: ratio of the impulses of
the two kinds of paddles over that minute, the model's exponent without an error. Waveform: flow over density, by the pulses'
shape. Kernels: flow, times a bias. Sweep: mean forces of `sweep.angles_deg` once. Flow has no prior; the others have PRIOR_SD.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yieldmon.engine.settings import SweepSettings
from yieldmon.estimation.fitting.identifiability import directions
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel

Array = NDArray[np.float64]
NAMES = ("mass flow", "density", "restitution", "friction")
"""Of relative changes; 1 + restitution stands for restitution."""
PRIOR_SD = {"density": 0.15, "restitution": 0.05, "friction": 0.3}
VALUES = {"friction": 0.2, "density": 1100.0, "shape_ratio": 2.0, "restitution": 0.55}
SECONDS, SCATTER = 60.0, 0.07
WAVEFORM_SD = {"as shipped": 0.38, "calibrated": 0.10}
"""Of flow over density: with the shipped stretch, and with a law and an index of the machine (the page's tables)."""
KERNELS_SD = {"as shipped": 0.134, "after a weighed load": 0.02}
"""Of the bias, which does not average out, behind a cell of 0.3 ms or less."""
ANGLE_SD = 0.022
"""Of a mean force at one angle of a sweep, relative: 1 % of model error, 2 % of a feed that changes."""
SPEED_RAD_S, STEP = 400.0 * RPM, 1e-4
MACHINE = Machine()
MODEL = ForwardModel(MACHINE, ())


def _log_forces(changes: Array, flow_kg_s: float, angles_rad: Array, loads: Array) -> Array:
    """Of relative changes of NAMES (4,); loads: of the paddles over the mean one (m,)."""
    flow, density, gain, friction = np.exp(changes)
    values = {
        **VALUES, "density": VALUES["density"] * density, "friction": VALUES["friction"] * friction,
        "restitution": (1.0 + VALUES["restitution"]) * gain - 1.0,
    }  # fmt: skip
    found = MODEL.force(Conditions(angles_rad, SPEED_RAD_S, mass_flow_kg_s=flow_kg_s * flow * loads), values)
    return np.asarray(np.log(np.real(found)))


def _slopes(flow_kg_s: float, angles_rad: Array, loads: Array) -> Array:
    """(m, 4) d ln(force) / d of NAMES."""
    steps = STEP * np.eye(len(NAMES))
    up, down = ([_log_forces(sign * step, flow_kg_s, angles_rad, loads) for step in steps] for sign in (1.0, -1.0))
    return (np.array(up) - np.array(down)).T / (2.0 * STEP)


def rows(flow_kg_s: float, waveform: str, kernels: str) -> dict[str, Array]:
    """Derivatives of each observable over its standard deviation."""
    home = np.array([MACHINE.home_plate_angle_rad])
    paddles = SECONDS * MACHINE.paddle_speed_m_s(SPEED_RAD_S) / MACHINE.paddle_spacing_m
    spacings = np.asarray(MACHINE.paddle_spacings_m)
    kinds = _slopes(flow_kg_s, np.repeat(home, spacings.size), spacings / spacings.mean())
    apart = np.array([after - before for before, after in pairwise(kinds)])
    angles = np.radians(np.asarray(SweepSettings().angles_deg, dtype=float))
    return {
        "mean": _slopes(flow_kg_s, home, np.ones(1)) / (SCATTER / np.sqrt(paddles)),
        "contrast": apart / (SCATTER * 2.0 / np.sqrt(paddles)),
        "waveform": np.array([[1.0, -1.0, 0.0, 0.0]]) / WAVEFORM_SD[waveform],
        "kernels": np.array([[1.0, 0.0, 0.0, 0.0]]) / KERNELS_SD[kernels],
        "sweep": _slopes(flow_kg_s, angles, np.ones(angles.size)) / ANGLE_SD,
    }


def deviations(seen: list[Array]) -> dict[str, float]:
    """Relative standard deviations, by name, of what these rows and the priors leave."""
    prior = np.diag([PRIOR_SD.get(name, np.inf) ** -2.0 for name in NAMES])
    whole = np.vstack(seen)
    covariance = np.linalg.inv(whole.T @ whole + prior)
    return {name: float(sd) for name, sd in zip(NAMES, np.sqrt(np.diag(covariance)), strict=True)}


SETS = {
    "mean": ("mean",),
    "mean, contrast": ("mean", "contrast"),
    "mean, waveform": ("mean", "waveform"),
    "mean, kernels": ("mean", "kernels"),
    "all four": ("mean", "contrast", "waveform", "kernels"),
}


def report() -> dict[str, Any]:
    """For each load and state of calibration: standard deviations in per cent without and with one sweep, and the direction that
    no observable but the priors speaks of."""
    out = []
    for flow_kg_s in (4.0, 8.0, 16.0):
        for waveform, kernels in zip(WAVEFORM_SD, KERNELS_SD, strict=True):
            known = rows(flow_kg_s, waveform, kernels)
            for name, of in SETS.items():
                seen = [known[one] for one in of]
                at_home, swept = deviations(seen), deviations([*seen, known["sweep"]])
                worst = directions(np.vstack([*seen, known["sweep"]]), NAMES)[0]
                row = {
                    "flow_kg_s": flow_kg_s,
                    "observables": name,
                    "waveform": waveform if "waveform" in of else None,
                    "kernels": kernels if "kernels" in of else None,
                    "at_home_pct": {key: round(100.0 * sd, 2) for key, sd in at_home.items()},
                    "with_a_sweep_pct": {key: round(100.0 * sd, 2) for key, sd in swept.items()},
                    "scale_unobservable": worst.is_scale,
                }
                if row not in out:
                    out.append(row)
    return {"prior_pct": {key: round(100.0 * sd, 1) for key, sd in PRIOR_SD.items()}, "rows": out}

"""Whether sweeps read friction as well as they state, where all else is as it truly is.

Sweeps of a season at the daemon's plan and steadiness, each read with the true grain and the worn machine's model: what is left
is the noise of the windows, a flow that wanders and what the plant's force has beside the model's. The flow is projected out;
along friction the score (what the sweep reads less what is true, over its stated deviation) has a deviation of 1 where all is
stated as it is, whatever the filter makes of it afterwards.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.season.season import Season
from studies.season.study import Array, StudySettings
from yieldmon.estimation.closed_loop_settings import ClosedLoopSettings
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.closed_loop_inputs import Sweep
from yieldmon.estimation.self_calibration.closed_loop_problem import ClosedLoopProblem
from yieldmon.physics.machine import RPM
from yieldmon.physics.model import ForwardModel

GRAIN = ("friction", "restitution", "density")
_KNOWN = 1e-5
"""Relative standard deviation of what is taken as true."""


def sweep_readings(season: Season, shape_ratio: float, kept: StudySettings) -> dict[str, Any]:
    """Of all sweeps of a season: their number, mean and rms of the score, the deviation of friction that one states (median,
    relative), chi-square over its degrees of freedom, and the flow's stated and true deviation within a sweep."""
    loop = ClosedLoopSettings(
        flow="process", flow_process_sd=kept.flow_process_sd, flow_process_time_s=kept.flow_process_time_s,
        model_error=kept.model_error,
    )  # fmt: skip
    rows = [_row(season, windows, angle_deg, shape_ratio, loop) for windows, angle_deg in _sweeps(season, kept)]
    score, stated, chi2, process, wander = np.array(rows).T
    return {
        "sweeps": len(rows),
        "score_mean": round(float(np.mean(score)), 2),
        "score_mean_sd": round(float(np.std(score) / np.sqrt(score.size)), 2),
        "score_rms": round(float(np.sqrt(np.mean(score**2))), 2),
        "friction_stated_sd": round(float(np.median(stated)), 3),
        "chi2_over_dof": round(float(np.mean(chi2)), 2),
        "flow_sd_taken": round(float(np.mean(process)), 3),
        "flow_sd": round(float(np.mean(wander)), 3),
    }


def _sweeps(season: Season, kept: StudySettings) -> list[tuple[NDArray[np.int64], Array]]:
    """Windows at rest of each sweep, and their angles: as `study.Keeper` makes them, by the true flow."""
    home = float(np.degrees(season.machine.home_plate_angle_rad))
    plan = [home]
    for i, angle in enumerate(kept.sweep_angles_deg):
        plan += [angle, home] if (i + 1) % kept.home_every == 0 else [angle]
    travel_s = np.abs(np.diff([home, *plan])) / kept.plate_rate_deg_s + kept.settle_s
    lost = np.ceil(travel_s).astype(int)
    strides = lost + kept.windows_per_angle
    angles = np.repeat(np.array(plan), strides)
    at_rest = np.concatenate([np.arange(n) >= k for n, k in zip(strides, lost, strict=True)])
    place, found, flow = int(kept.sweep_interval_s), [], season.mass_flow_kg_s
    while place + angles.size < flow.size:
        before, during = flow[place - kept.steady_windows : place], flow[place : place + angles.size]
        if before.min() < kept.min_flow_kg_s or before.std() > kept.steady_cv * before.mean():
            place += 5
        elif during.min() <= 0.0 or place + angles.size >= season.loads.end[season.load[place]]:
            place += 30
        else:
            found.append((np.arange(place, place + angles.size)[at_rest], angles[at_rest]))
            place += angles.size + int(kept.sweep_interval_s)
    return found


def _row(
    season: Season, windows: NDArray[np.int64], angle_deg: Array, shape_ratio: float, loop: ClosedLoopSettings
) -> tuple[float, ...]:
    true = {"friction": season.friction, "restitution": season.restitution, "density": season.density_kg_m3}
    values = {name: float(np.mean(column[windows])) for name, column in true.items()}
    values |= {"shape_ratio": shape_ratio, "gravity.acceleration_m_s2": 9.81}
    worn = replace(season.machine, paddle_length_m=float(np.mean(season.paddle_length_m[windows])))
    model = ForwardModel(worn, ("gravity",))
    known = ParameterSet(values, GRAIN, np.diag([(_KNOWN * values[name]) ** 2 for name in GRAIN]))
    force, sd = season.measure(windows, angle_deg)
    speed = season.elevator_speed_rpm[windows] * RPM
    sweep = Sweep(season.time_s[windows], np.radians(angle_deg), speed, force, np.hypot(sd, 0.1))
    problem = ClosedLoopProblem(model, known, [sweep], (), None, loop)
    solution, count = problem.solve(), windows.size
    of_flow = solution.jacobian[:count, len(GRAIN)]
    unit = of_flow / np.linalg.norm(of_flow)
    residual = solution.residual[:count] - unit * (unit @ solution.residual[:count])
    by_friction = solution.jacobian[:count, 0] - unit * (unit @ solution.jacobian[:count, 0])
    size = float(np.linalg.norm(by_friction))
    flow = season.mass_flow_kg_s[windows]
    return (
        -float(by_friction @ residual) / size,
        1.0 / size / values["friction"],
        float(residual @ residual) / (count - 1),
        float(np.sqrt(solution.flow_covariances[0][0, 0])),
        float(np.std(flow) / np.mean(flow)),
    )

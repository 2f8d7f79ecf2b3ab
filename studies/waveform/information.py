"""Fisher information of a window's pulses, and the scatter of the estimator over random windows."""

from __future__ import annotations

from typing import Any

import numpy as np

from studies.waveform.arrival import sample_noise_n
from yieldmon.estimation.waveform.pattern_fold import PatternWave
from yieldmon.estimation.waveform.pulse_fit import information
from yieldmon.estimation.waveform.pulse_model import PulseModel, PulseSettings
from yieldmon.estimation.waveform.pulse_shape import estimate_near
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import ForwardModel

GRAIN = {"friction": 0.2, "density": 1100.0, "shape_ratio": 2.0, "restitution": 0.55}
FLOWS_KG_S = (4.0, 8.0, 18.0)
SPEEDS_RPM = (330.0, 400.0, 480.0)
ANGLES_DEG = (50.0, 70.0, 90.0)


def table(sds: tuple[float, ...] = (0.02, 0.3), errors: tuple[float, ...] = (0.001, 0.05, 0.1)) -> list[dict[str, Any]]:
    """Standard deviation of the volume flow from one second and from a minute, %, at home and 400 rpm."""
    rows = []
    for error in errors:
        for shape_sd in sds:
            pulses = _pulses(error, shape_sd)
            for flow in (4.0, 6.0, 8.0, 15.0, 18.0):
                found = []
                for seconds in (1.0, 60.0):
                    noise = sample_noise_n(pulses, sample_sd_n=1.33, samples=1000.0 * seconds)
                    covariance, _ = information(
                        pulses, pulses.start(flow / 1100.0), elevator_speed_rad_s=400.0 * RPM, plate_angle_rad=np.deg2rad(70.0),
                        noise_n=noise, patterns=6.08 * seconds,
                    )  # fmt: skip
                    found.append(round(100.0 * float(np.sqrt(covariance[0, 0])), 2))
                rows.append(
                    {
                        "model_error": error,
                        "shape_ratio_sd": shape_sd,
                        "flow_kg_s": flow,
                        "sd_1_s_pct": found[0],
                        "sd_60_s_pct": found[1],
                    }
                )
    return rows


def against_monte_carlo(draws: int, seed: int) -> list[dict[str, Any]]:
    """Scatter of ln(volume flow) over the standard deviation that Fisher information gives, on the grid.

    Friction, heap shape, cell, scatter, shift, noise and the model's error are drawn; fits begin at flows that are 20 % off.
    """
    pulses = _pulses(0.05, 0.02)
    noise = sample_noise_n(pulses, sample_sd_n=1.33, samples=1000.0)
    rows = []
    for flow in FLOWS_KG_S:
        for rpm in SPEEDS_RPM:
            for angle in ANGLES_DEG:
                rng = np.random.default_rng([seed, int(flow), int(rpm), int(angle)])
                where = (rpm * RPM, float(np.deg2rad(angle)))
                centre = pulses.start(flow / 1100.0)
                expected, _ = information(
                    pulses, centre, elevator_speed_rad_s=where[0], plate_angle_rad=where[1], noise_n=noise, patterns=6.0
                )
                prior = pulses.prior_sd(6.0)
                prior[[0, 6, 7]] = 0.0
                theta = centre + prior * rng.standard_normal((draws, prior.size))
                theta[:, 6] = rng.uniform(0.0, 0.16, draws)
                at = pulses.linearised(theta, *(np.full(draws, v) for v in where))
                sd = np.sqrt(noise**2 + pulses.lasting_variance(at.envelope))
                shown = at.waves + sd * (rng.standard_normal(sd.shape) + 1j * rng.standard_normal(sd.shape))
                begun = flow / 1100.0 * np.exp(0.2 * rng.standard_normal(draws))
                waves = [PatternWave(wave, noise, 6.0, *where) for wave in shown]
                fits = estimate_near(pulses, waves, begun.tolist())
                errors = np.log([found.volume_flow_m3_s for found in fits]) - theta[:, 0]
                stated = np.array([found.relative_sd for found in fits])
                fisher = float(np.sqrt(expected[0, 0]))
                rows.append(
                    {
                        "flow_kg_s": flow, "rpm": rpm, "angle_deg": angle, "fisher_pct": round(100.0 * fisher, 2),
                        "scatter_pct": round(100.0 * float(np.nanstd(errors)), 2),
                        "ratio": round(float(np.nanstd(errors)) / fisher, 3),
                        "bias_pct": round(100.0 * float(np.nanmean(errors)), 2),
                        "rms_error_over_stated": round(float(np.sqrt(np.nanmean((errors / stated) ** 2))), 3),
                        "settled": sum(found.converged for found in fits), "without": int(np.isnan(errors).sum()),
                    }
                )  # fmt: skip
    return rows


def _pulses(model_error: float, shape_sd: float) -> PulseModel:
    sd = {**PulseSettings().sd, "log_shape_ratio": shape_sd}
    return PulseModel(ForwardModel(Machine()), GRAIN, PulseSettings(model_error=model_error, sd=sd))

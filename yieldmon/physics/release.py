"""Stage 3, release: the heap slides out along the paddle and leaves it at the tip [8.10-8.16].

Lengths in l, time in 1/Omega. With gravity number G = g / (l Omega^2) and theta the paddle's angle,
rho'' = rho - 2 mu rho' + G (sin theta + mu cos theta); the published model has G = 0. The rotation tau_d to the tip is the
independent variable: the radius of release follows from it in closed form, because the solution is linear in rho_0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .numerics import AnyArray, maximum, real
from .stages import Setting

TOP = 1.5 * np.pi


@dataclass(frozen=True, slots=True)
class Outflow:
    """Motion of the grain that reaches the tip after the rotation tau."""

    release_radius: AnyArray
    radial_speed: AnyArray
    """At the tip, in l Omega."""
    inward_rate: AnyArray
    """-d rho_0 / d tau."""


def outflow(tau: AnyArray, setting: Setting) -> Outflow:
    """Closed-form solution for the grain that leaves at rotation tau [8.13-8.15], gravity and radial speed included."""
    mu = setting.friction
    s = np.sqrt(1.0 + mu * mu)
    damping = np.exp(-mu * tau)
    grow = np.exp(s * tau)
    cosh, sinh = 0.5 * (grow + 1.0 / grow), 0.5 * (grow - 1.0 / grow)
    position = damping * (cosh + mu / s * sinh)
    velocity = damping * sinh / s
    particular, particular_rate = 0.0, 0.0
    initial = setting.radial_speed
    if np.any(initial != 0.0):
        rate = damping * (cosh - mu / s * sinh)
        position, velocity = position + initial * velocity, velocity + initial * rate
    if np.any(setting.gravity_m_s2 != 0.0):
        particular, particular_rate = _forced(tau, mu, s, damping, cosh, sinh, setting)
    release = (1.0 - particular) / position
    radial = release * velocity + particular_rate
    return Outflow(release, radial, radial / position)


def _forced(
    tau: AnyArray, mu: AnyArray, s: AnyArray, damping: AnyArray, cosh: AnyArray, sinh: AnyArray, setting: Setting
) -> tuple[AnyArray, AnyArray]:
    """Solution for G (sin theta + mu cos theta) that starts at rest at the centre, and its rate."""
    number = setting.gravity_m_s2 / (setting.paddle_length_m * setting.elevator_speed_rad_s**2)
    start = TOP + setting.release_angle_rad
    a = -number * (1.0 - mu * mu) / (2.0 * (1.0 + mu * mu))
    b = -number * mu / (1.0 + mu * mu)
    free, free_rate = damping * (cosh + mu / s * sinh), damping * sinh / s
    free_rate_rate = damping * (cosh - mu / s * sinh)
    sin0, cos0 = np.sin(start), np.cos(start)
    sin, cos = np.sin(start + tau), np.cos(start + tau)
    at_start, rate_at_start = a * sin0 + b * cos0, a * cos0 - b * sin0
    value = a * sin + b * cos - at_start * free - rate_at_start * free_rate
    rate = a * cos - b * sin - at_start * free_rate - rate_at_start * free_rate_rate
    return value, rate


def rotation_to_empty(inner_radius: AnyArray, setting: Setting, limit: AnyArray) -> AnyArray:
    """tau at which the innermost grain (radius `inner_radius`, in l) leaves the tip, at most `limit`, rad.

    Newton on log rho_0, which is nearly linear once past the start; complex perturbations are carried by a last step.
    """
    x = maximum(inner_radius, np.asarray(1e-300))
    goal = real(x)
    tau = np.minimum(np.arccosh(np.maximum(1.0 / np.maximum(goal, 1e-12), 1.0)), real(limit))
    low, high = np.zeros_like(tau), np.broadcast_to(real(limit), tau.shape).copy()
    for _ in range(60):
        flow = outflow(tau, setting)
        rho, rate = real(flow.release_radius), real(flow.inward_rate)
        late = rho < goal
        low, high = np.where(late, low, tau), np.where(late, tau, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            trial = tau + np.where(rho > 0.0, rho * np.log(rho / goal), rho - goal) / rate
        inside = (trial >= low) & (trial <= high)
        trial = np.where(inside, trial, 0.5 * (low + high))
        moved = np.abs(trial - tau)
        tau = trial
        if not np.any(moved > 1e-14 * tau + 1e-300):
            break
    flow = outflow(tau, setting)
    if np.iscomplexobj(flow.release_radius) or np.iscomplexobj(x):
        rate = real(flow.inward_rate)
        inside = (tau < real(limit)) & (rate > 0.0)
        step = 1j * np.imag(flow.release_radius - x) / np.where(inside, rate, 1.0)
        return np.where(inside, tau + step, np.where(tau < real(limit), tau, limit))
    return tau


def at_tip(tau: AnyArray, flow: Outflow, setting: Setting) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
    """Place (x, y) in m and velocity (x, y) in m/s of the grain as it leaves the tip [8.16]."""
    theta = TOP + setting.release_angle_rad + tau
    sin, cos = np.sin(theta), np.cos(theta)
    length = setting.paddle_length_m
    tip_speed = length * setting.elevator_speed_rad_s
    u = flow.radial_speed
    return length * cos, length * sin, tip_speed * (u * cos - sin), tip_speed * (u * sin + cos)

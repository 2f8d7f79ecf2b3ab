"""Stage 3, release: the heap slides out along the paddle and leaves it at the tip [8.10-8.16].

Lengths in l, time in 1/Omega. With gravity number G = g / (l Omega^2) and theta the paddle's angle,
rho'' = rho - 2 mu rho' + G (sin theta + mu cos theta); the published model has G = 0. The rotation tau_d to the tip is the
independent variable: the radius of release follows from it in closed form, because the solution is linear in rho_0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .numerics import AnyArray, distinct, exp, real, sin_cos
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
    angle: AnyArray
    """The paddle's, as the grain leaves the tip."""
    direction: tuple[AnyArray, AnyArray] | None
    """Sine and cosine of that angle where the motion needed them."""


def outflow(tau: AnyArray, setting: Setting) -> Outflow:
    """Closed-form solution for the grain that leaves at rotation tau [8.13-8.15], gravity and radial speed included."""
    mu = setting.friction
    s = np.sqrt(1.0 + mu * mu)
    damping = exp(-mu * tau)
    grow = exp(s * tau)
    cosh, sinh = 0.5 * (grow + 1.0 / grow), 0.5 * (grow - 1.0 / grow)
    free, free_rate = damping * (cosh + mu / s * sinh), damping * sinh / s
    position, velocity = free, free_rate
    if setting.radial_speed is not None:
        rate = damping * (cosh - mu / s * sinh)
        position, velocity = position + setting.radial_speed * velocity, velocity + setting.radial_speed * rate
    angle = start_angle(setting) + tau
    if setting.gravity_m_s2 is None:
        release = 1.0 / position
        radial = release * velocity
        return Outflow(release, radial, radial * release, angle, None)
    sin, cos = sin_cos(angle)
    free_rate_rate = damping * (cosh - mu / s * sinh)
    forced, forced_rate = _forced(sin, cos, mu, (free, free_rate, free_rate_rate), setting)
    release = (1.0 - forced) / position
    radial = release * velocity + forced_rate
    return Outflow(release, radial, radial / position, angle, (sin, cos))


def start_angle(setting: Setting) -> AnyArray:
    """Paddle angle at which the heap is let go, rad."""
    if setting.release_angle_rad is None:
        return np.full(1, TOP)
    return TOP + setting.release_angle_rad


def _forced(
    sin: AnyArray,
    cos: AnyArray,
    mu: AnyArray,
    unforced: tuple[AnyArray, AnyArray, AnyArray],
    setting: Setting,
) -> tuple[AnyArray, AnyArray]:
    """Solution for G (sin theta + mu cos theta) that starts at rest at the centre, and its rate; sin, cos: of theta.

    unforced: the solution without that force that starts at 1 at rest, its rate, and the rate of that.
    """
    assert setting.gravity_m_s2 is not None
    number = setting.gravity_m_s2 / (setting.paddle_length_m * setting.elevator_speed_rad_s**2)
    start = start_angle(setting)
    a = -number * (1.0 - mu * mu) / (2.0 * (1.0 + mu * mu))
    b = -number * mu / (1.0 + mu * mu)
    free, free_rate, free_rate_rate = unforced
    sin0, cos0 = np.sin(start), np.cos(start)
    at_start, rate_at_start = a * sin0 + b * cos0, a * cos0 - b * sin0
    value = a * sin + b * cos - at_start * free - rate_at_start * free_rate
    rate = a * cos - b * sin - at_start * free_rate - rate_at_start * free_rate_rate
    return value, rate


def rotation_to_empty(inner_radius: AnyArray, setting: Setting, limit: AnyArray) -> AnyArray:
    """tau at which the innermost grain (radius `inner_radius`, in l) leaves the tip, at most `limit`, rad.

    Newton on log rho_0, kept inside a bracket; complex perturbations are carried by a last step. What has settled stays as it is,
    so that no value depends on those beside it.
    """
    perturbed = any(map(np.iscomplexobj, (inner_radius, limit))) or setting.perturbed
    goal, end = np.maximum(real(inner_radius), 1e-12), real(limit)
    still = setting
    if perturbed:
        goal, end, still = distinct(goal), distinct(end), setting.unperturbed()
    plain = np.arccosh(np.maximum(1.0 / goal, 1.0))
    # Exact without friction; the factor is friction's first order near the tip.
    tau = np.minimum(plain * (1.0 + still.friction * plain / 3.0), end)
    shape = np.broadcast_shapes(tau.shape, still.friction.shape, still.elevator_speed_rad_s.shape)
    low, high = np.zeros(shape), end
    settled = np.zeros(shape, dtype=bool)
    for _ in range(60):
        flow = outflow(tau, still)
        rho, rate = flow.release_radius, flow.inward_rate
        late = rho < goal
        low, high = np.where(late, low, tau), np.where(late, tau, high)
        trial = np.minimum(tau + rho * np.log(np.maximum(rho, 1e-300) / goal) / np.maximum(rate, 1e-300), end)
        trial = np.where((trial >= low) & (trial <= high), trial, 0.5 * (low + high))
        # Quadratic convergence: a step this small leaves an error of 1e-10, and the heap has no grain there anyway.
        small = ~(np.abs(trial - tau) > 1e-5 * trial + 1e-300)
        tau = np.where(settled, tau, trial)
        settled = settled | small
        if settled.all():
            break
    if perturbed:
        flow = outflow(tau, setting)
        rate = real(flow.inward_rate)
        inside = (tau < end) & (rate > 0.0)
        step = 1j * np.imag(flow.release_radius - inner_radius) / np.where(inside, rate, 1.0)
        return np.where(inside, tau + step, np.where(tau < end, tau, limit))
    return tau


def at_tip(flow: Outflow, setting: Setting) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
    """Place (x, y) in m and velocity (x, y) in m/s of the grain as it leaves the tip [8.16]."""
    sin, cos = flow.direction or sin_cos(flow.angle)
    length = setting.paddle_length_m
    tip_speed = length * setting.elevator_speed_rad_s
    u = flow.radial_speed
    return length * cos, length * sin, tip_speed * (u * cos - sin), tip_speed * (u * sin + cos)

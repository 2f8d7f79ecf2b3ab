"""Stage 3, release: the heap slides out along the paddle and leaves it at the tip [8.10-8.16].

Lengths in l, time in 1/Omega. With gravity number G = g / (l Omega^2) and theta the paddle's angle,
rho'' = rho - 2 (mu rho' + D) + G (sin theta + mu cos theta), with a steady drag D; the published model has G = D = 0. The
rotation tau_d to the tip is the independent variable: the radius of release follows from it in closed form, because the solution
is linear in rho_0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .numerics import AnyArray, distinct, exp, perturbed, real, sin_cos
from .stages import Setting

TOP = 1.5 * np.pi
_AT_TOP = np.full(1, TOP)
_AT_TOP.flags.writeable = False


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


@dataclass(frozen=True, slots=True)
class Slide:
    """What of the solution is the same for all grain of a setting."""

    friction: AnyArray
    growth: AnyArray
    """s = sqrt(1 + mu^2)"""
    ratio: AnyArray
    """mu / s"""
    radial_speed: AnyArray | None
    start: AnyArray
    forced: tuple[AnyArray, AnyArray, AnyArray, AnyArray] | None
    """Under gravity: factors of sine and cosine, and what these are at the start, itself and its rate."""
    steady: AnyArray | None = None
    """Radius at which a steady drag balances the centrifugal force."""


def slide_of(setting: Setting) -> Slide:
    """Of a setting; `outflow` makes it itself where it is not given."""
    mu, start = setting.friction, start_angle(setting)
    s = np.sqrt(1.0 + mu * mu)
    forced = None
    if setting.gravity_m_s2 is not None:
        number = setting.gravity_m_s2 / (setting.paddle_length_m * setting.elevator_speed_rad_s**2)
        a = -number * (1.0 - mu * mu) / (2.0 * (1.0 + mu * mu))
        b = -number * mu / (1.0 + mu * mu)
        sin0, cos0 = np.sin(start), np.cos(start)
        forced = a, b, a * sin0 + b * cos0, a * cos0 - b * sin0
    steady = None
    if setting.steady_drag_m_s is not None:
        steady = 2.0 * setting.steady_drag_m_s / (setting.paddle_length_m * setting.elevator_speed_rad_s)
    return Slide(mu, s, mu / s, setting.radial_speed, start, forced, steady)


def outflow(tau: AnyArray, setting: Setting, slide: Slide | None = None) -> Outflow:
    """Closed-form solution for the grain that leaves at rotation tau [8.13-8.15], gravity and radial speed included."""
    known = slide_of(setting) if slide is None else slide
    damping = exp(-known.friction * tau)
    grow = exp(known.growth * tau)
    shrink = 1.0 / grow
    cosh, sinh = 0.5 * (grow + shrink), 0.5 * (grow - shrink)
    slowed = known.ratio * sinh
    free, free_rate = damping * (cosh + slowed), damping * sinh / known.growth
    position, velocity = free, free_rate
    if known.radial_speed is not None:
        rate = damping * (cosh - slowed)
        position, velocity = position + known.radial_speed * velocity, velocity + known.radial_speed * rate
    angle = known.start + tau
    if known.forced is None and known.steady is None:
        release = 1.0 / position
        radial = release * velocity
        return Outflow(release, radial, radial * release, angle, None)
    # What acts on grain whatever its radius forces a solution that starts at rest at the centre.
    forced: AnyArray | float = 0.0
    forced_rate: AnyArray | float = 0.0
    direction = None
    if known.forced is not None:
        direction = sin, cos = sin_cos(angle)
        free_rate_rate = damping * (cosh - slowed)
        # G (sin theta + mu cos theta)
        a, b, at_start, rate_at_start = known.forced
        forced = a * sin + b * cos - at_start * free - rate_at_start * free_rate
        forced_rate = a * cos - b * sin - at_start * free_rate - rate_at_start * free_rate_rate
    if known.steady is not None:
        forced, forced_rate = forced + known.steady * (1.0 - free), forced_rate - known.steady * free_rate
    release = (1.0 - forced) / position
    radial = release * velocity + forced_rate
    return Outflow(release, radial, radial / position, angle, direction)


def slides_of(setting: Setting) -> tuple[Slide, Setting, Slide]:
    """The slide of a setting, the setting without perturbations (itself where it has none), and the slide of that."""
    slide, still = slide_of(setting), setting.unperturbed()
    return slide, still, slide if still is setting else slide_of(still)


def start_angle(setting: Setting) -> AnyArray:
    """Paddle angle at which the heap is let go, rad."""
    if setting.release_angle_rad is None:
        return _AT_TOP
    return TOP + setting.release_angle_rad


def rotation_to_empty(
    inner_radius: AnyArray, setting: Setting, limit: AnyArray, slides: tuple[Slide, Setting, Slide] | None = None
) -> AnyArray:
    """tau at which the innermost grain (radius `inner_radius`, in l) leaves the tip, at most `limit`, rad.

    Newton on log rho_0, kept inside a bracket; complex perturbations are carried by a last step. What has settled stays as it is,
    so that no value depends on those beside it. slides: `slides_of` the setting, where they are at hand.
    """
    slide, still, still_slide = slides_of(setting) if slides is None else slides
    carries = perturbed(inner_radius) or perturbed(limit) or still is not setting
    goal, end = np.maximum(real(inner_radius), 1e-12), real(limit)
    if carries:
        goal, end = distinct(goal), distinct(end)
    plain = np.arccosh(np.maximum(1.0 / goal, 1.0))
    # Exact without friction; the factor is friction's first order near the tip.
    tau = np.minimum(plain * (1.0 + still.friction * plain / 3.0), end)
    shape = np.broadcast_shapes(tau.shape, still.friction.shape, still.elevator_speed_rad_s.shape)
    low, high = np.zeros(shape), end
    settled = np.zeros(shape, dtype=bool)
    for _ in range(60):
        flow = outflow(tau, still, still_slide)
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
    if carries:
        flow = outflow(tau, setting, slide)
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

"""A parcel slides out along the turning paddle.

Equation of motion along the paddle in the turning frame, lengths in paddle lengths l, time as paddle angle tau past vertical,
gamma = g / (l Omega^2), theta = 3 pi/2 + tau:

    r'' = r - mu max(N, 0) sign(r') + gamma sin(theta),    N = 2 r' - gamma cos(theta)

integrated with classical Runge-Kutta from rest (or from a given radial speed) until the parcel passes the tip. mu is a number, or
one that follows the speed along the paddle (:class:`Friction`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from yieldmon.physics.numerics import Array

_STEP_RAD = 0.025
_LAST_ANGLE_RAD = 2.2
_NODES = 160
"""Past this angle a parcel leaves downward, away from any plate."""


@dataclass(frozen=True, slots=True)
class Release:
    """Where the paddle stands (rad past vertical) and how fast the parcel moves outward (tip speeds) when it passes the tip.

    nan for a parcel that does not get out in time to fly forward.
    """

    angle_rad: Array
    radial_speed: Array


@dataclass(frozen=True, slots=True)
class Friction:
    """Friction at the speed u along the paddle (tip speeds): fast (1 + rise exp(-u / scale))."""

    fast: float
    rise: float = 0.0
    scale: float = 1.0

    def at(self, speed: Array) -> Array | float:
        """Friction at speeds of any shape."""
        return self.fast * (1.0 + self.rise * np.exp(-np.abs(speed) / self.scale)) if self.rise else self.fast


def _acceleration(angle: float, radius: Array, speed: Array, friction: Friction, gamma: float) -> Array:
    normal = np.maximum(2.0 * speed - gamma * np.sin(angle), 0.0)
    return np.asarray(radius - friction.at(speed) * normal * np.sign(speed) - gamma * np.cos(angle))


def slide(
    radius: Array, friction: float | Friction, gamma: float, radial_speed: float = 0.0, start_angle_rad: float = 0.0
) -> Release:
    """Release of parcels that start at the given radii (l, any shape) when the paddle is at start_angle_rad.

    radial_speed: speed outward at the start per radius, in tip speeds. gamma: g / (l Omega^2).
    """
    law = friction if isinstance(friction, Friction) else Friction(friction)
    r = np.array(radius, dtype=float)
    u = radial_speed * r
    inside = np.ones(r.shape, dtype=bool)
    before = np.full((7, *r.shape), np.nan)
    angle, h = start_angle_rad, _STEP_RAD
    while angle < _LAST_ANGLE_RAD and inside.any():
        a1 = _acceleration(angle, r, u, law, gamma)
        u2 = u + 0.5 * h * a1
        a2 = _acceleration(angle + 0.5 * h, r + 0.5 * h * u, u2, law, gamma)
        u3 = u + 0.5 * h * a2
        a3 = _acceleration(angle + 0.5 * h, r + 0.5 * h * u2, u3, law, gamma)
        u4 = u + h * a3
        a4 = _acceleration(angle + h, r + h * u3, u4, law, gamma)
        r_next = r + h / 6.0 * (u + 2.0 * u2 + 2.0 * u3 + u4)
        u_next = u + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
        passing = inside & (r_next >= 1.0)
        if passing.any():
            step = (np.full_like(r, angle), r, u, a1, r_next, u_next, a4)
            before[:, passing] = np.stack(step)[:, passing]
            inside &= ~passing
        r, u, angle = r_next, u_next, angle + h
    begin, r0, u0, a0, r1, u1, a1 = before
    share = _crossing(r0, u0, r1, u1, h)
    return Release(begin + share * h, _hermite(share, u0, a0, u1, a1, h))


def _hermite(share: Array, y0: Array, d0: Array, y1: Array, d1: Array, h: float) -> Array:
    s = share
    return (1 + 2 * s) * (1 - s) ** 2 * y0 + s * (1 - s) ** 2 * h * d0 + s**2 * (3 - 2 * s) * y1 + s**2 * (s - 1) * h * d1


def _crossing(r0: Array, u0: Array, r1: Array, u1: Array, h: float) -> Array:
    """Share of the step at which the radius reaches 1 (bisection on the Hermite interpolant)."""
    low, high = np.zeros_like(r0), np.ones_like(r0)
    for _ in range(40):
        middle = 0.5 * (low + high)
        short = _hermite(middle, r0, u0, r1, u1, h) < 1.0
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    return 0.5 * (low + high)


@dataclass(frozen=True, slots=True)
class ReleaseCurve:
    """Release against the start depth sqrt(1 - radius), as splines through parcels integrated once per speed and grain."""

    angle: scipy.interpolate.CubicSpline
    radial_speed: scipy.interpolate.CubicSpline
    deepest: float

    def __call__(self, radius: Array) -> Release:
        """Release of parcels at the given radii; nan for those too deep to get out."""
        depth = np.sqrt(1.0 - radius)
        depth = np.where(depth > self.deepest, np.nan, depth)
        return Release(np.asarray(self.angle(depth)), np.asarray(self.radial_speed(depth)))


def release_curve(
    friction: float | Friction, gamma: float, radial_speed: float = 0.0, start_angle_rad: float = 0.0
) -> ReleaseCurve:
    """Release of every parcel of a paddle; arguments as for :func:`slide`."""
    depth = np.linspace(0.0, np.sqrt(0.98), _NODES)
    release = slide(1.0 - depth**2, friction, gamma, radial_speed, start_angle_rad)
    out = np.isfinite(release.angle_rad)
    depth, angle, speed = depth[out], release.angle_rad[out], release.radial_speed[out]
    return ReleaseCurve(
        scipy.interpolate.CubicSpline(depth, angle), scipy.interpolate.CubicSpline(depth, speed), float(depth[-1])
    )

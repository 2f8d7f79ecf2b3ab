"""The published algorithm as a benchmark's baseline: sums over radial steps, bisection for every unknown.

Written from the equations of the thesis (chapters 8 and 9) in plain Python floats, one flow at a time. It shares no code with
yieldmon.physics and serves as an independent check of it as well.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import acos, atan2, cos, exp, hypot, pi, sin, sqrt


@dataclass(frozen=True)
class Case:
    """Geometry and grain of table 11.1; SI units, radians."""

    elevator_speed_rad_s: float = 400.0 * 2.0 * pi / 60.0
    sprocket_pitch_radius_m: float = 0.0541
    paddle_spacing_m: float = 0.18635
    paddle_length_m: float = 0.16
    paddle_width_m: float = 0.21
    pivot_m: tuple[float, float] = (0.4, -0.16)
    plate_length_m: float = 0.1887
    friction: float = 0.2
    restitution: float = 0.6
    density: float = 1100.0
    shape_ratio: float = 2.0


def bisect(function: Callable[[float], float], low: float, high: float, tolerance: float) -> float:
    """Root of a function that is negative at low and not at high."""
    while high - low > tolerance:
        middle = 0.5 * (low + high)
        if function(middle) < 0.0:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def paddle_momentum(case: Case, mass_flow_kg_s: float, plate_angle_rad: float, steps: int = 200) -> float:
    """Horizontal momentum per paddle, kg m/s, by a midpoint sum over `steps` radial layers."""
    paddle_speed = case.elevator_speed_rad_s * case.sprocket_pitch_radius_m
    mass = mass_flow_kg_s * case.paddle_spacing_m / paddle_speed
    fraction = mass / (case.density * case.paddle_width_m * case.paddle_length_m**2)

    def excess(x: float) -> float:
        psi = case.shape_ratio * (1.0 - x)
        return fraction - (0.5 * psi - 0.5 * x * sin(psi))

    inner = bisect(excess, 0.0, 1.0, 1e-12)
    mu, s = case.friction, sqrt(1.0 + case.friction**2)
    a, b = 0.5 * (1.0 - mu / s), 0.5 * (1.0 + mu / s)
    psi_f = case.shape_ratio * (1.0 - inner)
    dx, dy = cos(psi_f) - inner, sin(psi_f)
    foot = inner * dy / hypot(dx, dy)
    foot_angle = atan2(-dx, dy)
    normal = (sin(plate_angle_rad), -cos(plate_angle_rad))
    along = (cos(plate_angle_rad), sin(plate_angle_rad))
    low_edge = tuple(p + case.plate_length_m * d for p, d in zip(case.pivot_m, along, strict=True))
    tip_speed = case.paddle_length_m * case.elevator_speed_rad_s
    step = (1.0 - inner) / steps
    total = 0.0
    for i in range(steps):
        rho = 1.0 - (i + 0.5) * step

        def short_of_tip(tau: float, rho: float = rho) -> float:
            return rho * (a * exp(-(mu + s) * tau) + b * exp((s - mu) * tau)) - 1.0

        tau = bisect(short_of_tip, 0.0, 6.0, 1e-12)
        u = rho * (-a * (mu + s) * exp(-(mu + s) * tau) + b * (s - mu) * exp((s - mu) * tau))
        theta = 1.5 * pi + tau
        vx, vy = u * cos(theta) - sin(theta), u * sin(theta) + cos(theta)
        vn = vx * normal[0] + vy * normal[1]
        if vn <= 0.0:
            break
        px, py = case.paddle_length_m * cos(theta), case.paddle_length_m * sin(theta)
        time = ((case.pivot_m[0] - px) * normal[0] + (case.pivot_m[1] - py) * normal[1]) / vn
        kappa = (px + time * vx - low_edge[0]) * along[0] + (py + time * vy - low_edge[1]) * along[1]
        if kappa >= 0.0:
            break
        psi = foot_angle + acos(min(foot / rho, 1.0))
        total += vn * rho * psi * step
    layer = case.density * case.paddle_width_m * case.paddle_length_m**2
    return (1.0 + case.restitution) * layer * tip_speed * sin(plate_angle_rad) * total


def mass_flow(case: Case, force_n: float, plate_angle_rad: float, steps: int = 200) -> float:
    """Open loop by bisection between 0 and 40 kg/s."""
    passes_per_s = case.elevator_speed_rad_s * case.sprocket_pitch_radius_m / case.paddle_spacing_m

    def short(flow: float) -> float:
        return paddle_momentum(case, flow, plate_angle_rad, steps) * passes_per_s - force_n

    return bisect(short, 0.0, 40.0, 1e-6)

"""The published model written down a second time, plainly: root finding at every radius and adaptive quadrature over the radius.

Shares nothing with the package but the equations (thesis, chapter 8).
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq

PIVOT_X, PIVOT_Y, PLATE = 0.4, -0.16, 0.1887
LENGTH, WIDTH, PITCH_RADIUS = 0.16, 0.21, 0.0541


def paddle_momentum(
    paddle_mass_kg: float,
    plate_angle_rad: float,
    speed_rad_s: float,
    friction: float,
    restitution: float,
    density: float,
    shape_ratio: float,
) -> float:
    """Horizontal momentum per paddle, kg m/s."""
    phi = plate_angle_rad
    share = paddle_mass_kg / (density * WIDTH * LENGTH**2)
    x = brentq(lambda x: shape_ratio * (1 - x) / 2 - x / 2 * np.sin(shape_ratio * (1 - x)) - share, 0, 1, xtol=1e-15)
    inner, outer = np.array([x, 0.0]), np.array([np.cos(shape_ratio * (1 - x)), np.sin(shape_ratio * (1 - x))])

    def opening(rho: float) -> float:
        def gap(t: float) -> float:
            return float(np.hypot(*(inner + t * (outer - inner)))) - rho

        point = inner + (brentq(gap, 0, 1, xtol=1e-15) if rho > x else 0.0) * (outer - inner)
        return float(np.arctan2(point[1], point[0]))

    s = np.sqrt(1 + friction**2)
    a, b = (1 - friction / s) / 2, (1 + friction / s) / 2

    def stretch(t: float) -> float:
        return a * np.exp(-(friction + s) * t) + b * np.exp((s - friction) * t)

    def stretch_rate(t: float) -> float:
        return -a * (friction + s) * np.exp(-(friction + s) * t) + b * (s - friction) * np.exp((s - friction) * t)

    def leaving(t: float) -> tuple[np.ndarray, np.ndarray]:
        theta, u = 1.5 * np.pi + t, stretch_rate(t) / stretch(t)
        radial, along = np.array([np.cos(theta), np.sin(theta)]), np.array([-np.sin(theta), np.cos(theta)])
        return LENGTH * radial, LENGTH * speed_rad_s * (u * radial + along)

    direction = np.array([np.cos(phi), np.sin(phi)])
    low_edge = np.array([PIVOT_X, PIVOT_Y]) + PLATE * direction

    def kappa(t: float) -> float:
        place, velocity = leaving(t)
        return float(np.linalg.solve(np.column_stack((velocity, -direction)), low_edge - place)[1])

    def rotation(rho: float) -> float:
        return float(brentq(lambda t: stretch(t) * rho - 1.0, 0.0, 60.0, xtol=1e-14))

    lowest = x
    times = np.linspace(0.0, min(rotation(max(x, 1e-9)), 2.2), 400)
    places = [kappa(t) for t in times]
    for before, after, t0, t1 in zip(places, places[1:], times, times[1:], strict=False):
        # A jump by far more than a plate is the pole where the path runs along the plate.
        if before < 0.0 <= after < 50.0:
            lowest = 1.0 / stretch(brentq(kappa, t0, t1, xtol=1e-14))
            break

    def integrand(z: float) -> float:
        rho = 1.0 - z * z
        _, (vx, vy) = leaving(rotation(rho))
        return 2.0 * z * (vx * np.sin(phi) - vy * np.cos(phi)) * rho * opening(rho)

    value, _ = quad(integrand, 0.0, np.sqrt(1.0 - lowest), epsabs=1e-14, epsrel=1e-11, limit=200)
    return (1.0 + restitution) * density * WIDTH * LENGTH**2 * np.sin(phi) * value

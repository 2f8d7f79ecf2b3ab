"""Stage 2, settling: the heap against the housing, with a straight inner surface [8.4-8.9, appendix E].

Lengths in units of the paddle length l; x = h0 / l is where the inner surface meets the paddle, psi_f = h_f (1 - x) the angle at
which it meets the housing.
"""

from __future__ import annotations

import numpy as np

from .numerics import AnyArray, arccos, distinct, perturbed, real, sin_cos


def filled_fraction(x: AnyArray, shape_ratio: AnyArray) -> AnyArray:
    """M / (eta w l^2) of a heap with inner radius x: h_f (1-x) / 2 - (x/2) sin(h_f (1-x)) [8.8]."""
    psi = shape_ratio * (1.0 - x)
    return 0.5 * psi - 0.5 * x * sin_cos(psi)[0]


def inner_radius(fraction: AnyArray, shape_ratio: AnyArray) -> AnyArray:
    """x = h0/l of a heap of `fraction` = M / (eta w l^2), 0 <= fraction <= shape_ratio / 2; nan outside.

    Newton from the thin-heap limit 1 - x = sqrt(2 a / h_f), which lies on the side from which the iteration is monotone for
    thin heaps; steps that leave [0, 1] are halved back. Complex perturbations are carried by a last step. What has settled
    stays as it is, so that no value depends on those beside it.
    """
    carries = perturbed(fraction) or perturbed(shape_ratio)
    a, h = real(fraction), real(shape_ratio)
    if carries:
        a, h = distinct(a), distinct(h)
    with np.errstate(invalid="ignore", divide="ignore"):
        thin = np.sqrt(2.0 * a / h)
        thickness = np.minimum(thin, 1.0)
        settled, none = np.zeros(thickness.shape, dtype=bool), a == 0.0
        for _ in range(60):
            psi, rest = h * thickness, 1.0 - thickness
            sin = np.sin(psi)
            value = 0.5 * (psi - rest * sin) - a
            slope = 0.5 * (h + sin - rest * h * np.cos(psi))
            trial = thickness - value / slope
            trial = np.where(trial > 1.0, 0.5 * (thickness + 1.0), np.where(trial < 0.0, 0.5 * thickness, trial))
            # Quadratic convergence: a step this small leaves an error at rounding.
            small = ~(np.abs(trial - thickness) > 1e-8 * trial) | none
            thickness = np.where(settled, thickness, np.where(none, 0.0, trial))
            settled = settled | small
            if settled.all():
                break
    # So thin a heap is its own limit; Newton would stumble over rounding in filled_fraction.
    thickness = np.where(a < 1e-20, thin, thickness)
    # Rounding may ask for a hair more than a full paddle; beyond that the heap does not exist.
    thickness = np.where((a >= 0.0) & (a <= 0.5 * h * (1.0 + 1e-12)), thickness, np.nan)
    x: AnyArray = 1.0 - thickness
    if carries:
        psi = h * thickness
        slope = -(0.5 * h + 0.5 * np.sin(psi) - 0.5 * x * h * np.cos(psi))
        x = x - 1j * np.imag(filled_fraction(x, shape_ratio) - fraction) / np.where(slope == 0.0, 1.0, slope)
    return x


def opening_angle(rho: AnyArray, x: AnyArray, shape_ratio: AnyArray) -> AnyArray:
    """psi(rho): angle over which the heap holds grain at radius rho >= x, rad; the inverse of h, in closed form.

    The inner surface is the straight line from (x, 0) to the polar point (1, psi_f); at distance p from the centre and foot
    angle alpha, rho cos(psi - alpha) = p.
    """
    psi_f = shape_ratio * (1.0 - x)
    dy, along = sin_cos(psi_f)
    dx = along - x
    length = np.sqrt(dx * dx + dy * dy)
    distance = x * dy / np.where(real(length) > 0.0, length, 1.0)
    foot_angle = _arctan2(-dx, dy)
    # Rounding may put the innermost node a hair inside the line's nearest point.
    ratio = distance / rho
    angle: AnyArray = foot_angle + arccos(np.where(real(ratio) > 1.0, 1.0, ratio))
    return angle


def _arctan2(y: AnyArray, x: AnyArray) -> AnyArray:
    angle: AnyArray = np.arctan2(real(y), real(x))
    if perturbed(y) or perturbed(x):
        yr, xr = real(y), real(x)
        radius2 = xr * xr + yr * yr
        angle = angle + 1j * (xr * np.imag(y) - yr * np.imag(x)) / np.where(radius2 > 0.0, radius2, 1.0)
    return angle

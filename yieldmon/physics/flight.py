"""Stage 4a, flight: from the paddle's tip to the plate's line [8.17-8.20, appendix K]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .numerics import AnyArray, real
from .stages import Setting


@dataclass(frozen=True, slots=True)
class Meeting:
    """Where and how a path meets the plate's line; miss is a smooth function with the sign of from_low_edge_m."""

    from_low_edge_m: AnyArray
    time_s: AnyArray
    normal_speed_m_s: AnyArray
    tangential_speed_m_s: AnyArray
    miss: AnyArray


def meet_plate(x_m: AnyArray, y_m: AnyArray, vx_m_s: AnyArray, vy_m_s: AnyArray, setting: Setting) -> Meeting:
    """Follow a path under `setting.gravity_m_s2` (0: a straight line) to the plate's line.

    from_low_edge_m is kappa [8.19]: along the plate from its low edge, negative above it. A path that never meets the line has
    from_low_edge_m = inf.
    """
    sin, cos = np.sin(setting.plate_angle_rad), np.cos(setting.plate_angle_rad)
    g = setting.gravity_m_s2
    rx, ry = x_m - setting.plate_pivot_x_m, y_m - setting.plate_pivot_y_m
    gap = ry * cos - rx * sin
    from_top = rx * cos + ry * sin
    vn = vx_m_s * sin - vy_m_s * cos
    vt = vx_m_s * cos + vy_m_s * sin
    if g is not None:
        square = vn * vn - 2.0 * g * cos * gap
        reaches = (real(square) >= 0.0) & (real(vn) > 0.0)
        closing = 0.5 * (vn + np.sqrt(np.where(reaches, square, 0.0)))
        vn_end = np.sqrt(np.where(reaches, square, 0.0))
    else:
        reaches = real(vn) > 0.0
        closing, vn_end = vn, vn
    # Multiplied through by the closing speed, the miss distance has no pole where the path runs along the plate.
    miss = (from_top - setting.machine.plate_length_m) * closing + gap * vt
    safe = np.where(reaches, closing, 1.0)
    time = np.where(reaches, gap / safe, np.inf)
    if g is not None:
        flown = np.where(reaches, time, 0.0)
        fallen = 0.5 * g * sin * flown * flown
        miss = miss + fallen * closing
        vt_end = vt + g * sin * flown
        kappa = from_top - setting.machine.plate_length_m + vt * flown + fallen
    else:
        vt_end = vt
        kappa = miss / safe
    return Meeting(np.where(reaches, kappa, np.inf), time, vn_end, vt_end, miss)

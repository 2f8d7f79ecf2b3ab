"""Stage 4a, flight: from the paddle's tip to the plate's line [8.17-8.20, appendix K]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .numerics import AnyArray, real, sin_cos, sqrt
from .stages import Setting


@dataclass(frozen=True, slots=True)
class Meeting:
    """Where and how a path meets the plate's line."""

    from_low_edge_m: AnyArray
    time_s: AnyArray
    normal_speed_m_s: AnyArray
    tangential_speed_m_s: AnyArray


@dataclass(frozen=True, slots=True)
class _Start:
    """A path's start in the plate's frame: distance to its line, place along it from the top edge, speeds into and along it."""

    gap_m: AnyArray
    from_top_m: AnyArray
    vn_m_s: AnyArray
    vt_m_s: AnyArray
    sin: AnyArray
    cos: AnyArray


def _start(x_m: AnyArray, y_m: AnyArray, vx_m_s: AnyArray, vy_m_s: AnyArray, setting: Setting) -> _Start:
    sin, cos = sin_cos(setting.plate_angle_rad)
    rx, ry = x_m - setting.plate_pivot_x_m, y_m - setting.plate_pivot_y_m
    return _Start(ry * cos - rx * sin, rx * cos + ry * sin, vx_m_s * sin - vy_m_s * cos, vx_m_s * cos + vy_m_s * sin, sin, cos)


def _closing(start: _Start, g: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray]:
    """Under gravity: whether the path reaches the line, its mean and its final speed towards it."""
    square = start.vn_m_s * start.vn_m_s - 2.0 * g * start.cos * start.gap_m
    reaches = (real(square) >= 0.0) & (real(start.vn_m_s) > 0.0)
    final = sqrt(np.where(reaches, square, 0.0))
    return reaches, 0.5 * (start.vn_m_s + final), final


def miss_measure(x_m: AnyArray, y_m: AnyArray, vx_m_s: AnyArray, vy_m_s: AnyArray, setting: Setting) -> AnyArray:
    """A smooth function with the sign of kappa: below 0 where the path meets the plate above its low edge.

    kappa multiplied through by the speed towards the plate, so that it has no pole where the path runs along the plate.
    """
    start = _start(x_m, y_m, vx_m_s, vy_m_s, setting)
    along = start.from_top_m - setting.machine.plate_length_m
    g = setting.gravity_m_s2
    if g is None:
        measure: AnyArray = along * start.vn_m_s + start.gap_m * start.vt_m_s
        return measure
    reaches, closing, _ = _closing(start, g)
    time = np.where(reaches, start.gap_m / np.where(reaches, closing, 1.0), 0.0)
    fallen: AnyArray = 0.5 * g * start.sin * time * time
    measure = (along + fallen) * closing + start.gap_m * start.vt_m_s
    return measure


def meet_plate(x_m: AnyArray, y_m: AnyArray, vx_m_s: AnyArray, vy_m_s: AnyArray, setting: Setting) -> Meeting:
    """Follow a path under `setting.gravity_m_s2` (None: a straight line) to the plate's line.

    from_low_edge_m is kappa [8.19]: along the plate from its low edge, negative above it. A path that never meets the line has
    from_low_edge_m = inf.
    """
    start = _start(x_m, y_m, vx_m_s, vy_m_s, setting)
    g = setting.gravity_m_s2
    along = start.from_top_m - setting.machine.plate_length_m
    if g is None:
        reaches = real(start.vn_m_s) > 0.0
        time = start.gap_m / np.where(reaches, start.vn_m_s, 1.0)
        kappa, vn, vt = along + start.vt_m_s * time, start.vn_m_s, start.vt_m_s
    else:
        reaches, closing, vn = _closing(start, g)
        time = np.where(reaches, start.gap_m / np.where(reaches, closing, 1.0), 0.0)
        kappa = along + start.vt_m_s * time + 0.5 * g * start.sin * time * time
        vt = start.vt_m_s + g * start.sin * time
    if not np.all(reaches):
        kappa, time = np.where(reaches, kappa, np.inf), np.where(reaches, time, np.inf)
    return Meeting(kappa, time, vn, vt)

"""Flow while the plate is away from home, interpolated between the visits home before and after.

A visit is a series of successive windows at home; its flow is their mean. In between, the logarithm of the flow is interpolated
linearly. Deviations from the line are a random walk whose variance per second is estimated from the differences between visits
beyond their noise. Since the flow is known at both ends, the deviation is a Brownian bridge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yieldmon.physics.numerics import Array

_VISIT_GAP_S = 3.0
"""Gap between windows at home from which on they belong to two visits."""


@dataclass(frozen=True, slots=True)
class Visits:
    """Visits home of one sweep in order of time.

    Attributes
    ----------
    time_s : ndarray (visits,)
        Middle of each visit, s.
    log_flow, sd : ndarray (visits,)
        ln(flow, kg/s), and its standard deviation by noise.
    """

    time_s: Array
    log_flow: Array
    sd: Array

    @classmethod
    def of(cls, time_s: Array, flow_kg_s: Array, relative_sd: Array) -> Visits:
        """Build it from the windows at home, arrays (windows,); those without a flow above 0 are left out."""
        with np.errstate(invalid="ignore"):
            known = np.flatnonzero((flow_kg_s > 0.0) & (relative_sd > 0.0))
        order = known[np.argsort(time_s[known], kind="stable")]
        time, log_flow, sd = time_s[order], np.log(flow_kg_s[order]), relative_sd[order]
        if not order.size:
            return cls(time, log_flow, sd)
        number = np.concatenate(([0], np.cumsum(np.diff(time) > _VISIT_GAP_S)))
        count = np.bincount(number)
        return cls(
            np.bincount(number, time) / count,
            np.bincount(number, log_flow) / count,
            np.sqrt(np.bincount(number, sd**2)) / count,
        )

    def __len__(self) -> int:
        return self.time_s.size


@dataclass(frozen=True)
class AwayVisits:
    """Visits away from home of one sweep.

    Attributes
    ----------
    plate_angle_rad, elevator_speed_rad_s, mass_flow_kg_s, force_n : Array
        Of each visit, (visits,), in rad, rad/s, kg/s and N; the flow is interpolated between the visits home before and after.
    moisture_pct : float
        Of the sweep; nan if it is not known.
    force_variance : Array
        Variance of ln(force), (visits,).
    flow_covariance : Array
        Covariance of ln(flow), (visits, visits); visits between the same visits home are correlated.
    """

    plate_angle_rad: Array
    elevator_speed_rad_s: Array
    mass_flow_kg_s: Array
    force_n: Array
    moisture_pct: float
    force_variance: Array
    flow_covariance: Array

    def __len__(self) -> int:
        return self.force_n.size


def wander_per_s(sweeps: Sequence[Visits]) -> float:
    """Variance of the random walk of ln(flow) per second, pooled over sweeps; 0 if noise explains all differences."""
    excess, seconds = 0.0, 0.0
    for visits in sweeps:
        step = np.diff(visits.log_flow)
        excess += float(np.sum(step**2 - visits.sd[1:] ** 2 - visits.sd[:-1] ** 2))
        seconds += float(np.sum(np.diff(visits.time_s)))
    return max(excess, 0.0) / seconds if seconds > 0.0 else 0.0


def bracketed(visits: Visits, time_s: Array, wander: float, *, at_home: NDArray[np.bool_] | None = None) -> tuple[Array, Array]:
    """Interpolated ln(flow) at given times.

    Parameters
    ----------
    visits : Visits
    time_s : ndarray (t,)
    wander : float
        See `wander_per_s`.
    at_home : ndarray of bool (t,), optional
        Times at which the plate is at home. For these the flow is interpolated without their own visit, so that the first and
        last visit have none.

    Returns
    -------
    ndarray (t,), ndarray (t,)
        ln(flow) and its standard deviation; nan before the first and after the last visit.
    """
    value, sd = np.full(time_s.shape, np.nan), np.full(time_s.shape, np.nan)
    for i, at in enumerate(time_s):
        time, log_flow, spread = visits.time_s, visits.log_flow, visits.sd
        if at_home is not None and at_home[i] and len(visits):
            others = np.arange(len(visits)) != int(np.argmin(np.abs(time - at)))
            time, log_flow, spread = time[others], log_flow[others], spread[others]
        right = int(np.searchsorted(time, at))
        if right == 0 or right == len(time):
            continue
        span = time[right] - time[right - 1]
        share = (at - time[right - 1]) / span
        value[i] = (1.0 - share) * log_flow[right - 1] + share * log_flow[right]
        noise = ((1.0 - share) * spread[right - 1]) ** 2 + (share * spread[right]) ** 2
        sd[i] = np.sqrt(noise + wander * span * share * (1.0 - share))
    return value, sd


def covariance(visits: Visits, time_s: Array, wander: float) -> Array:
    """Covariance of the errors of `bracketed` at ascending times away from home, (t, t); nan before the first and after the last
    visit.

    Times between the same visits have their noise and the random walk between them in common.
    """
    share = np.full((time_s.size, max(len(visits), 1)), np.nan)
    bridge = np.zeros((time_s.size, time_s.size))
    right = np.searchsorted(visits.time_s, time_s)
    inside = np.flatnonzero((right > 0) & (right < len(visits)))
    for i in inside:
        before, span = right[i] - 1, visits.time_s[right[i]] - visits.time_s[right[i] - 1]
        part = (time_s[i] - visits.time_s[before]) / span
        share[i] = 0.0
        share[i, before], share[i, right[i]] = 1.0 - part, part
        for j in inside[right[inside] == right[i]]:
            other = (time_s[j] - visits.time_s[before]) / span
            bridge[i, j] = wander * span * min(part, other) * (1.0 - max(part, other))
    spread = visits.sd if len(visits) else np.full(1, np.nan)
    return np.asarray((share * spread**2) @ share.T + bridge)

"""Arrival of a dense stream of grain at the plate, as a law relative to the arrival along straight paths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from yieldmon.physics.machine import RPM
from yieldmon.physics.numerics import AnyArray, Array

_LEAST_FILL = 0.02
"""Ratio of load to a full paddle below which a law is constant; it is also constant above 1."""
BEYOND_FILL = 1.1
BEYOND_SPEED = 1.1
BEYOND_ANGLE_RAD = float(np.deg2rad(5.0))
TERMS = 15
"""Number of terms of an `ArrivalLaw`."""


@dataclass(frozen=True, slots=True)
class ArrivalLaw:
    """Difference of a dense stream's arrival from that along straight paths, from a calibration.

    ln stretch and ln tail are each a sum of coefficients times, in this order,

        1, x, c, xc, c^2, x^2, xc^2, x^2 c, r, p, xr, xp, cr, cp, rp

    x: ln of load over a full paddle, c: cosine of the plate angle, r and p: ln of elevator speed and of friction over those of
    `reference`. Coefficients not given are 0. Stretch: ratio of the duration of the arrival to that along straight paths, by
    collisions between grains. Tail: mean time (s) for which grain still pushes after its path has met the plate, exponentially
    distributed.

    Attributes
    ----------
    stretch : tuple of float
    tail : tuple of float or None
        None: no tail.
    covariance : tuple of 3 float
        Deviation of ln stretch and ln tail from the law: variance of each, covariance.
    delay : tuple of float
        Mean delay (s) of the whole pulse, in the same terms; only if an index on the chain gives the position of the paddles.
    delay_sd_s : float
        Standard deviation of the delay about the law.
    reference : tuple of 2 float
        Elevator speed (rad/s) and friction at which r and p are 0.
    fills : tuple of 2 float
        Range of load over a full paddle in the calibration; (0, inf) if the law is not from a calibration.
    plate_angles_rad, elevator_speeds_rad_s : tuple of 2 float
        The same for plate angle and elevator speed.
    """

    stretch: tuple[float, ...] = ()
    tail: tuple[float, ...] | None = None
    covariance: tuple[float, float, float] = (0.0, 0.0, 0.0)
    delay: tuple[float, ...] = ()
    delay_sd_s: float = 0.0
    reference: tuple[float, float] = (400.0 * RPM, 0.3)
    fills: tuple[float, float] = (0.0, float("inf"))
    plate_angles_rad: tuple[float, float] = (-float("inf"), float("inf"))
    elevator_speeds_rad_s: tuple[float, float] = (0.0, float("inf"))

    def conditions(
        self, plate_angle_rad: ArrayLike, elevator_speed_rad_s: ArrayLike, friction: float
    ) -> tuple[Array, Array, Array]:
        """c, r and p of the law; angles and speeds broadcast against fills."""
        speed, usual = self.reference
        cosine, faster = np.cos(plate_angle_rad), np.log(np.asarray(elevator_speed_rad_s) / speed)
        return np.asarray(cosine), np.asarray(faster), np.asarray(np.log(friction / usual))

    def delay_s(self, fill: AnyArray, conditions: tuple[Array, Array, Array]) -> Array:
        """Mean delay at fills, s."""
        return law_and_slope(self.delay, fill, conditions)[0]

    def log_stretch(self, fill: AnyArray, conditions: tuple[Array, Array, Array]) -> Array:
        """ln stretch at fills."""
        return law_and_slope(self.stretch, fill, conditions)[0]

    def tail_s(self, fill: AnyArray, conditions: tuple[Array, Array, Array]) -> Array:
        """Tail at fills, s."""
        if self.tail is None:
            return np.zeros(np.shape(fill))
        return np.asarray(np.exp(law_and_slope(self.tail, fill, conditions)[0]))

    def outside(self, fill: float, plate_angle_rad: float, elevator_speed_rad_s: float) -> str:
        """Reason why the law does not apply; "" if it does.

        Values may lie beyond those of the calibration by BEYOND_FILL, BEYOND_SPEED (factors) and BEYOND_ANGLE_RAD.
        """
        least, largest = self.fills
        if not least / BEYOND_FILL <= fill <= largest * BEYOND_FILL:
            return f"load {fill:.2f} of a full paddle, calibrated {least:.2f} to {largest:.2f}"
        low, high = self.plate_angles_rad
        if not low - BEYOND_ANGLE_RAD <= plate_angle_rad <= high + BEYOND_ANGLE_RAD:
            shown, first, last = np.rad2deg([plate_angle_rad, low, high])
            return f"plate at {shown:.0f} deg, calibrated {first:.0f} to {last:.0f} deg"
        slow, fast = self.elevator_speeds_rad_s
        if not slow / BEYOND_SPEED <= elevator_speed_rad_s <= fast * BEYOND_SPEED:
            shown, first, last = np.array([elevator_speed_rad_s, slow, fast]) / RPM
            return f"elevator at {shown:.0f} rpm, calibrated {first:.0f} to {last:.0f} rpm"
        return ""


def features(fill: float, conditions: tuple[Array, Array, Array]) -> Array:
    """Values of the terms of a law at a fill, (TERMS,)."""
    x = float(np.log(min(max(fill, _LEAST_FILL), 1.0)))
    c, r, p = (float(v) for v in conditions)
    return np.array([1.0, x, c, x * c, c * c, x * x, x * c * c, x * x * c, r, p, x * r, x * p, c * r, c * p, r * p])


def law_and_slope(coefficients: tuple[float, ...], fill: AnyArray, conditions: tuple[Array, Array, Array]) -> tuple[Array, Array]:
    """A law's value at fills, and its derivative with respect to ln fill."""
    k = (*coefficients, *(0.0,) * (TERMS - len(coefficients)))
    c, r, p = conditions
    one = k[0] + c * (k[2] + k[4] * c) + k[8] * r + k[9] * p + c * (k[12] * r + k[13] * p) + k[14] * r * p
    line = k[1] + c * (k[3] + k[6] * c) + k[10] * r + k[11] * p
    square = k[5] + k[7] * c
    log_fill = np.log(np.minimum(np.maximum(fill, _LEAST_FILL), 1.0))
    inside = (fill >= _LEAST_FILL) & (fill <= 1.0)
    return np.asarray(one + log_fill * (line + square * log_fill)), np.where(inside, line + 2.0 * square * log_fill, 0.0)

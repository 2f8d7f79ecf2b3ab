"""Calibration of an arrival law from waves at known volume flows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from yieldmon.physics.numerics import Array

from .arrival_law import TERMS, ArrivalLaw, features
from .pattern_fold import PatternWave
from .pulse_fit import PulseEstimate
from .pulse_model import GAIN, SHIFT, PulseModel
from .pulse_shape import estimate, look_for_start

Terms = tuple[Sequence[int], Sequence[int], Sequence[int]]
_TYPICAL_LOG_TAIL = float(np.log(0.004))


@dataclass(frozen=True)
class ArrivalPoint:
    """Arrival of the pulses at one known volume flow.

    Attributes
    ----------
    features : ndarray (TERMS,)
        Terms of the law at these conditions (`arrival_law.features`).
    found : ndarray (3,)
        Fitted ln stretch, ln tail (s) and delay (s).
    fill, plate_angle_rad, elevator_speed_rad_s : float
    """

    features: Array
    found: Array
    fill: float
    plate_angle_rad: float
    elevator_speed_rad_s: float


def arrival_point(pulses: PulseModel, wave: PatternWave, volume_flow_m3_s: float) -> ArrivalPoint:
    """Fit stretch, tail and delay to a wave at a known flow.

    The model's own arrival law is not used; friction, shape_ratio and cell are held at their means.
    """
    wide = ArrivalLaw(tail=(_TYPICAL_LOG_TAIL,), covariance=(0.3**2, 0.7**2, 0.0))
    sd = {**pulses.settings.sd, "log_volume_flow": 0.0, "log_friction": 0.0, "log_shape_ratio": 0.0, "log_cell": 0.0}
    held = PulseModel(pulses.model, pulses.parameters, replace(pulses.settings, arrival=wide, sd=sd))
    values = _at_flow(held, wave, volume_flow_m3_s).values
    fill = pulses.mean_fill(volume_flow_m3_s, wave.elevator_speed_rad_s)
    where = wide.conditions(wave.plate_angle_rad, wave.elevator_speed_rad_s, pulses.parameters["friction"])
    found = np.array([values["log_stretch"], values["log_tail"] + _TYPICAL_LOG_TAIL, values["shift_s"]])
    return ArrivalPoint(features(fill, where), found, fill, wave.plate_angle_rad, wave.elevator_speed_rad_s)


def law_of(points: Sequence[ArrivalPoint], *, terms: int | Terms, indexed: bool = False) -> ArrivalLaw:
    """Fit a law to points by least squares.

    Parameters
    ----------
    points : sequence
        More points than free terms.
    terms : int or tuple
        Free coefficients of stretch, tail and delay: a number of the first terms of `ArrivalLaw`, or the indices for each. One
        plate angle determines two.
    indexed : bool
        Whether the law has a delay.

    Returns
    -------
    ArrivalLaw
        `covariance` from the residuals; `fills`, `plate_angles_rad` and `elevator_speeds_rad_s` are the ranges of the points.

    Raises
    ------
    ValueError
        For too few points.
    """
    chosen = tuple(tuple(range(terms)) for _ in range(3)) if isinstance(terms, int) else terms
    most = max(map(len, chosen))
    if len(points) <= most:
        raise ValueError(f"{len(points)} waves, expected more than {most}, the terms of the law")
    rows, targets = (np.array([getattr(point, name) for point in points]) for name in ("features", "found"))
    laws, left = zip(*map(partial(_fitted_law, rows), chosen, targets.T), strict=True)
    spread = np.array(left) @ np.array(left).T
    fills, angles, speeds = (
        [getattr(point, name) for point in points] for name in ("fill", "plate_angle_rad", "elevator_speed_rad_s")
    )
    return ArrivalLaw(
        laws[0],
        laws[1],
        (float(spread[0, 0]), float(spread[1, 1]), float(spread[0, 1])),
        delay=laws[2] if indexed else (),
        delay_sd_s=float(np.sqrt(spread[2, 2])) if indexed else 0.0,
        fills=(min(fills), max(fills)),
        plate_angles_rad=(min(angles), max(angles)),
        elevator_speeds_rad_s=(min(speeds), max(speeds)),
    )


def _fitted_law(rows: Array, places: Sequence[int], target: Array) -> tuple[tuple[float, ...], Array]:
    """Coefficients (TERMS,) of a law with some free terms, and its residuals (waves,) / sqrt(degrees of freedom).

    rows: (waves, TERMS), from `features`. target: (waves,).
    """
    table = rows[:, list(places)]
    found = np.linalg.lstsq(table, target, rcond=None)[0]
    whole = np.zeros(TERMS)
    whole[list(places)] = found
    return tuple(float(v) for v in whole), (target - table @ found) / np.sqrt(len(target) - len(places))


def _at_flow(pulses: PulseModel, wave: PatternWave, volume_flow_m3_s: float) -> PulseEstimate:
    """The fit with a fixed flow."""
    near = look_for_start(pulses, wave)
    begin = pulses.start(volume_flow_m3_s, shift_s=float(near[SHIFT]), log_gain=float(near[GAIN]))
    return estimate(pulses, wave, start=begin, centre=begin.copy())

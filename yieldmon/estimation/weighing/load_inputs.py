"""Input of a calibration by loads: weighed masses with their windows, and the prior assumptions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from yieldmon.estimation.self_calibration.closed_loop_inputs import WEIGHED_COLUMNS
from yieldmon.physics.numerics import Array

_GROUPS = 12
"""Largest number of groups of similar force into which the windows of one angle and speed are condensed."""


@dataclass(frozen=True, slots=True)
class LoadSettings:
    """Prior assumptions of a calibration by loads.

    Attributes
    ----------
    load_error : float
        Relative standard deviation of a load's measured mass by the zero's drift and the model, without the scale's error and the
        windows' scatter (measured in studies/setup).
    density_sd, gain_sd : float
        Relative standard deviations of a machine that was never calibrated.
    least_information : float
        Least ratio of the loads' information on a direction to the prior's; with less, the direction is held.
    outlier_sds : float
        Deviation from the other loads, in standard deviations, from which a load is an outlier.
    outlier_least : int
        Least number of loads for which it can be decided which one is wrong.
    huber_sds : float
        Deviation, in standard deviations, from which a load loses weight.
    law_error : float
        Relative error of the model's force that remains once density and gain are fitted; 3 % for the published discrete-element
        table.
    law_reach : float
        Correlation length of that error in ln flow.
    """

    load_error: float = 0.002
    density_sd: float = 0.2
    gain_sd: float = 0.2
    least_information: float = 1.0
    outlier_sds: float = 4.0
    outlier_least: int = 4
    huber_sds: float = 1.5
    law_error: float = 0.03
    law_reach: float = 0.5


@dataclass(frozen=True)
class WeighedLoad:
    """A weighed mass and the windows in which it was harvested.

    Attributes
    ----------
    name : str
    weighed_kg, std_dev_kg : float
        Weighed mass and its standard deviation, kg.
    duration_s : ndarray (n,)
        Time that each window counts for, s.
    force_n, plate_angle_rad, elevator_speed_rad_s : ndarray (n,)
        N, rad, rad/s.
    moisture_pct : ndarray (n,), optional
    noise_sd : float
        Relative standard deviation of the measured mass by the windows' scatter, which averages out over a long load; 0 if it is
        not known.
    common_kg : float
        The part of `std_dev_kg` that comes from another combine's monitor, kg. Its error is the same in all loads.

    Raises
    ------
    ValueError
        For shapes that differ, or values that are not finite or out of range.
    """

    name: str
    weighed_kg: float
    std_dev_kg: float
    duration_s: Array
    force_n: Array
    plate_angle_rad: Array
    elevator_speed_rad_s: Array
    moisture_pct: Array | None = None
    noise_sd: float = 0.0
    common_kg: float = 0.0

    def __post_init__(self) -> None:
        if not (0.0 < self.weighed_kg < np.inf and 0.0 < self.std_dev_kg < np.inf):
            raise ValueError(f"load {self.name}: weighed {self.weighed_kg} kg, sd {self.std_dev_kg} kg; expected above 0")
        if not 0.0 <= self.common_kg <= self.std_dev_kg:
            raise ValueError(f"load {self.name}: common_kg {self.common_kg}; expected 0 to its sd, {self.std_dev_kg} kg")
        if not 0.0 <= self.noise_sd < np.inf:
            raise ValueError(f"load {self.name}: noise_sd {self.noise_sd}; expected 0 or above")
        for name in WEIGHED_COLUMNS:
            value = getattr(self, name)
            if value.shape != self.force_n.shape or value.ndim != 1 or not value.size or not np.all(np.isfinite(value)):
                raise ValueError(f"load {self.name}: {name} must hold one finite number for each window")

    @property
    def relative_sd(self) -> float:
        """Relative standard deviation of the weighed mass."""
        return self.std_dev_kg / self.weighed_kg

    @property
    def mean_moisture_pct(self) -> float:
        """Mean moisture of the grain, weighted by force and time; nan if it is not known."""
        if self.moisture_pct is None:
            return float("nan")
        known = np.isfinite(self.moisture_pct)
        weight = np.where(known, self.duration_s * np.maximum(self.force_n, 0.0), 0.0)
        if not weight.sum() > 0.0:
            return float("nan")
        return float(np.average(np.where(known, self.moisture_pct, 0.0), weights=weight))

    def measured_sd(self, load_error: float) -> float:
        """Relative standard deviation of the measured mass, given the true parameters."""
        return float(np.hypot(load_error, self.noise_sd))

    @cached_property
    def condensed(self) -> WeighedLoad:
        """The load with windows of similar force replaced by their mean: at most `_GROUPS` for each angle and speed."""
        key = np.stack((np.round(self.plate_angle_rad / np.radians(2.0)), np.round(np.log(self.elevator_speed_rad_s) / 0.03)))
        _, place = np.unique(key, axis=1, return_inverse=True)
        parts: list[NDArray[np.intp]] = []
        for value in np.unique(place):
            here = np.flatnonzero(place.ravel() == value)
            order = here[np.argsort(self.force_n[here], kind="stable")]
            parts += [p for p in np.array_split(order, min(_GROUPS, order.size)) if self.duration_s[p].sum() > 0.0]

        def mean(column: Array) -> Array:
            return np.array([np.average(column[p], weights=self.duration_s[p]) for p in parts])

        return replace(
            self,
            duration_s=np.array([self.duration_s[p].sum() for p in parts]),
            force_n=mean(self.force_n),
            plate_angle_rad=mean(self.plate_angle_rad),
            elevator_speed_rad_s=mean(self.elevator_speed_rad_s),
            moisture_pct=None if self.moisture_pct is None else mean(self.moisture_pct),
        )

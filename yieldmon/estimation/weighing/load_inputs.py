"""Data of a calibration by loads: weighed masses with their windows, and what is assumed before them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from yieldmon.estimation.self_calibration.closed_loop_inputs import WEIGHED_COLUMNS
from yieldmon.physics.numerics import Array

_GROUPS = 12
"""Of windows of like force, into which those of one angle and speed are condensed at most."""


@dataclass(frozen=True, slots=True)
class LoadSettings:
    """What is assumed before the loads.

    load_error: relative standard deviation of a load's measured mass beside the scale's and the windows' scatter: what the
    zero's wandering and the model leave (measured: studies/setup). density_sd, gain_sd: relative, of a machine that was never
    calibrated. least_information: of the loads on a direction, over what was known; below it, it is held.
    outlier_sds: departure from the other loads that is no scatter. huber_sds: departure from which a load loses weight.
    law_error, law_reach: what the model's force leaves of a machine's once density and gain are fitted, relative, and over which
    change of ln flow that changes: neither a wrong ticket nor scatter. Of the published discrete-element table it is 3 %.
    """

    load_error: float = 0.002
    density_sd: float = 0.2
    gain_sd: float = 0.2
    least_information: float = 1.0
    outlier_sds: float = 4.0
    outlier_least: int = 4
    """Loads below which it is not known which one is wrong."""
    huber_sds: float = 1.5
    law_error: float = 0.03
    law_reach: float = 0.5


@dataclass(frozen=True)
class WeighedLoad:
    """A weighed mass and the windows in which it was harvested, all arrays (n,).

    duration_s: time that each window stands for. noise_sd: relative standard deviation of the measured mass by the windows'
    scatter, which averages out over a long load; 0 where it is not known. common_kg: the part of std_dev_kg by another combine's
    monitor, the same error in all loads that have one. Raises ValueError for shapes that differ or values that are not finite.
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
        """Of the weighed mass."""
        return self.std_dev_kg / self.weighed_kg

    @property
    def mean_moisture_pct(self) -> float:
        """Of its grain, weighed by the force; nan where it is not known."""
        if self.moisture_pct is None:
            return float("nan")
        known = np.isfinite(self.moisture_pct)
        weight = np.where(known, self.duration_s * np.maximum(self.force_n, 0.0), 0.0)
        if not weight.sum() > 0.0:
            return float("nan")
        return float(np.average(np.where(known, self.moisture_pct, 0.0), weights=weight))

    def measured_sd(self, load_error: float) -> float:
        """Relative standard deviation of the measured mass, where the parameters are right."""
        return float(np.hypot(load_error, self.noise_sd))

    @cached_property
    def condensed(self) -> WeighedLoad:
        """Windows of like force, at like angle and speed, replaced by their mean: at most `_GROUPS` for each angle and speed."""
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

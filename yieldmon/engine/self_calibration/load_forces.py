"""The forces over each load, or between two readings of a tank scale, summarised in groups of windows, so that a weighed mass can
be compared with the model."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from math import inf, isfinite, log, nan
from typing import NamedTuple

import numpy as np

from yieldmon.physics.numerics import Array

_KEPT_LOADS = 64
_ANGLE_RAD = 0.035
"""Width of the groups of windows in plate angle, in ln(speed) and in ln(force)."""
_LN_SPEED, _LN_FORCE = 0.03, 0.1


@dataclass(frozen=True, slots=True)
class LoadForces:
    """Groups of windows of one load, all arrays (n,). duration_s: that a group stands for; moisture_pct: nan where not known."""

    duration_s: Array
    force_n: Array
    plate_angle_rad: Array
    elevator_speed_rad_s: Array
    moisture_pct: Array


class WindowForces(NamedTuple):
    """Of a window with grain; nan where a value is not known. seconds: that its mass stands for."""

    seconds: float
    force_n: float
    angle_rad: float
    speed_rad_s: float
    moisture_pct: float = nan

    def share(self, share: float) -> WindowForces:
        """The same of a share of the window's mass."""
        return self._replace(seconds=share * self.seconds)


class LoadForceSums:
    """Group sums over the loads of a run."""

    def __init__(self) -> None:
        self._loads: OrderedDict[int, dict[tuple[int, int, int], list[float]]] = OrderedDict()
        self._unknown_kg: dict[int, float] = {}
        self._known_kg: dict[int, float] = {}

    def add(self, load_number: int, mass_kg: float, window: WindowForces) -> None:
        """A window that added mass_kg to a load."""
        if mass_kg <= 0.0:
            return
        seconds, force_n, angle_rad, speed_rad_s, moisture_pct = window
        usable = 0.0 < force_n < inf and 0.0 < speed_rad_s < inf and isfinite(angle_rad)
        masses = self._known_kg if usable else self._unknown_kg
        masses[load_number] = masses.get(load_number, 0.0) + mass_kg
        if not usable:
            return
        if load_number not in self._loads:
            self._loads[load_number] = {}
            while len(self._loads) > _KEPT_LOADS:
                gone, _ = self._loads.popitem(last=False)
                self._known_kg.pop(gone, None)
                self._unknown_kg.pop(gone, None)
        key = round(angle_rad / _ANGLE_RAD), round(log(speed_rad_s) / _LN_SPEED), round(log(force_n) / _LN_FORCE)
        sums = self._loads[load_number].setdefault(key, [0.0] * 6)
        sums[0] += seconds
        sums[1] += seconds * force_n
        sums[2] += seconds * angle_rad
        sums[3] += seconds * speed_rad_s
        if isfinite(moisture_pct):
            sums[4] += seconds * moisture_pct
            sums[5] += seconds

    def forget(self) -> None:
        """Another zero changed the masses: the forces measured until now no longer belong to them and become unknown."""
        self._loads.clear()
        for load_number, mass_kg in self._known_kg.items():
            self._unknown_kg[load_number] = self._unknown_kg.get(load_number, 0.0) + mass_kg
        self._known_kg.clear()

    def of(self, load_number: int) -> LoadForces | None:
        """The groups of a load, scaled up for its few windows without a usable force; None where more than 10 % of the mass has
        none."""
        groups = self._loads.get(load_number)
        known, unknown = self._known_kg.get(load_number, 0.0), self._unknown_kg.get(load_number, 0.0)
        if not groups or unknown > 0.1 * known:
            return None
        table = np.array([groups[key] for key in sorted(groups)])
        seconds = table[:, 0]
        share = (known + unknown) / known
        with np.errstate(invalid="ignore", divide="ignore"):
            moisture = np.where(table[:, 5] > 0.5 * seconds, table[:, 4] / table[:, 5], nan)
        force, angle, speed = (table[:, 1:4] / seconds[:, None]).T.copy()
        return LoadForces(seconds * share, force, angle, speed, moisture)

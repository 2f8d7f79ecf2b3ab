"""Recorded seconds as arrays: their forces and conditions, and the time for which each counts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from yieldmon.estimation.estimators import estimator_of
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import Array
from yieldmon.service.storage.rows import SecondRow


@dataclass(frozen=True)
class ForceSeconds:
    """Seconds of loads.

    Parameters
    ----------
    duration_s : ndarray
        (n,) time for which each second's flow, by the parameters that measured it, gives its mass, s; NaN where unknown.
    force_n, plate_angle_rad, elevator_speed_rad_s, moisture_pct, mass_kg : ndarray
        (n,) as measured; NaN where unknown.
    """

    duration_s: Array
    force_n: Array
    plate_angle_rad: Array
    elevator_speed_rad_s: Array
    moisture_pct: Array
    mass_kg: Array

    def take(self, chosen: NDArray[np.bool_]) -> ForceSeconds:
        """Some of the seconds."""
        return ForceSeconds(*(getattr(self, column.name)[chosen] for column in fields(self)))

    @classmethod
    def joined(cls, parts: Iterable[ForceSeconds]) -> ForceSeconds:
        """Seconds one after another; empty without parts."""
        known = list(parts)
        return cls(*(np.concatenate([np.zeros(0), *(getattr(part, column.name) for part in known)]) for column in fields(cls)))


def force_seconds(rows: Sequence[SecondRow], parameters: ParameterSet, machine: Machine) -> ForceSeconds:
    """Seconds that one set of parameters measured."""

    def column(attribute: str) -> Array:
        return np.array([np.nan if (v := getattr(row, attribute)) is None else v for row in rows], dtype=float)

    force, angle, speed = column("force_n"), np.radians(column("plate_angle_deg")), column("elevator_speed_rpm") * RPM
    moisture, mass = column("moisture_pct"), column("mass_kg")
    model = ForwardModel(machine, parameters.effects)
    usable = np.isfinite(force) & np.isfinite(angle) & np.isfinite(speed) & (force > 0.0)
    if model.needs_moisture:
        usable &= np.isfinite(moisture)
    flow = np.full(force.shape, np.nan)
    if np.any(usable):
        flow[usable] = estimator_of(machine, parameters, model).invert(
            force[usable], angle[usable], speed[usable], moisture[usable]
        )
    with np.errstate(divide="ignore", invalid="ignore"):
        duration = np.where(flow > 0.0, mass / flow, np.nan)
    return ForceSeconds(duration, force, angle, speed, moisture, mass)


def known_seconds(rows: Sequence[SecondRow], sets: Mapping[int, ParameterSet], machine: Machine) -> ForceSeconds:
    """The seconds of a load whose mass rests on a known force, angle and speed, in the order of the parameters' versions.

    Parameters
    ----------
    rows : sequence of SecondRow
    sets : mapping of int to ParameterSet
        Parameters by version; seconds of other versions are left out.
    machine : Machine
    """
    versions = sorted({row.parameter_version for row in rows} & set(sets))
    parts = (force_seconds([row for row in rows if row.parameter_version == v], sets[v], machine) for v in versions)
    found = ForceSeconds.joined(parts)
    return found.take(np.isfinite(found.duration_s) & (found.duration_s > 0.0))

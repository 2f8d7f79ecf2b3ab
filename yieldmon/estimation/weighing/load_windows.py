"""The windows of several weighed loads, one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yieldmon.estimation.self_calibration.closed_loop_inputs import joined
from yieldmon.physics.numerics import Array

from .load_inputs import WeighedLoad


@dataclass(frozen=True)
class LoadWindows:
    """The w windows of n loads.

    Attributes
    ----------
    loads : int
        n.
    of_load : ndarray of int (w,)
        Index of each window's load.
    duration_s, force_n, plate_angle_rad, elevator_speed_rad_s : ndarray (w,)
    moisture_pct : ndarray (w,) or None
        None if the moisture of a load is not known.
    """

    loads: int
    of_load: NDArray[np.intp]
    duration_s: Array
    force_n: Array
    plate_angle_rad: Array
    elevator_speed_rad_s: Array
    moisture_pct: Array | None

    @classmethod
    def of(cls, loads: Sequence[WeighedLoad]) -> LoadWindows:
        """The windows of these loads."""
        known = all(load.moisture_pct is not None for load in loads)
        return cls(
            len(loads),
            np.repeat(np.arange(len(loads)), [load.force_n.size for load in loads]),
            *joined(loads),
            np.concatenate([np.asarray(load.moisture_pct) for load in loads]) if known else None,
        )

    def total_kg(self, flow_kg_s: Array) -> Array:
        """Mass of each load from a flow of each window, kg, (n,)."""
        return np.asarray(np.bincount(self.of_load, self.duration_s * flow_kg_s, minlength=self.loads), dtype=float)

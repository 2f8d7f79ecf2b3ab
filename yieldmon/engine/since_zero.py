"""Seconds since the operator's last zero calibration, kept so that they can be measured again with the zero before it."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from math import isfinite

import numpy as np

from yieldmon.engine.records import FlowEstimator, WindowRecord

KEPT_S = 7200
"""Newest seconds that are kept."""


@dataclass(frozen=True, slots=True)
class KeptSecond:
    """What of a second it takes to measure it again; nan where not known."""

    load_number: int
    duration_s: float
    mass_kg: float
    coverage: float
    zero_mv: float
    force_n: float
    force_std_dev_n: float
    plate_angle_rad: float
    elevator_speed_rad_s: float
    moisture_pct: float

    @classmethod
    def of(cls, record: WindowRecord) -> KeptSecond:
        """Of a window's record."""
        return cls(*(getattr(record, name) for name in cls.__dataclass_fields__))


class SinceZero:
    """The seconds, and the mass that the tank scale put in their place."""

    def __init__(self) -> None:
        self._seconds: deque[KeptSecond] = deque(maxlen=KEPT_S)
        self._by_scale: dict[int, float] = {}

    def clear(self) -> None:
        """Another zero from now on."""
        self._seconds.clear()
        self._by_scale.clear()

    def add(self, seconds: Iterable[KeptSecond]) -> None:
        """Further seconds."""
        self._seconds.extend(seconds)

    def add_scale(self, load_number: int, mass_kg: float) -> None:
        """Mass that joined a load because the tank scale showed it."""
        self._by_scale[load_number] = self._by_scale.get(load_number, 0.0) + mass_kg

    @property
    def seconds(self) -> tuple[KeptSecond, ...]:
        """The newest of them, in order."""
        return tuple(self._seconds)

    @property
    def by_scale(self) -> dict[int, float]:
        """Load number -> kg, for a restart."""
        return dict(self._by_scale)

    def missed(self, zero_mv: float, estimator: FlowEstimator, gain_n_per_mv: float, grain_on_n: float) -> dict[int, float]:
        """Load number -> kg that the seconds miss where zero_mv is the zero; forces up to grain_on_n are no grain."""
        rows = [s for s in self._seconds if isfinite(s.zero_mv) and isfinite(s.force_n) and s.coverage > 0.0]
        force = np.array([s.force_n + (s.zero_mv - zero_mv) * gain_n_per_mv for s in rows])
        loaded = force > grain_on_n
        rows, force = [s for s, ok in zip(rows, loaded, strict=True) if ok], force[loaded]
        missed = {number: -kg for number, kg in self._by_scale.items()}
        if not rows:
            return missed
        columns = np.array([(s.plate_angle_rad, s.elevator_speed_rad_s, s.force_std_dev_n, s.moisture_pct) for s in rows]).T
        flow = np.nan_to_num(estimator.estimate(force, *columns).mass_flow_kg_s)
        for second, rate in zip(rows, flow.tolist(), strict=True):
            kg = rate * second.duration_s - second.mass_kg
            missed[second.load_number] = missed.get(second.load_number, 0.0) + kg
        return missed

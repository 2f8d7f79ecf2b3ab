"""Reference masses: what a scale weighed against what was measured over the same grain."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import StrEnum

from yieldmon.engine.settings import AnchorSettings


class AnchorSource(StrEnum):
    """Where a reference mass came from."""

    TANK_SCALE = "tank scale"
    TICKET = "ticket"


@dataclass(frozen=True, slots=True)
class ReferenceMass:
    """A weighed mass and the mass measured over the same time, kg; times are bus time, s.

    complete: every second in between was measured. load_number is 0 where the weighing belongs to no load.
    """

    source: AnchorSource
    start_s: float
    end_s: float
    reference_kg: float
    std_dev_kg: float
    measured_kg: float
    complete: bool
    load_number: int = 0


@dataclass(frozen=True, slots=True)
class _Weighing:
    time_s: float
    mass_kg: float
    measured_kg: float


class TankScale:
    """Increments of a tank scale between stable readings."""

    def __init__(self, settings: AnchorSettings) -> None:
        self._settings = settings
        self._pending: tuple[float, float] | None = None
        self._start: _Weighing | None = None
        self._complete = True
        self.anchors: deque[ReferenceMass] = deque(maxlen=settings.keep)

    def reading(self, time_s: float, mass_kg: float) -> None:
        """A stable reading; it is matched with the measured total when the window around it closes."""
        self._pending = (time_s, mass_kg)

    def window(self, start_s: float, end_s: float, total_before_kg: float, mass_kg: float, measured: bool) -> bool:
        """A window that measured (or failed to measure) mass_kg between two times; the total before it.

        Returns whether a reference mass has come of it.
        """
        if not measured:
            self._complete = False
        if self._pending is None:
            return False
        time_s, scale_kg = self._pending
        if time_s > end_s:
            return False
        self._pending = None
        share = min(1.0, max(0.0, (time_s - start_s) / (end_s - start_s))) if end_s > start_s else 1.0
        return self._weigh(_Weighing(time_s, scale_kg, total_before_kg + share * mass_kg))

    def _weigh(self, now: _Weighing) -> bool:
        start = self._start
        if start is None or now.mass_kg < start.mass_kg - self._settings.unloading_kg:
            self._start, self._complete = now, True
            return False
        increment = now.mass_kg - start.mass_kg
        if increment < self._settings.min_increment_kg:
            return False
        self.anchors.append(
            ReferenceMass(
                source=AnchorSource.TANK_SCALE,
                start_s=start.time_s,
                end_s=now.time_s,
                reference_kg=increment,
                std_dev_kg=2.0**0.5 * self._settings.scale_std_dev_kg,
                measured_kg=now.measured_kg - start.measured_kg,
                complete=self._complete,
            )
        )
        self._start, self._complete = now, True
        return True

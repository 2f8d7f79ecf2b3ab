"""Reference masses from a tank scale: the increase between two stable readings."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, replace

from yieldmon.engine.duplicate_senders import tank_leaps
from yieldmon.engine.mass.budget import EMPTY, MassBudget
from yieldmon.engine.self_calibration.load_forces import LoadForceSums, WindowForces
from yieldmon.engine.self_calibration.reference_mass import ReferenceMass, ReferenceSource
from yieldmon.engine.settings import ReferenceMassSettings

_AS_BEFORE_SDS = 4.0
"""Standard deviations of the scale within which two readings mean the same mass."""
_LACKING_SHARE = 0.5
"""Share of the measured mass missing in the tank above which grain was unloaded: no calibration is that wrong."""


@dataclass(frozen=True, slots=True)
class _Weighing:
    time_s: float
    mass_kg: float
    measured_kg: float
    budget: MassBudget


class TankScale:
    """Increments of a tank scale between stable readings."""

    def __init__(self, settings: ReferenceMassSettings) -> None:
        self._settings = settings
        self._pending: tuple[float, float] | None = None
        self._start: _Weighing | None = None
        self._last: _Weighing | None = None
        self._complete = True
        self._zero_doubted = False
        self._forces = LoadForceSums()
        self._number = 0
        """Key of the increment under way in `_forces`."""
        self.masses: deque[ReferenceMass] = deque(maxlen=settings.keep)

    def reading(self, time_s: float, mass_kg: float) -> None:
        """Take a stable reading; it is matched with the measured total when the window around it closes."""
        self._pending = (time_s, mass_kg)

    def forget(self) -> None:
        """Discard all readings: the next one is a new start."""
        self._pending = self._start = self._last = None

    def doubt_zero(self) -> None:
        """The zero is suspect: the increment under way is no reference, but its mass can replace the measured one."""
        self._complete, self._zero_doubted = False, True

    def empty_since(self, time_s: float) -> None:
        """No grain has come since a time: an increment that began then is complete although it was not measured."""
        if self._start is not None and self._start.time_s >= time_s:
            self._complete = True

    def counted(self, mass_kg: float) -> None:
        """Mass was added to the total without having been measured."""
        if self._start is not None:
            self._start = replace(self._start, measured_kg=self._start.measured_kg + mass_kg)
        if self._last is not None:
            self._last = replace(self._last, measured_kg=self._last.measured_kg + mass_kg)

    def next_mass(self, masses_kg: Iterable[float]) -> int:
        """Position, from 1, of the first coming reading at which the tank may have gained enough for a reference; 0 for none."""
        least_kg = self._start.mass_kg if self._start is not None else float("inf")
        for number, mass_kg in enumerate(masses_kg, 1):
            if mass_kg - least_kg >= self._settings.min_increment_kg:
                return number
            least_kg = min(least_kg, mass_kg)
        return 0

    def window(
        self,
        start_s: float,
        end_s: float,
        total_before_kg: float,
        mass_kg: float,
        *,
        measured: bool,
        budget: MassBudget = EMPTY,
        forces: WindowForces | None = None,
    ) -> ReferenceMass | None:
        """Add a window.

        Parameters
        ----------
        start_s, end_s : float
            Engine time, s.
        total_before_kg, mass_kg : float
            Total before the window, and its mass.
        measured : bool
            Whether all of its grain was measured.
        budget : MassBudget
            Of the total after the window.
        forces : WindowForces, optional
            Of its mass.

        Returns
        -------
        ReferenceMass or None
            The increment that was completed with a reading in this window.
        """
        if not measured:
            self._complete = False
        if self._pending is None or self._pending[0] > end_s:
            self._add(mass_kg, forces)
            return None
        time_s, scale_kg = self._pending
        self._pending = None
        share = min(1.0, max(0.0, (time_s - start_s) / (end_s - start_s))) if end_s > start_s else 1.0
        self._add(mass_kg, forces, share)
        weighed = self._weigh(_Weighing(time_s, scale_kg, total_before_kg + share * mass_kg, budget))
        self._add(mass_kg, forces, 1.0 - share)
        return weighed

    def _add(self, mass_kg: float, forces: WindowForces | None, share: float = 1.0) -> None:
        if forces is not None and self._start is not None and share > 0.0:
            self._forces.add(self._number, share * mass_kg, forces.share(share))

    def _begin(self, now: _Weighing) -> None:
        """Start the next increment at this reading."""
        self._start, self._complete, self._zero_doubted = now, True, False
        self._number += 1

    def _weigh(self, now: _Weighing) -> ReferenceMass | None:
        start, last, self._last = self._start, self._last, now
        if start is None or last is None or self._interrupted(last, now):
            self._begin(now)
            return None
        increment = now.mass_kg - start.mass_kg
        if not self._complete and not self._zero_doubted and abs(increment) <= _AS_BEFORE_SDS * self._settings.scale_std_dev_kg:
            # The scale shows that the unmeasured time held no grain, as before the first zero.
            self._begin(now)
            return None
        if increment < self._settings.min_increment_kg:
            return None
        self.masses.append(
            ReferenceMass(
                source=ReferenceSource.TANK_SCALE,
                start_s=start.time_s,
                end_s=now.time_s,
                reference_kg=increment,
                std_dev_kg=2.0**0.5 * self._settings.scale_std_dev_kg,
                measured_kg=now.measured_kg - start.measured_kg,
                complete=self._complete,
                budget=now.budget.minus(start.budget),
                zero_doubted=self._zero_doubted,
                forces=self._forces.of(self._number),
            )
        )
        self._begin(now)
        return self.masses[-1]

    def _interrupted(self, last: _Weighing, now: _Weighing) -> bool:
        """Whether something else than incoming grain changed the reading: another or a reset scale, unloading, or a tank that
        lacks much of the measured mass."""
        gained_kg, counted_kg = now.mass_kg - last.mass_kg, now.measured_kg - last.measured_kg
        if tank_leaps(now.time_s - last.time_s, gained_kg):
            return True
        lacking_kg = max(self._settings.unloading_kg, _LACKING_SHARE * counted_kg)
        return gained_kg < -self._settings.unloading_kg or counted_kg - gained_kg > lacking_kg

"""Since when the parameters in use hold, and from which mass of grain on."""

from __future__ import annotations

from math import isfinite, nan
from typing import NamedTuple

from yieldmon.engine.self_calibration.earlier_parameters import Places, moved, place_of, remembered
from yieldmon.estimation.parameters import ParameterSet


class Instant(NamedTuple):
    """Bus time, mass in total, and moisture of the grain, nan where it is not known or does not matter."""

    time_s: float
    total_kg: float
    moisture_pct: float


class HeldSince:
    """The instant of the last update, and those of the parameters before it.

    Attributes
    ----------
    at : Instant
        The last update, or since when the parameters in use are known to hold.
    past : Places
        The same of earlier parameters.
    """

    def __init__(self) -> None:
        self.at = Instant(nan, nan, nan)
        self.past: Places = ()
        self._waited_s = 0.0
        """Time from the last update to a restart, s."""
        self._before_s: float | None = None
        """Bus time of the last update before a restart, s."""
        self._outside: tuple[ParameterSet, float] | None = None
        """Parameters from outside with which no window was measured yet, and grain since their estimation, kg."""
        self._placed: ParameterSet | None = None
        """Parameters in use that did not come from an update here, where it is known since when they hold."""

    def harvested_kg(self, total_kg: float) -> float:
        """Grain since then, kg."""
        return max(total_kg - self.at.total_kg, 0.0)

    def is_of(self, used: ParameterSet) -> bool:
        """Whether it is known since when these parameters hold although they did not come from an update here."""
        return used is self._placed

    def supersede(self, before: ParameterSet, at: Instant) -> None:
        """An update: it begins to hold at this instant, and that of the parameters before is remembered."""
        self.past = remembered(self.past, before, self.at.time_s, self.at.total_kg)
        self.at = at

    def use(self, before: ParameterSet | None, used: ParameterSet, harvested_kg: float) -> None:
        """Use other parameters than those of the last update; see `ParameterKnowledge.use`."""
        if before is not None:
            self.past = remembered(self.past, before, self.at.time_s, self.at.total_kg)
        place = place_of(self.past, used)
        if place is None:
            self._outside = used, harvested_kg
            return
        self._outside, self._placed = None, used
        self.move(place.at_s, place.at_kg)

    def begin_counting(self, used: ParameterSet, now_s: float, total_kg: float) -> None:
        """With the first window: start counting time and grain for parameters from outside."""
        if self._outside is not None and self._outside[0] is used:
            self.move(now_s, total_kg - self._outside[1])
            self._placed = used
        self._outside = None

    def begin(self, at: Instant) -> None:
        """Before the first update of a run: count from now, less the waiting time of the run before."""
        if not isfinite(self.at.time_s):
            # If bus time has begun anew, the stored time of the update is useless.
            before_s = self._before_s
            since_s = before_s if before_s is not None and before_s <= at.time_s else at.time_s - self._waited_s
            self.at = self.at._replace(time_s=since_s)
        self.begin_total(at.total_kg)

    def begin_total(self, total_kg: float) -> None:
        """Before the first update of a run: count grain from now."""
        if not isfinite(self.at.total_kg):
            self.at = self.at._replace(total_kg=total_kg)

    def move(self, time_s: float, total_kg: float) -> None:
        """The parameters in use hold since then."""
        self.at = self.at._replace(time_s=time_s, total_kg=total_kg)

    def set_moisture(self, moisture_pct: float) -> None:
        """They hold for grain of this moisture."""
        self.at = self.at._replace(moisture_pct=moisture_pct)

    def totals_reset(self, before_kg: float) -> None:
        """The total begins anew at 0; it was before_kg."""
        self.at = self.at._replace(total_kg=self.at.total_kg - before_kg)
        self.past = moved(self.past, -before_kg)

    def waited_s(self, now_s: float) -> float:
        """Time since the last update for a restart, s; now_s: bus time, nan before the first frame."""
        # Before the first frame of a run, an undo may restore parameters of an earlier run.
        timed = isfinite(self.at.time_s) and isfinite(now_s)
        return max(now_s - self.at.time_s, 0.0) if timed else self._waited_s

    @property
    def at_s(self) -> float | None:
        """Bus time of the last update, also of an earlier run, s; None where it is not known."""
        return self.at.time_s if isfinite(self.at.time_s) else self._before_s

    def restore(self, used: ParameterSet, at: Instant, *, at_s: float | None, waited_s: float, past: Places) -> None:
        """Continue after a restart with the parameters that were in use then. at: bus time aside, which begins anew."""
        self._before_s, self._waited_s = at_s, waited_s
        self.past, self._outside, self._placed = past, None, used
        self.at = at._replace(time_s=self.at.time_s)

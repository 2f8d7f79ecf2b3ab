"""Mass that may have come in seconds that were not measured.

It is in no load. The mass at the mean of the flows before and after is taken as one standard deviation of the load's mass. Such
mass can only be missing, never too much, so several such times add linearly, also over a load. While the daemon was stopped, or
the bus silent for more than a minute, the machine may have stood: the smaller of the two flows counts, for an hour at most.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from yieldmon.engine.mass.silences import Missing

_LONGEST_SILENCE_S = 60.0
"""Longest silence of the bus during which the machine is assumed to have harvested on."""
_SHORTEST_STOP_S, _LONGEST_STOP_S = 2.0, 3600.0
"""Lengths between two runs for which grain may have come: in a shorter one no whole second is missing, and a longer one counts no
further because the clock may have changed."""


@dataclass(frozen=True, slots=True)
class FlowAtStop:
    """How a run ended, for the next one.

    time_s: bus time of the end of its last window. flow_kg_s: of the last measured second; grain_kg_s: of the last second with
    grain. silent_s: time without measurement since then; whole: no grain can have come in it. stopped_s: time without measurement
    during stops since then. load_kg, total_kg: as in `UnseenMass`.
    """

    time_s: float
    flow_kg_s: float
    grain_kg_s: float = 0.0
    silent_s: float = 0.0
    whole: bool = True
    stopped_s: float = 0.0
    load_kg: float = 0.0
    total_kg: float = 0.0


@dataclass(frozen=True, slots=True)
class UnseenChange:
    """Seconds of a load are measured again with another zero: before_kg may have come unseen in them as it was stated, after_kg
    by that zero; hidden_kg: of this what was stated as hidden by the zero before."""

    before_kg: float = 0.0
    after_kg: float = 0.0
    hidden_kg: float = 0.0


SAME = UnseenChange()
"""Nothing was measured again."""


@dataclass(slots=True)
class UnseenMass:
    """Mass that may have come since the last measured second. load_kg, total_kg: standard deviations of the open load's mass and
    of the total by all such times before. grain_kg_s: flow of the last second with grain."""

    load_kg: float = 0.0
    total_kg: float = 0.0
    grain_kg_s: float = 0.0
    _before_kg_s: float = 0.0
    _silent_s: float = 0.0
    _whole: bool = True
    _stopped_s: float = 0.0

    @classmethod
    def since(cls, stop: FlowAtStop) -> UnseenMass:
        """Continue from the end of an earlier run."""
        return cls(stop.load_kg, stop.total_kg, stop.grain_kg_s, stop.flow_kg_s, stop.silent_s, stop.whole, stop.stopped_s)

    def at_stop(self, time_s: float) -> FlowAtStop:
        """Inverse of `since`, at a bus time, s."""
        return FlowAtStop(
            time_s=time_s,
            flow_kg_s=self._before_kg_s,
            grain_kg_s=self.grain_kg_s,
            silent_s=self._silent_s,
            whole=self._whole,
            stopped_s=self._stopped_s,
            load_kg=self.load_kg,
            total_kg=self.total_kg,
        )

    def changed_by(self, change: UnseenChange) -> tuple[UnseenChange, UnseenChange]:
        """The change of all that may have come unseen in the open load, of which it is a part, and in the total."""
        more_kg = change.after_kg - change.before_kg
        load, total = (replace(change, before_kg=kg, after_kg=max(kg + more_kg, 0.0)) for kg in (self.load_kg, self.total_kg))
        return load, total

    def change(self, change: UnseenChange, *, in_load: bool) -> None:
        """Take the change over. in_load: it is the open load's as well."""
        load, total = self.changed_by(change)
        self.total_kg = total.after_kg
        self.load_kg = load.after_kg if in_load else self.load_kg

    def recomputed(self, since: UnseenMass) -> None:
        """The seconds until now were measured again: since, as they leave it. Of a stop it says nothing."""
        self._before_kg_s, self._silent_s, self._whole = since._before_kg_s, since._silent_s, since._whole

    def resume(self, stopped_s: float) -> None:
        """The run before ended stopped_s before this one."""
        if stopped_s >= _SHORTEST_STOP_S:
            self._stopped_s = min(self._stopped_s + stopped_s, _LONGEST_STOP_S)

    def second(
        self, duration_s: float, rate_kg_s: float, missing: Missing | None, *, whole: bool, stands: bool, silent: bool
    ) -> float:
        """A further second; returns as `measured`. missing: None where it was measured. stands: so did the elevator, which brings
        nothing. The other arguments as of `measured` and `missing`."""
        if missing is None:
            return self.measured(rate_kg_s, whole=whole)
        if not (stands and missing in (Missing.ALL, Missing.ZERO_STANDING)):
            self.missing(duration_s, whole=whole, silent=silent)
        return 0.0

    def missing(self, seconds: float, *, whole: bool, silent: bool = False) -> None:
        """Another `seconds` were not measured. whole: no grain can have come in them. silent: neither sensor nor speed is
        reported; after a long silence the machine counts as switched off, like a stop."""
        if self._stopped_s > 0.0:
            self._stopped_s = min(self._stopped_s + seconds, _LONGEST_STOP_S)
            return
        self._silent_s += seconds
        self._whole = self._whole and whole
        if silent and self._silent_s > _LONGEST_SILENCE_S:
            self._stopped_s, self._silent_s, self._whole = self._silent_s, 0.0, True

    def measured(self, rate_kg_s: float, *, whole: bool = True) -> float:
        """A second was measured; returns the mass that may have come unmeasured before it, kg. rate_kg_s: 0 without grain. whole:
        the second shows that none can have come."""
        silent_s = 0.0 if self._whole and whole else self._silent_s
        # During a stop of the daemon the machine may have stopped as well.
        between_kg_s, stopped_kg_s = 0.5 * (self._before_kg_s + rate_kg_s), min(self._before_kg_s, rate_kg_s)
        missed_kg = silent_s * between_kg_s + self._stopped_s * stopped_kg_s
        self.grain_kg_s = rate_kg_s if rate_kg_s > 0.0 else self.grain_kg_s
        self._begin(rate_kg_s)
        return missed_kg

    def cut(self) -> float:
        """The load ends before the next measured second; returns the mass that may have come unmeasured, kg."""
        missed_kg = 0.0 if self._whole else self._silent_s * self._before_kg_s
        self._begin(self._before_kg_s)
        return missed_kg

    def _begin(self, before_kg_s: float) -> None:
        self._before_kg_s, self._silent_s, self._whole, self._stopped_s = before_kg_s, 0.0, True, 0.0

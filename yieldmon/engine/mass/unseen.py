"""Mass that may have come in seconds that were not measured.

It is in no load. As much as would have come if grain had gone on at the mean of the flows before and after is one standard
deviation of the load's mass. All of it is missing, never too much, so several such times add, also over a load. While the daemon
was stopped, or the bus silent for more than a minute, the machine may have stood: the smaller of the two flows counts, for an
hour at most.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

_LONGEST_SILENCE_S = 60.0
"""Of a bus on which the machine may have gone on."""
_SHORTEST_STOP_S, _LONGEST_STOP_S = 2.0, 3600.0
"""Of a run for which grain may have gone on: of a shorter one no whole second is missing, of a longer one the clock may have been
another."""


@dataclass(frozen=True, slots=True)
class FlowAtStop:
    """How a run ended, for the next one. time_s: bus time of the end of its last window. flow_kg_s: of the last second that was
    measured; grain_kg_s: of the last one with grain. silent_s: not measured since, stopped_s: since a stop before; whole: no
    grain can have come in silent_s. load_kg, total_kg: as in `UnseenMass`."""

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
    """Of the seconds since the last one that was measured. load_kg, total_kg: standard deviation of the open load's mass and of
    the total by all of those before."""

    load_kg: float = 0.0
    total_kg: float = 0.0
    _before_kg_s: float = 0.0
    _silent_s: float = 0.0
    _whole: bool = True
    _stopped_s: float = 0.0

    @classmethod
    def since(cls, stop: FlowAtStop) -> UnseenMass:
        """As a run before left it."""
        return cls(stop.load_kg, stop.total_kg, stop.flow_kg_s, stop.silent_s, stop.whole, stop.stopped_s)

    def at_stop(self, time_s: float, grain_kg_s: float) -> FlowAtStop:
        """Inverse of `since`, at a bus time, s; grain_kg_s: flow of the last second with grain."""
        return FlowAtStop(
            time_s=time_s,
            flow_kg_s=self._before_kg_s,
            grain_kg_s=grain_kg_s,
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

    def measured_again(self, since: UnseenMass) -> None:
        """The seconds until now were measured again: since, as they leave it. Of a stop it says nothing."""
        self._before_kg_s, self._silent_s, self._whole = since._before_kg_s, since._silent_s, since._whole

    def resume(self, stopped_s: float) -> None:
        """The run before ended so long before this one."""
        if stopped_s >= _SHORTEST_STOP_S:
            self._stopped_s = min(self._stopped_s + stopped_s, _LONGEST_STOP_S)

    def missing(self, seconds: float, *, whole: bool, silent: bool = False) -> None:
        """So many more were not measured. whole: and no grain can have come in them. silent: neither sensor nor speed is
        reported; for long, the machine is switched off, which is the same as a stop."""
        if self._stopped_s > 0.0:
            self._stopped_s = min(self._stopped_s + seconds, _LONGEST_STOP_S)
            return
        self._silent_s += seconds
        self._whole = self._whole and whole
        if silent and self._silent_s > _LONGEST_SILENCE_S:
            self._stopped_s, self._silent_s, self._whole = self._silent_s, 0.0, True

    def measured(self, rate_kg_s: float, *, whole: bool = True) -> float:
        """A second was measured; returns what may have come unseen before it, kg. rate_kg_s: 0 without grain. whole: it shows
        that none can have come."""
        silent_s = 0.0 if self._whole and whole else self._silent_s
        # While no run was there the machine may have stopped as well.
        between_kg_s, stopped_kg_s = 0.5 * (self._before_kg_s + rate_kg_s), min(self._before_kg_s, rate_kg_s)
        missed_kg = silent_s * between_kg_s + self._stopped_s * stopped_kg_s
        self._begin(rate_kg_s)
        return missed_kg

    def cut(self) -> float:
        """The load ends, what comes after it is not known; returns what may have come unseen, kg."""
        missed_kg = 0.0 if self._whole else self._silent_s * self._before_kg_s
        self._begin(self._before_kg_s)
        return missed_kg

    def _begin(self, before_kg_s: float) -> None:
        self._before_kg_s, self._silent_s, self._whole, self._stopped_s = before_kg_s, 0.0, True, 0.0

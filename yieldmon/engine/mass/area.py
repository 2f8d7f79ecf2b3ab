"""Harvested area, delayed so that it belongs to the grain at the plate.

Grain reaches the plate some seconds after the header has cut it (`Implement.grain_delay_s`). The area counted with a second is
the area cut that long before, so mass over area is a yield at any moment, and load by load. Where the bus reports the header up
or the drives off, nothing is cut; where it reports neither, the area driven counts while grain comes. A header that is up for a
moment within a pass, as a loose switch reports it, cuts on where the delay leaves time to see that. Grain that comes when the
machine should long have run empty contradicts the header, as where its signal is inverted: no area is known from then on, until
grain has come as long with the header down.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from math import inf, isfinite, nan
from typing import NamedTuple

from yieldmon.engine.inputs import InputSnapshot
from yieldmon.engine.settings import GateSettings
from yieldmon.frames import FLICKER_S, HeaderDown, WorkState
from yieldmon.physics.machine import Implement


class _Cut(NamedTuple):
    """Area rate in a second, nan where it is not known. by_header: whether the bus reported whether the header cuts. driven_m2_s:
    the rate if it cut. idle: whether header or drives were reported not to cut."""

    end_s: float
    rate_m2_s: float
    by_header: bool
    driven_m2_s: float
    idle: bool


class AreaCounter:
    """Area of each second, in order of time."""

    def __init__(self, implement: Implement, gate: GateSettings) -> None:
        self._width_m = implement.working_width_m
        self._delay_s = implement.grain_delay_s or 0.0
        self._min_speed_m_s = gate.min_ground_speed_m_s
        self._emptied_s = self._delay_s + gate.emptying_s
        """From the header's going up until no grain comes."""
        self._up_since_s = self._grain_since_s = inf
        self._contradicted = False
        self._cuts: deque[_Cut] = deque()
        self.unknown_because = ""
        """Why no area is known of the last second's grain; "" where one is."""

    def second(self, end_s: float, duration_s: float, inputs: InputSnapshot, *, grain_comes: bool) -> float:
        """Area that belongs to the grain of a second, m2; nan where width or ground speed was not known, or the grain contradicts
        the header.

        Parameters
        ----------
        end_s, duration_s : float
            Engine time of the second's end, and its length.
        inputs : InputSnapshot
            Held at its end.
        grain_comes : bool
            Whether grain is measured in it.
        """
        idle = inputs.fresh["header_down"] == HeaderDown.UP or inputs.fresh["work_state"] == WorkState.NOT_WORKING
        self._compare(end_s, idle=idle, grain_comes=grain_comes)
        self._cuts.append(self._cut(end_s, inputs.fresh, idle=idle))
        self._bridge_a_moment()
        while len(self._cuts) > 1 and self._cuts[1].end_s <= end_s - self._delay_s:
            self._cuts.popleft()
        cut = self._cuts[0]
        self.unknown_because = self._why_unknown(cut, end_s)
        if self.unknown_because:
            return nan
        return cut.rate_m2_s * duration_s if cut.by_header or grain_comes else 0.0

    def _why_unknown(self, cut: _Cut, end_s: float) -> str:
        if self._width_m is None:
            return "the machine file states no implement.working_width_m"
        if self._contradicted:
            return "grain comes although header or drives are reported not to cut"
        if cut.end_s > end_s - self._delay_s:
            return f"grain comes {self._delay_s:g} s after it is cut, and what came before the start is not known"
        return "" if isfinite(cut.rate_m2_s) else "no ground speed is received"

    def _compare(self, end_s: float, *, idle: bool, grain_comes: bool) -> None:
        """Compare header and drives with the grain."""
        self._up_since_s = min(self._up_since_s, end_s) if idle else inf
        self._grain_since_s = min(self._grain_since_s, end_s) if grain_comes and not idle else inf
        if grain_comes and end_s - self._up_since_s > self._emptied_s:
            self._contradicted = True
        elif end_s - self._grain_since_s > self._emptied_s:
            self._contradicted = False

    def _cut(self, end_s: float, fresh: Mapping[str, float], *, idle: bool) -> _Cut:
        header, work, speed_m_s = fresh["header_down"], fresh["work_state"], fresh["ground_speed"]
        width_m = nan if self._width_m is None else self._width_m
        stands = speed_m_s < self._min_speed_m_s
        driven_m2_s = 0.0 * width_m if stands else width_m * speed_m_s
        if idle or stands:
            return _Cut(end_s, 0.0 * width_m, by_header=True, driven_m2_s=driven_m2_s, idle=idle)
        return _Cut(end_s, driven_m2_s, header == HeaderDown.DOWN or work == WorkState.WORKING, driven_m2_s, idle=False)

    def _bridge_a_moment(self) -> None:
        """Between two seconds in which ground is cut a moment without cuts it too."""
        count = len(self._cuts)
        begin = count - 1
        while begin and self._cuts[begin - 1].idle:
            begin -= 1
        if not 0 < begin < count - 1 or self._cuts[-2].end_s - self._cuts[begin - 1].end_s > FLICKER_S:
            return
        if not (self._cuts[-1].rate_m2_s > 0.0 and self._cuts[begin - 1].rate_m2_s > 0.0):
            return
        for place in range(begin, count - 1):
            cut = self._cuts[place]
            self._cuts[place] = cut._replace(rate_m2_s=cut.driven_m2_s, by_header=True, idle=False)

"""Harvested area, delayed so that it belongs to the grain at the plate.

Grain reaches the plate some seconds after the header has cut it (`Implement.grain_delay_s`). The area counted with a second is
the area cut that long before, so mass over area is a yield at any moment, and load by load. Where the bus reports the header up
or the drives off, nothing is cut; where it reports neither, the area driven counts while grain comes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from math import isfinite, nan
from typing import NamedTuple

from yieldmon.engine.inputs import InputSnapshot
from yieldmon.engine.settings import GateSettings
from yieldmon.frames import HeaderDown, WorkState
from yieldmon.physics.machine import Implement


class _Cut(NamedTuple):
    """Area rate in a second, nan where it is not known. by_header: whether the bus reported whether the header cuts."""

    end_s: float
    rate_m2_s: float
    by_header: bool


class AreaCounter:
    """Area of each second, in order of time."""

    def __init__(self, implement: Implement, gate: GateSettings) -> None:
        self._width_m = implement.working_width_m
        self._delay_s = implement.grain_delay_s or 0.0
        self._min_speed_m_s = gate.min_ground_speed_m_s
        self._cuts: deque[_Cut] = deque()

    def second(self, end_s: float, duration_s: float, inputs: InputSnapshot, *, grain_comes: bool) -> float:
        """Area that belongs to the grain of a second, m2; nan where width or ground speed was not known.

        Parameters
        ----------
        end_s, duration_s : float
            Engine time of the second's end, and its length.
        inputs : InputSnapshot
            Held at its end.
        grain_comes : bool
            Whether grain is measured in it.
        """
        self._cuts.append(self._cut(end_s, inputs.fresh))
        while len(self._cuts) > 1 and self._cuts[1].end_s <= end_s - self._delay_s:
            self._cuts.popleft()
        cut = self._cuts[0]
        if cut.end_s > end_s - self._delay_s:
            return nan
        return cut.rate_m2_s * duration_s if cut.by_header or grain_comes or not isfinite(cut.rate_m2_s) else 0.0

    def _cut(self, end_s: float, fresh: Mapping[str, float]) -> _Cut:
        header, work, speed_m_s = fresh["header_down"], fresh["work_state"], fresh["ground_speed"]
        idle = header == HeaderDown.UP or work == WorkState.NOT_WORKING
        if idle or speed_m_s < self._min_speed_m_s:
            return _Cut(end_s, 0.0 if self._width_m is not None else nan, by_header=True)
        width_m = nan if self._width_m is None else self._width_m
        return _Cut(end_s, width_m * speed_m_s, header == HeaderDown.DOWN or work == WorkState.WORKING)

"""The windows of the sweep under way, and the moments at which they update the model error."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

from yieldmon.engine.records import WindowRecord
from yieldmon.engine.sweeps.disagreement import Disagreement
from yieldmon.engine.sweeps.sweep import PlateSweep
from yieldmon.engine.sweeps.sweep_inputs import SweepAbort
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.machine import SAME_ANGLE_RAD

_WAY_HOME_S = 20.0
"""Longest way home after which the flow at home is comparable with that before."""
_SAME_FLOW = 1.5
"""Ratio of flows at one angle, or on the way home relative to its ends, above which the feed has changed."""
_MODELS_LARGEST = 2.0
"""Largest ratio of the flows at two angles that a model error can cause at a steady feed."""
_FORCES_HOLD = frozenset({SweepAbort.FLOW_CHANGED, SweepAbort.SPEED_CHANGED, SweepAbort.NOT_MEASURED, SweepAbort.OPERATOR})
"""Reasons of an early end that leave the windows until then usable."""


class SweepWindows:
    """Collects the windows of each sweep, and passes them to a `Disagreement` as soon as they are comparable.

    Parameters
    ----------
    disagreement : Disagreement
    home_rad : float
        Plate angle at home.

    Notes
    -----
    `between` and `within` return whether the disagreement was updated, so that the model must be judged anew.
    """

    def __init__(self, disagreement: Disagreement, home_rad: float) -> None:
        self._disagreement = disagreement
        self._home_rad = home_rad
        self._records: list[WindowRecord] = []
        self._under_way = False
        self._looked_step = 0
        """Step of the sweep under way at which its pattern was last updated."""
        self._visit: list[WindowRecord] = []
        """The newest windows of the sweep at one plate angle, usable or not."""
        self._way_home: list[WindowRecord] = []
        """Windows of a sweep that ended away from home because the flow changed, until the plate is home again."""
        self._on_the_way: list[float] = []
        """Flows since the window that ended it, kg/s."""

    def between(self, record: WindowRecord, sweep: PlateSweep, parameters: ParameterSet) -> bool:
        """A window while no sweep is under way."""
        looked = False
        if self._under_way:
            self.end_early(record, sweep.abort_reason, parameters)
            looked = True
        elif self._way_home:
            looked = self._come_home(record, parameters)
        self._records = [*self._records, record][-sweep.lead :] if sweep.lead else []
        return looked

    def within(self, record: WindowRecord, sweep: PlateSweep, parameters: ParameterSet) -> bool:
        """A window of a sweep under way, or the one that completes it."""
        self._way_home = []
        self._under_way = not sweep.completed
        self._visit = [r for r in self._visit if _same_angle(r, record)] + [record]
        if not record.usable_for_calibration:
            return False
        self._records.append(record)
        if not sweep.is_home_again(record.sweep_step) or record.sweep_step == self._looked_step:
            return False
        # Home again: the flow of the visits since is known, and with it how far the force was off there.
        self._looked_step = record.sweep_step
        self._disagreement.look(self._records, parameters)
        return True

    def whole(self) -> Sequence[WindowRecord]:
        """The usable windows of the complete sweep, which are removed."""
        records, self._records = self._records, []
        self._looked_step = 0
        return records

    def end_early(self, record: WindowRecord, reason: SweepAbort | None, parameters: ParameterSet) -> None:
        """The sweep under way ended with this window; its pattern until then is kept where it is usable."""
        self._under_way, self._looked_step = False, 0
        visit, self._visit = self._visit, []
        feed = any(_same_angle(r, record) and _differ(r.mass_flow_kg_s, record.mass_flow_kg_s) for r in visit)
        feed = feed or (self._is_home(record) and self._was_other_at_home(record, self._records))
        if reason is SweepAbort.FLOW_CHANGED and not feed:
            # The window that ended it is valid, and may be the visit home that the others need.
            records = [*self._records, record]
            self._disagreement.look(records, parameters)
            self._way_home = [] if self._is_home(record) else records
            self._on_the_way = [record.mass_flow_kg_s]
        self._disagreement.end_early(usable=reason in _FORCES_HOLD and not self._way_home)

    def _come_home(self, record: WindowRecord, parameters: ParameterSet) -> bool:
        """After a change of flow away from home, which may be a large model error: the next window at home decides, unless the
        feed changed meanwhile. A model error depends on the angle alone, so the flow on the way lies between that at its ends."""
        late = record.time_s - self._way_home[-1].time_s > _WAY_HOME_S
        if late or not isfinite(record.mass_flow_kg_s):
            self._way_home = []
            return False
        self._on_the_way.append(record.mass_flow_kg_s)
        if not (self._is_home(record) and record.plate_still):
            return False
        records, self._way_home = [*self._way_home, record], []
        if _feed_changed(self._on_the_way) or self._was_other_at_home(record, records):
            return False
        self._disagreement.look(records, parameters)
        self._disagreement.end_early(usable=True)
        return True

    def _was_other_at_home(self, record: WindowRecord, before: Sequence[WindowRecord]) -> bool:
        """Whether the flow at home differs from that at the visit before, so that the feed in between is not known."""
        at_home = [r for r in before if r is not record and self._is_home(r)]
        return bool(at_home) and _differ(at_home[-1].mass_flow_kg_s, record.mass_flow_kg_s)

    def _is_home(self, record: WindowRecord) -> bool:
        return abs(record.plate_angle_rad - self._home_rad) <= SAME_ANGLE_RAD


def _same_angle(one: WindowRecord, other: WindowRecord) -> bool:
    return abs(one.plate_angle_rad - other.plate_angle_rad) <= SAME_ANGLE_RAD


def _differ(one_kg_s: float, other_kg_s: float) -> bool:
    return max(one_kg_s, other_kg_s) > _SAME_FLOW * min(one_kg_s, other_kg_s)


def _feed_changed(flows_kg_s: Sequence[float]) -> bool:
    """Whether the feed changed on the way home. flows_kg_s: the first one away from home, the last one at home."""
    low, high = sorted((flows_kg_s[0], flows_kg_s[-1]))
    return high > _MODELS_LARGEST * low or min(flows_kg_s) * _SAME_FLOW < low or max(flows_kg_s) > high * _SAME_FLOW

"""The windows of a sweep under way, and when what they show of the model's error is looked at."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

from yieldmon.engine.records import WindowRecord
from yieldmon.engine.sweeps.disagreement import Disagreement
from yieldmon.engine.sweeps.sweep import SweepMachine
from yieldmon.engine.sweeps.sweep_inputs import SweepAbort
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.machine import SAME_ANGLE_RAD

_WAY_HOME_S = 20.0
"""How long a plate may take home for the flow there to speak of that before."""
_SAME_FLOW = 1.5
"""Ratio of flows at one angle, or on the way home beyond those at its ends, from which the feed has changed and not the model."""
_MODELS_LARGEST = 2.0
"""Ratio of flows at two angles that no error of the model makes of one feed."""
_FORCES_HOLD = frozenset({SweepAbort.FLOW_CHANGED, SweepAbort.SPEED_CHANGED, SweepAbort.NOT_MEASURED, SweepAbort.OPERATOR})
"""Ends of a sweep that leave what was measured until then usable."""


class SweepWindows:
    """Collects the windows of each sweep, and shows its visits to a `Disagreement` as soon as they are comparable.

    Parameters
    ----------
    disagreement : Disagreement
    home_rad : float
        Plate angle at home.

    Notes
    -----
    Each method returns whether the disagreement was looked at, so that the model is to be judged anew.
    """

    def __init__(self, disagreement: Disagreement, home_rad: float) -> None:
        self._disagreement = disagreement
        self._home_rad = home_rad
        self._records: list[WindowRecord] = []
        self._under_way = False
        self._looked_step = 0
        """Of the sweep under way, at which its pattern was last looked at."""
        self._visit: list[WindowRecord] = []
        """The newest windows of the sweep at one plate angle, whether usable or not."""
        self._way_home: list[WindowRecord] = []
        """Of a sweep that ended away from home because the flow changed, until the plate is back."""
        self._on_the_way: list[float] = []
        """Flows from the window that ended it on, kg/s."""

    def between(self, record: WindowRecord, sweep: SweepMachine, parameters: ParameterSet) -> bool:
        """A window while no sweep is under way."""
        looked = False
        if self._under_way:
            self.end_early(record, sweep.abort_reason, parameters)
            looked = True
        elif self._way_home:
            looked = self._come_home(record, parameters)
        self._records = [*self._records, record][-sweep.lead :] if sweep.lead else []
        return looked

    def within(self, record: WindowRecord, sweep: SweepMachine, parameters: ParameterSet) -> bool:
        """A window of a sweep under way, or the one that completes it."""
        self._way_home = []
        self._under_way = not sweep.completed
        self._visit = [r for r in self._visit if _together(r, record)] + [record]
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
        """The usable windows of the sweep that is complete; the next one begins without."""
        records, self._records = self._records, []
        self._looked_step = 0
        return records

    def end_early(self, record: WindowRecord, reason: SweepAbort | None, parameters: ParameterSet) -> None:
        """The sweep under way has ended with this window; what it has shown of the model's error until then is kept."""
        self._under_way, self._looked_step = False, 0
        visit, self._visit = self._visit, []
        feed = any(_together(r, record) and _differ(r.mass_flow_kg_s, record.mass_flow_kg_s) for r in visit)
        feed = feed or (self._is_home(record) and self._was_other_at_home(record, self._records))
        if reason is SweepAbort.FLOW_CHANGED and not feed:
            # The window that ended it was as good as those before it, and may be the visit home that they need.
            records = [*self._records, record]
            self._disagreement.look(records, parameters)
            self._way_home = [] if self._is_home(record) else records
            self._on_the_way = [record.mass_flow_kg_s]
        self._disagreement.end_early(usable=reason in _FORCES_HOLD and not self._way_home)

    def _come_home(self, record: WindowRecord, parameters: ParameterSet) -> bool:
        """After a change of flow away from home, which a large error of the model may be: the next window at home tells, unless
        the feed changed meanwhile. The model's error changes with the angle alone, so that the flow on the way lies between."""
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
        """Whether the feed at home was another one at the visit before, so that what it was meanwhile is not known."""
        at_home = [r for r in before if r is not record and self._is_home(r)]
        return bool(at_home) and _differ(at_home[-1].mass_flow_kg_s, record.mass_flow_kg_s)

    def _is_home(self, record: WindowRecord) -> bool:
        return abs(record.plate_angle_rad - self._home_rad) <= SAME_ANGLE_RAD


def _together(one: WindowRecord, other: WindowRecord) -> bool:
    return abs(one.plate_angle_rad - other.plate_angle_rad) <= SAME_ANGLE_RAD


def _differ(one_kg_s: float, other_kg_s: float) -> bool:
    return max(one_kg_s, other_kg_s) > _SAME_FLOW * min(one_kg_s, other_kg_s)


def _feed_changed(flows_kg_s: Sequence[float]) -> bool:
    """Whether flows on the way home say so, the first of them away from home and the last one there."""
    low, high = sorted((flows_kg_s[0], flows_kg_s[-1]))
    return high > _MODELS_LARGEST * low or min(flows_kg_s) * _SAME_FLOW < low or max(flows_kg_s) > high * _SAME_FLOW

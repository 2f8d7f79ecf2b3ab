"""The plate sweep as a state machine: ticks and windows in, demands on the plate out (docs/internals/sweep.md).

IDLE, ABORTED, UPDATED, NOT_LEARNED    at rest, the plate is not driven
WAITING                                due; conditions do not hold yet
MOVING -> SETTLING -> MEASURING        for each angle of the sequence, which begins and ends at home
RETURNING                              on the way home after an abort, or because the plate was found away from home
"""

from __future__ import annotations

from math import inf, isfinite

from yieldmon.engine.settings import PlateSettings, SweepSettings
from yieldmon.engine.sweeps.plate_commands import GO_HOME, RELEASE, PlateDemand
from yieldmon.engine.sweeps.sweep import RESTING, PlateSweep
from yieldmon.engine.sweeps.sweep_inputs import PlateReading, SweepAbort, SweepWindow, plate_trouble
from yieldmon.frames import ActuatorState, CommandMode, SweepState

_ACTUATOR_REASONS = (SweepAbort.NOT_FOLLOWING, SweepAbort.FORCE_DOES_NOT_FOLLOW)
"""Ends after which the plate counts as not following until a movement arrives."""


class SweepMachine(PlateSweep):
    """The sweeps of one plate that is driven. Times are engine time, s."""

    def __init__(self, settings: SweepSettings, plate: PlateSettings, home_deg: float) -> None:
        super().__init__(settings, plate, home_deg)
        self._deadline_s = inf
        self._on_target_s: float | None = None
        self._away_s: float | None = None
        self._home_try_s = -inf
        self._moves = False
        """Whether the angle of the step differs from that at which the plate was when it began."""
        self._driven_home_until_s = -inf

    def request(self) -> None:
        """Operator: sweep as soon as the conditions hold, due or not."""
        self.schedule.requested = True

    def abort(self, now_s: float, reason: SweepAbort = SweepAbort.OPERATOR) -> bool:
        """End the sweep under way, if any, and take the plate home; withdraw an open request; put off a sweep that is due. False
        where there was none of these."""
        requested, self.schedule.requested = self.schedule.requested, False
        if self.visiting or self.completed:
            self._abort(now_s, reason)
        elif self.state is SweepState.WAITING:
            self._enter(SweepState.IDLE)
            if self.schedule.begins(now_s):
                self.schedule.skip(now_s)
        else:
            return requested
        return True

    def tick(self, plate: PlateReading) -> PlateDemand | None:
        """Advance the time; returns the demand on the plate, None where it is not driven."""
        now = plate.time_s
        self.schedule.tick(now)
        if self.state in RESTING:
            return self._rest(plate)
        if self.state is SweepState.RETURNING:
            return self._return(plate)
        reason = plate_trouble(plate)
        if reason is not None:
            self._abort(now, reason)
            return self._return(plate)
        if self.state is SweepState.MOVING:
            self._move(plate)
        elif self.state is SweepState.SETTLING:
            self._settle(plate)
        elif not self._on_target(plate):
            self._enter(SweepState.SETTLING, now + self._settings.settle_timeout_s)
            self._on_target_s = None
        elif now > self._deadline_s:
            self._abort(now, SweepAbort.NOT_SETTLING)
        return self._demand(plate)

    def window(self, window: SweepWindow) -> int:
        """Take a closed window. Returns the sweep step that it counts for, or -1."""
        good = window.whole and isfinite(window.flow_kg_s)
        if self.state in RESTING:
            if good and window.still and self._is_home(window.angle_deg):
                self._home.add(window)
            else:
                self._home.clear()
            return -1
        if not self.visiting or self.completed:
            return -1
        usable = good and self._usable(window)
        reason = self._measurement.trouble(window, usable=usable, at_home=self.sequence[self.step] == self._home_deg)
        if reason is not None:
            self._abort(window.end_s, reason)
        if reason is not None or not usable:
            return -1
        step = self.step
        self._measurement.add(window)
        if self._measurement.step_done:
            self._next_step(window.end_s, window.angle_deg)
        return step

    def _rest(self, plate: PlateReading) -> PlateDemand | None:
        now = plate.time_s
        if self._found_away(plate):
            self._home_try_s = now
            self._enter(SweepState.RETURNING, now + self._settings.return_timeout_s)
            return self._return(plate)
        if self.state is not SweepState.WAITING:
            if not self.schedule.begins(now):
                return None
            self._enter(SweepState.WAITING)
        if not self._ready(plate):
            return None
        self._start(plate)
        return self._demand(plate)

    def _found_away(self, plate: PlateReading) -> bool:
        """Whether the plate has rested away from home for long, not driven by others: a sweep left it there."""
        away = isfinite(plate.angle_deg) and plate.state is ActuatorState.IDLE and not self._is_home(plate.angle_deg)
        if not away:
            self._away_s = None
            return False
        if self._away_s is None:
            self._away_s = plate.time_s
        rested = plate.time_s - self._away_s >= self._settings.home_rest_s
        return rested and plate.time_s - self._home_try_s >= self._settings.home_retry_s

    def _ready(self, plate: PlateReading) -> bool:
        return plate_trouble(plate) is None and self._is_home(plate.angle_deg) and self._home.steady

    def _start(self, plate: PlateReading) -> None:
        self.sweep_id += 1
        self.schedule.requested = False
        self.abort_reason = None
        self._measurement.begin(self._home.means)
        self._home.clear()
        self.step = -1
        self._next_step(plate.time_s, plate.angle_deg)

    def _next_step(self, now_s: float, angle_deg: float) -> None:
        self._measurement.begin_step()
        if self.step + 1 >= len(self.sequence):
            self.completed = True
            return
        self.step += 1
        self._moves = abs(self.sequence[self.step] - angle_deg) > self._plate.at_target_tolerance_deg
        self._enter(SweepState.MOVING, now_s + self._travel_s(angle_deg))

    def _travel_s(self, angle_deg: float) -> float:
        """Longest time between an angle and that of the step."""
        return abs(self.sequence[self.step] - angle_deg) / self._plate.max_rate_deg_s + self._settings.move_margin_s

    def _move(self, plate: PlateReading) -> None:
        if self._on_target(plate):
            self.not_following = self.not_following and not self._moves
            self._enter(SweepState.SETTLING, plate.time_s + self._settings.settle_timeout_s)
            self._on_target_s = plate.time_s
        elif plate.time_s > self._deadline_s:
            self.not_following = True
            if self._is_home(plate.angle_deg):
                # The plate may have moved all the same, with feedback that stays.
                self._driven_home_until_s = plate.time_s + self._travel_s(self._home_deg)
            self._abort(plate.time_s, SweepAbort.NOT_FOLLOWING)

    def _settle(self, plate: PlateReading) -> None:
        now = plate.time_s
        if not self._on_target(plate) or plate.state is ActuatorState.MOVING:
            self._on_target_s = None
        elif self._on_target_s is None:
            self._on_target_s = now
        elif now - self._on_target_s >= self._settings.settle_s:
            self._settled_s = now
            self._enter(SweepState.MEASURING, now + self._settings.measure_timeout_s)
            return
        if now > self._deadline_s:
            self._abort(now, SweepAbort.NOT_SETTLING)

    def _return(self, plate: PlateReading) -> PlateDemand:
        now = plate.time_s
        if abs(plate.angle_deg - self._home_deg) <= self._plate.at_target_tolerance_deg:
            if now < self._driven_home_until_s:
                return GO_HOME
            self.not_following = self.not_following and self.abort_reason in _ACTUATOR_REASONS
        elif plate.state is ActuatorState.MANUAL:
            # Manual control has priority; afterwards the plate is found away from home and driven there.
            self._home_try_s = -inf
        elif now > self._deadline_s:
            self.not_following = True
            self._home_try_s = now
        else:
            return GO_HOME
        self._enter(SweepState.ABORTED if self.abort_reason else SweepState.IDLE)
        return RELEASE

    def _abort(self, now_s: float, reason: SweepAbort) -> None:
        self.abort_reason = reason
        self.completed = False
        self.step = -1
        self.schedule.aborted(now_s)
        if reason is SweepAbort.FORCE_DOES_NOT_FOLLOW:
            self.not_following = True
        self._enter(SweepState.RETURNING, now_s + self._settings.return_timeout_s)

    def _demand(self, plate: PlateReading) -> PlateDemand:
        if self.state is SweepState.RETURNING:
            return self._return(plate)
        return PlateDemand(CommandMode.GO_TO_ANGLE, self.sequence[self.step])

    def _is_home(self, angle_deg: float) -> bool:
        """Whether the plate rests at home, by its feedback."""
        return abs(angle_deg - self._home_deg) <= self._plate.rest_tolerance_deg

    def _on_target(self, plate: PlateReading) -> bool:
        return abs(plate.angle_deg - self.sequence[self.step]) <= self._plate.at_target_tolerance_deg

    def _enter(self, state: SweepState, deadline_s: float = inf) -> None:
        super()._enter(state)
        self._away_s, self._deadline_s = None, deadline_s

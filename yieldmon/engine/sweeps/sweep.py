"""The plate sweep as a state machine: ticks and windows in, demands on the plate out (docs/internals/sweep.md).

IDLE, ABORTED, UPDATED, NOT_LEARNED    at rest, the plate is not driven
WAITING                                due; conditions do not hold yet
MOVING -> SETTLING -> MEASURING        for each angle of the sequence, which begins and ends at home
RETURNING                              on the way home after an abort, or because the plate was found away from home
"""

from __future__ import annotations

from math import isfinite, log

from yieldmon.engine.settings import PlateSettings, SweepSettings
from yieldmon.engine.sweeps.plate_commands import GO_HOME, RELEASE, PlateDemand
from yieldmon.engine.sweeps.steady_home import SteadyHome, spread
from yieldmon.engine.sweeps.sweep_inputs import PlateReading, SweepAbort, SweepWindow, plate_trouble
from yieldmon.frames import ActuatorState, CommandMode, SweepState

_ACTUATOR_REASONS = (SweepAbort.NOT_FOLLOWING, SweepAbort.FORCE_DOES_NOT_FOLLOW)
"""Ends after which the plate counts as not following until a movement arrives."""
RESTING = frozenset({SweepState.IDLE, SweepState.WAITING, SweepState.ABORTED, SweepState.UPDATED, SweepState.NOT_LEARNED})
"""States in which the plate is not driven."""
VISITING = frozenset({SweepState.MOVING, SweepState.SETTLING, SweepState.MEASURING})
"""States of a sweep under way."""


def sweep_sequence(angles_deg: tuple[float, ...], home_deg: float, home_every: int) -> tuple[float, ...]:
    """Angles to visit: home first and last, and after every home_every angles."""
    sequence = [home_deg]
    for number, angle in enumerate(angles_deg, start=1):
        sequence.append(angle)
        if number % home_every == 0 or number == len(angles_deg):
            sequence.append(home_deg)
    return tuple(sequence)


class SweepMachine:
    """One plate's sweeps. Times are engine time, s."""

    def __init__(self, settings: SweepSettings, plate: PlateSettings, home_deg: float) -> None:
        self._settings = settings
        self._plate = plate
        self._home_deg = home_deg
        self.sequence = sweep_sequence(settings.angles_deg, home_deg, settings.home_every)
        self.state = SweepState.IDLE
        self.abort_reason: SweepAbort | None = None
        """Why the last sweep ended early; None when it did not."""
        self.sweep_id = 0
        self.step = -1
        self.completed = False
        """All steps are measured; the owner calls `finish`."""
        self.not_following = False
        """The last movement did not arrive; the next one that does clears it."""
        self.by_schedule = True
        """Whether a sweep begins when it is due; one that is asked for begins anyway."""
        self.first_after_s = settings.first_after_s
        """Time from the first tick to the first sweep, s."""
        self.declined = 0
        """Number of sweeps that were due and gained too little."""
        self.declined_because = ""
        """Reason of the last of them, in a sentence."""
        self._due_s: float | None = None
        self._requested = False
        self._aborts = 0
        self._deadline_s = 0.0
        self._on_target_s: float | None = None
        self._away_s: float | None = None
        self._home_try_s = float("-inf")
        self._settled_s = 0.0
        self._measured = 0
        self._home = SteadyHome(settings)
        self._base_flow = float("nan")
        self._base_speed = float("nan")
        self._seen: list[tuple[float, float]] = []

    @property
    def lead(self) -> int:
        """How many of the newest windows would belong to a sweep that begins now."""
        return 0

    @property
    def driving(self) -> bool:
        """Whether commands go to the plate."""
        return self.state not in RESTING

    @property
    def visiting(self) -> bool:
        """Whether a sweep is under way."""
        return self.state in VISITING

    @property
    def progress_pct(self) -> float:
        """Share of the steps done, %; 0 outside a sweep and 100 after a whole one."""
        if self.state in (SweepState.UPDATED, SweepState.NOT_LEARNED):
            return 100.0
        return 100.0 * max(0, self.step) / len(self.sequence) if self.visiting else 0.0

    def is_home_again(self, step: int) -> bool:
        """Whether a step of the sweep is a visit home after one away from it."""
        return step > 0 and self.sequence[step] == self._home_deg

    def remaining_s(self, now_s: float) -> float:
        """Time until the next sweep is due, s; 0 when it is."""
        return self.first_after_s if self._due_s is None else max(0.0, self._due_s - now_s)

    def schedule(self, now_s: float, after_s: float) -> None:
        """The next sweep is due after_s from now."""
        self._due_s = now_s + after_s

    def could_begin(self, now_s: float) -> bool:
        """Whether the next sweep of the schedule is due, and flow and elevator speed at home are steady."""
        due = self.state in RESTING and self._due_s is not None and now_s >= self._due_s
        return due and self._home.steady

    def decline(self, now_s: float, reason: str) -> None:
        """Skip the sweep that is due; the next one is due an interval later."""
        self.declined += 1
        self.declined_because = reason
        self.schedule(now_s, self._settings.interval_s)

    @property
    def requested(self) -> bool:
        """Whether the operator asked for a sweep that has not begun."""
        return self._requested

    def restore(self, sweep_id: int, first_after_s: float) -> None:
        """After a restart: the last sweep's number, and the time from the first tick to the next sweep, s."""
        self.sweep_id, self.first_after_s = sweep_id, first_after_s

    def request(self) -> None:
        """Operator: sweep as soon as the conditions hold, due or not."""
        self._requested = True

    def abort(self, now_s: float, reason: SweepAbort = SweepAbort.OPERATOR) -> bool:
        """End the sweep under way, if any, and take the plate home; withdraw an open request. False where there was neither."""
        requested, self._requested = self._requested, False
        if self.visiting or self.completed:
            self._abort(now_s, reason)
        elif self.state is SweepState.WAITING:
            self._enter(SweepState.IDLE)
            self.schedule(now_s, self._settings.interval_s)
        else:
            return requested
        return True

    def finish(self, now_s: float, updated: bool) -> None:
        """After `completed`: whether the sweep changed the parameters."""
        self.completed = False
        self._aborts = 0
        self.step = -1
        self.schedule(now_s, self._settings.interval_s)
        self._enter(SweepState.UPDATED if updated else SweepState.NOT_LEARNED)

    def implausible_feedback(self) -> bool:
        """Whether a plate that never moved explains the whole sweep: the force varies less than the flow computed from it."""
        if any(flow <= 0.0 or force <= 0.0 for flow, force in self._seen):
            return False
        flow_spread = spread([log(flow) for flow, _ in self._seen])
        force_spread = spread([log(force) for _, force in self._seen])
        limits = self._settings
        least, share = limits.feedback_plausibility_flow_spread, limits.feedback_plausibility_force_ratio
        return flow_spread > least and force_spread < share * flow_spread

    def tick(self, plate: PlateReading) -> PlateDemand | None:
        """Advance the time; returns the demand on the plate, None where it is not driven."""
        now = plate.time_s
        if self._due_s is None:
            self.schedule(now, self.first_after_s)
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
            self._enter(SweepState.SETTLING)
            self._on_target_s = None
            self._deadline_s = now + self._settings.settle_timeout_s
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
        now = window.end_s
        settled = self.state is SweepState.MEASURING and window.support_start_s >= self._settled_s and window.still
        usable = settled and good and not window.trend > self._settings.signal_trend
        at_home = self.sequence[self.step] == self._home_deg
        reason = self._window_trouble(window, usable, at_home)
        if reason is not None:
            self._abort(now, reason)
        if reason is not None or not usable:
            return -1
        self._seen.append((window.flow_kg_s, window.force_n))
        step = self.step
        self._measured += 1
        if self._measured >= self._settings.windows_per_step:
            self._next_step(now, window.angle_deg)
        return step

    def _window_trouble(self, window: SweepWindow, usable: bool, at_home: bool) -> SweepAbort | None:
        if not isfinite(window.flow_kg_s):
            return SweepAbort.NOT_MEASURED
        if abs(window.speed_rad_s / self._base_speed - 1.0) > self._settings.speed_change:
            return SweepAbort.SPEED_CHANGED
        limit = self._settings.flow_change if at_home else self._settings.flow_change_away
        if usable and abs(window.flow_kg_s / self._base_flow - 1.0) > limit:
            return SweepAbort.FLOW_CHANGED
        return None

    def _rest(self, plate: PlateReading) -> PlateDemand | None:
        now = plate.time_s
        if self._found_away(plate):
            self._home_try_s = now
            self._enter(SweepState.RETURNING)
            self._deadline_s = now + self._settings.return_timeout_s
            return self._return(plate)
        if self.state is not SweepState.WAITING:
            due = self._settings.enabled and self.by_schedule and self._due_s is not None and now >= self._due_s
            if not (due or self._requested):
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
        self._requested = False
        self.abort_reason = None
        self._base_flow, self._base_speed = self._home.means
        self._seen = []
        self._home.clear()
        self.step = -1
        self._next_step(plate.time_s, plate.angle_deg)

    def _next_step(self, now_s: float, angle_deg: float) -> None:
        self._measured = 0
        if self.step + 1 >= len(self.sequence):
            self.completed = True
            return
        self.step += 1
        self._enter(SweepState.MOVING)
        travel_s = abs(self.sequence[self.step] - angle_deg) / self._plate.max_rate_deg_s
        self._deadline_s = now_s + travel_s + self._settings.move_margin_s

    def _move(self, plate: PlateReading) -> None:
        if self._on_target(plate):
            self.not_following = False
            self._enter(SweepState.SETTLING)
            self._on_target_s = plate.time_s
            self._deadline_s = plate.time_s + self._settings.settle_timeout_s
        elif plate.time_s > self._deadline_s:
            self.not_following = True
            self._abort(plate.time_s, SweepAbort.NOT_FOLLOWING)

    def _settle(self, plate: PlateReading) -> None:
        now = plate.time_s
        if not self._on_target(plate) or plate.state is ActuatorState.MOVING:
            self._on_target_s = None
        elif self._on_target_s is None:
            self._on_target_s = now
        elif now - self._on_target_s >= self._settings.settle_s:
            self._settled_s = now
            self._enter(SweepState.MEASURING)
            self._deadline_s = now + self._settings.measure_timeout_s
            return
        if now > self._deadline_s:
            self._abort(now, SweepAbort.NOT_SETTLING)

    def _return(self, plate: PlateReading) -> PlateDemand:
        now = plate.time_s
        if abs(plate.angle_deg - self._home_deg) <= self._plate.at_target_tolerance_deg:
            self.not_following = self.not_following and self.abort_reason in _ACTUATOR_REASONS
        elif plate.state is ActuatorState.MANUAL:
            # Manual control has priority; afterwards the plate is found away from home and driven there.
            self._home_try_s = float("-inf")
        elif now > self._deadline_s:
            self.not_following = True
            self._home_try_s = now
        else:
            return GO_HOME
        self._enter(SweepState.ABORTED if self.abort_reason else SweepState.IDLE)
        return RELEASE

    def _abort(self, now_s: float, reason: SweepAbort) -> None:
        wait = min(self._settings.interval_s, self._settings.backoff_s * 2.0 ** min(self._aborts, 30))
        self._aborts += 1
        self.abort_reason = reason
        self.completed = False
        self.step = -1
        self.schedule(now_s, wait)
        if reason is SweepAbort.FORCE_DOES_NOT_FOLLOW:
            self.not_following = True
        self._enter(SweepState.RETURNING)
        self._deadline_s = now_s + self._settings.return_timeout_s

    def _demand(self, plate: PlateReading) -> PlateDemand:
        if self.state is SweepState.RETURNING:
            return self._return(plate)
        return PlateDemand(CommandMode.GO_TO_ANGLE, self.sequence[self.step])

    def _is_home(self, angle_deg: float) -> bool:
        """Whether the plate rests at home, by its feedback."""
        return abs(angle_deg - self._home_deg) <= self._plate.rest_tolerance_deg

    def _on_target(self, plate: PlateReading) -> bool:
        return abs(plate.angle_deg - self.sequence[self.step]) <= self._plate.at_target_tolerance_deg

    def _enter(self, state: SweepState) -> None:
        self.state = state
        self._away_s = None

"""Sweeps as a log shows them: the plate leaves home in steady flow, rests at other angles, and is at home again.

Nothing is commanded, so a plate that stays at home is no fault, and movements unlike a sweep are ignored. A sweep in a log counts
under the same conditions as a live one (`sweep_machine.py`).
"""

from __future__ import annotations

from collections import deque
from itertools import groupby

from yieldmon.engine.settings import PlateSettings, SweepSettings
from yieldmon.engine.sweeps.sweep import RESTING, PlateSweep
from yieldmon.engine.sweeps.sweep_inputs import PlateReading, SweepAbort, SweepWindow, plate_trouble
from yieldmon.frames import ActuatorState, SweepState

_LEAST_ANGLES = 3
"""Different angles, home among them, from which a sweep of another sequence than the configured one counts."""
_LONGEST_STOP = 10.0
"""Time at one angle away from home, relative to `measure_timeout_s`, after which the movement is no sweep."""


class SweepFollower(PlateSweep):
    """The sweeps of one plate that something else drove. Times are engine time, s."""

    def __init__(self, settings: SweepSettings, plate: PlateSettings, home_deg: float) -> None:
        super().__init__(settings, plate, home_deg)
        self._tolerance_deg = plate.rest_tolerance_deg
        self._configured = _stops(self.sequence)
        self._before: deque[SweepWindow] = deque(maxlen=settings.windows_per_step)
        self._stop_deg = float("nan")
        self._rest_since_s: float | None = None
        self._stop_since_s = 0.0

    @property
    def lead(self) -> int:
        """How many of the newest windows, at rest at home, would belong to a sweep that begins now."""
        return len(self._before) if self.state in RESTING else 0

    def request(self) -> None:
        """Without effect on a log."""

    def tick(self, plate: PlateReading) -> None:
        """Follow the plate."""
        if not self.visiting or self.completed:
            return
        now, trouble = plate.time_s, plate_trouble(plate)
        if trouble is SweepAbort.MANUAL:
            self._ignore()
        elif trouble is not None:
            self._end_aborted(trouble)
        elif plate.state is ActuatorState.MOVING or not self._near(plate.angle_deg, self._stop_deg):
            self._stop_deg = plate.angle_deg
            self._rest_since_s = None if plate.state is ActuatorState.MOVING else now
            self._enter(SweepState.MOVING)
        elif self._rest_since_s is None:
            self._rest_since_s = now
        elif self.state is SweepState.MOVING and now - self._rest_since_s >= self._settings.settle_s:
            self._arrive(now, plate.angle_deg)

    def window(self, window: SweepWindow) -> int:
        """Take a closed window. Returns the sweep step that it counts for, or -1."""
        good = window.whole and window.flow_kg_s > 0.0
        at_home = self._near(window.angle_deg, self._home_deg)
        if not self.visiting:
            if good and window.still and at_home:
                self._note(window)
                return -1
            begins = not (window.still and at_home) and self._settings.enabled and self._home.steady
            if not begins:
                self._forget()
                return -1
            self._begin()
        if self.completed:
            return -1
        usable = good and self._usable(window)
        reason = self._measurement.trouble(window, usable=usable, at_home=at_home)
        if reason is not None:
            self._end_aborted(reason)
            return -1
        if usable:
            self._measurement.add(window)
        self._look_for_the_end(window.end_s, at_home)
        return self.step if usable else -1

    def _note(self, window: SweepWindow) -> None:
        self._home.add(window)
        self._before.append(window)

    def _forget(self) -> None:
        self._home.clear()
        self._before.clear()

    def _begin(self) -> None:
        self.sweep_id += 1
        self.abort_reason = None
        self.not_following = False
        self._measurement.begin(self._home.means, self._before)
        self._forget()
        self.sequence, self.step = (self._home_deg,), 0
        self._stop_deg, self._rest_since_s = self._home_deg, None
        self._stop_since_s = float("inf")
        self._enter(SweepState.MOVING)

    def _arrive(self, now_s: float, angle_deg: float) -> None:
        """The plate has come to rest, at the angle of the last stop or at another one."""
        self._settled_s = now_s
        self._enter(SweepState.MEASURING)
        if not self._near(angle_deg, self.sequence[-1]):
            at_home = self._near(angle_deg, self._home_deg)
            self.sequence = (*self.sequence, self._home_deg if at_home else round(angle_deg, 1))
            self.step += 1
            self._measurement.begin_step()
        self._stop_since_s = now_s

    def _look_for_the_end(self, now_s: float, at_home: bool) -> None:
        rested_s = now_s - self._stop_since_s if self.state is SweepState.MEASURING else 0.0
        if not at_home:
            if rested_s > _LONGEST_STOP * self._settings.measure_timeout_s:
                self._ignore()
            return
        as_configured = len(self.sequence) == len(self._configured) and all(map(self._near, self.sequence, self._configured))
        if as_configured and self._measurement.step_done:
            self.completed = True
        elif rested_s > self._settings.measure_timeout_s:
            if len({round(angle) for angle in self.sequence}) >= _LEAST_ANGLES:
                self.completed = True
            else:
                self._ignore()

    def _near(self, one_deg: float, other_deg: float) -> bool:
        return abs(one_deg - other_deg) <= self._tolerance_deg

    def _ignore(self) -> None:
        """The movement is no sweep."""
        self.step = -1
        self._enter(SweepState.IDLE)

    def _end_aborted(self, reason: SweepAbort) -> None:
        """End the sweep: it cannot count."""
        self.step = -1
        self.abort_reason = reason
        self._enter(SweepState.ABORTED)

    def abort(self, now_s: float, reason: SweepAbort = SweepAbort.OPERATOR) -> bool:
        """Discard the sweep of the log. False where there is none."""
        if not (self.visiting or self.completed):
            return False
        self.completed = False
        self.not_following = reason is SweepAbort.FORCE_DOES_NOT_FOLLOW
        self._end_aborted(reason)
        return True


def _stops(sequence: tuple[float, ...]) -> tuple[float, ...]:
    """A sequence without the repetitions of an angle, between which the plate does not move."""
    return tuple(angle for angle, _ in groupby(sequence))

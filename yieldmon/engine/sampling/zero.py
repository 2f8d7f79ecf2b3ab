"""Zero-load voltage of the sensor, followed while the elevator runs empty.

Whether it runs empty is seen from the paddles, not from the level: grain comes in pulses that keep step with the chain. The
amplitudes of the paddle pattern's harmonics, averaged coherently over several windows, must be those that vibration alone was
found to make, no more and no less, each by itself. Shaft and engine vibration do not keep step with the pattern and average out;
a drifted zero has no pulses at all; a trickle of grain shows in some harmonic, whatever its phase against the vibration, so the
zero stands still under it however long it lasts. What vibration makes is measured once, with the first zero or by the operator's
zero calibration, and not again, or it would follow a trickle step by step; it is taken to grow with the square of the speed.

A trickle so small that all its harmonics stay within the margins (about 0.1 kg/s on a quiet machine, 0.3 kg/s where the paddles
themselves shake the plate by 3 N) moves the zero by no more than its own force, unless header and work state say that the machine
is cutting: then the zero stands still.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any

from yieldmon.engine.sampling.paddle_pattern import (
    Departure,
    RecentWindows,
    mean_level,
    mean_speed,
    middle_level,
    pulse_mv,
    speed_factor,
)
from yieldmon.engine.sampling.windows import Window, coherent_amplitudes
from yieldmon.engine.settings import ZeroSettings

_NEWEST = 3
"""Windows whose median a single one does not decide."""


@dataclass(frozen=True, slots=True)
class ZeroState:
    """The zero and the first zero, with which it is compared; amplitudes with the elevator empty at speed_rad_s.

    vibration_mv: each pattern harmonic over several windows, empty until measured. window_pulse_mv: largest of a single window.
    """

    zero_mv: float
    first_zero_mv: float
    speed_rad_s: float
    window_pulse_mv: float
    vibration_mv: tuple[float, ...] = ()

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> ZeroState:
        """Inverse of `dataclasses.asdict`. Raises TypeError."""
        return cls(**{**data, "vibration_mv": tuple(data.get("vibration_mv", ()))})


@dataclass(frozen=True, slots=True)
class ZeroRefusal:
    """Windows in which the elevator ran and no first zero could be taken.

    Attributes
    ----------
    waited_s : float
        How long that has been so.
    pulse_mv : float
        Amplitude in step with the paddles in the last windows.
    level_range_mv : float
        Range of the last windows' means.
    obstacle : str
        What the last window lacked; empty for one that was looked at, and had pulses or a level that ranges too far.
    """

    waited_s: float
    pulse_mv: float = float("nan")
    level_range_mv: float = float("nan")
    obstacle: str = ""


class ZeroTracker:
    """Finds and follows the zero. `state` is None until there is one."""

    def __init__(self, settings: ZeroSettings, *, sees_pulses: bool = True) -> None:
        """sees_pulses: whether the sensor is fast enough for grain to show in pulses."""
        self._settings = settings
        self._sees_pulses = sees_pulses
        self._state: ZeroState | None = None
        self._recent = RecentWindows(settings)
        self._calibrating = False
        self._against_signs = False
        self._after_suspect = False
        """Whether the zero in use was suspect when the operator's calibration began."""
        self._despite_signs = False
        self._before: ZeroState | None = None
        self._before_known_s: float | None = None
        self.suspect = False
        """Whether the zero in use was taken despite signs of grain and differs from the one before it."""
        self._refusal: ZeroRefusal | None = None
        self.known_s: float | None = None
        """Engine time at which the zero was last taken or followed; None before."""
        self.taken_from_s = float("inf")
        """Engine time at the begin of the windows from which the zero was last taken."""
        self.far_mv = 0.0
        """Difference from the zero when the elevator last looked empty, where it is too far to follow, else 0."""
        self.level_is_empty = False
        """Whether the elevator looked empty by its pulses when the operator's calibration began."""

    def calibrate(self, *, against_signs: bool = False, despite_signs: bool = True) -> bool:
        """Operator's zero calibration: the operator states that the next windows are empty; measure zero and vibration from them.

        against_signs: there are signs of grain now. despite_signs: take the windows even if they show signs of grain. Returns
        whether an undo restores the zero before an earlier calibration, because that one is suspect.
        """
        goes_on = self.suspect and self._before is not None
        self._calibrating = True
        self._despite_signs = despite_signs
        self._against_signs, self._after_suspect = against_signs, goes_on
        if not goes_on:
            self._before, self._before_known_s = self._state, self.known_s
        self.level_is_empty = despite_signs and self.looks_empty
        self.interrupt()
        return goes_on

    @property
    def before(self) -> ZeroState | None:
        """The zero that an undo restores."""
        return self._before

    @property
    def before_age_s(self) -> float:
        """Age of the zero that an undo restores, at the time when the zero in use was taken, s; 0 where not known."""
        if self._before_known_s is None or not isfinite(self.taken_from_s):
            return 0.0
        return max(self.taken_from_s - self._before_known_s, 0.0)

    @property
    def state(self) -> ZeroState | None:
        """The zero in use."""
        return self._state

    def restore(self, state: ZeroState | None) -> None:
        """After a restart: the zero that was in use."""
        self._state, self.far_mv = state, 0.0

    def resume(self, before: ZeroState, *, suspect: bool) -> None:
        """After a restart: the zero that an undo restores, and whether the zero in use is suspect."""
        self._before, self.suspect = before, suspect

    def undo(self) -> None:
        """Restore the zero before the operator's last calibration, with its age."""
        self._state, self._before = self._before, None
        self.known_s, self._before_known_s = self._before_known_s, None
        self._calibrating = self.suspect = False
        self.far_mv = 0.0
        self.interrupt()

    @property
    def doubted_mv(self) -> float:
        """How far a suspect zero is above the one before it, mV; 0 for a zero that is not suspect."""
        if not self.suspect or self._state is None or self._before is None:
            return 0.0
        return self._state.zero_mv - self._before.zero_mv

    @property
    def calibrating(self) -> bool:
        """Whether a zero calibration by the operator is under way."""
        return self._calibrating

    def go_on_with(self, before: ZeroTracker) -> None:
        """Take over the operator's calibration under way in another tracker; it begins anew."""
        if before._calibrating:
            self.calibrate(against_signs=before._against_signs, despite_signs=before._despite_signs)
            self.level_is_empty = before.level_is_empty

    def waits_for_grain_to_pass(self, signs: str) -> bool:
        """Whether the calibration must leave out the current window because of signs of grain ("" for none).

        Where it takes the window nevertheless, its zero counts as taken against signs of grain.
        """
        if not (self._calibrating and signs):
            return False
        self._against_signs = self._against_signs or self._despite_signs
        return not self._despite_signs

    @property
    def refusal(self) -> ZeroRefusal | None:
        """Why there is no first zero although the elevator runs; None where there is one, or nothing has been seen yet."""
        return None if self._state is not None else self._refusal

    @property
    def progress(self) -> tuple[int, int]:
        """Windows collected for the zero to take, and windows needed; (0, 0) while none is to be taken."""
        if self._calibrating:
            return len(self._recent), self._settings.settle_windows
        if self._state is not None:
            return 0, 0
        wanted = self._settings.first_zero_windows
        return min(len(self._recent), wanted), wanted

    @property
    def looks_empty(self) -> bool:
        """Whether the last windows show only the measured vibration; False also while that is unknown."""
        departure = self._departure_from(self._state)
        return departure is not None and not departure.either

    @property
    def level_says_nothing(self) -> bool:
        """Whether the elevator looks empty, or did so when the operator's calibration under way began."""
        return self.level_is_empty if self._calibrating else self.looks_empty

    @property
    def looks_loaded(self) -> bool:
        """Whether the last windows show paddle pulses beyond the vibration; False also while that is unknown."""
        departure = self._departure_from(self._state)
        return departure is not None and departure.above

    def _departure_from(self, state: ZeroState | None) -> Departure | None:
        """Of the last windows from the vibration of a zero; None while one of them is unknown."""
        if state is None or not state.vibration_mv or not self._recent.full:
            return None
        return self._recent.departure(state.vibration_mv, state.speed_rad_s)

    def _far_mv(self, state: ZeroState) -> float:
        """Difference of the empty level from the zero, mV, as last seen; 0 where it is near enough to follow."""
        if not self.looks_empty:
            return self.far_mv
        away_mv = self._recent.newest.mean_mv - state.zero_mv
        return away_mv if abs(away_mv) > self._settings.max_step_mv else 0.0

    @property
    def drift(self) -> str:
        """What is wrong with the zero, for the operator; "" where nothing is."""
        state = self._state
        if state is None:
            return ""
        if self.suspect:
            return "the last zero was taken despite signs of grain"
        if self.below_empty:
            return f"the plate reads {state.zero_mv - self._recent.newest.mean_mv:.0f} mV below empty"
        away_mv = state.zero_mv - state.first_zero_mv
        if abs(away_mv) > self._settings.drift_limit_mv:
            return f"the zero is {away_mv:+.0f} mV from its first value"
        far_mv = self._far_mv(state)
        return f"the empty elevator reads {far_mv:+.0f} mV from the zero" if far_mv != 0.0 else ""

    @property
    def below_empty(self) -> bool:
        """Whether the plate has read below empty for some time: the zero was taken with grain."""
        if self._state is None or not self._recent.full:
            return False
        return all(window.mean_mv < self._state.zero_mv - self._settings.max_step_mv for window in self._recent.all)

    def pulses(self, window: Window) -> bool:
        """Whether one window has paddle pulses beyond vibration."""
        state = self._state
        if state is None:
            return window.pulse_mv > self._settings.first_pulse_limit_mv
        return window.pulse_mv > self._pulse_limit_mv(self._usual_pulse_mv(state, window))

    def unseen_pulse_mv(self, window: Window) -> float:
        """Amplitude beyond vibration below which `pulses` does not detect pulses, mV; inf where no zero is known."""
        if self._state is None:
            return float("inf")
        usual = self._usual_pulse_mv(self._state, window)
        return self._pulse_limit_mv(usual) - usual

    def _pulse_limit_mv(self, usual: float) -> float:
        return max(usual * self._settings.window_pulse_margin, usual + self._settings.window_pulse_margin_mv)

    def _usual_pulse_mv(self, state: ZeroState, window: Window) -> float:
        return state.window_pulse_mv * speed_factor(window.speed_rad_s, state.speed_rad_s)

    def interrupt(self) -> None:
        """Discard the windows collected (sensor lost, plate moved, elevator out of its range)."""
        self._recent.clear()

    def lack(self, window: Window, obstacle: str) -> None:
        """Note a window that has samples and a valid elevator speed, but from which no zero can be taken."""
        if self._state is None:
            self._refusal = ZeroRefusal(self._waited_s + window.end_s - window.start_s, obstacle=obstacle)

    @property
    def _waited_s(self) -> float:
        return self._refusal.waited_s if self._refusal is not None else 0.0

    def see(self, window: Window, may_be_empty: bool) -> None:
        """Update with a complete window with a valid elevator speed and the plate at home.

        may_be_empty: neither harvesting nor header and work state exclude an empty elevator.
        """
        if not isfinite(window.mean_mv):
            self.interrupt()
            return
        self._recent.add(window)
        windows = self._recent.all
        if self._calibrating:
            if self._recent.full:
                against_signs = self._against_signs or (self._after_suspect and not self._empty_by_before())
                self._state = _measured(windows)
                self._calibrating, self.far_mv = False, 0.0
                away_mv = abs(self._state.zero_mv - self._before.zero_mv) if self._before is not None else 0.0
                self.suspect = against_signs and away_mv > self._settings.level_range_mv
                self.known_s, self.taken_from_s = window.end_s, windows[0].start_s
        elif may_be_empty and self._state is None:
            self._first(windows[-self._settings.first_zero_windows :])
        elif may_be_empty and self._state is not None:
            if self._state.vibration_mv:
                self._follow(self._state, windows)
            elif self._recent.full:
                self._measure_vibration(self._state, windows)
        elif self._state is None:
            self.lack(window, "the machine is cutting, by header and work state (check them if it is not)")

    def _empty_by_before(self) -> bool:
        """Whether the last windows look empty by the vibration of the zero before. That of a suspect zero may be of grain."""
        departure = self._departure_from(self._before) if self._sees_pulses else None
        return departure is not None and not departure.either

    def _first(self, windows: list[Window]) -> None:
        if len(windows) < self._settings.first_zero_windows:
            return
        if self._quiet(windows):
            self._state = _measured(windows, vibration=False)
            self.known_s, self.taken_from_s = windows[-1].end_s, windows[0].start_s
            return
        waited_s = self._waited_s + windows[-1].end_s - windows[-1].start_s
        levels = [window.mean_mv for window in windows]
        self._refusal = ZeroRefusal(waited_s, pulse_mv(windows), max(levels) - min(levels))

    def _measure_vibration(self, state: ZeroState, windows: list[Window]) -> None:
        near = all(abs(window.mean_mv - state.zero_mv) <= self._settings.level_range_mv for window in windows)
        if near and self._quiet(windows):
            self._state = replace(_measured(windows), zero_mv=middle_level(windows), first_zero_mv=state.first_zero_mv)
            self.known_s = windows[-1].end_s

    def _follow(self, state: ZeroState, windows: list[Window]) -> None:
        settings = self._settings
        if not self.looks_empty:
            return
        # Grain only adds. A trickle that begins has loaded most windows before their mean amplitude shows it, but not the oldest.
        step = min(windows[0].mean_mv, middle_level(windows)) - state.zero_mv
        if abs(step) > settings.max_step_mv:
            self.far_mv = self._far_mv(state)
            return
        # Grain that dies away has left least in the newest; a level that falls further is of something else.
        newest = middle_level(windows[-_NEWEST:]) - state.zero_mv
        step = min(step, newest) if newest >= -settings.max_step_mv else step
        self.known_s, self.far_mv = windows[-1].end_s, 0.0
        seconds = windows[-1].end_s - windows[-1].start_s
        limit = settings.max_rate_mv_s * seconds
        change = min(limit, max(-limit, seconds / settings.follow_time_s * step))
        self._state = replace(state, zero_mv=state.zero_mv + change)

    def _quiet(self, windows: list[Window]) -> bool:
        levels = [window.mean_mv for window in windows]
        return (
            pulse_mv(windows) <= self._settings.first_pulse_limit_mv
            and max(levels) - min(levels) <= self._settings.level_range_mv
        )


def _measured(windows: list[Window], *, vibration: bool = True) -> ZeroState:
    """The zero of windows that are taken as empty; vibration: measure it too."""
    zero, pulse = mean_level(windows), max(window.pulse_mv for window in windows)
    return ZeroState(zero, zero, mean_speed(windows), pulse, coherent_amplitudes(windows) if vibration else ())

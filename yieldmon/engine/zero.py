"""Zero-load voltage of the sensor, followed while the elevator runs empty.

Whether it runs empty is told by the paddles, not by the level: grain comes in pulses that keep step with the chain, so the part
of the signal that repeats with the paddle pattern, averaged coherently over several windows, stays at what vibration alone makes.
Shaft and engine vibration do not keep step with the pattern and average out; a drifted zero has no pulses at all. A trickle of
grain has pulses, so the zero stands still under it, however long it lasts.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import isfinite

from yieldmon.engine.settings import ZeroSettings
from yieldmon.engine.windows import Window, coherent_amplitude


@dataclass(frozen=True, slots=True)
class ZeroState:
    """zero_mv and the first zero it is judged against.

    vibration_mv and window_pulse_mv: paddle-synchronous amplitude with the elevator empty, over several windows and within one.
    """

    zero_mv: float
    first_zero_mv: float
    vibration_mv: float
    window_pulse_mv: float


class ZeroTracker:
    """Learns and follows the zero. `state` is None until there is one."""

    def __init__(self, settings: ZeroSettings) -> None:
        self._settings = settings
        self.state: ZeroState | None = None
        self._recent: deque[Window] = deque(maxlen=max(settings.first_zero_windows, settings.settle_windows))
        self._forced: list[Window] | None = None

    def calibrate(self) -> None:
        """Operator's zero calibration: the next windows are empty by the operator's word; learn zero and vibration from them."""
        self._forced = []

    @property
    def calibrating(self) -> bool:
        """Whether a zero calibration by the operator is under way."""
        return self._forced is not None

    def pulses(self, window: Window) -> bool:
        """Whether a window has paddle pulses beyond what vibration makes."""
        state = self.state
        if state is None:
            return window.pulse_mv > self._settings.first_pulse_limit_mv
        return window.pulse_mv > self._limit(state.window_pulse_mv)

    @property
    def drifted(self) -> bool:
        """Whether the zero is further from the first zero than allowed."""
        state = self.state
        return state is not None and abs(state.zero_mv - state.first_zero_mv) > self._settings.drift_limit_mv

    def interrupt(self) -> None:
        """The windows to come do not follow on those seen (sensor lost, plate moved, elevator stopped)."""
        self._recent.clear()
        if self._forced:
            self._forced = []

    def see(self, window: Window) -> None:
        """A whole window with the elevator turning in its range, the plate at home and nothing known that feeds grain."""
        if not isfinite(window.mean_mv):
            self.interrupt()
            return
        if self._forced is not None:
            self._forced.append(window)
            if len(self._forced) >= self._settings.first_zero_windows:
                self._learn(self._forced)
                self._forced = None
            return
        self._recent.append(window)
        if self.state is None:
            windows = list(self._recent)[-self._settings.first_zero_windows :]
            if len(windows) == self._settings.first_zero_windows and self._empty(windows, self._settings.first_pulse_limit_mv):
                self._learn(windows)
        else:
            self._follow(self.state, window)

    def _follow(self, state: ZeroState, window: Window) -> None:
        settings = self._settings
        windows = list(self._recent)[-settings.settle_windows :]
        if len(windows) < settings.settle_windows or not self._empty(windows, self._limit(state.vibration_mv)):
            return
        step = window.mean_mv - state.zero_mv
        if abs(step) > settings.max_step_mv:
            return
        seconds = window.end_s - window.start_s
        share = seconds / settings.follow_time_s
        limit = settings.max_rate_mv_s * seconds
        self.state = ZeroState(
            zero_mv=state.zero_mv + min(limit, max(-limit, share * step)),
            first_zero_mv=state.first_zero_mv,
            vibration_mv=state.vibration_mv + share * (coherent_amplitude(windows) - state.vibration_mv),
            window_pulse_mv=state.window_pulse_mv + share * (window.pulse_mv - state.window_pulse_mv),
        )

    def _empty(self, windows: list[Window], limit_mv: float) -> bool:
        levels = [window.mean_mv for window in windows]
        return coherent_amplitude(windows) <= limit_mv and max(levels) - min(levels) <= limit_mv

    def _learn(self, windows: list[Window]) -> None:
        zero = sum(window.mean_mv for window in windows) / len(windows)
        self.state = ZeroState(zero, zero, coherent_amplitude(windows), max(window.pulse_mv for window in windows))
        self._recent.clear()

    def _limit(self, vibration_mv: float) -> float:
        return max(vibration_mv * self._settings.pulse_margin, vibration_mv + self._settings.pulse_margin_mv)

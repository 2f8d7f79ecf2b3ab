"""When something falls due: ticks of plate commands on one grid, and every so many of them the end of a window.

Times are engine time, s. Ticks are whole command intervals counted from time 0, so that windows end at the same instants whatever
came before.
"""

from __future__ import annotations

from math import floor


class Schedule:
    """The next thing that is due, at `next_s`; -inf before `begin`."""

    def __init__(self, *, window_s: float, command_interval_s: float, grid_offset_s: float) -> None:
        self._window_s = window_s
        self._ticks_per_window = round(window_s / command_interval_s)
        self._offset_ticks = round(grid_offset_s / command_interval_s)
        self._tick = self._next_tick = 0
        self.begun = False
        self.next_s = float("-inf")
        self.window_start_s = 0.0
        """Start of the window that is being formed."""

    def begin(self, now_s: float) -> None:
        """The first frame has come; a first window shorter than half a second is joined to the next."""
        self.begun = True
        earliest = floor(now_s * self._ticks_per_window / self._window_s) + self._ticks_per_window // 2
        self._tick = earliest + self._ticks_to_end(earliest) - self._ticks_per_window
        self.window_start_s = now_s
        self._plan(driving=False)

    def formed(self, end_s: float) -> None:
        """Windows until this time are formed; the next one begins there."""
        self.window_start_s = end_s

    @property
    def window_is_due(self) -> bool:
        """Whether what is due next is the end of a window."""
        return self._ticks_to_end(self._next_tick) == self._ticks_per_window

    def done(self, *, driving: bool) -> None:
        """What was due is done. driving: the plate is driven, so that every tick matters, not only the ends of windows."""
        self._tick = self._next_tick
        self._plan(driving=driving)

    def window_ends(self, last_s: float) -> list[float]:
        """Ends of windows that fall due until last_s."""
        ends: list[float] = []
        tick = self._tick
        while True:
            tick += self._ticks_to_end(tick)
            end_s = self._time_of(tick)
            if end_s > last_s:
                return ends
            ends.append(end_s)

    def _plan(self, *, driving: bool) -> None:
        self._next_tick = self._tick + (1 if driving else self._ticks_to_end(self._tick))
        self.next_s = self._time_of(self._next_tick)

    def _time_of(self, tick: int) -> float:
        return tick * self._window_s / self._ticks_per_window

    def _ticks_to_end(self, tick: int) -> int:
        """Ticks from a tick to the next end of a window after it."""
        return self._ticks_per_window - (tick - self._offset_ticks) % self._ticks_per_window

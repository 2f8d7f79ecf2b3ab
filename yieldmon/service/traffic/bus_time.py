"""The bus's time: that of its frames, and while none comes the monotonic clock's."""

from __future__ import annotations

#: How far the engine's time stays behind the monotonic clock by which it goes on, so that frames still on their way are not late.
_DELAY_S = 0.1


class BusTime:
    """When the last frame came, and how far the engine's time may go on without one."""

    def __init__(self, silence_s: float, idle_after_s: float, now_s: float) -> None:
        """silence_s: see `Timeouts`. idle_after_s: a bus without any frame since the start counts as idle after this time. now_s:
        monotonic time."""
        self._silence_s = silence_s
        self._idle_from_s = now_s + idle_after_s
        self._last: tuple[float, float] | None = None
        self.ours_s = float("-inf")
        """Bus time of the last frame that was one for the engine."""

    @property
    def last_s(self) -> float | None:
        """Bus time of the last frame, whoever sent it; None before the first."""
        return None if self._last is None else self._last[0]

    def frame_came(self, bus_s: float, now_s: float) -> None:
        """A frame with this time stamp has come, at this monotonic time."""
        self._last = (bus_s, now_s)

    def without_ours(self, empty_until_s: float, now_s: float, system_s: float) -> float | None:
        """Bus time up to which the engine's goes on without frames of ours: as far as others' frames say, or the bus is known to
        be empty; None: it has no need to.

        empty_until_s, now_s: monotonic. system_s: Unix time.
        """
        if self._last is None:
            if now_s <= self._idle_from_s:
                return None
            # No frame yet, so no bus time either; the system's clock is as good a start as any.
            self._last = (system_s, now_s)
            return system_s
        bus_s, heard_s = self._last
        if empty_until_s - heard_s > self._silence_s:
            return bus_s + (empty_until_s - heard_s) - _DELAY_S
        return bus_s if abs(bus_s - self.ours_s) > self._silence_s else None

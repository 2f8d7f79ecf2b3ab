"""When a sweep of the plate is due."""

from __future__ import annotations

from yieldmon.engine.settings import SweepSettings


class SweepSchedule:
    """Times are engine time, s.

    Attributes
    ----------
    by_schedule : bool
        Whether a sweep begins when it is due; one that is asked for begins anyway.
    requested : bool
        Whether the operator asked for a sweep that has not begun.
    first_after_s : float
        Time from the first tick to the first sweep, s.
    declined : int
        Number of sweeps that were due and gained too little.
    declined_because : str
        Reason of the last of them, in a sentence.
    """

    def __init__(self, settings: SweepSettings) -> None:
        self._settings = settings
        self.by_schedule = True
        self.requested = False
        self.first_after_s = settings.first_after_s
        self.declined = 0
        self.declined_because = ""
        self._due_s: float | None = None
        self._aborts = 0

    def tick(self, now_s: float) -> None:
        """With the first tick the time to the first sweep begins."""
        if self._due_s is None:
            self._due_s = now_s + self.first_after_s

    def remaining_s(self, now_s: float) -> float:
        """Time until the next sweep is due, s; 0 when it is."""
        return self.first_after_s if self._due_s is None else max(0.0, self._due_s - now_s)

    def is_due(self, now_s: float) -> bool:
        """Whether the next sweep of the schedule is due."""
        return self._due_s is not None and now_s >= self._due_s

    def begins(self, now_s: float) -> bool:
        """Whether a sweep is to begin as soon as the conditions hold."""
        return (self._settings.enabled and self.by_schedule and self.is_due(now_s)) or self.requested

    def skip(self, now_s: float) -> None:
        """The next sweep is due an interval from now."""
        self._due_s = now_s + self._settings.interval_s

    def decline(self, now_s: float, reason: str) -> None:
        """Skip the sweep that is due, for a reason."""
        self.declined += 1
        self.declined_because = reason
        self.skip(now_s)

    def finished(self, now_s: float) -> None:
        """A whole sweep is over."""
        self._aborts = 0
        self.skip(now_s)

    def aborted(self, now_s: float) -> None:
        """A sweep ended early: the next one is due the later the more have done so one after another."""
        self._due_s = now_s + min(self._settings.interval_s, self._settings.backoff_s * 2.0 ** min(self._aborts, 30))
        self._aborts += 1

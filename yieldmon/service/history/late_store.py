"""A store that is read on a thread of its own: on a disk that hangs at the start measuring begins without it, and what came
meanwhile is measured again from what the store remembers when the disk answers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from time import monotonic

from yieldmon.engine.monitor import Monitor
from yieldmon.engine.results import Result
from yieldmon.frames import Frame
from yieldmon.service.answering import on_a_thread
from yieldmon.service.history.memory import Memory
from yieldmon.service.history.recovery import Recovery

_LOOK_EVERY_S = 0.1
#: After what was measured again, before the first sweep.
_REST_S = 60.0


class StoreReading:
    """One reading of the store, which may take as long as the disk does.

    Parameters
    ----------
    read : callable
        Takes the store for this run and says what it remembers; raises as `Daemon.run`.
    """

    def __init__(self, read: Callable[[], Recovery]) -> None:
        self._begun_s = monotonic()
        self._reading = on_a_thread(read, "store-reading")

    @property
    def done(self) -> bool:
        """Whether the disk has answered."""
        return self._reading.done()

    @property
    def age_s(self) -> float:
        """Since its begin, s."""
        return monotonic() - self._begun_s

    def wait(self, timeout_s: float, given_up: Callable[[], bool]) -> bool:
        """Until the disk answers, timeout_s seconds at most, and no longer than given_up() is false; whether it has."""
        end_s = monotonic() + timeout_s
        while not self._reading.done():
            left_s = end_s - monotonic()
            if left_s <= 0.0 or given_up():
                return False
            try:
                self._reading.exception(min(left_s, _LOOK_EVERY_S))
            except TimeoutError:
                continue
        return True

    def result(self) -> Recovery:
        """What the store remembers, once it is done. Raises what the reading raised."""
        return self._reading.result(0.0)


class KeptInput:
    """What the engine is fed meanwhile, in order: frames, and bus times up to which there were none.

    Parameters
    ----------
    limit : int
        Beyond it no more is kept.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._kept: list[Frame | float] = []
        self.full = False

    def add(self, item: Frame | float) -> bool:
        """Keep one more; True for the first one that there is no room for."""
        if self.full:
            return False
        if len(self._kept) >= self._limit:
            self.full = True
            return True
        self._kept.append(item)
        return False

    @property
    def duration_s(self) -> float:
        """From the first to the last, s."""
        times = [item.time_s if isinstance(item, Frame) else item for item in (*self._kept[:1], *self._kept[-1:])]
        return max(times) - min(times) if times else 0.0

    def into(self, monitor: Monitor) -> Iterator[Sequence[Result]]:
        """What a monitor makes of it, result by result."""
        for item in self._kept:
            results = monitor.feed(item) if isinstance(item, Frame) else monitor.tick(item)
            if results:
                yield monitor.completed(results)


def without_sweeps_for(memory: Memory, duration_s: float) -> Memory:
    """The same, with no sweep due within duration_s, nor in the minute after it: what is measured again moves no plate."""
    if memory.engine is None:
        return memory
    due_in_s = max(memory.engine.sweep_due_in_s, duration_s + _REST_S)
    return replace(memory, engine=replace(memory.engine, sweep_due_in_s=due_in_s))

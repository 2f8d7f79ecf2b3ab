"""The store of one run of the daemon, which may answer late: its owner, reader and writer, and what is to be said of it."""

from __future__ import annotations

import logging
from collections.abc import Callable

from yieldmon.frames import Frame
from yieldmon.service.config.configuration import Configuration
from yieldmon.service.history.late_store import KeptInput, StoreReading
from yieldmon.service.history.memory import Memory
from yieldmon.service.history.recovery import Recovery, recover
from yieldmon.service.storage.batch import Batch
from yieldmon.service.storage.identity import this_computer
from yieldmon.service.storage.ownership import Ownership
from yieldmon.service.storage.store import Store
from yieldmon.service.storage.writer import StoreWriter
from yieldmon.service.timeouts import Timeouts

_log = logging.getLogger(__name__)


class RunStore:
    """Read once at the start; from then on batches go to it.

    On a disk that does not answer at the start measuring begins without it: `known` is False, what the engine is fed is kept, and
    `answers` says when `take` gives what the store remembers after all.

    Parameters
    ----------
    configuration : Configuration
    timeouts : Timeouts

    Attributes
    ----------
    note : str
        What is to be said of it, "" when all is well.
    writer : StoreWriter
    """

    def __init__(self, configuration: Configuration, timeouts: Timeouts) -> None:
        self.path = configuration.store_path
        self._retention = configuration.retention
        self._timeouts = timeouts
        self._computer = this_computer()
        self._ownership = Ownership(self.path)
        self.note = ""
        self.writer = StoreWriter(
            self.open,
            configuration.document.store.pending_seconds,
            timeouts.retry_s,
            path=self.path,
            keep=self._ownership.keep,
        )
        self._reading: StoreReading | None = None
        self._kept = KeptInput(timeouts.kept_frames)
        self._replacements = 0

    def open(self) -> Store:
        """Another connection to it. Raises StoreError."""
        return Store(self.path, self._retention, computer=self._computer)

    def release(self) -> None:
        """Let other daemons have it."""
        self._ownership.release()

    @property
    def known(self) -> bool:
        """Whether it has been read."""
        return self._reading is None

    @property
    def answers(self) -> bool:
        """Whether the disk has answered and what it remembers has not been taken yet."""
        return self._reading is not None and self._reading.done

    def read(self, given_up: Callable[[], bool]) -> bool:
        """Begin to read it, and wait for it as long as a start does; False where given_up() ended that.

        The reading goes on where the disk does not answer in that time.
        """
        # On a thread of its own: the disk may hang.
        self._reading = reading = StoreReading(self._recover)
        reading.wait(self._timeouts.store_s, given_up)
        if not reading.done and given_up():
            _log.error("%s: the disk has not answered since the start", self.path)
            return False
        return True

    def _recover(self) -> Recovery:
        self._ownership.take()
        return recover(self.path, self._retention, self.open, self._computer)

    def remembered(self) -> Memory:
        """What the run begins with: nothing on a disk that does not answer. Raises as `Daemon.run`."""
        assert self._reading is not None, "read first"
        if self._reading.done:
            return self.take().memory
        age_s = self._reading.age_s
        self.note = f"the disk has not answered for {age_s:.0f} s; until it does, totals are those since the start"
        _log.error("%s: %s", self.path, self.note)
        return Memory()

    def take(self) -> Recovery:
        """What it remembers, once it answers; from then on it is known. Raises what the reading raised."""
        assert self._reading is not None, "taken once"
        recovery = self._reading.result()
        self._reading = None
        self.note = recovery.note
        if recovery.made:
            self.writer.expect(recovery.last_batch)
        return recovery

    @property
    def reading_age_s(self) -> float:
        """Since the reading began, s; 0 once it is known."""
        return 0.0 if self._reading is None else self._reading.age_s

    def keep(self, item: Frame | float) -> bool:
        """What the engine is fed while it is not known; True for the first that there is no room for."""
        if self.known or not self._kept.add(item):
            return False
        _log.error("%s: still does not answer; seconds from now on have no records", self.path)
        return True

    def take_kept(self) -> KeptInput:
        """What was kept, once."""
        kept, self._kept = self._kept, KeptInput(0)
        return kept

    def submit(self, batch: Batch) -> None:
        """Hand a batch over; while it is not known the batch has the number of one that it may have already, and is left out."""
        if self.known:
            self.writer.submit(batch)

    def replaced(self) -> bool:
        """Whether it was made anew since the last call: then it lacks what an earlier one was given."""
        before, self._replacements = self._replacements, self.writer.health().replacements
        return self._replacements != before

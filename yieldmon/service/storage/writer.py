"""The store's own thread: takes batches from the engine's without ever making it wait, and outlasts a failing disk."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from time import monotonic, time

from yieldmon.errors import reason
from yieldmon.service.storage.batch import Batch
from yieldmon.service.storage.in_the_way import make_way
from yieldmon.service.storage.rescue import finish, repair
from yieldmon.service.storage.store import Store
from yieldmon.service.storage.store_errors import BatchRefusedError, StoreDamagedError, StoreDetachedError, StoreError
from yieldmon.service.storage.store_file import set_aside
from yieldmon.service.storage.store_names import beside

_log = logging.getLogger(__name__)

RETRY_S = 2.0
"""A write that failed is tried again after so long."""
#: A medium that damages what is written to it would be filled with stores set aside.
_REPAIR_EVERY_S = 60.0
#: For files that were removed or replaced again, and for another try where a repair failed on a medium without room, say.
_REPAIR_AGAIN_S = 10.0
#: Commits between two rounds of making room.
_PRUNE_EVERY = 60
#: Events carried along from a batch whose record had to be given up.
_EVENTS_KEPT = 1000


@dataclass(frozen=True)
class StoreHealth:
    """`failing` says what is wrong, None while all is well. `pending` batches wait, the first of them for
    `waiting_s`; `records_dropped` one-second records were dropped because too many waited (their mass is in the totals);
    `batches_refused` held a row that breaks the schema, which was left out. `replacements`: how often a store that was damaged,
    removed or replaced while in use was put in order, and why the last time."""

    failing: str | None = None
    pending: int = 0
    waiting_s: float = 0.0
    committed: int = 0
    records_dropped: int = 0
    batches_refused: int = 0
    replacements: int = 0
    replaced_because: str = ""


class StoreWriter:
    """Writes batches in order on its own thread; a batch is written once, whatever fails in between."""

    def __init__(
        self, open_store: Callable[[], Store], capacity: int, retry_s: float = RETRY_S, path: Path | None = None,
        keep: Callable[[], None] = lambda: None,
    ) -> None:  # fmt: skip
        """open_store: opens the store anew each time it is called. capacity: batches that may wait with their records;
        beyond it the oldest gives up its record and hands its totals and events to the next. path: where the store is, for one
        that cannot be opened to be set aside. keep: called before each write; raises StoreError when the store is another's."""
        self._open_store = open_store
        self._capacity = capacity
        self._retry_s = retry_s
        self._pending: deque[Batch] = deque()
        self._changed = threading.Condition()
        self._stopping = False
        self._health = StoreHealth()
        self._waiting_since_s = 0.0
        self._in_flight = 0
        self._path = path
        self._keep = keep
        self._store: Store | None = None
        self._last_committed = 0
        self._last_submitted = 0
        self._written: tuple[float, float] | None = None
        """Time of the last second that was written, s, and the total then, kg."""
        self._there = False
        """There is a store already: a file that is missing has been removed."""
        self._repaired_s = float("-inf")
        self._thread = threading.Thread(target=self._run, name="store-writer", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def expect(self, last_batch: int) -> None:
        """Say, before the start, which batch is the last in the store: one that lacks it when opened is reported as replaced."""
        self._last_committed = self._last_submitted = last_batch
        self._there = True

    def submit(self, batch: Batch) -> None:
        """Hand over the next batch; returns at once."""
        with self._changed:
            if not self._pending:
                self._waiting_since_s = monotonic()
            self._pending.append(batch)
            self._last_submitted = batch.number
            # Batches that are being written stay as they are, or their events would be written twice.
            if len(self._pending) - self._in_flight > self._capacity:
                oldest = self._pending[self._in_flight]
                del self._pending[self._in_flight]
                self._pending[self._in_flight] = _without_record(oldest, self._pending[self._in_flight])
                dropped = self._health.records_dropped + len(oldest.seconds)
                self._health = replace(self._health, records_dropped=dropped)
            self._changed.notify_all()

    @property
    def alive(self) -> bool:
        """Whether the thread runs."""
        return self._thread.is_alive()

    def health(self) -> StoreHealth:
        """How the store does."""
        with self._changed:
            if not self._pending:
                return self._health
            return replace(self._health, pending=len(self._pending), waiting_s=monotonic() - self._waiting_since_s)

    def wait_until_written(self, timeout_s: float) -> bool:
        """Wait until nothing is pending; False when that takes longer than timeout_s seconds."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._pending, timeout_s)

    def stop(self, timeout_s: float | None = None) -> bool:
        """Write what is pending, once more if the disk fails, and end the thread; False when it did not end within timeout_s
        seconds, as on a disk that hangs."""
        with self._changed:
            self._stopping = True
            self._changed.notify_all()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        last_try = False
        while self._wait_for_work():
            if not self.work():
                if last_try:
                    _log.error("%s", self._lost())
                    break
                last_try = self._wait_before_retry()
        self.close()

    def _lost(self) -> str:
        """What a stop leaves unwritten."""
        with self._changed:
            batches, problem = tuple(self._pending), self._health.failing
        rows = [row for batch in batches for row in batch.seconds]
        if not rows:
            return f"{len(batches)} batches could not be written: {problem}"
        first, last = rows[0], rows[-1]
        since_s, before_kg = self._written or (first.time_s - first.duration_s, first.total_kg - first.mass_kg)
        lost_kg = max(last.total_kg - before_kg, 0.0)
        return (
            f"the last {last.time_s - since_s:.0f} s could not be written and are lost, with {lost_kg:.1f} kg: {problem}; "
            f"the total was {last.total_kg:.1f} kg, load {last.load_number} held {last.load_kg:.1f} kg"
        )

    def work(self) -> bool:
        """Write what is pending, on the caller's thread; False when the disk failed and another try needs a pause."""
        store = self._store
        try:
            self._keep()
            store = self._store = store or self._opened()
            self._write(store)
        except StoreError as error:
            if self._mended(store, error):
                self._store, self._last_committed = None, 0
                return True
            self._failed(str(error))
            if not isinstance(error, StoreDetachedError):
                self.close()
            # Else what it sees has no other place yet.
            return False
        return True

    def close(self) -> None:
        """Close the file, on the thread that wrote it."""
        if self._store is not None:
            self._store.close()
            self._store = None

    def _mended(self, store: Store | None, error: StoreError) -> bool:
        """Whether a store that was found damaged, removed or replaced is in order again."""
        path = self._path if store is None else store.path
        if path is None or not isinstance(error, StoreDamagedError | StoreDetachedError):
            return False
        detached = isinstance(error, StoreDetachedError)
        # At a stop what waits has no other time.
        if not self._stopping and monotonic() - self._repaired_s < (_REPAIR_AGAIN_S if detached else _REPAIR_EVERY_S):
            return False
        self._repaired_s = monotonic()
        try:
            note = repair(store, path, error)
        except (StoreError, OSError) as failure:
            _log.error("%s: %s", path, failure)
            self._repaired_s = float("-inf") if detached else self._repaired_s + _REPAIR_AGAIN_S - _REPAIR_EVERY_S
            return False
        self._report_replaced(path, note)
        return True

    def _report_replaced(self, path: Path, note: str) -> None:
        _log.error("%s: %s", path, note)
        with self._changed:
            count = self._health.replacements + 1
            self._health = replace(self._health, replacements=count, replaced_because=note)

    def _opened(self) -> Store:
        """The store, opened; whether it is still the one that was written is reported. Raises StoreError."""
        removed = self._there and self._path is not None and not self._found(self._path)
        if self._path is not None:
            with suppress(OSError):
                make_way(beside(self._path))
        store = self._open_store()
        try:
            found = store.last_batch()
        except StoreError:
            store.close()
            raise
        if found > self._last_submitted:
            # Another one's: it would leave out batches whose numbers it has.
            store.close()
            try:
                aside = set_aside(store.path, f"replaced-{int(time())}")
            except OSError as error:
                raise StoreError(f"{store.path}: {error}") from error
            store, found = self._open_store(), 0
            self._report_replaced(
                store.path, f"replaced by another store while closed, which is {aside.name}; a new one is started"
            )
        elif found < self._last_committed:
            missing = self._last_committed - found
            self._report_replaced(store.path, f"removed or replaced while closed; its last {missing} commits are missing")
        elif removed:
            self._report_replaced(store.path, "removed while closed; a new one is started")
        self._last_committed, self._there = found, True
        return store

    @staticmethod
    def _found(path: Path) -> bool:
        """Whether there is a store; a replacement that could not be ended is ended first. Raises StoreError."""
        try:
            if not path.exists():
                finish(path)
            return path.exists() and path.stat().st_size > 0
        except OSError as error:
            raise StoreError(f"{path}: {reason(error)}") from error

    def _wait_for_work(self) -> bool:
        with self._changed:
            self._changed.wait_for(lambda: self._pending or self._stopping)
            return bool(self._pending)

    def _wait_before_retry(self) -> bool:
        """True when the service is to stop: the next try is the last."""
        with self._changed:
            return self._changed.wait_for(lambda: self._stopping, self._retry_s)

    def _write(self, store: Store) -> None:
        with self._changed:
            batches = tuple(self._pending)
            self._in_flight = len(batches)
        done = refused = 0
        try:
            store.require_attached()
            for done, refused in self._commits(store, batches):  # noqa: B007 - counted however the loop ends
                self._last_committed = batches[done - 1].number
                if batches[done - 1].seconds:
                    self._written = batches[done - 1].seconds[-1].time_s, batches[done - 1].seconds[-1].total_kg
        finally:
            with self._changed:
                self._in_flight = 0
                for _ in range(done):
                    self._pending.popleft()
                committed, in_part = self._health.committed + done, self._health.batches_refused + refused
                self._health = replace(self._health, committed=committed, batches_refused=in_part)
        with self._changed:
            self._waiting_since_s = monotonic()
            if self._health.failing:
                _log.info("%s: writing again", store.path)
            self._health = replace(self._health, failing=None)
            self._changed.notify_all()
        if committed // _PRUNE_EVERY != (committed - done) // _PRUNE_EVERY:
            store.prune()

    @staticmethod
    def _commits(store: Store, batches: tuple[Batch, ...]) -> Iterator[tuple[int, int]]:
        """After each commit, how many batches are written, and of how many of them a part was left out that no store takes."""
        if not batches:
            return
        try:
            store.commit(batches)
            yield len(batches), 0
            return
        except BatchRefusedError as error:
            _log.debug("%s; batch by batch", error)
        refused = 0
        for count, batch in enumerate(batches, 1):
            try:
                store.commit([batch])
            except BatchRefusedError:
                refused += 1
                for what in store.commit_in_part(batch):
                    _log.error("%s: %s; left out, the rest of its second is stored", store.path, what)
            yield count, refused

    def _failed(self, problem: str) -> None:
        with self._changed:
            if self._health.failing != problem:
                _log.error("%s; measuring continues, %d seconds wait to be written", problem, len(self._pending))
            self._health = replace(self._health, failing=problem)


def _without_record(oldest: Batch, following: Batch) -> Batch:
    # A load under way is in every batch: its newest row is the one that counts, and the only one to keep.
    loads = {load.number: load for load in oldest.loads + following.loads}
    return replace(
        following,
        loads=tuple(loads.values()),
        sweeps=(oldest.sweeps + following.sweeps)[-_EVENTS_KEPT:],
        parameter_versions=(oldest.parameter_versions + following.parameter_versions)[-_EVENTS_KEPT:],
        faults=(oldest.faults + following.faults)[-_EVENTS_KEPT:],
        tickets=oldest.tickets + following.tickets,
        actions=oldest.actions + following.actions,
        steps=oldest.steps + following.steps,
        counters={**oldest.counters, **following.counters},
    )

"""What a start goes on from, whatever became of the store since."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from yieldmon.engine.mass.budget import MassBudget
from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.state import EngineState
from yieldmon.errors import reason
from yieldmon.service.history.memory import Memory, recall
from yieldmon.service.storage import rescue
from yieldmon.service.storage.batch import Load
from yieldmon.service.storage.hard_links import detach_hard_links
from yieldmon.service.storage.identity import NONE, are_two, detach_foreign_journal
from yieldmon.service.storage.in_the_way import make_way
from yieldmon.service.storage.retention import Retention
from yieldmon.service.storage.rows import SecondRow
from yieldmon.service.storage.spare_copy import spare_copy
from yieldmon.service.storage.store import Store
from yieldmon.service.storage.store_errors import StoreDamagedError, StoreError, StoreUnreadableError
from yieldmon.service.storage.store_file import last_noted_batch, last_noted_store, note_beginning, refuse_foreign_file, set_aside
from yieldmon.service.storage.store_names import beside, parts

_log = logging.getLogger(__name__)

#: Commits that a kill may leave unnoted: those that waited for the medium.
_UNNOTED_AT_MOST = 60
_ANOTHERS = "the totals may be another machine's"
#: Between two tries to read a medium that gives back nothing: one that has just been plugged in may answer the next time.
_ANSWERS_WITHIN_S = 1.0


@dataclass(frozen=True)
class Recovery:
    """What the store remembers, and what is to be said of it, empty when all is well. last_batch: the last that it has. made:
    there is a store; False where there was none and the medium has no room for one yet."""

    memory: Memory
    note: str = ""
    last_batch: int = 0
    made: bool = True


@dataclass(frozen=True)
class _Remembered:
    """What a store remembers, its identity, and the computer that wrote it last. made: as in `Recovery`."""

    memory: Memory
    identity: int
    computer: int
    made: bool = True


def recover(path: Path, retention: Retention, open_store: Callable[[], Store], computer: int = NONE) -> Recovery:
    """What the store at `path` remembers. A damaged one is set aside and a new one made of what is left of it.

    A medium that is full, takes no writing, or does not read all that is on it need not stop the measuring: what it holds can be
    read all the same, and where it holds nothing the store can be made later. A store of which nothing can be read, at two tries,
    is set aside. Raises StoreError when that cannot be done, InputError as `store_file.refuse_foreign_file`, OccupiedError as
    `detach_hard_links`.
    """
    refuse_foreign_file(path)
    notes = _made_ready(path)
    for without in rescue.GIVEN_UP:
        try:
            found = _remember(path, retention, open_store, without, notes)
        except StoreUnreadableError:
            time.sleep(_ANSWERS_WITHIN_S)
            found = _remember_or_set_aside(path, retention, open_store, without, notes)
        if found is None:
            continue
        memory, last_batch = found.memory, found.memory.last_batch
        missing = last_noted_batch(path) - last_batch
        notes += _doubts(last_batch, missing)
        if missing > 0:
            # Numbers go on, or an older copy put back later would look like the newer one.
            memory = replace(memory, last_batch=last_batch + missing)
        if are_two(found.identity, last_noted_store(path)):
            notes.append(f"it is not the store that was written here: {_ANOTHERS}")
        if are_two(computer, found.computer):
            notes.append(f"it was last written on another computer: {_ANOTHERS}")
        for note in notes:
            _log.error("%s: %s", path, note)
        note_beginning(path)
        return Recovery(memory, "; ".join(notes), last_batch, found.made)
    raise StoreError(f"{path}: cannot be used, nor can a new one in its place")


def _made_ready(path: Path) -> list[str]:
    """What an interrupted rescue, links and another store's journal left is cleared away; what was done is returned."""
    notes: list[str] = []
    try:
        make_way(beside(path))
        rescue.finish(path)
        if shared := detach_hard_links(path):
            notes.append(shared)
        if strange := detach_foreign_journal(path):
            notes.append(strange)
    except OSError as error:
        _log.error("%s: %s", path, error)
    return notes


def _doubts(last_batch: int, missing: int) -> list[str]:
    """What the number of commits says against a store; missing: commits made here that it lacks, below 0 where it has more."""
    if missing > 0:
        return [f"its last {missing} commits are missing, as expected if an older copy was put in its place"]
    if 0 < last_batch + missing < last_batch - _UNNOTED_AT_MOST:
        return [f"it has {-missing} commits more than were made here: {_ANOTHERS}"]
    return []


def _remember(
    path: Path, retention: Retention, open_store: Callable[[], Store], without: tuple[str, ...], notes: list[str]
) -> _Remembered | None:
    """As `_read`; None where a damaged one has been set aside, and the one in its place is to be
    read. Says in `notes` what was done. Raises StoreError, and StoreUnreadableError where nothing of it can be read."""
    try:
        return _read(path, retention, open_store)
    except StoreDamagedError as error:
        _log.error("%s", error)
        try:
            notes.append(_rescued(path, without))
            return None
        except (OSError, StoreError) as failure:
            why = f"{error}, and cannot be set aside: {reason(failure)}"
    except StoreError as error:
        why = str(error)
        left = _left_at(path)
        return _Remembered(Memory(), NONE, NONE, made=False) if left is None else _from_copy(left, retention, why, notes)
    return _from_copy(path, retention, why, notes)


def _remember_or_set_aside(
    path: Path, retention: Retention, open_store: Callable[[], Store], without: tuple[str, ...], notes: list[str]
) -> _Remembered | None:
    """As `_remember`; a store of which nothing can be read is set aside. Raises StoreError where that cannot be done."""
    try:
        return _remember(path, retention, open_store, without, notes)
    except StoreUnreadableError as why:
        try:
            aside = set_aside(path, f"unreadable-{int(time.time())}")
        except OSError as error:
            raise StoreError(f"{why}, and cannot be set aside: {reason(error)}") from error
        what = str(why).removeprefix(f"{path}: ")
        notes.append(f"{what}; nothing of it can be read, set aside as {aside.name}; totals are those of a new store")
        return None


def _left_at(path: Path) -> Path | None:
    """What there is of a store: itself, or the one that was to take its place; None where nothing has been written yet."""
    try:
        if any(part.is_file() and part.stat().st_size for part in parts(path)[:2]):
            return path
        return rescue.replacement(path)
    except OSError:
        return path


def _rescued(path: Path, without: tuple[str, ...]) -> str:
    """What is to be said of a store that was set aside. Raises StoreError or OSError where it cannot be."""
    rescued = rescue.rescue(path, f"damaged-{int(time.time())}", without=without)
    return f"damaged, {rescued}; {_origin_of_totals(rescued)}".removesuffix("; ")


def _origin_of_totals(rescued: rescue.Rescued) -> str:
    """Empty where they are those of the last state."""
    if rescued.saved.get("state"):
        return ""
    return f"totals are those of {'the last second saved' if rescued.saved.get('second') else 'a new store'}"


def _from_copy(path: Path, retention: Retention, why: str, notes: list[str]) -> _Remembered:
    """As `_read`, of what is left of a store that stays as it is; says so in `notes`. Raises StoreError, and
    StoreUnreadableError where nothing of it can be read."""
    try:
        with spare_copy(path) as (copy, unread):
            # A note of commits is not copied: without it a file whose first bytes are damaged could be anybody's.
            note_beginning(copy)
            for without in rescue.GIVEN_UP:
                rescued = rescue.rescue(copy, "damaged", without=without)
                with suppress(StoreDamagedError), Store(copy, retention) as store:
                    found = _Remembered(remembered(store), store.identity(), store.computer())
                    break
            else:
                raise StoreError(f"{path}: what is left of it cannot be used")
    except (OSError, StoreError) as failure:
        if str(failure) not in why:
            _log.error("%s", failure)
        unreadable = isinstance(failure, StoreUnreadableError)
        raise (StoreUnreadableError if unreadable else StoreError)(why) from failure
    said = [f"{why}; read from a copy", rescued.contents, _origin_of_totals(rescued)]
    if unread:
        said.insert(1, f"{unread} bytes cannot be read")
    notes.append("; ".join(part for part in said if part).removeprefix(f"{path}: "))
    return found


def _read(path: Path, retention: Retention, open_store: Callable[[], Store]) -> _Remembered:
    """What the store remembers, opened the first way that works."""
    ways: tuple[Callable[[], Store], ...] = (
        open_store,
        lambda: Store(path, retention, exclusive=True),
        lambda: Store(path, retention, immutable=True),
        lambda: Store(path, retention, copied=True),
    )
    failures: list[StoreError] = []
    for way in ways:
        try:
            with way() as store:
                identity, computer = store.identity(), store.computer()
                return _Remembered(remembered(store), identity, computer)
        except StoreDamagedError:
            raise
        except StoreError as error:
            if str(error) not in map(str, failures):
                _log.error("%s", error)
            failures.append(error)
    # The first says what is wrong with the medium, the others why there is no way around that.
    raise failures[0]


def remembered(store: Store) -> Memory:
    """What a store remembers, its totals being those of its last second where its state is older or lost.

    Raises StoreDamagedError when it makes no sense.
    """
    memory, last = recall(store), store.last_second()
    if last is None:
        return memory
    if memory.engine is None:
        return _without_state(store, last)
    if memory.last_second <= int((store.state() or {}).get("last_second", 0)):
        return memory
    return replace(memory, engine=replace(memory.engine, totals=_caught_up(memory.engine.totals, last, memory.loads)))


def _without_state(store: Store, last: SecondRow) -> Memory:
    versions, loads = store.parameter_versions(), store.loads()
    totals = Totals(load_number=last.load_number)
    open_load = next((load for load in loads if load.number == last.load_number), None)
    return Memory(
        engine=EngineState(totals=_caught_up(totals, last, loads)),
        saved_s=last.time_s,
        last_second=last.number,
        last_version=max((version.version for version in versions), default=0),
        loads=tuple(loads),
        tickets=tuple(store.tickets()),
        actions=tuple(store.actions()),
        field=open_load.field if open_load is not None else "",
        crop=open_load.crop if open_load is not None else "",
        counters=store.counters(),
    )


def _caught_up(totals: Totals, last: SecondRow, loads: Sequence[Load]) -> Totals:
    """Totals that are not behind a second's, nor behind a load that has begun or ended.

    Mass that only the second knows has no known moisture and area; its standard deviation is the second's, of unknown causes.
    """
    if last.load_number > totals.load_number:
        totals = replace(totals.start_load(), load_number=last.load_number)
    ended = any(load.number == totals.load_number and load.ended_s is not None for load in loads)
    missing_kg = max(0.0, last.total_kg - totals.total_kg)
    missing_load_kg = max(0.0, last.load_kg - totals.load_kg)
    return replace(
        totals,
        total_kg=totals.total_kg + missing_kg,
        total_unknown_moisture_kg=totals.total_unknown_moisture_kg + missing_kg,
        load_open=totals.load_open and not ended,
        load_kg=totals.load_kg + missing_load_kg,
        load_unknown_moisture_kg=totals.load_unknown_moisture_kg + missing_load_kg,
        load_unknown_area_kg=totals.load_unknown_area_kg + missing_load_kg,
        total_budget=_budget(last.total_std_dev_kg) if missing_kg > 0.0 else totals.total_budget,
        load_budget=_budget(last.load_std_dev_kg) if missing_load_kg > 0.0 else totals.load_budget,
    )


def _budget(std_dev_kg: float | None) -> MassBudget:
    """All of it may be common."""
    return MassBudget.unknown() if std_dev_kg is None else MassBudget(parameters_kg=std_dev_kg)

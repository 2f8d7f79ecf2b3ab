"""The service in a simulated world: a disk that lies, tears, fills, goes away and takes no writing, a clock that steps, a process
that is killed at any commit, operators at any second; random schedules by seed, invariants after each life.

    python -m tests.robustness simulation --days 10000 --seed 1
    python -m tests.robustness simulation --undo checksums       # a mend undone: the simulation must find it
    python -m tests.robustness simulation --table                # every mend undone in turn

A day is some lives of a daemon, each a few seconds of harvest and as many chances for trouble. The store's, the journal's, the
writer's and the recovery's code is the daemon's own, stepped on one thread; the monitor is one that measures 10 kg a second.

Invariants: a start always succeeds; the total after a start is that of the last commit, or something is said; no total is above
what was measured, and none goes back unsaid; a state that is damaged alone, and a replacement that was interrupted, cost nothing;
seconds are numbered without a gap or a double; the seconds kept add up; what counts as committed is in the file of that name, or
something is said; tickets that were committed are there once, or something is said; what could not be written says so; files that
are removed or replaced under an open store cost no second of the history.
Ends with 1 when one is broken.
"""

from __future__ import annotations

import errno
import os
import random
import shutil
import sqlite3
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest import mock

from tests.robustness import undoing
from tests.robustness.undoing import Mend, Simulation
from tests.service.test_store import second
from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.state import EngineState
from yieldmon.errors import InputError
from yieldmon.files import parameter_file
from yieldmon.service.history import recovery
from yieldmon.service.storage import rescue, schema
from yieldmon.service.storage.batch import Batch, Load, ParameterVersion, Ticket
from yieldmon.service.storage.retention import Retention
from yieldmon.service.storage.rows import SecondRow
from yieldmon.service.storage.store import Store
from yieldmon.service.storage.store_errors import StoreError
from yieldmon.service.storage.writer import StoreWriter

KG_PER_S = 10.0
_TRANSFER = ("", "-wal", ".last")
_PARAMETERS = parameter_file.to_document(parameter_file.load())


@dataclass
class World:
    """One machine's disk and clock, and what is true. `spoken` says that the store has said something since the last look."""

    folder: Path
    rng: random.Random
    clock_s: float = 1.7e9
    measured_kg: float = 0.0
    committed_kg: float = 0.0
    reported: list[str] = field(default_factory=list)
    troubles: Counter[str] = field(default_factory=Counter)
    broken: list[str] = field(default_factory=list)
    tickets: int = 0
    copied_kg: float = 0.0
    """What had been measured when the copy that may be put back was made; a life that began at 0 since has measured less."""
    excused: bool = False
    """Seconds have been lost, and that was said."""
    harmless: bool = False
    """What happened to the store last costs nothing."""
    full: bool = False
    read_only: bool = False

    @property
    def path(self) -> Path:
        return self.folder / "yieldmon.sqlite"

    def wrong(self, what: str) -> None:
        self.broken.append(what)

    def open_store(self) -> Store:
        if self.read_only:
            raise StoreError(f"{self.path}: attempt to write a readonly database")
        with self.room():
            store = Store(self.path, Retention())
        if self.full:
            pages = store._pragma("page_count")
            store._database.execute(f"PRAGMA max_page_count = {pages}")
        return store

    def room(self) -> AbstractContextManager[Any]:
        """On a full medium no table can be made, but in memory."""
        made = Store._migrate

        def make(store: Store, step: int) -> None:
            if store._database.execute("PRAGMA database_list").fetchone()[2]:
                raise sqlite3.OperationalError("database or disk is full")
            made(store, step)

        return mock.patch.object(Store, "_migrate", make) if self.full else nullcontext()

    @contextmanager
    def seal(self) -> Iterator[None]:
        """At the start on a medium that takes no writing a store is read, and nothing is put in order."""
        opened, rescued = Store, rescue.rescue

        def reading(path: Path, *given: Any, **how: Any) -> Store:
            if path == self.path and not ("immutable" in how or "copied" in how):
                return self.open_store()
            return opened(path, *given, **how)

        def in_order(path: Path, *given: Any, **how: Any) -> rescue.Rescued:
            if path == self.path:
                raise OSError(errno.EROFS, os.strerror(errno.EROFS))
            return rescued(path, *given, **how)

        def unfinished(path: Path) -> None:
            raise OSError(errno.EROFS, os.strerror(errno.EROFS))

        sealed = (
            mock.patch.object(recovery, "Store", reading), mock.patch.object(rescue, "rescue", in_order),
            mock.patch.object(rescue, "finish", unfinished),
        )  # fmt: skip
        with ExitStack() as stack:
            if self.read_only:
                for patch in sealed:
                    stack.enter_context(patch)
            yield


class Life:
    """One run of a daemon, as far as the store goes: recovers, measures, commits, ends one way or another."""

    def __init__(self, world: World) -> None:
        self.world = world
        with world.room(), world.seal():
            found = recovery.recover(world.path, Retention(), world.open_store)
        memory, self.said = found.memory, bool(found.note)
        self.totals = memory.engine.totals if memory.engine is not None else Totals()
        self.batch = memory.last_batch
        self.second = memory.last_second
        self.version = memory.last_version
        self.tickets = list(memory.tickets)
        self._judge_start(found.note)
        self.writer = StoreWriter(world.open_store, 3600, retry_s=0.0, path=world.path)
        if found.made:
            self.writer.expect(found.last_batch)
        self.whole = True
        self.entered: list[Ticket] = []
        self.acceptable_kg = self.totals.total_kg
        """Total of the last batch handed over that a store can take: one that none can take commits nothing."""
        self.failing = False
        """The writer says that it cannot use the store."""
        self.owed: frozenset[int] = frozenset()
        """Seconds that an open store had when its files were removed: it can write them anew."""

    def _judge_start(self, note: str) -> None:
        world, total_kg = self.world, self.totals.total_kg
        if total_kg > world.measured_kg + 1e-6:
            world.wrong(f"total {total_kg} kg of {world.measured_kg} kg measured")
        if total_kg < world.committed_kg - 1e-6 and not note:
            world.wrong(f"total {total_kg} kg where {world.committed_kg} kg were committed, unsaid")
        if round(total_kg / KG_PER_S, 6) % 1.0:
            world.wrong(f"total {total_kg} kg, which no second had")
        if world.harmless and total_kg != world.committed_kg:
            world.wrong(f"total {total_kg} kg where {world.committed_kg} kg could be had")
        world.harmless = False
        if len(set(map(repr, self.tickets))) < len(self.tickets):
            world.wrong("a ticket twice")
        if len(self.tickets) < world.tickets and not note:
            world.wrong(f"{len(self.tickets)} of {world.tickets} tickets, unsaid")
        # From here on the truth is what the store has: grain that nobody remembers is not measured again. A medium that takes no
        # writing keeps a store that could not be read, and a later start may find what that one said was missing.
        world.measured_kg = max(total_kg, world.measured_kg) if world.read_only else total_kg
        world.committed_kg = total_kg
        world.tickets = len(self.tickets)

    def measure(self) -> None:
        """A second."""
        world = self.world
        world.clock_s += 1.0
        self.totals = self.totals.with_mass(KG_PER_S, None)
        world.measured_kg += KG_PER_S
        self.second += 1
        self.batch += 1
        row = second(
            self.second, mass_kg=KG_PER_S, time_s=world.clock_s, load_number=self.totals.load_number, load_kg=self.totals.load_kg,
            total_kg=self.totals.total_kg,
        )  # fmt: skip
        self.submit(replace(self._batch(), seconds=(row,)))

    def _batch(self) -> Batch:
        world = self.world
        tickets = entered = tuple(self.entered)
        self.entered = []
        versions: tuple[ParameterVersion, ...] = ()
        if not self.version or not self.whole:
            self.version = max(1, self.version)
            versions = (ParameterVersion(self.version, world.clock_s, "file", {**_PARAMETERS, "version": self.version}),)
        if not self.whole:
            tickets, self.whole = tuple(self.tickets), True
        state = {
            "engine": EngineState(totals=self.totals).as_dict(), "saved_s": world.clock_s, "last_second": self.second,
            "parameter_digest": "", "field": "", "crop": "", "faults": [],
        }  # fmt: skip
        load = Load(self.totals.load_number, "", "", None, None, self.totals.load_kg, None)
        counters = {"starts": 1}
        if world.rng.random() < 0.001:
            # No store takes it, which is said: what it alone would have brought is not committed.
            counters["huge"] = 10**20
            self.tickets = [ticket for ticket in self.tickets if ticket not in entered]
        else:
            self.acceptable_kg = self.totals.total_kg
        return Batch(
            self.batch, world.clock_s, state, loads=(load,), tickets=tickets, parameter_versions=versions,
            counters=counters,
        )  # fmt: skip

    def submit(self, batch: Batch) -> None:
        """Hand over and let the writer work, as its thread would."""
        writer, world = self.writer, self.world
        before = writer.health()
        writer.submit(batch)
        done = writer.work()
        if done and writer.health().pending:
            done = writer.work()
        health = writer.health()
        if health.replacements != before.replacements:
            self.said, self.whole = True, False
        if health.batches_refused != before.batches_refused:
            # Its mass is in the state of the next.
            world.troubles["refused"] += 1
            self.said = True
        if not health.pending:
            world.committed_kg = self.acceptable_kg
            world.tickets = len(self.tickets)
        elif not health.failing:
            world.wrong("batches wait and nothing is said")
        self.failing = bool(health.pending)

    def end(self, kill: bool) -> None:
        """A stop, or a kill: files as they are, the writer's connection forgotten."""
        world = self.world
        if kill:
            saved = {suffix: _read(world.path, suffix) for suffix in _TRANSFER}
            self.writer.close()
            for suffix, content in saved.items():
                target = world.path.with_name(world.path.name + suffix)
                target.unlink(missing_ok=True)
                if content is not None:
                    target.write_bytes(content)
            world.path.with_name(world.path.name + "-shm").unlink(missing_ok=True)
        else:
            replacements = self.writer.health().replacements
            self.writer.work()
            if not self.writer.health().pending:
                world.committed_kg, self.failing = self.acceptable_kg, False
            if self.writer.health().replacements != replacements:
                self.said, self.whole = True, False
            if not self.whole:
                self.batch += 1
                self.submit(self._batch())
            self.writer.close()

    def files_go(self) -> None:
        """The files are about to be removed or replaced: what an open store has is owed, what a closed one had is gone."""
        world = self.world
        if self.writer._store is None or world.full or world.read_only or self.failing:
            self.owed = frozenset()
            return
        with suppress(StoreError, InputError, sqlite3.Error), Store.reading(world.path) as store:
            self.owed |= {row.number for row in store.seconds()}

    def look(self) -> None:
        """The seconds in the store are numbered and add up."""
        if self.world.read_only:
            return
        if not self.world.path.exists():
            # A writer that says it cannot use the store does not see that it is gone; the next start is held to say so.
            if self.world.committed_kg and not self.said and not self.failing:
                self.world.wrong(f"{self.world.committed_kg} kg count as committed, to a file that is gone, unsaid")
            return
        try:
            with Store.reading(self.world.path) as store:
                rows: list[SecondRow] = store.seconds()
                tickets, versions = len(store.tickets()), store.parameter_versions()
        except Exception as error:  # noqa: BLE001 - damage that came after the last look is found by the next start
            self.world.troubles[f"unreadable {type(error).__name__}"] += 1
            return
        world = self.world
        if lost := self.owed - {row.number for row in rows}:
            world.wrong(f"{len(lost)} seconds of the history lost with files that an open store could write anew")
        in_file_kg = rows[-1].total_kg if rows else 0.0
        if not self.said and not self.failing and in_file_kg < world.committed_kg - 1e-6:
            world.wrong(f"{in_file_kg} kg in the file where {world.committed_kg} kg count as committed, unsaid")
        if not self.said and not self.failing and tickets < world.tickets:
            world.wrong(f"{tickets} tickets in the file where {world.tickets} count as committed, unsaid")
        if rows and not self.said and not self.failing and not versions:
            world.wrong("seconds in the file without the parameters they were measured with, unsaid")
        world.excused |= self.said
        if not world.excused and [row.number for row in rows] != list(range(rows[0].number, rows[-1].number + 1) if rows else []):
            world.wrong("seconds with a gap or a double")
        if rows and not world.excused and rows[-1].total_kg - rows[0].total_kg - KG_PER_S * (len(rows) - 1) > 1e-6:
            world.wrong("seconds that do not add up to the total")


def _read(path: Path, suffix: str) -> bytes | None:
    part = path.with_name(path.name + suffix)
    return part.read_bytes() if part.exists() else None


# Troubles: while a daemon runs, and between two lives


def _clock(world: World, life: Life) -> None:
    world.clock_s += world.rng.choice((-86400.0, -3600.0, 3600.0, 1e7))


def _fill(world: World, life: Life) -> None:
    world.full = not world.full
    life.writer.close()


def _protect(world: World, life: Life) -> None:
    world.read_only = not world.read_only
    life.writer.close()


def _remove(world: World, life: Life) -> None:
    life.files_go()
    for suffix in world.rng.choice((("",), ("-wal",), ("", "-wal"), ("", "-wal", "-shm"))):
        world.path.with_name(world.path.name + suffix).unlink(missing_ok=True)


def _swap(world: World, life: Life) -> None:
    life.files_go()
    world.path.unlink(missing_ok=True)
    world.path.write_bytes(b"another file")


def _exchange(world: World, life: Life) -> None:
    """While the store is closed, as after each failure, that of another machine comes into its place."""
    life.writer.close()
    life.files_go()
    for suffix in ("", "-wal", "-shm"):
        world.path.with_name(world.path.name + suffix).unlink(missing_ok=True)
    other = world.folder / "other"
    if not other.exists():
        state = {
            "engine": EngineState().as_dict(), "saved_s": world.clock_s, "last_second": 10**6, "parameter_digest": "",
            "field": "", "crop": "", "faults": [],
        }  # fmt: skip
        with Store(other) as store:
            store.commit([Batch(10**6, world.clock_s, state)])
    shutil.copyfile(other, world.path)


def _ticket(world: World, life: Life) -> None:
    ticket = Ticket(world.clock_s, life.totals.load_number, life.totals.load_number, 100.0, 99.0, str(world.rng.random()))
    life.entered.append(ticket)
    life.tickets.append(ticket)


def _new_load(world: World, life: Life) -> None:
    life.totals = life.totals.start_load()


RUNNING: tuple[Callable[[World, Life], None], ...] = (
    _clock, _fill, _protect, _remove, _swap, _exchange, _ticket, _ticket, _new_load, _new_load,
)  # fmt: skip


def _flip(world: World) -> None:
    suffix = world.rng.choice(("", "-wal"))
    content = _read(world.path, suffix)
    if content:
        out = bytearray(content)
        at = world.rng.randrange(len(out))
        kind = world.rng.random()
        if kind < 0.4:
            out[at] ^= 1 << world.rng.randrange(8)
        elif kind < 0.7:
            at -= at % 512
            out[at : at + 512] = bytes(len(out[at : at + 512]))
        else:
            at -= at % 4096
            out[at : at + 4096] = world.rng.randbytes(len(out[at : at + 4096]))
        world.path.with_name(world.path.name + suffix).write_bytes(out)


def _sound(world: World) -> bool:
    """Whether the store has what was committed: a trouble before may have left another file."""
    try:
        with Store.reading(world.path) as store:
            last = store.last_second()
    except Exception:  # noqa: BLE001 - it has not
        return False
    return last is not None and last.total_kg == world.committed_kg


def _alter(world: World) -> None:
    """A change that leaves the file sound for SQLite: what a flipped bit in a value does."""
    statements = (
        "UPDATE state SET document = replace(document, ':', ';')",
        "UPDATE state SET document = replace(document, '\"total_kg\":', '\"total_kg\":9')",
        "UPDATE ticket SET weighed_mass_kg = weighed_mass_kg + 1",
        "UPDATE second SET total_kg = total_kg + 512 WHERE number = (SELECT max(number) FROM second)",
        "UPDATE parameter_set SET document = CAST(x'ff' AS TEXT)",
        "DELETE FROM state",
    )
    try:
        database = sqlite3.connect(world.path, isolation_level=None)
        chosen = world.rng.choice(statements)
        sound = _sound(world)
        database.execute(chosen)
        database.close()
        world.harmless = sound and "state" in chosen
    except sqlite3.Error:
        pass


def _cut(world: World) -> None:
    content = _read(world.path, "-wal")
    if content:
        world.path.with_name(world.path.name + "-wal").write_bytes(content[: world.rng.randrange(len(content))])


def _put_back(world: World) -> None:
    """A disk that lied: the store is as it was a while ago."""
    copy = world.folder / "copy"
    if copy.exists():
        world.path.with_name(world.path.name + "-wal").unlink(missing_ok=True)
        shutil.copyfile(copy, world.path)
        world.measured_kg = max(world.measured_kg, world.copied_kg)


def _interrupt(world: World) -> None:
    """A power cut between two steps of a replacement."""
    if world.path.exists() and not _read(world.path, "-wal"):
        world.harmless = _sound(world)
        world.path.rename(world.path.with_name(world.path.name + ".ready"))


RESTING: tuple[Callable[[World], None], ...] = (_flip, _flip, _flip, _alter, _cut, _put_back, _interrupt)


def _seal(world: World) -> None:
    """The next life begins on a medium that takes no writing."""
    world.read_only = True


def day(world: World) -> None:
    """A few lives."""
    rng = world.rng
    for _ in range(rng.randint(1, 4)):
        try:
            life = Life(world)
        except StoreError as error:
            world.wrong(f"does not start: {error}")
            world.read_only = False
            continue
        except Exception as error:  # noqa: BLE001 - whatever keeps a daemon from starting is what is looked for
            world.wrong(f"does not start: {type(error).__name__}: {error}")
            _clear(world)
            continue
        for _ in range(rng.randint(1, 12)):
            if rng.random() < 0.15:
                trouble = rng.choice(RUNNING)
                world.troubles[trouble.__name__.strip("_")] += 1
                trouble(world, life)
            life.measure()
        world.full = world.read_only = False
        life.end(kill=rng.random() < 0.5)
        life.look()
        if rng.random() < 0.3 and world.path.exists() and not _read(world.path, "-wal"):
            shutil.copyfile(world.path, world.folder / "copy")
            world.copied_kg = world.measured_kg
        if rng.random() < 0.4:
            harm = rng.choice(RESTING)
            world.troubles[harm.__name__.strip("_")] += 1
            harm(world)
        if rng.random() < 0.15:
            world.troubles["seal"] += 1
            _seal(world)


def _begun(world: World) -> None:
    """A store that was never made to its end, since the medium was full, and is."""
    made, end = Store._migrate, world.rng.randrange(schema.VERSION)

    def make(store: Store, step: int) -> None:
        if step == end:
            raise sqlite3.OperationalError("database or disk is full")
        made(store, step)

    with mock.patch.object(Store, "_migrate", make), suppress(StoreError):
        Store(world.path).close()
    world.full = True
    world.troubles["begun"] += 1


def _clear(world: World) -> None:
    for left in world.folder.iterdir():
        left.unlink()
    world.measured_kg = world.committed_kg = world.copied_kg = 0.0
    world.tickets = 0


def simulate(days: int, seed: int) -> World:
    """So many days on one machine after another, 20 each; each problem with its seed and day."""
    problems: list[str] = []
    troubles: Counter[str] = Counter()
    ticks = iter(range(10**12))
    # Time that the code waits for is the simulation's: a minute goes by between two looks.
    clock = mock.patch("yieldmon.service.storage.writer.monotonic", side_effect=lambda: 100.0 * next(ticks))
    # In memory where there is such a file system: what a medium does to a file is the simulation's to say.
    memory = Path("/dev/shm")
    with clock, tempfile.TemporaryDirectory(dir=memory if os.access(memory, os.W_OK) else None) as place:
        world = World(Path(place), random.Random(seed))
        for number in range(days):
            if number % 20 == 0:
                for left in Path(place).iterdir():
                    left.unlink()
                world = World(Path(place), random.Random(f"{seed}/{number // 20}"))
                if world.rng.random() < 0.3:
                    _begun(world)
            day(world)
            problems += [f"seed {seed}, day {number}: {what}" for what in world.broken]
            world.broken.clear()
            troubles += world.troubles
            world.troubles.clear()
    world.broken, world.troubles = problems, troubles
    return world


# Each mend undone


def _patched(target: str, value: Any) -> Callable[[], AbstractContextManager[Any]]:
    return lambda: mock.patch(target, value)


@contextmanager
def _no_checksums() -> Iterator[None]:
    flat = lambda table, *values: 0  # noqa: E731
    with ExitStack() as patched:
        for module in ("stored_rows", "rescue", "identity", "store_file", "store_sql"):
            patched.enter_context(mock.patch(f"yieldmon.service.storage.{module}.row_checksum", flat))
        yield


def _no_copy(path: Path, timeout_s: float) -> sqlite3.Connection:
    raise StoreError(f"{path}: no other way")


def _nothing_set_aside(path: Path, label: str, **_: Any) -> rescue.Rescued:
    raise OSError("not set aside")


def _mend(points: tuple[int, ...], undone: Callable[[], AbstractContextManager[Any]]) -> Mend:
    return Mend(points, lambda days, seed: simulate(days, seed).broken, undone)


def _no_spare(path: Path) -> AbstractContextManager[Any]:
    raise StoreError(f"{path}: no other way")


MENDS = {
    "stores read from a copy": _mend((), _patched("yieldmon.service.history.recovery.spare_copy", _no_spare)),
    "checksums": _mend((1,), _no_checksums),
    "rescue": _mend((1,), _patched("yieldmon.service.history.recovery.rescue.rescue", _nothing_set_aside)),
    "removed files": _mend((6,), _patched("yieldmon.service.storage.store.Store.require_attached", lambda store: None)),
    "witness of commits": _mend((1,), _patched("yieldmon.service.history.recovery.last_noted_batch", lambda path: 0)),
    "looking after files while closed": _mend(
        (6,), _patched("yieldmon.service.storage.writer.StoreWriter._opened", lambda writer: writer._open_store())
    ),
    "mending in use": _mend(
        (2,), _patched("yieldmon.service.storage.writer.StoreWriter._mended", lambda writer, store, error: False)
    ),
    "interrupted replacement": _mend((1,), _patched("yieldmon.service.storage.rescue.finish", lambda path: None)),
    "totals of the last second": _mend(
        (1,), _patched("yieldmon.service.history.recovery._caught_up", lambda totals, last, loads: totals)
    ),
    "stores that cannot be made to their end": _mend((), _patched("yieldmon.service.storage.store.in_memory", _no_copy)),
    "tickets told once": _mend(
        (), _patched("yieldmon.service.storage.store_sql._INSERT_TICKET", "INSERT INTO ticket VALUES (NULL, ?, ?, ?, ?, ?, ?, ?)")
    ),
}


def _told(days: int, seed: int) -> tuple[list[str], Counter[str]]:
    world = simulate(days, seed)
    return world.broken, world.troubles


SIMULATION = Simulation(__doc__, "days", 1000, _told, MENDS)


def main(arguments: list[str]) -> int:
    """See `undoing.main`."""
    return undoing.main(SIMULATION, arguments)

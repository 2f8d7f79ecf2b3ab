"""A damaged store on a medium that takes no writing, and one with places that cannot be read: what is left of it is read."""

from __future__ import annotations

import errno
import fcntl
import os
import sqlite3
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.service.bench import EMPTY_MV, GRAIN_MV, START_S, running, wait_for
from tests.service.test_store import second
from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.state import EngineState
from yieldmon.files import parameter_file
from yieldmon.service.history import recovery
from yieldmon.service.history.recovery import recover
from yieldmon.service.storage.batch import Batch, ParameterVersion
from yieldmon.service.storage.retention import DEFAULT_RETENTION
from yieldmon.service.storage.spare_copy import spare_copy
from yieldmon.service.storage.store import Store
from yieldmon.service.storage.store_errors import StoreError

_GET_FLAGS, _SET_FLAGS, _IMMUTABLE = 0x80086601, 0x40086602, 0x10
"""FS_IOC_GETFLAGS, FS_IOC_SETFLAGS and FS_IMMUTABLE_FL of linux/fs.h."""


def set_immutable(path: Path, immutable: bool) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        flags = struct.unpack("l", fcntl.ioctl(descriptor, _GET_FLAGS, struct.pack("l", 0)))[0]
        flags = flags | _IMMUTABLE if immutable else flags & ~_IMMUTABLE
        fcntl.ioctl(descriptor, _SET_FLAGS, struct.pack("l", flags))
    except OSError:
        pytest.skip("root may write everywhere, and this file system knows no files that cannot be changed")
    finally:
        os.close(descriptor)


def set_writable(folder: Path, writable: bool) -> None:
    """The folder and its files. Modes keep everybody off but root."""
    for path in (folder, *folder.iterdir()):
        if os.geteuid():
            path.chmod(0o700 if writable else 0o500)
        else:
            set_immutable(path, not writable)


@contextmanager
def without_writing(folder: Path) -> Iterator[None]:
    set_writable(folder, False)
    try:
        yield
    finally:
        set_writable(folder, True)


HARM = {
    "a row": lambda database: database.execute("UPDATE counter SET value = value + 1"),
    "the state": lambda database: database.execute("UPDATE state SET document = replace(document, ':', ';')"),
    "a table": lambda database: database.executescript(
        "PRAGMA writable_schema = 1; DELETE FROM sqlite_schema WHERE name = 'load'"
    ),
}


@pytest.mark.parametrize("harm", HARM)
@pytest.mark.parametrize("journal", [False, True])
def test_a_damaged_store_that_cannot_be_set_aside_stops_no_measuring(tmp_path, monkeypatch, harm, journal):
    monkeypatch.setattr("yieldmon.service.storage.writer._REPAIR_AGAIN_S", 0.0)
    state = tmp_path / "state"
    with running(tmp_path, state=state) as bench:
        bench.play(14, EMPTY_MV)
        bench.play(6, GRAIN_MV)
        bench.played()
    path = state / "yieldmon.sqlite"
    with Store(path) as store:
        before_kg = store.seconds()[-1].total_kg
    assert before_kg > 1.0
    database = sqlite3.connect(path, isolation_level=None)
    HARM[harm](database)
    kept = {part: part.read_bytes() for part in state.iterdir() if part.name.endswith(("sqlite", "-wal"))}
    database.close()
    if journal:
        for part, content in kept.items():
            part.write_bytes(content)
    with without_writing(state), running(tmp_path, state=state, start_s=START_S + 60.0, retry_s=0.05) as bench:
        assert bench.status["total"]["mass_kg"] == pytest.approx(before_kg, rel=1e-12)
        assert "read from a copy" in bench.status["store"]["note"]
        bench.play(4, GRAIN_MV)
        bench.played()
        assert "StoreFailing" in bench.faults
        wait_for(lambda: bench.daemon.writer.health().failing, "the failing to be noticed")
        assert bench.daemon.writer.health().committed == 0
        set_writable(state, True)
        wait_for(lambda: bench.daemon.writer.health().pending == 0, "what waited, written once the medium takes it")
        assert "StoreFailing" in bench.faults
    with Store(path) as store:
        rows = store.seconds()
    assert [row.number for row in rows] == list(range(1, len(rows) + 1))
    assert rows[-1].total_kg >= before_kg
    assert sum(row.mass_kg for row in rows) == pytest.approx(rows[-1].total_kg, rel=1e-9)
    assert len(list(state.glob("yieldmon.sqlite.damaged-*[0-9]"))) == 1


def stored(path: Path, seconds: int) -> None:
    parameters = parameter_file.to_document(parameter_file.load())
    with Store(path) as store:
        for number in range(1, seconds + 1):
            engine = EngineState(totals=Totals().with_mass(10.0 * number, None))
            state = {
                "engine": engine.as_dict(), "saved_s": 1.0, "last_second": number,
                "parameter_digest": "", "field": "", "crop": "", "faults": [],
            }  # fmt: skip
            versions = (ParameterVersion(1, 1.0, "file", parameters),) if number == 1 else ()
            row = second(number, mass_kg=10.0, total_kg=10.0 * number)
            store.commit([Batch(number, 1.0, state, seconds=(row,), parameter_versions=versions)])


def refuse_to_read(monkeypatch: pytest.MonkeyPatch, begin: int, end: int) -> None:
    """As a medium with bad sectors does, whoever reads them."""
    read = os.pread

    def pread(descriptor: int, length: int, offset: int) -> bytes:
        if offset < end and offset + length > begin:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return read(descriptor, length, offset)

    monkeypatch.setattr("os.pread", pread)


def test_sectors_that_cannot_be_read_are_zero_in_the_copy_and_reported(tmp_path, monkeypatch):
    path = tmp_path / "s.sqlite"
    content = os.urandom(3_000_000)
    path.write_bytes(content)
    refuse_to_read(monkeypatch, 1_049_100, 1_050_000)
    with spare_copy(path) as (copy, unread):
        # From the begin of the first sector to the end of the last.
        assert unread == 1024
        assert copy.read_bytes() == content[:1_049_088] + bytes(1024) + content[1_050_112:]
    assert path.read_bytes() == content
    assert not copy.exists()


def test_a_medium_that_refuses_for_another_reason_gives_no_copy_with_holes(tmp_path, monkeypatch):
    """Permission, a stale handle: nothing says that the sector is bad, so zeros in its place would pass for damage."""
    path = tmp_path / "s.sqlite"
    path.write_bytes(os.urandom(3_000_000))

    def pread(descriptor: int, length: int, offset: int) -> bytes:
        raise OSError(errno.ESTALE, os.strerror(errno.ESTALE))

    monkeypatch.setattr("os.pread", pread)
    with pytest.raises(StoreError, match=f"cannot be copied to be read: .*{os.strerror(errno.ESTALE)}"), spare_copy(path):
        pass


def test_a_store_with_a_bad_sector_is_read_as_far_as_it_goes(tmp_path, monkeypatch):
    """SQLite reads around none: where it fails, every start did."""
    path = tmp_path / "s.sqlite"
    stored(path, 40)
    whole = path.read_bytes()

    def fail(*_: object, **__: object) -> Store:
        raise StoreError(f"{path}: disk I/O error")

    refuse_to_read(monkeypatch, 0, 512)
    opened = Store

    def reading(where: Path, *how: object, **named: object) -> Store:
        return fail() if where == path else opened(where, *how, **named)

    monkeypatch.setattr("yieldmon.service.history.recovery.Store", reading)
    found = recover(path, DEFAULT_RETENTION, fail)
    assert found.memory.engine.totals.total_kg == 400.0
    assert (found.memory.last_second, found.last_batch, found.made) == (40, 40, True)
    assert "disk I/O error; read from a copy; 512 bytes cannot be read; saved: " in found.note
    assert path.read_bytes() == whole, "nothing is done to a medium that may read it the next time"


def unreadable(path: Path, monkeypatch: pytest.MonkeyPatch, *, answers_later: bool = False) -> list[float]:
    """As a medium that gives back nothing of the file there, or only after somebody has waited. Returns the waits."""
    node, opened, read, waits = path.stat().st_ino, Store, os.pread, []

    def silent(found: os.stat_result) -> bool:
        return found.st_ino == node and not (answers_later and waits)

    def opening(where: Path, *how: object, **named: object) -> Store:
        if where.exists() and silent(where.stat()):
            raise StoreError(f"{where}: disk I/O error")
        return opened(where, *how, **named)

    def pread(descriptor: int, length: int, offset: int) -> bytes:
        if silent(os.fstat(descriptor)):
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return read(descriptor, length, offset)

    monkeypatch.setattr("yieldmon.service.history.recovery.Store", opening)
    monkeypatch.setattr("os.pread", pread)
    monkeypatch.setattr("time.sleep", waits.append)
    return waits


def test_a_store_of_which_nothing_can_be_read_is_set_aside_and_the_totals_are_marked(tmp_path, monkeypatch):
    path = tmp_path / "s.sqlite"
    stored(path, 3)
    whole = path.read_bytes()
    unreadable(path, monkeypatch)
    found = recover(path, DEFAULT_RETENTION, lambda: recovery.Store(path))
    (aside,) = tmp_path.glob("s.sqlite.unreadable-*[0-9]")
    assert aside.read_bytes() == whole
    assert found.memory.engine is None
    assert (found.memory.last_batch, found.last_batch, found.made) == (3, 0, True)
    assert found.note.startswith(
        f"disk I/O error; nothing of it can be read, set aside as {aside.name}; totals are those of a new"
    )
    assert "its last 3 commits are missing" in found.note
    assert "another" not in found.note


def test_a_medium_that_answers_a_second_later_loses_nothing(tmp_path, monkeypatch):
    path = tmp_path / "s.sqlite"
    stored(path, 3)
    waits = unreadable(path, monkeypatch, answers_later=True)
    found = recover(path, DEFAULT_RETENTION, lambda: recovery.Store(path))
    assert waits == [1.0]
    assert found.memory.engine is not None
    assert (found.memory.engine.totals.total_kg, found.last_batch, found.note) == (30.0, 3, "")


def test_a_store_that_can_neither_be_read_nor_renamed_ends_the_start(tmp_path, monkeypatch):
    path = tmp_path / "s.sqlite"
    stored(path, 3)
    unreadable(path, monkeypatch)

    def refuse(*_: object) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr("yieldmon.service.history.recovery.set_aside", refuse)
    with pytest.raises(StoreError, match=r"disk I/O error, and cannot be set aside: Input/output error$"):
        recover(path, DEFAULT_RETENTION, lambda: recovery.Store(path))
    assert path.exists()


def test_a_copy_finds_its_place_where_the_first_has_no_room(tmp_path, monkeypatch):
    path = tmp_path / "s.sqlite"
    path.write_bytes(b"what is there")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "no folder"))
    if not os.access("/dev/shm", os.W_OK):
        pytest.skip("there is no other place here")
    with spare_copy(path) as (copy, unread):
        assert (copy.read_bytes(), unread) == (b"what is there", 0)

"""Folders, pipes and links under the names of a store's files stop no start, and are kept; a lock whose file is removed lets no
second daemon onto a store."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.service.test_store import batch
from tests.service.test_store_damage import kept as kept  # noqa: PLC0414 - a fixture, which the next one needs
from tests.service.test_store_damage import path as path  # noqa: PLC0414 - a fixture
from tests.service.test_store_damage import state
from yieldmon.errors import InputError
from yieldmon.service.history.recovery import recover
from yieldmon.service.storage.ownership import OccupiedError, Ownership
from yieldmon.service.storage.retention import Retention
from yieldmon.service.storage.store import Store
from yieldmon.service.storage.store_errors import StoreError
from yieldmon.service.storage.store_file import read_only
from yieldmon.service.storage.writer import StoreWriter

KEPT = b"somebody else's"


def _folder(place: Path, victim: Path) -> None:
    place.mkdir()
    (place / "victim").write_bytes(KEPT)


def _pipe(place: Path, victim: Path) -> None:
    os.mkfifo(place)


def _nowhere(place: Path, victim: Path) -> None:
    place.symlink_to("/nonexistent/there")


def _link(place: Path, victim: Path) -> None:
    place.symlink_to(victim)


def _endless(place: Path, victim: Path) -> None:
    place.symlink_to("/dev/zero")


#: Of a sound store, and of one that is mended.
SUFFIXES = (("-wal", "-shm", ".last", ".lock"), ("-wal", ".being-made", ".being-made-wal", ".ready", ".mended"))


@pytest.mark.parametrize("damaged", [False, True], ids=["sound", "damaged"])
@pytest.mark.parametrize("plant", [_folder, _pipe, _nowhere, _link, _endless])
def test_a_start_finds_its_way_round_what_is_no_file(
    path: Path, tmp_path: Path, plant: Callable[[Path, Path], None], damaged: bool
) -> None:
    content, victim = path.read_bytes(), tmp_path / "a victim"
    victim.write_bytes(KEPT)
    for suffix in SUFFIXES[damaged]:
        folder = tmp_path / suffix
        folder.mkdir()
        store = folder / "s.sqlite"
        store.write_bytes(bytes(16) + content[16:] if damaged else content)
        if suffix != ".last":
            (folder / "s.sqlite.last").write_bytes(path.with_name("s.sqlite.last").read_bytes())
        plant(folder / f"s.sqlite{suffix}", victim)
        with Ownership(store):
            found = recover(store, Retention(), lambda store=store: Store(store))
            assert found.memory.engine is not None
            assert (found.memory.engine.totals.total_kg, found.last_batch) == (400.0, 40), suffix
            writer = StoreWriter(lambda store=store: Store(store), 10, path=store)
            writer.submit(batch(41, state=state(41)))
            assert writer.work(), suffix
            writer.close()
        with Store.reading(store) as reading:
            assert reading.last_batch() == 41
        assert all(left.read_bytes() == KEPT for left in (victim, *folder.rglob("victim")))
        assert any(left.is_dir() for left in folder.iterdir()) == (plant is _folder)


def test_a_journal_that_leads_elsewhere_is_not_read_by_readers(path: Path) -> None:
    path.with_name("s.sqlite-wal").symlink_to("/dev/zero")
    with pytest.raises(InputError):
        read_only(path)


def test_a_store_reached_by_two_paths_has_one_daemon(path: Path, tmp_path: Path) -> None:
    (tmp_path / "linked").symlink_to(tmp_path)
    with Ownership(path), pytest.raises(OccupiedError), Ownership(tmp_path / "linked" / path.name):
        pass


def test_a_lock_that_is_removed_is_taken_anew(path: Path) -> None:
    with Ownership(path) as first:
        path.with_name("s.sqlite.lock").unlink()
        first.keep()
        with pytest.raises(OccupiedError), Ownership(path):
            pass
        first.keep()


def test_two_daemons_never_write_one_store_whose_lock_was_removed(path: Path) -> None:
    """The second was faster than the first one's next look: the first writes no more, and says why."""
    with Ownership(path) as first:
        writer = StoreWriter(lambda: Store(path), 10, path=path, keep=first.keep)
        writer.expect(40)
        path.with_name("s.sqlite.lock").unlink()
        with Ownership(path) as second:
            second.keep()
            writer.submit(batch(41, state=state(41)))
            assert not writer.work()
            assert "another daemon is using it" in (writer.health().failing or "")
            with pytest.raises(StoreError):
                first.keep()
        assert writer.work()
        writer.close()
    with Store.reading(path) as store:
        assert store.last_batch() == 41

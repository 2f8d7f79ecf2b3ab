"""A store path that holds somebody else's file, or lies below a medium that is not mounted, is refused and left as it is."""

from __future__ import annotations

import os
import sqlite3
from pathlib import Path

import pytest

from yieldmon.errors import InputError
from yieldmon.service.history.recovery import recover
from yieldmon.service.storage.batch import Batch
from yieldmon.service.storage.retention import Retention
from yieldmon.service.storage.store import Store
from yieldmon.service.storage.store_file import last_noted_batch, refuse_foreign_file, unmounted_above


def start(path: Path) -> None:
    recover(path, Retention(), lambda: Store(path))


@pytest.mark.parametrize("content", [b"farm diary\n", b"\x89PNG\r\n\x1a\n....", b"PK\x03\x04"])
def test_a_file_that_is_no_store_is_left_as_it_is(tmp_path, content):
    path = tmp_path / "yieldmon.sqlite"
    path.write_bytes(content)
    with pytest.raises(InputError, match="is not a store; it is left as it is"):
        start(path)
    assert path.read_bytes() == content
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_another_programs_database_is_left_as_it_is(tmp_path):
    path = tmp_path / "yieldmon.sqlite"
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE cows (name TEXT)")
    database.close()
    before = path.read_bytes()
    with pytest.raises(InputError, match="another program"):
        start(path)
    assert path.read_bytes() == before


def test_a_folder_is_refused(tmp_path):
    with pytest.raises(InputError, match="is a folder"):
        start(tmp_path)


def test_a_pipe_is_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "yieldmon.sqlite")
    with pytest.raises(InputError, match="is not a file"):
        start(tmp_path / "yieldmon.sqlite")


def test_a_pipe_where_commits_are_noted_makes_way(tmp_path):
    path = tmp_path / "yieldmon.sqlite"
    os.mkfifo(tmp_path / "yieldmon.sqlite.last")
    start(path)
    with Store(path) as store:
        store.commit([Batch(1, 1.0, {})])
    assert last_noted_batch(path) == 1


def test_a_folder_in_the_place_of_the_journal_stops_no_measuring(tmp_path):
    path = tmp_path / "yieldmon.sqlite"
    (tmp_path / "yieldmon.sqlite-wal").mkdir()
    found = recover(path, Retention(), lambda: Store(path))
    assert (found.made, found.memory.engine) == (True, None)
    assert (tmp_path / "yieldmon.sqlite-wal.in-the-way").is_dir()


@pytest.mark.parametrize("content", [None, b"", b"\0" * 4096])
def test_a_new_or_empty_store_is_none_of_theirs(tmp_path, content):
    path = tmp_path / "yieldmon.sqlite"
    if content is not None:
        path.write_bytes(content)
    refuse_foreign_file(path, tmp_path / "none")
    assert path.exists() is (content is not None)


def test_a_store_below_a_medium_that_is_not_mounted_is_refused(tmp_path):
    place, fstab = tmp_path / "usb stick", tmp_path / "fstab"
    place.mkdir()
    fstab.write_text(f"# media\nUUID=1 / ext4 defaults 0 1\nUUID=2 {str(place).replace(' ', chr(92) + '040')} vfat nofail 0 0\n")
    store = place / "data" / "yieldmon.sqlite"
    assert unmounted_above(store, fstab) == place
    assert unmounted_above(tmp_path / "other.sqlite", fstab) is None
    assert unmounted_above(store, tmp_path / "no such file") is None
    with pytest.raises(InputError, match=r"usb stick is not mounted; expected its medium"):
        refuse_foreign_file(store, fstab)

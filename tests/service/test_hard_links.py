"""A store whose files have other names as well, as a backup by hard links (cp -al) leaves them."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from tests.service.test_store import batch
from tests.service.test_store_damage import kept as kept  # noqa: PLC0414 - a fixture, which the next one needs
from tests.service.test_store_damage import path as path  # noqa: PLC0414 - a fixture
from tests.service.test_store_damage import state
from yieldmon.service.history.recovery import Recovery, recover
from yieldmon.service.storage import hard_links
from yieldmon.service.storage.hard_links import detach_hard_links
from yieldmon.service.storage.ownership import OccupiedError, Ownership
from yieldmon.service.storage.retention import Retention
from yieldmon.service.storage.store import Store

#: Opens a store by SQLite alone, says so, and holds it until its input ends.
_HOLDER = """
import sqlite3, sys
database = sqlite3.connect(sys.argv[1], isolation_level=None)
database.execute("SELECT count(*) FROM second").fetchone()
print("open", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def killed(tmp_path: Path, path: Path) -> Path:
    """A store of 45 seconds whose daemon was killed: the last five are in its journal."""
    folder = tmp_path / "state"
    folder.mkdir()
    with Store(path) as store:
        store.commit([batch(n, state=state(n)) for n in range(41, 46)])
        for part in tmp_path.glob("s.sqlite*"):
            shutil.copy(part, folder)
    assert (folder / "s.sqlite-wal").stat().st_size
    return folder / "s.sqlite"


def linked(store: Path, folder: Path) -> dict[str, bytes]:
    """A backup of a store's folder by hard links, as `cp -al` makes it; what is in it."""
    folder.mkdir()
    for file in store.parent.iterdir():
        os.link(file, folder / file.name)
    return content(folder)


def content(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def started(store: Path) -> Recovery:
    with Ownership(store):
        return recover(store, Retention(), lambda: Store(store))


def total_kg(found: Recovery) -> float:
    assert found.memory.engine is not None
    return found.memory.engine.totals.total_kg


@contextmanager
def held(store: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process has the store open."""
    command = [sys.executable, "-c", _HOLDER, str(store)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "open\n"
        yield process
        assert process.stdin is not None
        process.stdin.close()


def test_a_backup_by_hard_links_stops_no_start_and_stays_as_it_was(
    tmp_path: Path, killed: Path, caplog: pytest.LogCaptureFixture
) -> None:
    before = linked(killed, tmp_path / "backup")
    found = started(killed)
    assert (total_kg(found), found.last_batch, found.note) == (450.0, 45, "")
    assert "was one file under 2 names (hard links); has a copy of its own now" in caplog.text
    with Store(killed) as store:
        store.commit([batch(46, state=state(46))])
    now = content(tmp_path / "backup")
    del before["s.sqlite-shm"], now["s.sqlite-shm"]
    assert now == before
    restored = started(tmp_path / "backup" / "s.sqlite")
    assert (total_kg(restored), restored.last_batch) == (450.0, 45)
    with Store.reading(killed) as store:
        assert store.last_batch() == 46


def test_a_store_of_one_name_is_not_copied(killed: Path, caplog: pytest.LogCaptureFixture) -> None:
    before = killed.stat().st_ino
    started(killed)
    assert killed.stat().st_ino == before
    assert "names" not in caplog.text


def test_a_store_that_another_process_has_open_is_refused_until_that_ends(tmp_path: Path, killed: Path) -> None:
    linked(killed, tmp_path / "backup")
    rests: list[float] = []
    with held(tmp_path / "backup" / "s.sqlite") as process:
        expected = (
            rf"2 names \(hard links\), and process {process.pid} has it open; expected that process stopped, or a file of its"
        )
        with pytest.raises(OccupiedError, match=expected):
            detach_hard_links(killed, rests.append)
    assert len(rests) > 1
    assert total_kg(started(killed)) == 450.0


def test_a_reader_that_is_soon_done_is_waited_for(tmp_path: Path, killed: Path) -> None:
    linked(killed, tmp_path / "backup")
    with held(killed) as process:

        def ends(_: float) -> None:
            assert process.stdin is not None
            process.stdin.close()
            process.wait()

        assert detach_hard_links(killed, ends) == ""
    assert killed.stat().st_nlink == 1


def test_without_room_for_a_copy_it_goes_on_and_says_so(tmp_path: Path, killed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    linked(killed, tmp_path / "backup")

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(hard_links.os, "fsync", full)
        note = detach_hard_links(killed)
    assert note == "is one file under 2 names (hard links), and no copy of its own could be made: No space left on device"
    assert sorted(file.name for file in killed.parent.iterdir()) == sorted(content(tmp_path / "backup"))
    found = started(killed)
    assert (total_kg(found), found.note) == (450.0, "")


def _killed_at(step: int, store: Path) -> bool:
    """Whether a start that is killed (SIGKILL) at this line of the module was still at it; False where it had ended."""
    child = os.fork()
    if child:
        return os.WIFSIGNALED(os.waitpid(child, 0)[1])
    left = step

    def trace(frame: FrameType, event: str, argument: Any) -> Callable[..., Any] | None:
        nonlocal left
        if frame.f_code.co_filename != hard_links.__file__:
            return None
        left -= event == "line"
        if left < 0:
            os.kill(os.getpid(), signal.SIGKILL)
        return trace

    sys.settrace(trace)
    try:
        detach_hard_links(store)
    finally:
        os._exit(0)


def test_a_kill_at_any_line_loses_nothing(tmp_path: Path, killed: Path) -> None:
    before = linked(killed, tmp_path / "backup")
    step, killed_here = 0, True
    while killed_here:
        place = tmp_path / f"{step}"
        place.mkdir()
        for name in before:
            os.link(tmp_path / "backup" / name, place / name)
        killed_here = _killed_at(step, place / "s.sqlite")
        assert content(tmp_path / "backup") == before
        found = started(place / "s.sqlite")
        assert (total_kg(found), found.last_batch, found.note) == (450.0, 45, ""), step
        assert not list(place.glob("*own-copy*"))
        assert all(part.stat().st_nlink == 1 for part in place.glob("s.sqlite*"))
        step += 3
    assert step > 60

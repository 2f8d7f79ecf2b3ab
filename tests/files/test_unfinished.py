"""What a command that was killed left of its output: the next one removes it, and nothing else."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from yieldmon.files.unfinished import held, make_folder, remove_abandoned
from yieldmon.files.whole_file import scratch_for

WRITES = """
import sys, time
from yieldmon.files.whole_file import scratch_for
with scratch_for(sys.argv[1]) as scratch:
    scratch.write_text("half")
    print("half", flush=True)
    time.sleep(60)
"""


def aged(folder: Path, since_s: float = 3600.0) -> Path:
    then = time.time() - since_s
    os.utime(folder, (then, then))
    return folder


def test_what_a_killed_program_was_writing_goes_when_it_is_dead(tmp_path: Path) -> None:
    path = tmp_path / "o.csv"
    with subprocess.Popen([sys.executable, "-c", WRITES, str(path)], stdout=subprocess.PIPE) as writer:
        assert writer.stdout is not None
        assert writer.stdout.readline() == b"half\n"
        (folder,) = tmp_path.iterdir()
        remove_abandoned(path)
        aged(folder)
        remove_abandoned(path)
        assert (folder / "o.csv").read_text() == "half"
        writer.send_signal(signal.SIGKILL)
    remove_abandoned(path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "what", ["young", "held", "of another file", "with something else in it", "a file", "a link", "not ours"]
)
def test_nothing_else_goes(what: str, tmp_path: Path) -> None:
    path, names = tmp_path / "o.csv", {"with something else in it": "mine.txt", "of another file": "o.parquet"}
    folder = make_folder(path)
    (folder / names.get(what, "o.csv")).write_text("kept")
    if what == "not ours":
        folder = folder.rename(tmp_path / ".o.backup12")
    if what in ("a file", "a link"):
        elsewhere = folder.rename(tmp_path / "elsewhere")
        folder.write_text("kept") if what == "a file" else folder.symlink_to(elsewhere)
    if what != "young":
        aged(folder)
    before = sorted(tmp_path.rglob("*"))
    if what == "held":
        with held(folder):
            remove_abandoned(path)
    else:
        remove_abandoned(path)
    assert sorted(tmp_path.rglob("*")) == before


def test_a_file_is_whole_while_the_next_command_begins(tmp_path: Path) -> None:
    path = tmp_path / "o.csv"
    with scratch_for(path) as scratch:
        scratch.write_text("whole")
        aged(scratch.parent)
        remove_abandoned(path)
    assert path.read_text() == "whole"
    assert [found.name for found in tmp_path.iterdir()] == ["o.csv"]


@pytest.mark.parametrize(("since_s", "stays"), [(50.0, True), (61.0, False)])
def test_a_folder_has_a_minute_to_be_locked(since_s: float, stays: bool, tmp_path: Path) -> None:
    folder = aged(make_folder(tmp_path / "o.csv"), since_s)
    remove_abandoned(tmp_path / "o.csv")
    assert folder.exists() is stays


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives a folder to another user")
def test_what_another_user_left_is_his(tmp_path: Path) -> None:
    folder = make_folder(tmp_path / "o.csv")
    os.chown(folder, 12345, -1)
    aged(folder)
    remove_abandoned(tmp_path / "o.csv")
    assert folder.exists()

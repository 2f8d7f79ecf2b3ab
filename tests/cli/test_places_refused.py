"""Outputs in folders in which the user may not write: refused before the work, with the user, the folder and a way out."""

from __future__ import annotations

import ctypes
import os
import pwd
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from yieldmon.cli.main import main

_CAPABILITIES_3, _DAC_OVERRIDE = 0x20080522, 1 << 1
"""_LINUX_CAPABILITY_VERSION_3 and CAP_DAC_OVERRIDE of linux/capability.h."""
VERBS = {
    "export": "export day.sqlite --out {}/a.csv",
    "simulate": "simulate --scenario demo --duration 2 --log {}/a.log",
    "process": "process a.log --out {}/a.csv",
    "calibrate": "calibrate t.csv --out {}/p.yaml",
    "pack": "pack a.log --out {}/a.parquet",
    "plot": "plot flow day.sqlite --out {}/a.png",
    "signals": "signals a.log --write {}/m.yaml",
    "demo": "demo --picture {}/a.png",
    "map": "map day.sqlite --width 9 --out {}/map",
    "setup": "setup --out {}/set-up",
    "task data": "export day.sqlite --format taskdata --swath 9 --out {}/task",
}


@contextmanager
def modes_obeyed() -> Iterator[None]:
    """Root obeys the modes of files too: without the capability that overrides them."""
    libc = ctypes.CDLL(None, use_errno=True)
    header, before = (ctypes.c_uint32 * 2)(_CAPABILITIES_3, 0), (ctypes.c_uint32 * 6)()
    assert libc.capget(header, before) == 0
    # Effective, permitted and inheritable, for two words of capabilities.
    less = (ctypes.c_uint32 * 6)(before[0] & ~_DAC_OVERRIDE, *before[1:])
    assert libc.capset(header, less) == 0
    try:
        yield
    finally:
        assert libc.capset(header, before) == 0


@pytest.fixture
def closed(tmp_path: Path) -> Iterator[Path]:
    """A folder that the user of the test may enter and read, and not write in."""
    folder = tmp_path / "closed"
    folder.mkdir()
    (folder / "old.csv").write_text("kept")
    (folder / "old.csv").chmod(0o444)
    folder.chmod(0o555)
    with modes_obeyed():
        yield folder
    folder.chmod(0o755)


@pytest.mark.parametrize("words", VERBS.values(), ids=VERBS)
def test_it_is_reported_before_the_work(closed: Path, capsys: pytest.CaptureFixture[str], words: str) -> None:
    assert main(words.format(closed).split()) == 2
    said = capsys.readouterr().err
    option = words.split()[-2]
    who = pwd.getpwuid(os.geteuid()).pw_name
    assert said.startswith(f"yieldmon: {option} {closed}/")
    assert f"user {who} may not write in the folder {closed}; expected another folder, sudo, or rights to this one" in said
    assert said.count("\n") == 1
    assert os.listdir(closed) == ["old.csv"]


def test_a_file_there_is_not_replaced_either(closed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", "day.sqlite", "--out", str(closed / "old.csv"), "--force"]) == 2
    assert "may not write in the folder" in capsys.readouterr().err
    assert (closed / "old.csv").read_text() == "kept"


def test_a_read_only_medium_is_no_matter_of_rights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """sudo, which was named, does not help."""

    class ReadOnly:
        f_flag = os.ST_RDONLY

    monkeypatch.setattr(os, "statvfs", lambda folder: ReadOnly)
    assert main(["export", "day.sqlite", "--out", str(tmp_path / "new.csv")]) == 2
    expected = "is on a read-only file system; expected a place on a medium that takes writing\n"
    assert capsys.readouterr().err == f"yieldmon: --out {tmp_path / 'new.csv'}: the folder {tmp_path} {expected}"

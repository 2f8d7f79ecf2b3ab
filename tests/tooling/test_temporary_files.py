"""Where tools/test puts the temporary files of a part."""

from __future__ import annotations

import os
import runpy
from pathlib import Path
from types import SimpleNamespace

import pytest

TOOL = Path(__file__).resolve().parents[2] / "tools" / "test"


@pytest.mark.parametrize(
    ("in_memory", "elsewhere", "bytes_needed", "used"),
    [(True, False, 1, True), (False, False, 1, False), (True, True, 1, False), (True, False, 1 << 62, False)],
    ids=["in memory", "a part that is about the disk", "a place of the caller's own", "without room"],
)
def test_files_are_in_memory_while_the_part_runs(
    in_memory: bool, elsewhere: bool, bytes_needed: int, used: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tool = runpy.run_path(str(TOOL))
    monkeypatch.delenv("TMPDIR", raising=False)
    if elsewhere:
        monkeypatch.setenv("TMPDIR", "/elsewhere")
    with tool["temporary_files"](tool["Part"]("unit", ("true",), in_memory=in_memory), tmp_path, bytes_needed) as folder:
        assert (folder is not None) == used
        if folder is not None:
            assert folder.parent == tmp_path
            assert folder.stat().st_mode & 0o777 == 0o755
            (folder / "left.sqlite").write_text("by a test")
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_is_not_there_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tool = runpy.run_path(str(TOOL))
    monkeypatch.delenv("TMPDIR", raising=False)
    with tool["temporary_files"](tool["Part"]("unit", ("true",), in_memory=True), tmp_path / "none", 1) as folder:
        assert folder is None


def test_a_place_where_no_program_may_run_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tool = runpy.run_path(str(TOOL))
    monkeypatch.delenv("TMPDIR", raising=False)
    real = os.statvfs(tmp_path)
    mounted = SimpleNamespace(
        f_frsize=real.f_frsize, f_blocks=real.f_blocks, f_bfree=real.f_bfree, f_bavail=real.f_bavail, f_flag=os.ST_NOEXEC
    )
    monkeypatch.setattr(os, "statvfs", lambda _path: mounted)
    with tool["temporary_files"](tool["Part"]("unit", ("true",), in_memory=True), tmp_path, 1) as folder:
        assert folder is None


def test_a_sockets_path_is_no_longer_than_where_pytest_puts_it() -> None:
    tool = runpy.run_path(str(TOOL))
    folder = tool["MEMORY"] / "y12345678"
    command, variables = tool["in_folder"](("pytest",), folder)
    assert command[0] == "pytest"
    place = command[1].removeprefix("--basetemp=")
    assert Path(place).parent == folder
    assert len(place) <= len("/tmp/pytest-of-root/pytest-0")
    assert variables == {"TMPDIR": str(folder)}
    assert tool["in_folder"](("pytest",), None) == (("pytest",), {})

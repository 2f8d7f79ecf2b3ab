"""Files that appear whole: what is there before, meanwhile, after, and when something fails."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from yieldmon.errors import InputError
from yieldmon.files.whole_file import noting_free_names, scratch_folder_for, scratch_for


@pytest.mark.parametrize("durable", [False, True])
def test_the_old_file_stays_until_the_new_one_is_whole(tmp_path: Path, durable: bool) -> None:
    path = tmp_path / "table.csv"
    path.write_text("old")
    with scratch_for(path, durable=durable) as scratch:
        scratch.write_text("new")
        assert path.read_text() == "old"
        assert scratch.suffix == ".csv"
    assert path.read_text() == "new"
    assert os.listdir(tmp_path) == ["table.csv"]


def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("old")
    writing = scratch_for(path)
    writing.__enter__().write_text("half")
    assert not writing.__exit__(KeyboardInterrupt, KeyboardInterrupt(), None)
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["table.csv"]


def test_what_is_no_file_is_written_to_and_stays_what_it_is(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        with scratch_for(pipe) as scratch:
            scratch.write_text("through")
        assert os.read(reader, 100) == b"through"
    finally:
        os.close(reader)
    assert pipe.is_fifo()


def test_standard_output_that_is_a_pipe_is_written_to() -> None:
    """/dev/stdout leads to a pipe, which has no path of its own."""
    reads, writes = os.pipe()
    try:
        with scratch_for(f"/dev/fd/{writes}") as scratch:
            scratch.write_text("through")
        assert os.read(reads, 100) == b"through"
    finally:
        os.close(reads)
        os.close(writes)


def test_a_link_is_followed(tmp_path: Path) -> None:
    kept = tmp_path / "real" / "corn.yaml"
    kept.parent.mkdir()
    kept.write_text("old")
    link = tmp_path / "corn.yaml"
    link.symlink_to(kept)
    with scratch_for(link) as scratch:
        scratch.write_text("new")
    assert link.is_symlink()
    assert kept.read_text() == "new"


@pytest.mark.parametrize(("name", "problem"), [("", "is a folder"), ("nowhere/x.csv", "there is no folder")])
def test_a_place_for_no_file_is_named(tmp_path: Path, name: str, problem: str) -> None:
    with pytest.raises(InputError, match=problem) as caught, scratch_for(tmp_path / name):
        pytest.fail("nothing can be written there")
    assert caught.value.where == str(tmp_path / name)


def test_a_full_medium_is_reported_with_the_path(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.symlink_to("/dev/full")
    with pytest.raises(OSError, match="No space left") as caught, scratch_for(path) as scratch:
        scratch.write_text("x" * 100_000)
    assert caught.value.filename == str(path)
    assert Path("/dev/full").is_char_device()


@pytest.mark.parametrize("opened", [Path, str], ids=["as a path", "as text"])
def test_a_scratch_file_that_cannot_be_made_is_reported_by_the_files_own_name(tmp_path: Path, opened: type) -> None:
    path = tmp_path / "x.csv"

    def write() -> None:
        with scratch_for(path) as scratch:
            scratch.mkdir()
            try:
                open(opened(scratch), "w")  # noqa: SIM115 - it does not open
            finally:
                scratch.rmdir()

    with pytest.raises(IsADirectoryError) as caught:
        write()
    assert caught.value.filename == str(path)


def test_an_error_names_the_path_that_was_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    with pytest.raises(FileNotFoundError) as caught, scratch_for(path):
        pass  # Nothing was written, so there is nothing to put in place.
    assert caught.value.filename == str(path)


@pytest.mark.parametrize("link", [False, True], ids=["file", "through a link"])
def test_what_another_program_made_meanwhile_is_not_replaced(tmp_path: Path, link: bool) -> None:
    path = tmp_path / "table.csv"
    named = path
    if link:
        named = tmp_path / "name.csv"
        named.symlink_to(path)
    path.with_name("table-2.csv").write_text("of an earlier day")
    with noting_free_names([named]):
        writing = scratch_for(named)
        writing.__enter__().write_text("ours")
        path.write_text("theirs")
        with pytest.raises(InputError, match=r"another program made it meanwhile; what was to be written is table-3\.csv"):
            writing.__exit__(None, None, None)
    assert {p.name: p.read_text() for p in tmp_path.iterdir() if not p.is_symlink()} == {
        "table.csv": "theirs",
        "table-2.csv": "of an earlier day",
        "table-3.csv": "ours",
    }


def test_what_was_there_when_the_command_began_and_its_own_file_are_replaced(tmp_path: Path) -> None:
    old, new, later = (tmp_path / name for name in ("old.csv", "new.csv", "later.csv"))
    old.write_text("old")
    with noting_free_names([old, new, later]):
        for path in (old, new, new):
            with scratch_for(path) as scratch:
                scratch.write_text("ours")
    with scratch_for(later) as scratch:
        scratch.write_text("ours")
        later.write_text("of whoever was first")
    assert [path.read_text() for path in (old, new, later)] == ["ours"] * 3
    assert len(os.listdir(tmp_path)) == 3


def test_files_of_a_folder_take_their_names_together(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("old")
    (tmp_path / "a.csv").chmod(0o600)
    (tmp_path / "other.txt").write_text("other")
    with scratch_folder_for(tmp_path, ["a.csv", "b.csv"]) as scratch:
        for name in ("a.csv", "b.csv"):
            (scratch / name).write_text("new")
        assert (tmp_path / "a.csv").read_text() == "old"
    found = {path.name: path.read_text() for path in tmp_path.iterdir()}
    assert found == {"a.csv": "new", "b.csv": "new", "other.txt": "other"}
    assert (tmp_path / "a.csv").stat().st_mode & 0o777 == 0o600


def test_no_file_of_a_folder_is_replaced_where_one_fails(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("old")

    def write() -> None:
        with scratch_folder_for(tmp_path, ["a.csv", "b.csv"]) as scratch:
            (scratch / "a.csv").write_text("new")
            (scratch / "b.csv").mkdir()
            (scratch / "b.csv").write_text("new")

    with pytest.raises(IsADirectoryError) as caught:
        write()
    assert caught.value.filename == str(tmp_path / "b.csv")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a.csv": "old"}

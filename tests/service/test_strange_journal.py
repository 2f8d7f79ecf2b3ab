"""A file, a journal and a note that are not of one store: SQLite takes any journal that lies beside a file for its own."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from tests.service.test_store import batch
from tests.service.test_store_damage import state
from yieldmon.files import parameter_file
from yieldmon.service.history.recovery import Recovery, recover
from yieldmon.service.storage.batch import ParameterVersion
from yieldmon.service.storage.identity import NONE, this_computer
from yieldmon.service.storage.retention import Retention
from yieldmon.service.storage.store import Store
from yieldmon.service.storage.store_file import last_noted_batch, last_noted_store, note_commit
from yieldmon.service.storage.store_names import parts

ENDS = ("", "-wal", ".last")
Files = dict[str, bytes]


def commit(store: Store, numbers: range) -> None:
    document = {**parameter_file.to_document(parameter_file.load()), "version": 1}
    for n in numbers:
        store.commit([batch(n, state=state(n), parameter_versions=(ParameterVersion(1, 1.0, "file", document),))])


def killed(folder: Path, whole: int, more: int) -> Files:
    """The files of a store with `whole` seconds in the file and `more` in its journal."""
    folder.mkdir()
    path = folder / "s.sqlite"
    with Store(path) as store:
        commit(store, range(1, whole + 1))
    with Store(path) as store:
        commit(store, range(whole + 1, whole + more + 1))
        return {end: path.with_name(path.name + end).read_bytes() for end in ENDS}


def start(folder: Path, files: Files) -> Recovery:
    path = folder / "placed.sqlite"
    for end, content in files.items():
        path.with_name(path.name + end).write_bytes(content)
    return recover(path, Retention(), lambda: Store(path))


def total_kg(found: Recovery) -> float:
    assert found.memory.engine is not None
    return found.memory.engine.totals.total_kg


def test_a_store_with_its_own_journal_has_nothing_to_say(tmp_path: Path) -> None:
    found = start(tmp_path, killed(tmp_path / "a", 5, 3))
    assert (total_kg(found), found.note) == (80.0, "")


@pytest.mark.parametrize("noted", [True, False])
def test_the_journal_of_another_store_is_set_aside(tmp_path: Path, noted: bool) -> None:
    ours, others = killed(tmp_path / "a", 5, 3), killed(tmp_path / "b", 6, 2)
    found = start(tmp_path, {"": ours[""], "-wal": others["-wal"]} | ({".last": ours[".last"]} if noted else {}))
    assert total_kg(found) == 50.0
    assert "its journal was another store's, set aside as placed.sqlite-wal.replaced-" in found.note
    assert ("its last 3 commits are missing" in found.note) == noted
    aside = next(tmp_path.glob("placed.sqlite-wal.replaced-*"))
    assert aside.read_bytes() == others["-wal"]


def test_a_journal_over_the_file_of_another_store_is_reported(tmp_path: Path) -> None:
    ours, others = killed(tmp_path / "a", 5, 3), killed(tmp_path / "b", 6, 2)
    found = start(tmp_path, {**ours, "": others[""]})
    assert "its file and its journal are of two stores" in found.note or "it is not the store that was written here" in found.note


def test_another_store_in_the_place_of_ours_is_reported_until_it_is_ours(tmp_path: Path) -> None:
    ours, others = killed(tmp_path / "a", 5, 3), killed(tmp_path / "b", 6, 2)
    found = start(tmp_path, {**others, ".last": ours[".last"]})
    assert "it is not the store that was written here: the totals may be another machine's" in found.note
    path = tmp_path / "placed.sqlite"
    with Store(path) as store:
        commit(store, range(30, 31))
    assert recover(path, Retention(), lambda: Store(path)).note == ""


def test_what_is_rescued_stays_the_same_store(tmp_path: Path) -> None:
    files = killed(tmp_path / "a", 5, 3)
    files[""] = bytes(16) + files[""][16:]
    found = start(tmp_path, files)
    assert "set aside" in found.note
    assert "another store" not in found.note
    with Store(tmp_path / "placed.sqlite") as store:
        assert store.identity() == last_noted_store(tmp_path / "placed.sqlite") > 0


def test_a_store_and_a_note_from_before_identities_grow_up(tmp_path: Path) -> None:
    path = tmp_path / "s.sqlite"
    with Store(path) as store:
        commit(store, range(1, 4))
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("DELETE FROM mark WHERE name = 'identity'")
    note = path.with_name("s.sqlite.last")
    note.write_bytes(b" ".join(note.read_bytes().split()[:2]).ljust(64))
    assert (last_noted_batch(path), last_noted_store(path)) == (3, 0)
    found = recover(path, Retention(), lambda: Store(path))
    assert (total_kg(found), found.note) == (30.0, "")
    with Store(path) as store:
        commit(store, range(4, 5))
        assert store.identity() == last_noted_store(path) > 0
    assert not parts(path)[1].exists()


@pytest.mark.parametrize("at", range(0, 40, 3))
def test_a_note_with_a_changed_digit_is_none(tmp_path: Path, at: int) -> None:
    path = tmp_path / "s.sqlite"
    note_commit(path, 12345678, 987654321)
    note = path.with_name("s.sqlite.last")
    content = bytearray(note.read_bytes())
    content[at] = ord("3") if content[at] != ord("3") else ord("4")
    note.write_bytes(content)
    assert (last_noted_batch(path), last_noted_store(path)) == (0, 0)


def test_all_files_of_another_computers_store_are_reported_once(tmp_path: Path) -> None:
    """Card and files of one machine in another one: each file fits the others."""
    path = tmp_path / "s.sqlite"

    def started(computer: int, number: int) -> Recovery:
        found = recover(path, Retention(), lambda: Store(path, computer=computer), computer)
        with Store(path, computer=computer) as store:
            commit(store, range(number, number + 1))
        return found

    assert started(NONE, 1).note == ""
    assert started(7, 2).note == "", "of an earlier version, or of no computer that is known"
    assert started(7, 3).note == ""
    assert started(8, 4).note == "it was last written on another computer: the totals may be another machine's"
    assert started(8, 5).note == ""
    assert started(NONE, 6).note == ""
    assert started(7, 7).note != ""
    with Store.reading(path) as store:
        assert store.computer() == 7


def test_a_computer_is_known_by_what_outlasts_a_boot(tmp_path: Path) -> None:
    numbers = []
    for content in ("0123456789abcdef" * 2, "f" * 32, "", "uninitialized\n", "\0" * 32):
        (tmp_path / "machine-id").write_text(content)
        numbers.append(this_computer(tmp_path / "machine-id"))
    assert numbers[0] not in (numbers[1], NONE)
    assert numbers[1] != NONE
    assert numbers[2:] == [NONE] * 3
    assert this_computer(tmp_path / "none") == NONE
    assert this_computer(Path("/proc/self/attr/../../version")) == NONE

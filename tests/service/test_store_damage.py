"""Damage to a store: found at opening or at first touch, set aside, what can be saved saved, and said."""

from __future__ import annotations

import logging
import math
import os
import random
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from tests.robustness.store_damage import KINDS, attempt, original
from tests.service.test_store import DATA, batch, connections_made, second
from yieldmon.engine.mass.totals import Totals
from yieldmon.engine.state import EngineState
from yieldmon.errors import InputError
from yieldmon.files import parameter_file
from yieldmon.service.history.recovery import recover
from yieldmon.service.storage import rescue, schema
from yieldmon.service.storage.batch import FaultEvent, Load, ParameterVersion, Ticket
from yieldmon.service.storage.checksums import row_checksum
from yieldmon.service.storage.retention import Retention
from yieldmon.service.storage.store import Store
from yieldmon.service.storage.store_errors import StoreDamagedError, StoreDetachedError
from yieldmon.service.storage.store_file import note_commit, read_only
from yieldmon.service.storage.store_names import parts
from yieldmon.service.storage.writer import StoreWriter

PATIENCE_S = 60.0


def state(n: int) -> dict[str, object]:
    """As the daemon leaves it after second n."""
    totals = Totals(total_kg=10.0 * n, load_kg=10.0 * n)
    named = {"saved_s": 1.0, "last_second": n, "parameter_digest": "", "field": "north", "crop": "corn", "faults": []}
    return {"engine": EngineState(totals=totals).as_dict(), **named}


def total_kg(store: Store) -> float | None:
    document = store.state()
    return None if document is None else document["engine"]["totals"]["total_kg"]


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of 40 seconds, closed."""
    path = tmp_path_factory.mktemp("kept") / "s.sqlite"
    parameters = parameter_file.to_document(parameter_file.load())
    with Store(path) as store:
        for n in range(1, 41):
            versions = (ParameterVersion(n // 10 + 1, 1.0, "file", {**parameters, "version": n // 10 + 1}),)
            events = (FaultEvent(1.0, "X", True, "d"),)
            store.commit([batch(n, state=state(n), parameter_versions=versions, faults=events, counters={"a": n})])
    return path


@pytest.fixture
def path(kept: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    shutil.copytree(kept.parent, tmp_path, dirs_exist_ok=True)
    return tmp_path / kept.name


@pytest.mark.parametrize("empty", [False, True], ids=["missing", "empty"])
def test_a_journal_without_its_store_is_not_thrown_away(tmp_path: Path, path: Path, empty: bool) -> None:
    place = tmp_path / "place"
    place.mkdir()
    orphan = place / "s.sqlite"
    with Store(path) as store:
        for n in range(41, 44):
            store.commit([batch(n, state=state(n))])
        shutil.copyfile(parts(path)[1], parts(orphan)[1])
    note_commit(orphan, 43)
    if empty:
        orphan.touch()
    kept = parts(orphan)[1].read_bytes()
    found = recover(orphan, Retention(), lambda: Store(orphan))
    assert found.note.startswith("damaged, set aside as s.sqlite.damaged-")
    assert kept in [aside.read_bytes() for aside in place.glob("s.sqlite.damaged-*-wal")]
    # Of the pages that the last commits wrote; what only the file had is gone, and reported.
    assert found.memory.last_second == 43
    assert found.memory.last_batch == 43
    assert "saved: 2 of state, 1 of load, 43 of second" in found.note


def damage(path: Path, table: str) -> None:
    """Random bytes where a table begins."""
    database = sqlite3.connect(f"file:{path}?mode=ro", uri=True)
    (root,) = database.execute("SELECT rootpage FROM sqlite_schema WHERE name = ?", (table,)).fetchone()
    database.close()
    with path.open("r+b") as file:
        file.seek((root - 1) * 4096)
        file.write(random.Random(1).randbytes(4096))


def overwrite_page_of_seconds(path: Path, last: int, pages_from_the_end: int) -> set[int]:
    """Random bytes in place of a page of seconds, which are numbered to `last`; returns those that were there.

    An interior page has 12 bytes, then where its cells are; a cell is a page's number and the last key in that page, of one byte
    below 128 (https://www.sqlite.org/fileformat2.html, section 1.6).
    """
    database = sqlite3.connect(f"file:{path}?mode=ro", uri=True)
    (root,) = database.execute("SELECT rootpage FROM sqlite_schema WHERE name = 'second'").fetchone()
    database.close()
    content = bytearray(path.read_bytes())
    page = content[(root - 1) * 4096 : root * 4096]
    assert page[0] == 5
    cells = [int.from_bytes(page[at : at + 2], "big") for at in range(12, 12 + 2 * int.from_bytes(page[3:5], "big"), 2)]
    pages = [int.from_bytes(page[at : at + 4], "big") for at in cells] + [int.from_bytes(page[8:12], "big")]
    bounds = [0, *(page[at + 4] for at in cells), last]
    chosen = len(pages) - 1 - pages_from_the_end
    content[(pages[chosen] - 1) * 4096 : pages[chosen] * 4096] = random.Random(1).randbytes(4096)
    path.write_bytes(content)
    return set(range(bounds[chosen] + 1, bounds[chosen + 1] + 1))


def change(path: Path, sql: str, *values: object) -> None:
    """Alters a store behind its back."""
    database = sqlite3.connect(path)
    database.execute(sql, values)
    database.commit()
    database.close()


CHANGES = [
    ("state", "UPDATE state SET document = replace(document, ':', ';')"),
    ("state", "UPDATE state SET document = CAST(x'7bff7d' AS TEXT)"),
    ("state", "UPDATE state SET document = replace(document, '400.0', '900.0') WHERE slot = 0"),
    ("parameter_set", "UPDATE parameter_set SET document = CAST(x'7b22fffe' AS TEXT) WHERE version = 2"),
    ("parameter_set", "UPDATE parameter_set SET document = replace(document, 'friction', 'frictiom') WHERE version = 5"),
    ("load", "UPDATE load SET mass_kg = 9999.0"),
    ("counter", "UPDATE counter SET value = 77"),
    ("second", "UPDATE second SET total_kg = 1e9 WHERE number = 40"),
]


@pytest.mark.parametrize(("table", "sql"), CHANGES)
def test_a_row_that_is_not_as_it_was_written_is_found_at_opening_and_left_out(path, table, sql):
    change(path, sql)
    with pytest.raises(StoreDamagedError, match=table):
        Store(path)
    rescued = rescue.rescue(path, "damaged-1")
    assert set(rescued.damaged) == {table}
    assert rescued.aside.exists()
    with Store(path) as store:
        assert len(store.seconds()) == 40 - (table == "second")
        expected = 390.0 if "slot = 0" in sql else 400.0
        assert total_kg(store) == (None if table == "state" and "slot" not in sql else expected)
        assert [load.mass_kg for load in store.loads()] == ([] if table == "load" else [400.0])


def test_totals_follow_the_last_second_where_the_state_is_lost(path):
    change(path, "UPDATE state SET document = replace(document, ':', ';')")
    recovery = recover(path, Retention(), lambda: Store(path))
    assert recovery.memory.engine is not None
    assert recovery.memory.engine.totals.total_kg == second(40).total_kg
    assert recovery.memory.engine.totals.load_kg == second(40).load_kg
    assert "totals are those of the last second saved" in recovery.note


#: What is lost with second 41; kg whose area is not known then, of a state of 10 kg a second.
LOST = {"the state": 410.0, "the newest state": 10.0, "nothing": 0.0}


@pytest.mark.parametrize("lost", LOST)
@pytest.mark.parametrize("std_dev_kg", [12.0, None])
def test_masses_that_only_the_last_second_knows_have_its_standard_deviation(
    path: Path, std_dev_kg: float | None, lost: str
) -> None:
    row = replace(second(41), total_std_dev_kg=std_dev_kg, load_std_dev_kg=std_dev_kg)
    with Store(path) as store:
        store.commit([replace(batch(41, state=state(40 if lost == "the newest state" else 41)), seconds=(row,))])
    if lost == "the state":
        change(path, "UPDATE state SET document = replace(document, ':', ';')")
    engine = recover(path, Retention(), lambda: Store(path)).memory.engine
    assert engine is not None
    totals = engine.totals
    assert (totals.total_kg, totals.load_kg, totals.load_unknown_area_kg) == (410.0, 410.0, LOST[lost])
    expected = 0.0 if lost == "nothing" else math.nan if std_dev_kg is None else std_dev_kg
    found = (totals.total_budget.std_dev_kg, totals.load_budget.std_dev_kg)
    assert found == pytest.approx((expected, expected), nan_ok=True)


@pytest.mark.parametrize("last", [91, 100])
@pytest.mark.parametrize("pages_from_the_end", [0, 1, 2])
def test_seconds_on_both_sides_of_a_damaged_page_are_saved(path, last, pages_from_the_end):
    """The newest page of seconds holds a single one, or ten; the state is lost as well."""
    with Store(path) as store:
        store.commit([batch(n, state=state(n)) for n in range(41, last + 1)])
    change(path, "UPDATE state SET document = replace(document, ':', ';')")
    numbers, lost = list(range(1, last + 1)), overwrite_page_of_seconds(path, last, pages_from_the_end)
    recovery = recover(path, Retention(), lambda: Store(path))
    with Store(path) as store:
        assert [row.number for row in store.seconds()] == [n for n in numbers if n not in lost]
    assert recovery.memory.engine is not None
    assert recovery.memory.engine.totals.total_kg == second(max(set(numbers) - lost)).total_kg


@pytest.mark.parametrize("table", ["fault", "sweep"])
def test_damage_in_an_event_table_is_found_at_opening(path, table):
    damage(path, table)
    recovery = recover(path, Retention(), lambda: Store(path))
    assert f"part of {table}" in recovery.note
    with Store(path) as store:
        assert store.last_batch() == 40


def test_damage_found_in_use_is_repaired_and_nothing_that_waits_is_lost(path, monkeypatch):
    """The table of seconds is not looked at as a whole: the first batch that touches the damage finds it."""
    opened, connections = [], connections_made(monkeypatch)

    def open_store() -> Store:
        store = Store(path)
        if not opened:
            connection = connections[-1]
            damage(path, "fault")
            connection.execute("PRAGMA shrink_memory")
        opened.append(store)
        return store

    writer = StoreWriter(open_store, 100, path=path)
    writer.start()
    writer.submit(batch(41))
    writer.submit(batch(42, faults=(FaultEvent(1.0, "X", False, ""),)))
    assert writer.wait_until_written(PATIENCE_S)
    assert writer.health().replacements == 1
    assert "set aside as" in writer.health().replaced_because
    writer.stop()
    with Store(path) as after:
        assert [row.number for row in after.seconds()] == list(range(1, 43))
        assert after.loads()[0].mass_kg == 420.0


@pytest.mark.parametrize("gone", ["", "-wal", "both", "replaced"])
def test_files_removed_while_in_use_are_reported_and_written_anew(path, gone):
    writer = StoreWriter(lambda: Store(path), 100, path=path)
    writer.start()
    writer.submit(batch(41))
    writer.submit(batch(42))
    assert writer.wait_until_written(PATIENCE_S)
    if gone in ("", "both", "replaced"):
        path.unlink()
    if gone in ("-wal", "both"):
        path.with_name("s.sqlite-wal").unlink()
    if gone == "replaced":
        path.write_bytes(b"something else")
    writer.submit(batch(43))
    assert writer.wait_until_written(PATIENCE_S)
    assert "while in use" in writer.health().replaced_because
    writer.stop()
    with Store(path) as store:
        assert [row.number for row in store.seconds()] == list(range(1, 44))
        assert store.loads()[0].mass_kg == 430.0
    if gone == "replaced":
        kept = [file.read_bytes() for file in path.parent.iterdir() if ".replaced-" in file.name]
        assert b"something else" in kept


@pytest.mark.parametrize(("cut", "reported"), [("", "set aside"), ("-wal", "its last 2 commits are missing")])
def test_files_that_are_cut_short_while_in_use_are_reported(path, cut, reported):
    """SQLite goes on with what it has in memory, into files that nobody can read."""
    writer = StoreWriter(lambda: Store(path), 100, retry_s=0.01, path=path)
    writer.start()
    writer.submit(batch(41))
    writer.submit(batch(42))
    assert writer.wait_until_written(PATIENCE_S)
    os.truncate(path.with_name(path.name + cut), 0)
    writer.submit(batch(43))
    assert writer.wait_until_written(PATIENCE_S)
    assert reported in writer.health().replaced_because
    writer.submit(batch(44))
    writer.stop()
    with Store(path) as store:
        assert [row.number for row in store.seconds()][-2:] == [43, 44]
        assert store.last_batch() == 44


def test_a_journal_that_another_process_wrote_into_the_file_is_no_damage(path):
    writer = StoreWriter(lambda: Store(path), 100, retry_s=0.01, path=path)
    writer.start()
    writer.submit(batch(41))
    assert writer.wait_until_written(PATIENCE_S)
    with closing(sqlite3.connect(path)) as other:
        assert other.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()[0] == 0
    writer.submit(batch(42))
    assert writer.wait_until_written(PATIENCE_S)
    assert (writer.health().replacements, writer.health().failing) == (0, None)
    writer.stop()
    with Store(path) as store:
        assert [row.number for row in store.seconds()] == list(range(1, 43))


@pytest.mark.parametrize("again_after_s", [0, 20])
def test_files_that_are_removed_again_are_written_anew_again(path, monkeypatch, again_after_s):
    """A folder that is exchanged twice in a minute, and a stop right after: what waits is written."""
    clock = [1000.0]
    monkeypatch.setattr("yieldmon.service.storage.writer.monotonic", lambda: clock[0])
    writer = StoreWriter(lambda: Store(path), 100, retry_s=0.01, path=path)
    writer.start()
    for number in (41, 42):
        writer.submit(batch(number))
        assert writer.wait_until_written(PATIENCE_S)
        path.unlink()
        clock[0] += again_after_s
    writer.submit(batch(43))
    if again_after_s:
        assert writer.wait_until_written(PATIENCE_S)
        assert writer.health().replacements == 2
    assert writer.stop(PATIENCE_S)
    assert writer.health().replacements == 2
    with Store(path) as store:
        assert [row.number for row in store.seconds()] == list(range(1, 44))


def closed_after_41(path: Path) -> StoreWriter:
    """A writer whose store is closed after batch 41, as after a failure of the disk."""
    writer = StoreWriter(lambda: Store(path), 100, path=path)
    writer.expect(40)
    writer.submit(batch(41))
    assert writer.work()
    writer.close()
    return writer


@pytest.mark.parametrize("before", ["the first batch", "a later one"])
def test_files_removed_while_the_writer_has_them_closed_are_reported(path, before):
    writer = StoreWriter(lambda: Store(path), 100, path=path)
    writer.expect(40)
    if before == "a later one":
        writer = closed_after_41(path)
    missing = 41 if before == "a later one" else 40
    path.unlink()
    writer.submit(batch(42))
    assert writer.work()
    writer.close()
    assert writer.health().replacements == 1
    assert f"its last {missing} commits are missing" in writer.health().replaced_because


def test_files_removed_before_the_first_batch_are_reported_where_the_state_was_lost(path):
    """A store without its state has no batch to miss."""
    with sqlite3.connect(path) as database:
        database.execute("DELETE FROM state")
    recovery = recover(path, Retention(), lambda: Store(path))
    assert (recovery.last_batch, recovery.memory.last_second) == (0, 40)
    writer = StoreWriter(lambda: Store(path), 100, path=path)
    writer.expect(recovery.last_batch)
    for part in parts(path):
        part.unlink(missing_ok=True)
    writer.submit(batch(41))
    assert writer.work()
    writer.close()
    assert "removed while closed" in writer.health().replaced_because


def test_a_replacement_that_failed_half_way_is_ended_before_a_new_store_is_made(path):
    writer = closed_after_41(path)
    path.rename(path.with_name("s.sqlite.ready"))
    writer.submit(batch(42))
    assert writer.work()
    writer.close()
    assert writer.health().replacements == 0
    with Store(path) as store:
        assert [row.number for row in store.seconds()] == list(range(1, 43))


def test_a_store_that_was_closed_in_between_is_no_replacement(path):
    writer = closed_after_41(path)
    writer.submit(batch(42))
    assert writer.work()
    writer.close()
    assert writer.health().replacements == 0


def test_a_store_of_another_machine_put_there_while_closed_is_set_aside(path, tmp_path):
    """It has numbers above those to come, so it would take none of them."""
    with Store(tmp_path / "other") as other:
        other.commit([batch(1000)])
    writer = closed_after_41(path)
    path.unlink()
    (tmp_path / "other").rename(path)
    writer.submit(batch(42))
    assert writer.work()
    writer.close()
    assert "another store" in writer.health().replaced_because
    with Store(path) as store:
        assert store.last_batch() == 42
    aside = next(file for file in tmp_path.iterdir() if ".replaced-" in file.name)
    assert aside.name in writer.health().replaced_because
    with Store(aside) as store:
        assert store.last_batch() == 1000


@pytest.mark.parametrize(("more", "reported"), [(60, False), (61, True)])
def test_a_start_on_a_store_with_more_commits_than_were_made_here_says_so(path, more, reported):
    note_commit(path, 40)
    with Store(path) as store:
        store.commit([batch(40 + more, state=state(40 + more))])
    note_commit(path, 40)
    recovery = recover(path, Retention(), lambda: Store(path))
    assert recovery.last_batch == 40 + more
    assert (f"{more} commits more" in recovery.note) is reported


def test_an_open_store_says_that_its_file_is_not_there(path):
    with Store(path) as store:
        store.require_attached()
        path.rename(path.with_name("elsewhere"))
        with pytest.raises(StoreDetachedError, match="removed while in use"):
            store.require_attached()


def test_a_store_put_back_from_a_copy_is_reported(path):
    copy = path.read_bytes()
    with Store(path) as store:
        store.commit([batch(n, state=state(n)) for n in (41, 42)])
    path.write_bytes(copy)
    assert (
        recover(path, Retention(), lambda: Store(path)).note
        == "its last 2 commits are missing, as expected if an older copy was put in its place"
    )


def test_a_replacement_that_was_interrupted_is_ended_at_the_next_start(path):
    path.rename(path.with_name("s.sqlite.ready"))
    assert recover(path, Retention(), lambda: Store(path)).note == ""
    with Store(path) as store:
        assert store.last_batch() == 40


def test_a_link_in_the_place_of_a_replacement_replaces_nothing(path, tmp_path):
    (tmp_path / "elsewhere").write_text("mine")
    path.with_name("s.sqlite.ready").symlink_to(tmp_path / "elsewhere")
    recovery = recover(path, Retention(), lambda: Store(path))
    assert (recovery.note, recovery.last_batch) == ("", 40)
    assert (tmp_path / "elsewhere").read_text() == "mine"


@pytest.mark.parametrize(("offset", "value"), [(18, 3), (52, 1), (60, 255), (68, 0xF9), (0, 0)])
def test_a_damaged_header_costs_nothing_but_itself(path, offset, value):
    content = bytearray(path.read_bytes())
    content[offset] = value
    path.write_bytes(content)
    recovery = recover(path, Retention(), lambda: Store(path))
    assert "set aside" in recovery.note
    with Store(path) as store:
        assert total_kg(store) == 400.0
        assert len(store.seconds()) == 40


def test_a_store_from_before_checksums_is_read_grows_up_and_is_rescued(tmp_path):
    path = tmp_path / "old"
    old = sqlite3.connect(path)
    old.executescript((DATA / "store-v1.sql").read_text())
    old.close()
    copy = tmp_path / "copy"
    copy.write_bytes(path.read_bytes())
    with Store.reading(path) as store:
        assert [load.mass_kg for load in store.loads()] == [9.5, 10.25]
        assert store.state() == {"total_mass_kg": 19.75}
    with Store(path) as store:
        assert store.state() == {"total_mass_kg": 19.75}
        assert [row.total_kg for row in store.seconds()] == [9.5, 9.5, 19.75]
    change(path, "UPDATE load SET mass_kg = 1.0 WHERE number = 1")
    with pytest.raises(StoreDamagedError):
        Store(path)
    assert rescue.rescue(copy, "x").saved["second"] == 3
    with Store(copy) as store:
        assert store.loads()[1] == Load(2, "north", "corn", 1700000002.0, None, 10.25, None)


@pytest.mark.parametrize("version", [0, 1, 3])
def test_a_header_that_speaks_of_an_older_version_does_not_switch_the_checks_off(path, version):
    change(path, f"PRAGMA user_version = {version}")
    with pytest.raises(StoreDamagedError, match="header"):
        Store.reading(path)
    with pytest.raises(StoreDamagedError):
        Store(path)


def test_damaged_seconds_are_left_out_of_an_export_and_reported(path, tmp_path):
    change(path, "UPDATE second SET mass_kg = 1e6 WHERE number IN (7, 9)")
    bad: list[int] = []
    with Store.reading(path) as store:
        assert len(store.seconds(on_damage=bad.append)) == 38
        with pytest.raises(StoreDamagedError, match="second 7"):
            store.seconds()
    assert bad == [7, 9]


@pytest.mark.parametrize("length", [100, 512])
def test_zeroed_cells_bring_no_other_seconds_unsaid(path: Path, length: int) -> None:
    """Where its cells begin SQLite takes zeros for rows of number 0 with every column's default, checksum included."""
    content, said = path.read_bytes(), 0
    for page in range(4096, len(content), 4096):
        at = page + int.from_bytes(content[page + 5 : page + 7], "big")
        path.write_bytes(content[:at] + bytes(length) + content[at + length :])
        try:
            with Store.reading(path) as store:
                numbers = [row.number for row in store.seconds()]
        except (StoreDamagedError, InputError):
            said += 1
        else:
            assert numbers == list(range(1, 41)), f"page at {page}"
    assert said > 2


def test_a_store_that_was_never_committed_to_is_repaired_like_any_other(tmp_path: Path) -> None:
    """Without a commit nothing but the note of its beginning says that the bytes were ours."""
    path = tmp_path / "new.sqlite"
    recover(path, Retention(), lambda: Store(path))
    path.write_bytes(random.Random(1).randbytes(4096) + path.read_bytes()[4096:])
    found = recover(path, Retention(), lambda: Store(path))
    assert (found.memory.last_second, "set aside as new.sqlite.damaged" in found.note) == (0, True)


@pytest.mark.parametrize("value", [10**20, -(10**30)])
def test_numbers_too_large_for_the_store_are_refused_and_block_nothing(path, value):
    writer = StoreWriter(lambda: Store(path), 100, path=path)
    writer.start()
    writer.submit(batch(41, counters={"huge": value}))
    writer.submit(batch(42))
    assert writer.wait_until_written(PATIENCE_S)
    assert writer.health().batches_refused == 1
    writer.stop()
    with Store(path) as store:
        assert store.last_batch() == 42


@pytest.mark.parametrize(
    "sql",
    [
        "CREATE VIEW second AS WITH RECURSIVE c(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM c) SELECT n FROM c",
        "CREATE TABLE second (number INTEGER PRIMARY KEY, time_s REAL GENERATED ALWAYS AS (length(zeroblob(1000000000))))",
    ],
)
def test_a_crafted_store_is_refused(tmp_path, sql):
    path = tmp_path / "crafted.sqlite"
    database = sqlite3.connect(path)
    database.execute(sql)
    database.execute(f"PRAGMA application_id = {schema.APPLICATION_ID}")
    database.execute("PRAGMA user_version = 3")
    database.commit()
    database.close()
    with pytest.raises(InputError, match="where a store has a plain table"):
        read_only(path)


def test_a_ticket_given_twice_is_entered_once(path):
    ticket = Ticket(1.0, 1, 1, 9.0, 10.0)
    with Store(path) as store:
        store.commit([batch(41, tickets=(ticket,)), batch(42, tickets=(ticket,))])
        assert store.tickets() == [ticket]


@pytest.mark.parametrize(
    ("one", "other"), [((1, "a"), (1, "b")), ((1.0,), (1.0 + 1e-12,)), ((None,), ("",)), (("a", "b"), ("ab", ""))]
)
def test_a_checksum_distinguishes_rows(one, other):
    assert row_checksum("load", *one) != row_checksum("load", *other)
    assert row_checksum("load", *one) != row_checksum("sweep", *one)


@pytest.mark.parametrize(("written", "read"), [((30,), (30.0,)), ((-0.0,), (0.0,)), ((True,), (1,)), ((float("nan"),), (None,))])
def test_a_checksum_is_of_what_the_store_gives_back(written, read):
    assert row_checksum("load", *written) == row_checksum("load", *read)


def test_random_damage_is_survived_and_never_silent(tmp_path):
    """A sample of ``python -m tests.robustness store-damage``."""
    made, place = tmp_path / "made", tmp_path / "place"
    made.mkdir()
    place.mkdir()
    true, rng = original(made, seconds=18), random.Random(20)
    findings = [attempt(place, true, KINDS[n % len(KINDS)], rng) for n in range(60)]
    assert [f.problem for f in findings if f.problem] == []
    assert len({f.outcome for f in findings}) > 1


def test_a_planted_link_is_not_written_to(path: Path, tmp_path: Path) -> None:
    """The name under which a damaged header is mended is known beforehand."""
    victim = tmp_path / "victim"
    victim.write_bytes(b"somebody else's")
    for suffix in (".mended", ".being-made"):
        path.with_name(path.name + suffix).symlink_to(victim)
    content = bytearray(path.read_bytes())
    content[:16] = bytes(16)
    path.write_bytes(content)
    recover(path, Retention(), lambda: Store(path))
    assert victim.read_bytes() == b"somebody else's"
    with Store(path) as store:
        assert len(store.seconds()) == 40


def test_a_schema_that_is_no_text_is_refused_by_readers(path: Path) -> None:
    """SQLite's message about it quotes the bytes, which Python cannot decode."""
    content = path.read_bytes()
    assert b"INTEGER PRIMARY KEY" in content
    path.write_bytes(content.replace(b"INTEGER PRIMARY KEY", b"INTEGER PRIMARY \xb0\x9c\xab"))
    with pytest.raises(InputError):
        read_only(path).close()


@pytest.mark.parametrize("put_there", [lambda place: place.write_bytes(b""), lambda place: place.symlink_to(place)])
def test_removed_files_that_cannot_be_written_anew_yet_stay_open(
    path: Path, tmp_path: Path, put_there: Callable[[Path], object]
) -> None:
    """What the connection sees is nowhere else: it is kept until there is a place for it."""
    place = tmp_path / "place"
    place.mkdir()
    path = path.rename(place / path.name)
    writer = StoreWriter(lambda: Store(path), 100, path=path)
    writer.submit(batch(41))
    assert writer.work()
    shutil.rmtree(place)
    put_there(place)
    writer.submit(batch(42))
    assert not writer.work()
    assert "removed while in use" in (writer.health().failing or "")
    place.unlink()
    assert writer.work()
    assert writer.work()
    writer.close()
    with Store(path) as store:
        assert [row.number for row in store.seconds()] == list(range(1, 43))


def test_a_store_whose_name_is_no_utf_8_is_read_and_repaired(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.CRITICAL, "yieldmon")  # pytest-xdist cannot hand on lines with such a name
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xff\xfe ?#%"))
    folder.mkdir()
    path = folder / "s.sqlite"
    document = {**parameter_file.to_document(parameter_file.load()), "version": 1}
    with Store(path) as store:
        for n in range(1, 6):
            store.commit([batch(n, state=state(n), parameter_versions=(ParameterVersion(1, 1.0, "file", document),))])
        with Store.reading(path) as reading:
            assert reading.last_batch() == 5
    content = bytearray(path.read_bytes())
    content[100:4096] = bytes(3996)
    path.write_bytes(content)
    found = recover(path, Retention(), lambda: Store(path))
    assert found.memory.engine is not None
    assert found.memory.engine.totals.total_kg == 50.0
    assert "damaged" in found.note


@pytest.mark.parametrize("table", ["state", "parameter_set", "fault", "sweep"])
@pytest.mark.parametrize("text", ["22adff22", "7b220122"], ids=["no text", "no JSON"])
def test_a_damaged_text_in_a_store_of_the_first_version_ends_no_start(tmp_path: Path, table: str, text: str) -> None:
    """Its rows have no checksum: what tells them is that no store takes them any more, or that they make no sense."""
    old = Path(__file__).parents[1] / "golden" / "store-0.1.0.sqlite"
    path, sound = tmp_path / "s.sqlite", tmp_path / "sound.sqlite"
    for target in (path, sound):
        shutil.copy(old, target)
    column, values = {
        "state": ("document", ""), "parameter_set": ("document", ""), "fault": ("detail", "VALUES (7, 1.0, 'x', 1, 'y')"),
        "sweep": ("document", "VALUES (7, 1.0, 'x', 'y', '{}')"),
    }[table]  # fmt: skip
    with sqlite3.connect(path) as database:
        if values:
            database.execute(f"INSERT INTO {table} {values}")
        database.execute(f"UPDATE {table} SET {column} = CAST(x'{text}' AS TEXT)")
    database.close()
    found, before = (recover(place, Retention(), lambda place=place: Store(place)) for place in (path, sound))
    assert found.memory.engine is not None
    assert before.memory.engine is not None
    assert found.memory.engine.totals.total_kg == pytest.approx(before.memory.engine.totals.total_kg)
    matters = table in ("state", "parameter_set") or text == "22adff22"
    assert ("damaged" in found.note) == matters
    if text == "22adff22":
        assert f"of {table}" in found.note.partition("lost:")[2]


def test_a_row_that_no_later_version_takes_ends_no_start(tmp_path: Path) -> None:
    path = tmp_path / "s.sqlite"
    shutil.copy(Path(__file__).parents[1] / "golden" / "store-0.1.0.sqlite", path)
    with sqlite3.connect(path) as database:
        database.execute("PRAGMA writable_schema = ON")
        database.execute(
            "UPDATE sqlite_schema SET sql = replace(sql, 'batch INTEGER NOT NULL', 'batch INTEGER') WHERE name = 'state'"
        )
    database.close()
    with sqlite3.connect(path) as database:
        database.execute("UPDATE state SET batch = NULL")
        database.execute("PRAGMA writable_schema = ON")
        database.execute(
            "UPDATE sqlite_schema SET sql = replace(sql, 'batch INTEGER', 'batch INTEGER NOT NULL') WHERE name = 'state'"
        )
    database.close()
    found = recover(path, Retention(), lambda: Store(path))
    assert "damaged" in found.note
    assert found.memory.engine is not None

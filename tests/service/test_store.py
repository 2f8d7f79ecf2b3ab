"""The store: whole batches or nothing, once and in order; migration; foreign, damaged and full files; retention."""

from __future__ import annotations

import os
import sqlite3
import tempfile
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from yieldmon.errors import InputError
from yieldmon.service.storage import schema
from yieldmon.service.storage.batch import Action, Batch, FaultEvent, Load, ParameterVersion, Step, SweepRecord, Ticket
from yieldmon.service.storage.retention import Retention
from yieldmon.service.storage.rows import SecondRow
from yieldmon.service.storage.store import Store
from yieldmon.service.storage.store_errors import BatchRefusedError, StoreError
from yieldmon.service.storage.store_file import set_aside

DATA = Path(__file__).parent / "data"


def second(number: int, mass_kg: float = 10.0, **changes) -> SecondRow:
    total = mass_kg * number
    record = SecondRow(
        number=number, time_s=1.7e9 + number, duration_s=1.0, mass_flow_kg_s=mass_kg, std_dev_kg_s=0.2, quality=0,
        operating_state=3, mass_kg=mass_kg, load_number=1, load_kg=total, total_kg=total, coverage=1.0, force_n=8.0,
        force_std_dev_n=0.1, elevator_speed_rpm=400.0, plate_angle_deg=70.0, plate_still=1, moisture_pct=None,
        test_weight_kg_m3=None, zero_mv=120.0, pulse_mv=30.0, saturated_share=0.0, lost_frames=0, surplus_frames=0,
        repeated_frames=0, sweep_id=0, sweep_step=-1, usable_for_calibration=0, parameter_version=1, faults="",
        latitude_deg=None, longitude_deg=None, ground_speed_m_s=None, course_deg=None,
    )  # fmt: skip
    return replace(record, **changes)


def batch(number: int, **changes) -> Batch:
    record = second(number)
    load = Load(1, "north", "corn", 1.7e9, None, record.load_kg, None)
    whole = Batch(number, record.time_s, {"total_mass_kg": record.total_kg}, seconds=(record,), loads=(load,))
    return replace(whole, **changes)


def connections_made(monkeypatch: pytest.MonkeyPatch) -> list[sqlite3.Connection]:
    """SQLite's connections from here on, for pragmas that hold for one connection."""
    made: list[sqlite3.Connection] = []
    connect = sqlite3.connect

    def recording(*arguments, **how) -> sqlite3.Connection:
        made.append(connect(*arguments, **how))
        return made[-1]

    monkeypatch.setattr(sqlite3, "connect", recording)
    return made


@pytest.fixture
def path(tmp_path) -> Path:
    return tmp_path / "folder" / "store.sqlite"


def test_what_was_committed_is_read_back_by_a_second_opening(path):
    sweep = SweepRecord(1.7e9, "UPDATED", "", {"angles_deg": [70, 60]})
    parameters = ParameterVersion(1, 1.7e9, "file", {"friction": 0.3})
    fault = FaultEvent(1.7e9, "FRAMES_LOST", True, "4 samples")
    whole = batch(1, sweeps=(sweep,), parameter_versions=(parameters,), faults=(fault,), counters={"samples_lost": 4})
    with Store(path) as store:
        assert store.state() is None
        assert store.last_second() is None
        store.commit([whole])
    with Store(path) as store:
        assert store.state() == {"total_mass_kg": 10.0}
        assert store.seconds() == [second(1)]
        assert store.last_second() == second(1)
        assert store.loads() == list(whole.loads)
        assert store.sweeps() == [sweep]
        assert store.parameter_versions() == [parameters]
        assert store.faults() == [fault]
        assert store.counters() == {"samples_lost": 4}
        assert store.last_batch() == 1


def test_a_batch_committed_again_counts_once(path):
    with Store(path) as store:
        store.commit([batch(1), batch(2)])
        store.commit([batch(1), batch(2), batch(3)])
        assert [s.number for s in store.seconds()] == [1, 2, 3]
        assert store.loads()[0].mass_kg == 30.0


def rows_of(store: Store) -> list[object]:
    kinds = (store.seconds, store.loads, store.sweeps, store.parameter_versions, store.faults, store.tickets, store.actions)
    return [*(list(kind()) for kind in kinds), store.steps(), store.counters(), store.state(), store.last_batch()]


@pytest.mark.parametrize("in_part", [False, True])
def test_no_row_of_any_kind_is_written_again(path, in_part):
    """A commit whose outcome was unclear is repeated, also row by row."""
    whole = batch(
        1, sweeps=(SweepRecord(1.7e9, "UPDATED", "", {}),), parameter_versions=(ParameterVersion(1, 1.7e9, "file", {}),),
        faults=(FaultEvent(1.7e9, "FRAMES_LOST", True),), tickets=(Ticket(1.7e9, 1, 1, 9000.0, 9100.0),),
        actions=(Action(1, 1.7e9, "ticket", "anna", {}),), steps=(Step(1, 1.7e9, {}),), counters={"samples_lost": 4},
    )  # fmt: skip
    with Store(path) as store:
        store.commit([whole])
        before = rows_of(store)
        assert all(before[:8])
        for _ in range(2):
            assert (store.commit_in_part(whole) if in_part else store.commit([whole])) == ([] if in_part else None)
            assert rows_of(store) == before
        assert store.commit_in_part(batch(2)) == []
        assert [s.number for s in store.seconds()] == [1, 2]
        store.commit([batch(1), batch(2)])
        assert [s.number for s in store.seconds()] == [1, 2]


SLIP = Ticket(1.7e9, 1, 2, 9000.0, 9100.0, "gate")


@pytest.mark.parametrize(
    ("changes", "tickets"),
    [
        ({}, 1),
        ({"measured_mass_kg": 9200.0}, 1),
        ({"time_s": 1.7e9 + 1.0}, 2),
        ({"first_load": 2}, 2),
        ({"last_load": 3}, 2),
        ({"weighed_mass_kg": 9001.0}, 2),
        ({"note": "yard"}, 2),
    ],
    ids=["the same", "measured again since", "later", "of other loads", "of more loads", "of another mass", "of another scale"],
)
def test_a_ticket_that_is_handed_on_to_a_store_made_anew_is_entered_once(path, changes, tickets):
    with Store(path) as store:
        store.commit([batch(1, tickets=(SLIP,))])
        store.commit([batch(2, tickets=(replace(SLIP, **changes),))])
        assert len(store.tickets()) == tickets


@settings(max_examples=40)
@given(st.lists(st.lists(st.integers(1, 8), max_size=4), max_size=6))
def test_any_order_of_repeats_leaves_totals_that_fit_the_records(tmp_path_factory, commits):
    with Store(tmp_path_factory.mktemp("store") / "s") as store:
        last = 0
        for numbers in commits:
            store.commit([batch(n) for n in numbers])
            last = max([last, *numbers])
            seconds = store.seconds()
            numbers_stored = [s.number for s in seconds]
            assert numbers_stored == sorted(set(numbers_stored))
            assert store.last_batch() == last
            if seconds:
                assert store.state() == {"total_mass_kg": seconds[-1].total_kg}
                assert store.loads()[0].mass_kg == seconds[-1].load_kg


REFUSED = [
    pytest.param(batch(2, seconds=(second(2, time_s=float("nan")),)), id="nan where a number must be"),
    pytest.param(batch(2, state={"zero_mv": float("inf")}), id="state that is not JSON"),
    pytest.param(batch(2, tickets=(Ticket(1.7e9, 2, 1, 9000.0, 9100.0),)), id="ticket that ends before it begins"),
]


@pytest.mark.parametrize("bad", REFUSED)
def test_a_refused_batch_leaves_nothing_behind(path, bad):
    with Store(path) as store:
        store.commit([batch(1)])
        with pytest.raises(BatchRefusedError, match=str(path)):
            store.commit([bad])
        assert [s.number for s in store.seconds()] == [1]
        assert store.last_batch() == 1
        store.commit([batch(2)])
        assert store.last_batch() == 2


def test_full_medium_fails_whole_and_recovers(path, monkeypatch):
    connections = connections_made(monkeypatch)
    with Store(path) as store:
        store.commit([batch(1)])
        (connection,) = connections
        connection.execute(f"PRAGMA max_page_count = {connection.execute('PRAGMA page_count').fetchone()[0]}")
        large = batch(2, state={"filler": "x" * 200_000})
        with pytest.raises(StoreError, match="full"):
            store.commit([large])
        assert store.last_batch() == 1
        connection.execute("PRAGMA max_page_count = 1000000")
        store.commit([large])
        assert store.last_batch() == 2


def test_a_store_of_version_1_grows_up(path):
    path.parent.mkdir()
    old = sqlite3.connect(path)
    old.executescript((DATA / "store-v1.sql").read_text())
    old.close()
    with Store(path) as store:
        with closing(sqlite3.connect(path)) as database:
            assert database.execute("PRAGMA user_version").fetchone() == (schema.VERSION,)
        assert [s.total_kg for s in store.seconds()] == [9.5, 9.5, 19.75]
        assert store.seconds()[1].moisture_pct is None
        assert store.loads()[1] == Load(2, "north", "corn", 1700000002.0, None, 10.25, None)
        assert store.state() == {"total_mass_kg": 19.75}
        store.commit([batch(4, seconds=(second(4),), tickets=(Ticket(1.7e9, 1, 1, 9.31, 9.5),))])
        assert [row["corrected_mass_kg"] for row in store.corrected_loads()] == pytest.approx([9.31, 10.25])


def test_a_grown_store_and_a_new_one_have_the_same_schema(path, tmp_path):
    path.parent.mkdir()
    old = sqlite3.connect(path)
    old.executescript((DATA / "store-v1.sql").read_text())
    old.close()

    def layout(file: Path) -> list[tuple]:
        Store(file).close()
        with closing(sqlite3.connect(file)) as database:
            names = [r[0] for r in database.execute("SELECT name FROM sqlite_schema ORDER BY name")]
            return [(n, database.execute(f"PRAGMA table_xinfo('{n}')").fetchall()) for n in names]

    assert layout(path) == layout(tmp_path / "new")


def test_interrupted_migration_leaves_the_old_version(path, monkeypatch):
    path.parent.mkdir()
    old = sqlite3.connect(path)
    old.executescript((DATA / "store-v1.sql").read_text())
    old.close()
    broken = (*schema.MIGRATIONS[:1], schema.MIGRATIONS[1] + "\nSELECT no_such_function();\n")
    with monkeypatch.context() as patch:
        patch.setattr(schema, "MIGRATIONS", broken)
        with pytest.raises(StoreError, match="no_such_function"):
            Store(path)
    with Store(path) as store:
        assert len(store.seconds()) == 3


def sqlite_file(path: Path, *statements: str) -> None:
    database = sqlite3.connect(path)
    for statement in statements:
        database.execute(statement)
    database.commit()
    database.close()


def test_files_that_are_not_ours_are_left_alone(tmp_path):
    foreign = tmp_path / "foreign"
    sqlite_file(foreign, "CREATE TABLE t (a)", "PRAGMA application_id = 77")
    with pytest.raises(InputError, match="another program"):
        Store(foreign)
    newer = tmp_path / "newer"
    sqlite_file(newer, "CREATE TABLE t (a)", f"PRAGMA user_version = {schema.VERSION + 1}")
    with pytest.raises(InputError, match=f"schema version {schema.VERSION + 1}; expected {schema.VERSION} at most"):
        Store(newer)


@pytest.mark.parametrize("offset", [0, 3 * 4096 + 100], ids=["header", "table"])
def test_a_damaged_store_is_reported_and_can_be_set_aside(path, offset):
    with Store(path) as store:
        store.commit([batch(n) for n in range(1, 300)])
    content = bytearray(path.read_bytes())
    content[offset : offset + 20000] = bytes(range(250)) * 80
    path.write_bytes(content)
    with pytest.raises(StoreError, match=str(path)):
        Store(path)
    aside = set_aside(path, "damaged-1")
    assert aside.read_bytes() == content
    with Store(path) as store:
        assert store.last_batch() == 0


def test_retention_by_hours_takes_the_oldest_records_only(path):
    with Store(path, Retention(record_hours=10 / 3600)) as store:
        store.commit([batch(n) for n in range(1, 101)])
        assert store.prune() == 90
        assert [s.number for s in store.seconds()] == list(range(91, 101))
        assert store.loads()[0].mass_kg == 1000.0
        assert store.prune() == 0


def test_retention_by_size_bounds_the_file(path):
    limit_mb = 0.5
    with Store(path, Retention(size_mb=limit_mb)) as store:
        for first in range(1, 8001, 1000):
            store.commit([batch(n) for n in range(first, first + 1000)])
            store.prune()
        assert store.seconds()[-1].number == 8000
        assert store.seconds()[0].number > 1, "the oldest have gone"
        assert store.size_bytes() < limit_mb * 1e6 + 200_000
    assert path.stat().st_size < limit_mb * 1e6 + 400_000


def test_retention_of_events(path):
    with Store(path, Retention(event_rows=5)) as store:
        store.commit([batch(n, faults=(FaultEvent(float(n), "X", True),)) for n in range(1, 11)])
        store.prune()
        assert [f.time_s for f in store.faults()] == [6.0, 7.0, 8.0, 9.0, 10.0]


def test_tickets_and_what_took_them_back_stay_beyond_retention_of_events(path):
    """A ticket's number is its place among all of them, and without its undo one would count again."""
    loads = tuple(Load(n, "north", "corn", 0.0, 1.0, 1000.0, 900.0) for n in range(1, 11))
    tickets = tuple(Ticket(float(n), n, n, 1000.0 + 10.0 * n, 1000.0) for n in range(1, 11))
    undone = Action(1, 20.0, "ticket-undo", "", {"ticket": 9})
    later = tuple(Action(n, 20.0 + n, "zero", "", {"second": n}) for n in range(2, 20))
    with Store(path, Retention(event_rows=5)) as store:
        store.commit([Batch(1, 1.0, {}, loads=loads, tickets=tickets, actions=(undone, *later))])
        before = store.corrected_loads()
        store.prune()
        assert store.corrected_loads() == before
        assert (len(store.tickets()), len(store.actions())) == (10, 19)
    assert [row["ticket_id"] for row in before] == [1, 2, 3, 4, 5, 6, 7, 8, None, 10]


def test_the_newest_ticket_corrects_and_originals_stay(path):
    loads = tuple(Load(n, "north", "corn", 0.0, 1.0, 1000.0 * n, 900.0 * n) for n in (1, 2, 3, 4))
    tickets = (Ticket(1.0, 1, 3, 6600.0, 6000.0), Ticket(2.0, 2, 2, 1900.0, 2000.0, "cart"))
    with Store(path) as store:
        store.commit([Batch(1, 1.0, {}, loads=loads, tickets=tickets)])
        assert store.loads() == list(loads)
        assert store.tickets() == list(tickets)
        rows = store.corrected_loads()
    assert [row["corrected_mass_kg"] for row in rows] == pytest.approx([1000.0, 1900.0, 3000.0, 4000.0])
    assert [row["corrected_dry_mass_kg"] for row in rows] == pytest.approx([900.0, 1710.0, 2700.0, 3600.0])
    assert [row["ticket_id"] for row in rows] == [None, 2, None, None]


def test_a_store_is_read_where_its_disk_has_no_room_for_the_journals_index(path, monkeypatch):
    class Full(sqlite3.Connection):
        """As SQLite on a full ext4: the first access fails, since the index cannot be made."""

        def execute(self, statement, *arguments):
            if "application_id" in statement:
                error = sqlite3.OperationalError("disk I/O error")
                error.sqlite_errorcode = 4874  # SQLITE_IOERR_SHMSIZE
                raise error
            return super().execute(statement, *arguments)

    connect = sqlite3.connect
    with Store(path) as writer:
        writer.commit([batch(1)])
        before = sorted(path.parent.iterdir())
        here = f"file:{path}?"

        def on_the_full_disk(at, **how):
            return connect(at, **how, factory=Full if here in at else sqlite3.Connection)

        monkeypatch.setattr(sqlite3, "connect", on_the_full_disk)
        with Store.reading(path) as reader:
            assert [row.number for row in reader.seconds()] == [1]
            assert reader.state() == {"total_mass_kg": 10.0}
        assert sorted(path.parent.iterdir()) == before


def test_a_reader_does_not_stop_the_writer(path):
    with Store(path) as writer:
        writer.commit([batch(1)])
        reader = sqlite3.connect(f"file:{path}?mode=ro", uri=True)
        cursor = reader.execute("SELECT number FROM second")
        writer.commit([batch(2)])
        assert cursor.fetchall() == [(1,)]
        reader.close()


def test_loads_and_tickets_of_the_first_version_are_read_as_they_stand() -> None:
    """Its rows have no checksums and its loads no area."""
    with Store.reading(Path(__file__).parents[1] / "golden" / "store-0.1.0.sqlite") as store:
        loads, (ticket,) = store.loads(), store.tickets()
        assert [(load.number, load.field, load.crop, round(load.mass_kg), load.area_m2) for load in loads] == [
            (1, "", "", 1210, None), (2, "south", "corn", 1090, None)
        ]  # fmt: skip
        assert (ticket.first_load, ticket.last_load, ticket.weighed_mass_kg) == (1, 1, 1200.0)
        assert [round(row["corrected_mass_kg"]) for row in store.corrected_loads()] == [1200, 1090]


@pytest.mark.parametrize("opens", [Store, Store.reading], ids=["to write", "to read"])
def test_a_store_of_another_user_says_who_may_not_use_what(opens):
    """SQLite's own words, "unable to open database file" or "disk I/O error", name neither."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "s.sqlite"
        with Store(path):
            pass
        path.chmod(0o000)
        path.parent.chmod(0o755)
        user = os.geteuid()
        try:
            if user == 0:
                os.seteuid(65534)
            with pytest.raises((StoreError, InputError)) as refused:
                opens(path)
        finally:
            os.seteuid(user)
    assert "Permission denied; expected a file or folder that user " in str(refused.value)

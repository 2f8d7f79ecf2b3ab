"""A disk that does not answer at the start: what comes meanwhile is measured all the same, once and from what the store knows."""

from __future__ import annotations

import contextlib
import os
import shutil
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future
from pathlib import Path

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.service.bench import PATIENCE_S, START_S, UNHURRIED, Bench, encoded, running, traffic, wait_for
from yieldmon.engine.mass.budget import FlowBudget
from yieldmon.engine.mass.totals import Totals
from yieldmon.errors import InputError
from yieldmon.service import answering
from yieldmon.service.config import configuration
from yieldmon.service.daemon import Daemon
from yieldmon.service.history.late_store import KeptInput
from yieldmon.service.history.recovery import recover
from yieldmon.service.operator.control_protocol import ControlError
from yieldmon.service.storage.ownership import OccupiedError
from yieldmon.service.storage.rows import SecondRow
from yieldmon.service.storage.store import Store

STORE = "yieldmon.sqlite"
#: Of the life before, and of the one that finds the disk hanging.
EMPTY_S, GRAIN_S = 4.0, 3.0
#: Before and after the disk answers.
FIRST_S, SECOND_S = 4.0, 2.0
LATER_S = FIRST_S + SECOND_S
NEXT_S = START_S + EMPTY_S + GRAIN_S


class Disk:
    """The store is read once `answer` has been called; `failure` is what the reading then ends with."""

    def __init__(self) -> None:
        self.asked, self._answers = threading.Event(), threading.Event()
        self.failure: Exception | None = None
        self.answer = self._answers.set

    def recover(self, *store):
        self.asked.set()
        assert self._answers.wait(PATIENCE_S)
        if self.failure is not None:
            raise self.failure
        return recover(*store)


@pytest.fixture
def disk(monkeypatch) -> Iterator[Disk]:
    hanging = Disk()
    monkeypatch.setattr("yieldmon.service.history.run_store.recover", hanging.recover)
    yield hanging
    hanging.answer()


@pytest.fixture(scope="module")
def before(tmp_path_factory) -> Path:
    """A folder with the store of a life that has a zero, a load under way, and a ticket."""
    folder = tmp_path_factory.mktemp("before")
    with running(folder) as bench:
        bench.play(EMPTY_S, 0.0)
        bench.play(GRAIN_S, 100.0)
        bench.played()
        bench.daemon.command({"command": "load-start", "field": "north"})
    return folder


def stored(folder: Path) -> list[SecondRow]:
    with Store(folder / STORE) as store:
        return store.seconds()


@pytest.fixture(scope="module")
def undisturbed(before, tmp_path_factory) -> list[SecondRow]:
    """The seconds with a disk that answers."""
    folder = shutil.copytree(before, tmp_path_factory.mktemp("sound"), dirs_exist_ok=True)
    with running(folder, start_s=NEXT_S) as bench:
        bench.play(FIRST_S, 100.0)
        bench.play(SECOND_S, 100.0)
        bench.played()
    return stored(folder)


@pytest.fixture
def folder(before, tmp_path) -> Path:
    return shutil.copytree(before, tmp_path / "life")


@contextlib.contextmanager
def without_store(folder: Path, **how) -> Iterator[Bench]:
    """A daemon that has begun without the store."""
    with running(folder, start_s=NEXT_S, store_s=0.01, **how) as bench:
        yield bench


def test_frames_of_a_start_that_waits_for_the_disk_are_measured_afterwards(folder, undisturbed, disk):
    channel = f"late-{folder.parent.name}"

    def bus() -> can.BusABC:
        return can.Bus(interface="virtual", channel=channel, preserve_timestamps=True)

    path = folder / "c.yaml"
    environment = {"STATE_DIRECTORY": str(folder), "RUNTIME_DIRECTORY": str(folder)}
    made = Daemon(
        configuration.load(path, environment), environment=environment, bus_factory=bus, timeouts=UNHURRIED,
    )  # fmt: skip
    peer, thread = bus(), threading.Thread(target=made.run)
    thread.start()
    assert disk.asked.wait(PATIENCE_S)
    for frame in (*traffic(NEXT_S, FIRST_S, 100.0), *traffic(NEXT_S + FIRST_S, SECOND_S, 100.0)):
        peer.send(encoded(frame))
    assert not made.started.is_set()
    disk.answer()
    wait_for(lambda: made.snapshot.get("windows") and made.snapshot["windows"][-1]["time_s"] >= NEXT_S + LATER_S - 1, "windows")
    made.request_stop()
    thread.join(PATIENCE_S)
    peer.shutdown()
    assert stored(folder) == undisturbed


def test_a_store_that_comes_late_has_every_second_as_if_it_had_been_there(folder, undisturbed, disk):
    last = len(undisturbed)
    with without_store(folder) as bench:
        bench.play(FIRST_S, 100.0)
        bench.played()
        assert "has not answered" in bench.faults["StoreFailing"]
        assert bench.rows[-1]["number"] < last - 2
        disk.answer()
        wait_for(lambda: bench.rows and bench.rows[-1]["number"] >= last - 2, "what was measured again")
        assert bench.status["load"]["field"] == "north"
        bench.play(SECOND_S, 100.0)
        bench.played()
        assert "StoreFailing" not in bench.faults
        total_kg = bench.status["total"]["mass_kg"]
    rows = stored(folder)
    assert rows == undisturbed
    assert rows[-1].total_kg == total_kg


def test_what_there_is_no_room_for_is_in_the_totals_and_said(folder, undisturbed, disk):
    kept_s = 2.0
    with without_store(folder, kept_frames=len(list(traffic(NEXT_S, kept_s, 0.0)))) as bench:
        bench.play(LATER_S, 100.0)
        bench.played()
        disk.answer()
        wait_for(lambda: bench.status["load"]["field"] == "north", "the store")
        measured_kg = bench.status["total"]["mass_kg"]
        bench.play(2.0, 100.0)
        bench.played()
        assert "measured after the first 2 s are in the totals, without records" in bench.faults["StoreFailing"]
    rows = stored(folder)
    kept = [row for row in rows if row.time_s < NEXT_S + kept_s]
    assert kept == undisturbed[: len(kept)]
    assert kept[-1].time_s == pytest.approx(NEXT_S + kept_s - 0.9, abs=0.01)
    # Without the store's zero there was none to measure the others with.
    assert measured_kg == kept[-1].total_kg
    assert rows[len(kept)].time_s > NEXT_S + LATER_S - 1.0


def test_mass_of_seconds_without_records_joins_the_open_load(before, folder, disk):
    empty_s = 4.0
    with without_store(folder, kept_frames=100) as bench:
        bench.play(empty_s, 0.0)
        bench.play(LATER_S, 100.0)
        bench.played()
        without_kg = bench.status["total"]["mass_kg"]
        assert without_kg > 0.0
        disk.answer()
        wait_for(lambda: bench.status["load"]["field"] == "north", "the store")
        with_kg, load_kg = bench.status["total"]["mass_kg"], bench.status["load"]["mass_kg"]
        last = stored(before)[-1]
        assert (with_kg, load_kg) == (pytest.approx(last.total_kg + without_kg), pytest.approx(without_kg))
        bench.play(2.0, 0.0)
        bench.played()
        assert f"{without_kg:.1f} kg" in bench.faults["StoreFailing"]
    with running(folder, start_s=NEXT_S + empty_s + LATER_S + 2.0) as bench:
        assert bench.status["total"]["mass_kg"] == pytest.approx(with_kg)


@pytest.mark.parametrize(
    "verb", ["load-start", "load-stop", "loads", "ticket", "tickets", "zero", "calibrations", "totals-reset"]
)
def test_nothing_is_answered_from_a_store_that_is_not_known(verb, folder, disk):
    with without_store(folder) as bench, pytest.raises(ControlError, match=r"has not answered since the start.*nothing was done"):
        bench.daemon.command({"command": verb})
    assert disk.asked.is_set()


def test_a_stop_does_not_wait_for_the_disk(folder, disk, caplog):
    with without_store(folder) as bench:
        bench.play(2.0, 0.0)
        bench.played()
        begun_s = time.monotonic()
    assert time.monotonic() - begun_s < 30.0
    assert "0.0 kg measured since then are in no store" in caplog.text
    disk.answer()
    assert len(stored(folder)) > 0


def test_a_stop_while_the_start_waits_for_the_disk_ends_it(folder, disk):
    environment = {"STATE_DIRECTORY": str(folder), "RUNTIME_DIRECTORY": str(folder)}
    made = Daemon(
        configuration.load(folder / "c.yaml", environment), environment=environment,
        bus_factory=lambda: can.Bus(interface="virtual", channel="late-stop"), timeouts=UNHURRIED,
    )  # fmt: skip
    codes: list[int] = []
    thread = threading.Thread(target=lambda: codes.append(made.run()))
    thread.start()
    assert disk.asked.wait(PATIENCE_S)
    made.request_stop()
    thread.join(PATIENCE_S)
    assert codes == [0]
    assert not made.started.is_set()


def test_a_reading_that_ends_with_an_error_ends_the_run_with_it(folder, disk):
    disk.failure = OccupiedError("store.path", "another daemon is using it", "a store for each daemon")

    def run() -> None:
        with without_store(folder) as bench:
            bench.play(2.0, 0.0)
            disk.answer()
            wait_for(lambda: bench.failure, "the end of the run")

    with pytest.raises(OccupiedError, match="another daemon"):
        run()


AMOUNTS = st.integers(0, 240).map(lambda number: number / 4.0)


#: Wet and dry mass, noise and what the seconds share, whether the mass is contested.
@pytest.mark.parametrize(
    ("metrics", "refused"), [("m.prom", False), ("yieldmon.sqlite", True), ("./x/../yieldmon.sqlite-wal", True), ("link", False)]
)
def test_a_configuration_is_read_although_the_stores_disk_does_not_answer(tmp_path, monkeypatch, metrics, refused):
    """Files are then distinguished by their names alone."""
    gate, real = threading.Event(), os.path.realpath
    (tmp_path / "link").symlink_to(tmp_path / STORE)
    path = tmp_path / "c.yaml"
    path.write_text(f"status: {{prometheus_file: {metrics}}}")
    environment = {"STATE_DIRECTORY": str(tmp_path), "RUNTIME_DIRECTORY": str(tmp_path)}

    def hanging(name, **how):
        if Path(name).name == STORE:
            gate.wait(PATIENCE_S)
        return real(name, **how)

    monkeypatch.setattr(os.path, "realpath", hanging)
    is_symlink = Path.is_symlink
    monkeypatch.setattr(Path, "is_symlink", lambda p: p.name == STORE and gate.wait(PATIENCE_S) and is_symlink(p))
    monkeypatch.setattr(answering, "ANSWERS_WITHIN_S", 0.05)
    try:
        if refused:
            with pytest.raises(InputError, match=r"status\.prometheus_file: .* is the store, or one beside it"):
                configuration.load(path, environment)
        else:
            assert configuration.load(path, environment).store_path == tmp_path / STORE
    finally:
        gate.set()


@pytest.mark.parametrize("error", [ValueError("no"), TimeoutError("its own")])
def test_what_a_question_raises_is_raised_where_it_was_asked(error):
    def question():
        raise error

    with pytest.raises(type(error), match=str(error)):
        answering.answer_or(question, lambda: pytest.fail("it was answered"))


def test_an_answer_in_the_moment_in_which_the_wait_ends_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    class AnsweredAtTheEnd(Future[int]):
        def result(self, timeout: float | None = None) -> int:
            found = super().result()
            if timeout is not None:
                raise TimeoutError
            return found

    monkeypatch.setattr(answering, "Future", AnsweredAtTheEnd)
    assert answering.answer_or(lambda: 7, lambda: pytest.fail("it was answered")) == 7


MASSES = st.lists(st.tuples(AMOUNTS, st.none() | AMOUNTS, AMOUNTS, AMOUNTS, st.booleans()), max_size=5)


def accumulated(totals: Totals, masses: list[tuple[float, float | None, float, float, bool]]) -> Totals:
    for mass_kg, dry_kg, noise, shared, contested in masses:
        if contested:
            totals = totals.with_contested(mass_kg)
        else:
            budget = FlowBudget(noise, shared, 2.0 * shared, 3.0 * shared)
            totals = totals.with_mass(mass_kg, dry_kg, budget, 1.0, float("nan"))
    return totals


@given(first=MASSES, second=MASSES, is_open=st.booleans())
def test_totals_of_two_monitors_are_those_of_one_that_measured_all(first, second, is_open):
    begin = Totals(load_number=7) if is_open else Totals(load_number=7).stop_load()
    joined = accumulated(begin, first).with_more(accumulated(Totals(), second))
    together = accumulated(begin, [*first, *second])
    for name in (
        "total_kg", "total_dry_kg", "total_unknown_moisture_kg", "load_kg", "load_dry_kg", "load_unknown_moisture_kg",
        "total_contested_kg", "load_contested_kg", "load_unknown_area_kg",
    ):  # fmt: skip
        assert getattr(joined, name) == pytest.approx(getattr(together, name), abs=1e-9), name
    for budget in ("total_budget", "load_budget"):
        ours, theirs = getattr(joined, budget), getattr(together, budget)
        for name in ("noise_kg2", "parameters_kg", "zero_kg", "moisture_kg"):
            assert getattr(ours, name) == pytest.approx(getattr(theirs, name), abs=1e-9), (budget, name)
    assert (joined.load_number, joined.load_open) == (7, is_open)


@pytest.mark.parametrize("limit", [0, 1, 3])
def test_the_first_beyond_the_limit_is_reported_once(limit):
    kept = KeptInput(limit)
    assert [kept.add(10.0 + number) for number in range(limit + 3)] == [number == limit for number in range(limit + 3)]
    assert kept.full
    assert kept.duration_s == max(0.0, limit - 1.0)

"""A ticket leads to the same whether or not the daemon was started anew between its load and the ticket."""

from __future__ import annotations

import contextlib
import io
import json
import math
import os
import types

import pytest

from tests.service.bench import START_S, running, wait_for
from yieldmon.cli import main as cli
from yieldmon.cli._answers import calibration_undone
from yieldmon.engine.self_calibration.parameter_updater import ParametersChanged
from yieldmon.files import parameter_file
from yieldmon.service.storage.batch import Ticket
from yieldmon.service.storage.ledger import PARAMETERS
from yieldmon.service.storage.store import Store
from yieldmon.service.tickets.action_log import ActionLog

LOADS = ((5, 40.0), (4, 80.0), (5, 110.0), (4, 60.0))
"""Seconds of grain and its signal, mV, of loads 2 to 5."""
TRUE = 1.15
"""Weighed over measured mass."""


def ask(folder, *words: str) -> dict:
    """The answer of the running daemon; not by capsys, which a fixture of a module cannot have."""
    with contextlib.redirect_stdout(io.StringIO()) as out:
        assert cli.main([*words, "--socket", str(folder / "yieldmon.sock"), "--json"]) == 0
    return json.loads(out.getvalue())


class Season:
    """Runs of a daemon on one store. masses: as measured, by load."""

    def __init__(self, folder) -> None:
        folder.mkdir()
        self.folder, self.now_s = folder, START_S
        self.masses: dict[int, float] = {}

    def harvest(self, bench) -> None:
        bench.play(14, 0.0)
        # The zero first: seconds without one are not measured.
        bench.played()
        for seconds, signal_mv in LOADS:
            ask(self.folder, "load", "start")
            bench.play(seconds, signal_mv)
            bench.played()
            bench.taken()
        ask(self.folder, "load", "stop")
        bench.play(2, 0.0)
        bench.played()
        self.masses = {row["number"]: row["mass_kg"] for row in ask(self.folder, "load", "list")["loads"]}

    def ticket(self, bench, number: int, factor: float) -> dict:
        weighed_kg = factor * self.masses[number]
        answer = ask(self.folder, "ticket", str(number), f"{weighed_kg}kg", "--std-dev", f"{0.002 * weighed_kg}kg")
        bench.play(2, 0.0)
        bench.played()
        return answer

    def updates(self) -> list[tuple[str, dict[str, float], list[list[float]]]]:
        with Store(self.folder / "yieldmon.sqlite") as store:
            versions = store.parameter_versions()
        sets = [(v.origin, parameter_file.from_document(v.document, "")) for v in versions]
        return [(origin, dict(known.values), known.covariance.tolist()) for origin, known in sets]


TICKETS = ((2, TRUE), (3, 1.003 * TRUE), (4, 0.998 * TRUE), (5, 1.12 * TRUE))
"""The last is another truck's grain."""


def learnt(folder, runs: tuple[int, ...]) -> tuple[list, list[str]]:
    """What the tickets lead to, so many of them in each run of the daemon, and why each did as it did."""
    season, reported, left = Season(folder), [], list(TICKETS)
    for place, count in enumerate(runs):
        with running(folder, start_s=season.now_s) as bench:
            if place == 0:
                season.harvest(bench)
            for _ in range(count):
                bench.play(2, 0.0)
                bench.played()
                assert season.ticket(bench, *left.pop(0))["why_no_reference"] == ""
                reported.append(bench.daemon.monitor.outcome.reason)
            season.now_s = bench.now_s
    return season.updates(), reported


def test_tickets_update_the_same_after_restarts(tmp_path) -> None:
    through, reported = learnt(tmp_path / "a", (4,))
    anew, told_anew = learnt(tmp_path / "b", (0, 1, 2, 1))
    assert [origin for origin, _, _ in through] == [origin for origin, _, _ in anew] == ["file", "ticket", "ticket", "ticket"]
    assert "contradicts the 3 weighed before" in reported[3]
    assert told_anew == reported
    for (_, values, covariance), (_, values_anew, covariance_anew) in zip(through, anew, strict=True):
        assert values_anew == pytest.approx(values, rel=1e-9)
        assert [math.sqrt(row[i]) for i, row in enumerate(covariance_anew)] == pytest.approx(
            [math.sqrt(row[i]) for i, row in enumerate(covariance)], rel=1e-6
        )


def test_tickets_that_wait_for_another_crop_update_it_after_restarts(tmp_path) -> None:
    season = Season(tmp_path / "a")
    with running(season.folder) as bench:
        season.harvest(bench)
        ask(season.folder, "ticket", "3", f"{1.1 * season.masses[3]}kg")
        wheat = ask(season.folder, "load", "start", "--crop", "wheat")["parameters"]["version"]
        season.now_s = bench.now_s
    for _ in range(2):
        with running(season.folder, start_s=season.now_s + 60.0) as bench:
            bench.play(3, 0.0)
            bench.played()
            assert bench.status["parameters"]["version"] == wheat, "which corn's ticket does not touch"
            season.now_s = bench.now_s
    with running(season.folder, start_s=season.now_s + 60.0) as bench:
        bench.play(3, 0.0)
        corn = ask(season.folder, "load", "start", "--crop", "corn")["parameters"]["version"]
        bench.play(3, 0.0)
        bench.played()
        wait_for(lambda: bench.status["parameters"]["version"] == corn + 1, "what the ticket says of corn")

        def again() -> dict[int, float]:
            """Once a second the daemon looks what has been measured again."""
            bench.play(1, 0.0)
            bench.played()
            rows = ask(season.folder, "load", "list")["loads"]
            return {row["number"]: row["posted_mass_kg"] for row in rows if row["posted_mass_kg"] is not None}

        wait_for(lambda: set(again()) >= {2, 3, 4, 5}, "the loads of corn, measured before wheat was harvested")
        assert again()[3] == pytest.approx(1.1 * season.masses[3], rel=0.01)
        undone = ask(season.folder, "ticket", "undo", "1")
        assert undone["undone"] == corn + 1
    assert "ticket" in [origin for origin, _, _ in season.updates()]


def test_a_ticket_that_updates_after_a_restart_is_undone_with_its_update(tmp_path) -> None:
    season = Season(tmp_path / "a")
    with running(season.folder) as bench:
        season.harvest(bench)
        ask(season.folder, "ticket", "3", f"{1.1 * season.masses[3]}kg")
        season.now_s = bench.now_s
    with running(season.folder, start_s=season.now_s + 60.0) as bench:
        bench.play(3, 0.0)
        bench.played()
        wait_for(lambda: bench.status["parameters"]["version"] == 2, "what it leads to")
        undone = ask(season.folder, "ticket", "undo", "1")
        assert (undone.get("undone"), undone.get("version")) == (2, 3)
    assert season.updates()[2][1] == season.updates()[0][1] != season.updates()[1][1]


def test_loads_are_measured_again_though_the_daemon_was_killed_meanwhile() -> None:
    tickets = [Ticket(1.0, 1, 1, 100.0, 90.0, "")]
    log = ActionLog([], [], 0.0)
    log.ticket(tickets[0], is_reference=True)
    assert log.unfinished == (1,)
    before = ActionLog(tickets, tuple(log), 0.0, log.unfinished)
    assert (before.updates.waiting, before.measuring_waits) == ((1,), False)
    led_to(log, 2)
    assert log.take_to_measure(2) == ((1,), 2)
    assert log.unfinished == (1,), "while they are measured"
    after = ActionLog(tickets, tuple(log), 0.0, log.unfinished)
    assert (after.updates.waiting, after.take_to_measure(2)) == ((), ((1,), 2))
    log.remeasured((1,), 2, {})
    assert log.unfinished == ()
    assert ActionLog([], [], 0.0, (1,)).updates.waiting == (), "a ticket that the store lost"


def led_to(log: ActionLog, version: int) -> None:
    """All tickets that wait led to one version."""
    change = ParametersChanged(parameter_file.load(), "ticket", "", references=tuple((n, 100.0) for n in log.updates.waiting))
    numbers = log.take_behind(change)
    log.add(PARAMETERS, "", {"version": version, "from_version": version - 1, "origin": "ticket", "tickets": numbers})


def log_of(count: int) -> ActionLog:
    """With so many tickets of the crop in use, which wait."""
    log = ActionLog([], [], 0.0)
    for number in range(1, count + 1):
        log.ticket(Ticket(1.0, number, number, 100.0, 90.0, ""), is_reference=True)
    return log


def test_tickets_of_a_crop_that_is_left_before_they_update_wait_for_its_return() -> None:
    log = log_of(1)
    log.updates.change_crop("wheat", "corn")
    assert (log.updates.waiting, log.unfinished, log.updates.of_crop) == ((), (), {"wheat": (1,)})
    log.ticket(Ticket(2.0, 2, 2, 100.0, 90.0, ""), is_reference=True)
    led_to(log, 5)
    assert log.take_to_measure(5) == ((2,), 5)
    log.remeasured((2,), 5, {})
    tickets = [Ticket(1.0, number, number, 100.0, 90.0, "") for number in (1, 2)]
    after = ActionLog(tickets, tuple(log), 0.0, log.unfinished, log.updates.of_crop)
    after.updates.change_crop("corn", "wheat")
    assert (after.updates.waiting, after.updates.of_crop) == ((1,), {})
    assert ActionLog(tickets[:1], (), 0.0, (), {"wheat": (1, 2)}).updates.of_crop == {"wheat": (1,)}, "the store lost one"
    log.undo_ticket(1, "", 3.0)
    assert log.updates.of_crop == {}


def test_an_undo_names_the_standing_ticket_whose_update_goes_with_it() -> None:
    """A ticket entered three times, one of them taken back."""
    log = ActionLog([], [], 0.0)
    for number, load in ((1, 4), (2, 4), (3, 7), (4, 4)):
        log.ticket(Ticket(1.0, load, load, 100.0, 90.0, ""), is_reference=True)
        log.add(PARAMETERS, "", {"version": 1 + number, "from_version": number, "origin": "ticket", "tickets": [number]})
    assert log.history.first_update(1, lambda _: True) == 2
    log.undo_ticket(1, "", 2.0)
    assert log.history.standing_of({2, 3, 4, 5}) == (3, 4)
    assert log.history.standing_of({2}) == ()
    answer = {"undone": 2, "until": 5, "version": 6, "crop": "", "standing_tickets": [3, 4]}
    assert calibration_undone(answer) == (
        "calibration 2 to 5 undone, what was in use before is version 6; the update by tickets 3 and 4 is undone with it: enter "
        "such a mass again if it is right"
    )


def test_loads_are_measured_again_with_the_crop_that_their_ticket_updated_though_another_is_in_use() -> None:
    """Two tickets of wheat; the crop changes while its loads are still to be measured again, and corn has a ticket at once."""
    log = log_of(2)
    led_to(log, 2)
    for version in (3, 4):
        log.add(PARAMETERS, "", {"version": version, "from_version": version - 1, "origin": "crop", "tickets": []})
    log.updates.change_crop("wheat", "corn")
    log.ticket(Ticket(2.0, 3, 3, 100.0, 90.0, ""), is_reference=True)
    led_to(log, 5)
    assert log.take_to_measure(5) == ((1, 2), 2)
    log.remeasured((1, 2), 2, {})
    assert log.take_to_measure(5) == ((3,), 5)
    assert not log.measuring_waits


def test_a_store_made_anew_by_the_last_write_has_the_tickets_too(tmp_path, monkeypatch) -> None:
    """The disk fails, the store's files are removed meanwhile, the disk works again, and the daemon is stopped."""
    season = Season(tmp_path / "a")
    path = season.folder / "yieldmon.sqlite"
    with running(season.folder) as bench:
        season.harvest(bench)
        season.ticket(bench, 2, 1.0)
        works = os.statvfs(tmp_path)
        monkeypatch.setattr(os, "statvfs", lambda _path: types.SimpleNamespace(f_flag=works.f_flag | os.ST_RDONLY))

        def failing() -> bool:
            """Whether the answer made after one more second says so: the writer finds out beside the engine."""
            bench.play(1, 0.0)
            bench.played()
            return bool(ask(season.folder, "status")["store"]["failing"])

        wait_for(failing, "a store that says that it fails")
        for file in season.folder.glob("yieldmon.sqlite*"):
            file.unlink()
        monkeypatch.undo()
        total_kg = ask(season.folder, "status")["total"]["mass_kg"]
    with Store(path) as store:
        assert [ticket.last_load for ticket in store.tickets()] == [2]
        assert len(store.loads()) == 1 + len(LOADS)
        assert store.state()["engine"]["totals"]["total_kg"] == pytest.approx(total_kg)


NO_SWEEPS = "bus: {transmit_max_age_s: 60}\nsweep: {enabled: false}"
"""Then the parameters' scale is known to 0.8 % by what they state, which a night's drift comes near."""


def posted(folder, night_s: float, factor: float) -> dict[int, float]:
    """Mass measured again over the mass as measured, by load, after a ticket for the first one that is entered so much later."""
    season = Season(folder)
    with running(folder, NO_SWEEPS) as bench:
        season.harvest(bench)
        season.now_s = bench.now_s
    with running(folder, NO_SWEEPS, start_s=season.now_s + night_s) as bench:
        bench.play(3, 0.0)
        bench.played()
        assert season.ticket(bench, 2, factor)["why_no_reference"] == ""

        def measured_again() -> dict[int, float]:
            bench.play(1, 0.0)
            rows = ask(folder, "load", "list")["loads"]
            return {row["number"]: row["posted_mass_kg"] / row["mass_kg"] for row in rows if row["posted_mass_kg"]}

        wait_for(measured_again, "the loads measured again")
        return measured_again()


def test_a_ticket_after_a_night_says_as_much_of_its_day_as_one_at_once(tmp_path) -> None:
    at_once, next_day = posted(tmp_path / "a", 60.0, TRUE), posted(tmp_path / "b", 12.0 * 3600.0, TRUE)
    assert set(next_day) == set(at_once) == {2, 3, 4, 5}
    assert next_day == pytest.approx(at_once, rel=3e-3)
    assert next_day[2] == pytest.approx(TRUE, rel=0.01)


@pytest.mark.parametrize("rests", [True, False], ids=["elevator stands", "elevator runs"])
def test_a_load_that_was_open_while_ignition_and_computer_were_off(tmp_path, rests: bool) -> None:
    """It is complete if no grain can have come meanwhile, also if the next one begins before the first frame."""
    with running(tmp_path) as bench:
        bench.play(14, 0.0)
        bench.play(20, 60.0)
        bench.play(8, 0.0)
        if rests:
            bench.play(4, 0.0, speed_rpm=0.0)
        bench.played()
        number, began_s = bench.status["load"]["number"], bench.now_s + 40_000.0
    with running(tmp_path, start_s=began_s) as bench:
        ask(tmp_path, "load", "start")
        bench.play(4, 0.0, speed_rpm=0.0 if rests else 400.0)
        bench.played()
        loads = {row["number"]: row for row in ask(tmp_path, "load", "list")["loads"]}
        assert loads[number]["ended_s"] is not None
        answer = ask(tmp_path, "ticket", str(number), f"{loads[number]['mass_kg']}kg")
        assert answer["why_no_reference"] == ("" if rests else "not every second of it was measured")

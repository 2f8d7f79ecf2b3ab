"""A ticket or a calibration taken back leaves what it would be without it, whatever came after it."""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
import threading
from dataclasses import replace
from pathlib import Path

import pytest

from tests.service.bench import running, wait_for
from tests.service.test_tickets_after_restart import TRUE, Season, ask
from yieldmon.cli import main as cli
from yieldmon.cli._answers import calibration_undone, ticket_undone
from yieldmon.files import parameter_file
from yieldmon.service.history import remeasuring_thread
from yieldmon.service.logs import recorded
from yieldmon.service.storage.store import Store

RIGHT = ((2, TRUE), (3, 1.003 * TRUE), (4, 0.998 * TRUE))


def enter(season: Season, bench, tickets) -> None:
    for number, factor in tickets:
        bench.play(2, 0.0)
        bench.played()
        assert season.ticket(bench, number, factor)["why_no_reference"] == ""


def last_second(season: Season) -> float:
    """The newest in the store."""
    with contextlib.closing(sqlite3.connect(season.folder / "yieldmon.sqlite")) as database:
        return float(database.execute("SELECT max(time_s) FROM second").fetchone()[0] or 0.0)


SETTLED_S = 10.0


def settle(season: Season, bench) -> None:
    """Until no ticket waits and loads are measured again: one ticket updates with each window.

    For as long on the bus however busy the machine is: the zero follows empty seconds, and with it what is measured next.
    """
    until_s = bench.now_s + SETTLED_S

    def settled() -> bool:
        bench.play(1, 0.0)
        bench.played()
        # In as few seconds as it takes: what comes of each is in the store before the next.
        wait_for(lambda: all(thread.name != "remeasuring" for thread in threading.enumerate()), "loads that are measured again")
        wait_for(lambda: last_second(season) >= bench.rows[-1]["time_s"], "the second's record")
        with Store(season.folder / "yieldmon.sqlite") as store:
            return not bench.daemon.monitor.masses_wait and not store.state()["unfinished_tickets"]

    wait_for(settled, "tickets that update and loads that are measured again")
    assert bench.now_s <= until_s
    bench.play(until_s - bench.now_s, 0.0)
    bench.played()


def left(season: Season, bench) -> dict:
    """What is learnt, and the loads' masses, when all has been done."""
    settle(season, bench)
    rows = ask(season.folder, "load", "list")["loads"]
    with contextlib.closing(sqlite3.connect(season.folder / "yieldmon.sqlite")) as database:
        listed = dict(database.execute("SELECT number, corrected_mass_kg FROM load_corrected"))
    assert {row["number"]: row["corrected_mass_kg"] for row in rows} == pytest.approx(
        {row["number"]: listed[row["number"]] for row in rows}
    )
    return {
        "values": dict(bench.daemon.monitor.estimator.parameters.values),
        "again": {row["number"]: row["posted_mass_kg"] for row in rows if row["posted_mass_kg"] is not None},
        "corrected": {row["number"]: row["corrected_mass_kg"] for row in rows},
    }


def same(found: dict, expected: dict) -> None:
    for key, value in expected.items():
        # A restart is a minute of drift.
        assert found[key] == pytest.approx(value, rel=3e-4, abs=1e-6), key


@pytest.fixture(scope="module")
def never(tmp_path_factory) -> dict:
    season = Season(tmp_path_factory.mktemp("never") / "a")
    with running(season.folder) as bench:
        season.harvest(bench)
        enter(season, bench, RIGHT)
        return left(season, bench)


WRONG = {
    "in the middle": ((RIGHT[0], (5, 1.12 * TRUE), *RIGHT[1:]), (2,)),
    "one before all": (((5, 1.12 * TRUE), *RIGHT), (1,)),
    "two that agree with each other, the first undone first": (((5, 1.3 * TRUE), (4, 1.31 * TRUE), *RIGHT), (1, 2)),
    "one that the others contradict": ((*RIGHT, (5, 1.3 * TRUE)), (4,)),
}


def with_own_file(season: Season) -> str:
    """A configuration with another parameter file, which lies beside it."""
    known = parameter_file.load()
    parameter_file.save(replace(known, values={**known.values, "density": 900.0}), season.folder / "own.yaml")
    return "bus: {transmit_max_age_s: 60}\nparameter_file: own.yaml\n"


@pytest.mark.parametrize("restart", [False, True], ids=["", "after a restart"])
@pytest.mark.parametrize(("tickets", "undone"), WRONG.values(), ids=list(WRONG))
def test_an_undo_leaves_what_never_having_entered_the_ticket_does(tickets, undone, restart, never, tmp_path) -> None:
    season = Season(tmp_path / "a")
    with running(season.folder) as bench:
        season.harvest(bench)
        enter(season, bench, tickets)
        settle(season, bench)
        if not restart:
            for number in undone:
                ask(season.folder, "ticket", "undo", str(number))
                settle(season, bench)
            same(left(season, bench), never)
            return
        season.now_s = bench.now_s
    with running(season.folder, start_s=season.now_s + 60.0) as bench:
        bench.play(3, 0.0)
        bench.played()
        for number in undone:
            ask(season.folder, "ticket", "undo", str(number))
        same(left(season, bench), never)


def test_a_second_undo_takes_back_what_was_learnt_again(tmp_path) -> None:
    """The parameters that a ticket led to when it updated again are its own: an undo of it reaches them."""
    season = Season(tmp_path / "a")
    with running(season.folder) as bench:
        season.harvest(bench)
        before = left(season, bench)
        enter(season, bench, RIGHT)
        answer = ask(season.folder, "ticket", "undo", "1")
        assert (answer["updated_again"], answer["not_updated_again"], answer["sweeps_undone"]) == ([2, 3], [], 0)
        assert ticket_undone(answer) == (
            "ticket 1 undone; calibration 2 to 4 undone, what was in use before is version 5; "
            "the update by tickets 2 and 3 is made again without it"
        )
        settle(season, bench)
        ask(season.folder, "ticket", "undo", "2")
        settle(season, bench)
        ask(season.folder, "ticket", "undo", "3")
        same(left(season, bench), before)


@pytest.mark.parametrize("undo", [("calibrations", "undo", "3"), ("ticket", "undo", "2")], ids=["calibration", "ticket"])
def test_an_undo_that_took_an_update_back_is_not_undone_behind_its_ticket(undo: tuple[str, ...], tmp_path, capsys) -> None:
    """Its parameters would hold what a ticket led to that stands for nothing; the mass entered again brings it back."""
    season = Season(tmp_path / "a")
    with running(season.folder) as bench:
        season.harvest(bench)
        enter(season, bench, RIGHT[:2])
        before = left(season, bench)
        ask(season.folder, *undo)
        settle(season, bench)
        capsys.readouterr()
        with pytest.raises(SystemExit):
            cli.main(["calibrations", "undo", "4", "--socket", str(season.folder / "yieldmon.sock")])
        said = capsys.readouterr().err
        assert "version 4: is an undo; what it took back used ticket 2, which no longer updates the parameters" in said
        words = said.split("`")[1].removeprefix("yieldmon ").split()
        assert ask(season.folder, *words, "--std-dev", f"{0.002 * 1.003 * TRUE * season.masses[3]}kg")["is_reference"]
        same(left(season, bench), before)


def test_a_kill_between_the_undo_and_the_learning_changes_nothing(never, tmp_path) -> None:
    """The store as a kill leaves it right after the answer; the run that goes on from it learns what was left to learn."""
    season = Season(tmp_path / "a")
    killed = tmp_path / "killed"
    killed.mkdir()
    with running(season.folder) as bench:
        season.harvest(bench)
        enter(season, bench, (RIGHT[0], (5, 1.12 * TRUE), *RIGHT[1:]))
        settle(season, bench)
        ask(season.folder, "ticket", "undo", "2")
        for file in Path(season.folder).glob("yieldmon.sqlite*"):
            shutil.copy(file, killed / file.name)
        season.now_s = bench.now_s
    season.folder = killed
    with running(killed, start_s=season.now_s + 60.0) as bench:
        bench.play(3, 0.0)
        bench.played()
        same(left(season, bench), never)


def test_a_ticket_from_before_a_new_parameter_file_leaves_that_file(tmp_path) -> None:
    season = Season(tmp_path / "a")
    with running(season.folder) as bench:
        season.harvest(bench)
        enter(season, bench, RIGHT[:2])
        assert set(left(season, bench)["again"]) == {2, 3, 4, 5}
        season.now_s = bench.now_s
    configured = with_own_file(season)
    with running(season.folder, configured, start_s=season.now_s + 60.0) as bench:
        bench.play(3, 0.0)
        bench.played()
        assert "undone" not in ask(season.folder, "ticket", "undo", "1")
        found = left(season, bench)
        assert found["values"]["density"] == 900.0
        assert found["again"] == {}, "what the second ticket led to rested on the first one as well"
        assert found["corrected"] == pytest.approx({**season.masses, 3: RIGHT[1][1] * season.masses[3]})


def versions_of(season: Season, number: int) -> list[int]:
    """Of the parameters, to which a ticket led and which stand."""
    rows = ask(season.folder, "calibrations", "list")["calibrations"]
    undone = {row["version"] for row in rows if row["state"] == "undone"}
    with Store(season.folder / "yieldmon.sqlite") as store:
        led = [a.document for a in store.actions() if a.kind == "parameters" and number in a.document["tickets"]]
    return [document["version"] for document in led if document["version"] not in undone]


@pytest.mark.parametrize("restart", [False, True], ids=["", "after a restart"])
@pytest.mark.parametrize("place", [0, 1, 3], ids=["first", "in the middle", "last"])
def test_a_calibration_undone_leaves_what_the_others_led_to(place: int, restart: bool, never, tmp_path) -> None:
    """A wrong ticket's update is taken back by its version: the parameters are those of the others alone, and the mass that
    it gives its own load stays until the ticket goes, too."""
    season = Season(tmp_path / "a")
    tickets = [*RIGHT[:place], (5, 1.01 * TRUE), *RIGHT[place:]]
    with running(season.folder) as bench:
        season.harvest(bench)
        enter(season, bench, tickets)
        settle(season, bench)
        version = versions_of(season, place + 1)[0]
        season.now_s = bench.now_s
        if not restart:
            answer = ask(season.folder, "calibrations", "undo", str(version))
            found = left(season, bench)
    if restart:
        with running(season.folder, start_s=season.now_s + 60.0) as bench:
            bench.play(3, 0.0)
            bench.played()
            answer = ask(season.folder, "calibrations", "undo", str(version))
            found = left(season, bench)
    others = list(range(place + 2, len(tickets) + 1))
    assert (answer["silenced"], answer["updated_again"], answer["not_updated_again"]) == ([place + 1], others, [])
    assert found["corrected"][5] == pytest.approx(1.01 * TRUE * season.masses[5], rel=1e-6)
    same({"values": found["values"]}, {"values": never["values"]})
    told = calibration_undone(answer)
    assert (
        f"; ticket {place + 1} still corrects its load and updates no parameters: `yieldmon ticket undo {place + 1}` takes that"
        in told
    )
    assert ("is made again without it" in told) is bool(others)


@pytest.mark.parametrize("undo", ["calibrations", "ticket"])
def test_a_ticket_whose_loads_are_being_measured_again_counts_once_after_an_undo_of_the_next(
    undo: str, never, tmp_path, monkeypatch
) -> None:
    """The next one's version names it as well, though its own stands: it updated the parameters a second time."""
    season, held, of_store = Season(tmp_path / "a"), threading.Event(), remeasuring_thread.of_store
    monkeypatch.setattr(remeasuring_thread, "of_store", lambda *args, **more: of_store(*args, **more) if held.wait(60.0) else {})
    with running(season.folder) as bench:
        season.harvest(bench)
        enter(season, bench, [*RIGHT, (5, 1.01 * TRUE)])
        wait_for(lambda: versions_of(season, 4), "what the last ticket leads to")
        number = versions_of(season, 4)[0] if undo == "calibrations" else 4
        answer = ask(season.folder, undo, "undo", str(number))
        held.set()
        found = left(season, bench)
    assert (answer["updated_again"], answer["not_updated_again"]) == ([], [])
    same({key: found[key] for key in ("values", "again")}, {key: never[key] for key in ("values", "again")})


def test_a_silenced_ticket_stays_silent_when_another_is_taken_back(tmp_path) -> None:
    season, alone = Season(tmp_path / "a"), Season(tmp_path / "alone")
    with running(season.folder) as bench:
        season.harvest(bench)
        enter(season, bench, RIGHT)
        settle(season, bench)
        ask(season.folder, "calibrations", "undo", str(versions_of(season, 2)[0]))
        settle(season, bench)
        undone = ask(season.folder, "ticket", "undo", "1")
        assert (undone["updated_again"], undone["not_updated_again"]) == ([3], [])
        found = left(season, bench)
    with running(alone.folder) as bench:
        alone.harvest(bench)
        enter(alone, bench, RIGHT[2:])
        same({"values": found["values"]}, {"values": left(alone, bench)["values"]})


def test_a_parameter_file_undone_gives_the_tickets_after_it_to_the_one_before(tmp_path) -> None:
    season = Season(tmp_path / "a")
    with running(season.folder) as bench:
        season.harvest(bench)
        enter(season, bench, RIGHT[:1])
        season.now_s = bench.now_s
    configured = with_own_file(season)
    with running(season.folder, configured, start_s=season.now_s + 60.0) as bench:
        bench.play(14, 0.0)
        bench.played()
        ask(season.folder, "load", "start")
        bench.play(5, 90.0)
        bench.played()
        ask(season.folder, "load", "stop")
        bench.play(2, 0.0)
        bench.played()
        season.masses = {row["number"]: row["mass_kg"] for row in ask(season.folder, "load", "list")["loads"]}
        number = max(season.masses)
        assert season.ticket(bench, number, TRUE)["why_no_reference"] == ""
        settle(season, bench)
        rows = ask(season.folder, "calibrations", "list")["calibrations"]
        version = next(row["version"] for row in reversed(rows) if row["origin"] == "file")
        answer = ask(season.folder, "calibrations", "undo", str(version))
        assert (answer["silenced"], answer["updated_again"], answer["not_updated_again"]) == ([], [2], [])
        assert left(season, bench)["values"]["density"] != pytest.approx(900.0, rel=0.01)
        # It updates again from the file before, so it is among those that an undo of it reaches.
        assert ask(season.folder, "ticket", "undo", "2")["undone"] > version


def together(season: Season, bench, *, kill_after: int | None) -> None:
    """All tickets within one second. kill_after: seconds after which the daemon is gone, with what the store had then."""
    for number, factor in RIGHT:
        weighed_kg = factor * season.masses[number]
        ask(season.folder, "ticket", str(number), f"{weighed_kg}kg", "--std-dev", f"{0.002 * weighed_kg}kg")
    if kill_after is None:
        settle(season, bench)
        return
    if kill_after:
        bench.play(kill_after, 0.0)
        bench.played()


def led_to(season: Season) -> list[list[int]]:
    with Store(season.folder / "yieldmon.sqlite") as store:
        return [a.document["tickets"] for a in store.actions() if a.kind == "parameters" and a.document["origin"] == "ticket"]


def test_tickets_entered_together_all_update_one_version_each(never, tmp_path) -> None:
    season = Season(tmp_path / "a")
    with running(season.folder) as bench:
        season.harvest(bench)
        together(season, bench, kill_after=None)
        same(left(season, bench), never)
        first = led_to(season)
        assert first[0] == [1]
        assert [max(numbers) for numbers in first] == [1, 2, 3]
        answer = ask(season.folder, "calibrations", "undo", str(versions_of(season, 1)[0]))
        assert (answer["silenced"], answer["updated_again"]) == ([1], [2, 3])


@pytest.mark.parametrize("seconds", [0, 1, 2, 3])
def test_a_kill_between_tickets_entered_together_loses_none_and_doubles_none(seconds: int, never, tmp_path) -> None:
    season, killed = Season(tmp_path / "a"), tmp_path / "killed"
    killed.mkdir()
    with running(season.folder) as bench:
        season.harvest(bench)
        together(season, bench, kill_after=seconds)
        for file in Path(season.folder).glob("yieldmon.sqlite*"):
            shutil.copy(file, killed / file.name)
        settle(season, bench)
        season.now_s = bench.now_s
    season.folder = killed
    with running(killed, start_s=season.now_s + 60.0) as bench:
        bench.play(3, 0.0)
        bench.played()
        same(left(season, bench), never)
        assert [max(numbers) for numbers in led_to(season)] == [1, 2, 3]


def test_a_ticket_that_is_still_to_update_says_so(tmp_path, capsys) -> None:
    season = Season(tmp_path / "a")
    with running(season.folder) as bench:
        season.harvest(bench)
        together(season, bench, kill_after=0)
        states = [row["state"] for row in ask(season.folder, "ticket", "list")["tickets"]]
        assert states == ["to update the parameters"] * 3
        settle(season, bench)
        states = [row["state"] for row in ask(season.folder, "ticket", "list")["tickets"]]
        assert states == [
            "updated the parameters to version 2",
            "updated the parameters to version 3",
            "updated the parameters to version 4",
        ]
        ask(season.folder, "ticket", "undo", "2")
        assert ask(season.folder, "ticket", "list")["tickets"][1]["state"] == "undone"
        capsys.readouterr()
        assert cli.main(["ticket", "list", "--socket", str(season.folder / "yieldmon.sock")]) == 0
        assert "updated the parameters to version 2" in capsys.readouterr().out


def test_the_owner_is_told_what_a_correction_and_a_second_ticket_leave(tmp_path, capsys) -> None:
    """The wrong crop since days: the closed load shows its own names, the next one is still of the wrong crop; a ticket twice."""
    season = Season(tmp_path / "a")
    with running(season.folder) as bench:
        bench.play(14, 0.0)
        bench.play(4, 80.0)
        bench.play(2, 0.0)
        bench.played()
        for words in (["load", "start", "--crop", "wheat"], ["load", "stop"]):
            ask(season.folder, *words)
            if words[1] == "start":
                bench.play(5, 80.0)
                bench.played()
        bench.play(2, 0.0)
        bench.played()
        socket = ["--socket", str(season.folder / "yieldmon.sock")]
        number = ask(season.folder, "load", "list")["loads"][-1]["number"]
        capsys.readouterr()
        assert cli.main(["load", "correct", str(number), "--crop", "corn", *socket]) == 0
        assert "the next load is still wheat: `yieldmon load start --crop corn` if it is not" in capsys.readouterr().out
        assert ask(season.folder, "status")["load"]["crop"] == "corn"
        mass_kg = ask(season.folder, "load", "list")["loads"][-1]["mass_kg"]
        assert cli.main(["ticket", str(number), f"{mass_kg}kg", *socket]) == 0
        assert "the new ticket replaces" not in capsys.readouterr().err
        assert cli.main(["ticket", str(number), f"{0.4 * mass_kg}kg + {0.6 * mass_kg}kg", *socket]) == 0
        assert ask(season.folder, "load", "list")["loads"][-1]["ticket_mass_kg"] == pytest.approx(mass_kg)
        told = capsys.readouterr().err
        assert "the new ticket replaces ticket 1 (`yieldmon ticket undo 2` if it is for another load; " in told
        assert f"of loads weighed in parts, as on two trucks, enter all in one: `yieldmon ticket {number} 9.1t+8.4t`)" in told
        assert "has no ticket any more" not in told
        first, weighed = f"{number - 1}-{number}", ask(season.folder, "load", "list")["loads"][-1]["ticket_mass_kg"]
        assert cli.main(["ticket", first, f"{2 * weighed}kg", *socket]) == 0
        assert cli.main(["ticket", str(number), f"{weighed}kg", *socket]) == 0
        told = capsys.readouterr().err
        assert "the new ticket replaces ticket 3" in told
        whole = f"`yieldmon ticket {first} MASS`"
        assert f"; load {number - 1} has no ticket any more: enter one for it, or one for all ({whole})" in told
        assert "brings back ticket 2, which ticket 3 replaced" not in told
        assert [row["ticket_id"] for row in ask(season.folder, "load", "list")["loads"][-2:]] == [None, 4]
        _harvest_on(season, bench)
        capsys.readouterr()
        for loads in (f"{number}-{number + 1}", str(number + 1)):
            assert cli.main(["ticket", loads, f"{weighed}kg", *socket]) == 0
        assert "; `yieldmon ticket undo 5` brings back ticket 4, which ticket 5 replaced" in capsys.readouterr().err
        assert cli.main(["ticket", "undo", "5", *socket]) == 0
        assert [row["ticket_id"] for row in ask(season.folder, "load", "list")["loads"][-2:]] == [4, 6]
        ask(season.folder, "load", "start", "--crop", "corn")
        assert ask(season.folder, "status")["load"]["crop"] == "corn"


def _harvest_on(season: Season, bench) -> float:
    """Another load; its mass as measured, kg."""
    ask(season.folder, "load", "start")
    bench.play(4, 80.0)
    bench.play(2, 0.0)
    bench.played()
    ask(season.folder, "load", "stop")
    bench.play(2, 0.0)
    bench.played()
    return ask(season.folder, "load", "list")["loads"][-1]["mass_kg"]


@pytest.fixture(scope="module")
def plain_kg(tmp_path_factory) -> float:
    """Of such a load, where no ticket has updated."""
    season = Season(tmp_path_factory.mktemp("not_updated") / "a")
    with running(season.folder) as bench:
        season.harvest(bench)
        return _harvest_on(season, bench)


@pytest.mark.parametrize("undo", [("ticket", "undo", "1"), ("calibrations", "undo", "2")])
@pytest.mark.parametrize("restart", [False, True])
def test_loads_measured_by_what_was_taken_back_are_measured_again(undo, restart: bool, plain_kg: float, tmp_path) -> None:
    season = Season(tmp_path / "a")
    with contextlib.ExitStack() as stack:
        bench = stack.enter_context(running(season.folder))
        season.harvest(bench)
        enter(season, bench, [(2, 1.3)])
        settle(season, bench)
        measured_kg = _harvest_on(season, bench)
        assert measured_kg > 1.05 * plain_kg, "by the wrong ticket's parameters"
        if restart:
            season.now_s = bench.now_s
            stack.close()
            bench = stack.enter_context(running(season.folder, start_s=season.now_s + 60.0))
            bench.play(2, 0.0)
            bench.played()
        assert ask(season.folder, *undo)["undone"] == 2

        def corrected_kg() -> float:
            bench.play(1, 0.0)
            bench.played()
            return ask(season.folder, "load", "list")["loads"][-1]["corrected_mass_kg"]

        wait_for(lambda: corrected_kg() != measured_kg, "the load measured again")
        assert corrected_kg() == pytest.approx(plain_kg, rel=0.01)


def test_each_ticket_says_what_became_of_it(tmp_path, capsys) -> None:
    """A list of the daemon, and of its store for the page, before and after a restart."""
    season = Season(tmp_path / "a")

    def states() -> list[str]:
        found = [row["state"] for row in ask(season.folder, "ticket", "list")["tickets"]]
        with Store.reading(season.folder / "yieldmon.sqlite") as store:
            assert [row["state"] for row in recorded.ticket_table(store)] == found
        return found

    doubted = "contradicts those before it, counts when another agrees"
    with running(season.folder) as bench:
        season.harvest(bench)
        enter(season, bench, [*RIGHT, (5, 0.8 * TRUE)])
        settle(season, bench)
        assert states() == [
            "updated the parameters to version 2",
            "updated the parameters to version 3",
            "updated the parameters to version 4",
            doubted,
        ]
        season.now_s = bench.now_s
    with running(season.folder, start_s=season.now_s + 60.0) as bench:
        bench.play(2, 0.0)
        bench.played()
        assert states()[3] == doubted
        assert cli.main(["load", "list", "--socket", str(season.folder / "yieldmon.sock")]) == 0
        heads, *rows = (line.split() for line in capsys.readouterr().out.splitlines())
        assert heads[3:7] == ["measured", "kg", "±", "kg"]
        kept = {str(row["number"]): row["std_dev_kg"] for row in ask(season.folder, "load", "list")["loads"]}
        assert [row[4] for row in rows[1:]] == [f"{kept[row[0]]:,.0f}" for row in rows[1:]]
        enter(season, bench, [(5, TRUE)])
        settle(season, bench)
        assert states()[3:] == ["replaced by ticket 5", "updated the parameters to version 5"]
        ask(season.folder, "calibrations", "undo", "5")
        ask(season.folder, "ticket", "undo", "1")
        settle(season, bench)
        found = states()
        assert (found[0], found[4]) == ("undone", "corrects its load, updates no parameters")

"""The cab's keys against a running daemon on a virtual bus: what each asks, what the daemon does, what the screen then says."""

from __future__ import annotations

import pytest

from tests.service.bench import Bench, running, wait_for
from yieldmon.cli._monitor.daemon_link import DaemonLink, aged
from yieldmon.cli._typed_mass import mass
from yieldmon.files.crops import crops, shipped_name
from yieldmon.screen.dialog import Dialog
from yieldmon.service.operator.control import ControlServer
from yieldmon.units import Units


class Cab:
    """A screen without a terminal. reported: a sentence about each request."""

    def __init__(self, bench: Bench, link: DaemonLink) -> None:
        self.bench, self.link, self.reported = bench, link, []
        self.dialog = Dialog(mass, shipped_name, lambda: tuple(crops()))

    def look(self) -> None:
        for news in self.link.news():
            if isinstance(news, str):
                self.reported.append(news)

    def press(self, *keys: str) -> str:
        """Presses keys; waits for what comes of the requests, if there are some, and returns the last, else the question."""
        self.reported = []
        sent = [request for key in keys for request in self.dialog.press(key, self.bench.status, Units())]
        if not sent:
            return self.dialog.prompt
        self.link.request(*sent)

        def answered() -> bool:
            self.look()
            return len(self.reported) == len(sent)

        wait_for(answered, f"what comes of {keys}")
        return self.reported[-1]


def test_every_key_does_on_the_daemon_what_it_asks(tmp_path) -> None:
    with running(tmp_path) as bench, DaemonLink(tmp_path / "yieldmon.sock") as link:
        cab = Cab(bench, link)
        bench.play(14, 0.0)
        bench.played()
        assert cab.press("l", "n", "n") == "nothing was done"
        assert bench.status["load"]["number"] == 1
        assert cab.press("l", "n", "y") == "load 2 started"
        bench.play(5, 60.0)
        bench.played()
        assert bench.status["load"]["number"] == 2
        refusal = cab.press("z", "y")
        assert refusal.startswith("zero: there is grain")
        assert refusal.endswith("`yieldmon zero --force` if it does")
        assert cab.press("t", *"2 50kg", "\r", "y").startswith("ticket for load 2: it is still open")
        assert cab.press("l", "s", "y") == "load 2 complete"
        measured_kg = bench.status["load"]["mass_kg"]
        reported = cab.press("t", *f"2 {1.02 * measured_kg:.4f}kg", "\r", "y")
        alone = "; as the first, it alone sets the scale: weigh a second load"
        assert reported == f"ticket for load 2 taken: +2.0 % against what was measured{alone}"
        assert [mass.load_number for mass in bench.daemon.monitor.reference_masses] == [2]
        reported = cab.press("t", *"1 9kg", "\r", "y")
        assert reported == "ticket for load 1: nothing was measured for it; expected a load with a measured mass"
        assert cab.press("w", "y") == "the sweep begins as soon as flow and speed are steady"
        bench.play(12, 0.0)
        bench.played()
        assert cab.press("z", "y").startswith("measuring the zero")


def masses(bench: Bench) -> tuple[float, dict[int, tuple[str, float]]]:
    loads = bench.daemon.command({"command": "loads"})["loads"]
    return bench.status["total"]["mass_kg"], {load["number"]: (load["crop"], load["mass_kg"]) for load in loads}


def test_a_wrong_crop_is_corrected_from_the_cab_and_taken_back(tmp_path) -> None:
    """The load that is complete, then the one that is open, of which no grain is lost; each undone by the same keys."""
    with running(tmp_path) as bench, DaemonLink(tmp_path / "yieldmon.sock") as link:
        cab = Cab(bench, link)
        bench.play(14, 0.0)
        bench.played()
        assert cab.press("x", "n", *"corn", "\r", "y") == "load 2 started of corn"
        bench.play(5, 60.0)
        bench.played()
        assert cab.press("l", "n", "y") == "load 3 started of corn"
        bench.play(5, 80.0)
        bench.played()
        total_kg, before = masses(bench)
        assert cab.press("x", "c", "\r", *"wheat", "\r", "n") == "nothing was done"
        assert masses(bench) == (total_kg, before)
        reported = cab.press("x", "c", "\r", *"Wheat", "\r", "y")
        assert reported == (
            "load 2: wheat; load 2 recomputed with the parameters of wheat, the seconds are unchanged; "
            "x, c and the former crop take it back"
        )
        assert masses(bench)[1] == {**before, 2: ("wheat", before[2][1])}
        assert cab.press("x", "c", "\r", *"wheat", "\r", "y").startswith("load 2: has 'wheat' already")
        assert cab.press("x", "c", "\r", *"corn", "\r", "y").startswith("load 2: corn; load 2 recomputed")
        assert masses(bench)[1] == before
        reported = cab.press("x", "c", *"3", "\r", *"wheat", "\r", "y")
        assert cab.reported[0] == "load 4 started of wheat"
        assert reported.startswith("load 3: wheat; load 3 recomputed with the parameters of wheat")
        bench.play(5, 80.0)
        bench.played()
        after_kg, loads = masses(bench)
        assert [loads[number][0] for number in (2, 3, 4)] == ["corn", "wheat", "wheat"]
        assert sum(kg for _, kg in loads.values()) == pytest.approx(after_kg, rel=1e-9)
        assert loads[3][1] == pytest.approx(before[3][1], rel=1e-9)
        assert loads[4][1] > 0.0


@pytest.mark.parametrize(
    ("typed", "problem"),
    [("7", "expected"), ("x 9t", "a load's number"), ("7 9 stone", "expected"), ("7 -4t", "expected"), ("", "a load's number")],
)
def test_a_ticket_that_makes_no_sense_is_not_sent(typed: str, problem: str) -> None:
    dialog = Dialog(mass, shipped_name, lambda: tuple(crops()))
    status = {"load": {"number": 7, "mass_kg": 100.0, "open": True}, "sweep": {"state": "idle"}}
    assert [dialog.press(key, status, Units()) for key in ("t", *typed, "\r", "y")] == [()] * (len(typed) + 3)
    assert problem in dialog.prompt


def test_an_answer_that_makes_no_sense_ends_no_screen(tmp_path) -> None:
    """Of a daemon of another version: the screen would go on with the last status."""
    path = tmp_path / "s.sock"
    server = ControlServer(path, None, lambda request: {"age_s": 0.0} if request["command"] == "status" else {"factor": "much"})
    server.start()
    news: list[object] = []

    def heard(count: int) -> bool:
        news.extend(link.news())
        return len(news) >= count

    with DaemonLink(path) as link:
        wait_for(lambda: heard(1), "a status")
        link.request({"command": "ticket"})
        wait_for(lambda: any(isinstance(item, str) for item in news) or heard(99), "what came of the ticket")
        assert "ticket: done; the daemon has another version than this screen" in news
        news.clear()
        wait_for(lambda: heard(1), "another status")
    server.stop()


def test_a_status_that_is_not_renewed_is_stale() -> None:
    status = {"age_s": 0.4, "stale": False}
    assert aged(status, 1.2) == status
    assert aged(status, 30.0) == {"age_s": 30.4, "stale": True}


def test_a_ticket_that_comes_after_its_crop_says_when_it_updates(tmp_path) -> None:
    with running(tmp_path) as bench, DaemonLink(tmp_path / "yieldmon.sock") as link:
        cab = Cab(bench, link)
        bench.play(14, 0.0)
        bench.played()
        assert cab.press("x", "n", *"vete", "\r", "y").startswith("load 2 started of wheat")
        bench.play(5, 60.0)
        bench.played()
        assert cab.press("x", "n", *"majs", "\r", "y").startswith("load 3 started of corn")
        bench.play(2, 0.0)
        bench.played()
        measured_kg = next(load["mass_kg"] for load in bench.status["loads"] if load["number"] == 2)
        reported = cab.press("t", *f"2 {1.02 * measured_kg:.4f}kg", "\r", "y")
        assert reported.startswith("ticket for load 2 taken: +2.0 % against what was measured")
        assert reported.endswith("; it updates the parameters of wheat once that is harvested again")

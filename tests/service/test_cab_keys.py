"""The cab's keys against a running daemon on a virtual bus: what each asks, what the daemon does, what the screen then says."""

from __future__ import annotations

import pytest

from tests.service.bench import Bench, running, wait_for
from yieldmon.cli._cab import DaemonLink, aged
from yieldmon.cli._daemon import mass
from yieldmon.screen.dialog import Dialog
from yieldmon.service.control import ControlServer
from yieldmon.units import Units


class Cab:
    """A screen without a terminal. reported: the last sentence about a request."""

    def __init__(self, bench: Bench, link: DaemonLink) -> None:
        self.bench, self.link, self.dialog, self.reported = bench, link, Dialog(mass), ""

    def look(self) -> None:
        for news in self.link.news():
            if isinstance(news, str):
                self.reported = news

    def press(self, *keys: str) -> str:
        """Presses keys; waits for what comes of the request, if there is one, else returns the question."""
        self.reported = ""
        sent = [self.dialog.press(key, self.bench.status, Units()) for key in keys]
        if not any(sent):
            return self.dialog.prompt
        self.link.request(next(request for request in sent if request))

        def answered() -> bool:
            self.look()
            return bool(self.reported)

        wait_for(answered, f"what comes of {keys}")
        return self.reported


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
        assert cab.press("z", "y").startswith("zero: there is grain")
        assert cab.press("t", *"2 50kg", "\r", "y").startswith("ticket for load 2: it is still open")
        assert cab.press("l", "s", "y") == "load 2 is complete"
        measured_kg = bench.status["load"]["mass_kg"]
        reported = cab.press("t", *f"2 {1.02 * measured_kg:.4f}kg", "\r", "y")
        assert reported == "ticket for load 2 taken: +2.0 % against what was measured"
        assert [anchor.load_number for anchor in bench.daemon.monitor.anchors] == [2]
        reported = cab.press("t", *"1 9kg", "\r", "y")
        assert reported == "ticket for load 1: nothing was measured for it; expected a load with a measured mass"
        assert cab.press("w", "y") == "a sweep begins as soon as the conditions hold"
        bench.play(12, 0.0)
        bench.played()
        assert cab.press("z", "y").startswith("the zero is being taken")


@pytest.mark.parametrize(
    ("typed", "problem"),
    [("7", "expected"), ("x 9t", "a load's number"), ("7 9 stone", "expected"), ("7 -4t", "expected"), ("", "a load's number")],
)
def test_a_ticket_that_makes_no_sense_is_not_sent(typed: str, problem: str) -> None:
    dialog = Dialog(mass)
    status = {"load": {"number": 7, "mass_kg": 100.0, "open": True}, "sweep": {"state": "idle"}}
    assert [dialog.press(key, status, Units()) for key in ("t", *typed, "\r", "y")] == [None] * (len(typed) + 3)
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
        assert "ticket: done; the daemon is of another version than this screen" in news
        news.clear()
        wait_for(lambda: heard(1), "another status")
    server.stop()


def test_a_status_that_is_not_renewed_is_stale() -> None:
    status = {"age_s": 0.4, "stale": False}
    assert aged(status, 1.2) == status
    assert aged(status, 30.0) == {"age_s": 30.4, "stale": True}

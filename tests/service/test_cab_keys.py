"""The cab's keys against a running daemon on a virtual bus: what each asks, what the daemon does, what the screen then says."""

from __future__ import annotations

import pytest

from tests.service.bench import Bench, running, wait_for
from yieldmon.cli._cab import DaemonLink
from yieldmon.cli._daemon import mass
from yieldmon.screen.dialog import Dialog
from yieldmon.units import Units


class Cab:
    """A screen without a terminal. told: the last sentence about a request."""

    def __init__(self, bench: Bench, link: DaemonLink) -> None:
        self.bench, self.link, self.dialog, self.told = bench, link, Dialog(mass), ""

    def look(self) -> None:
        for news in self.link.news():
            if isinstance(news, str):
                self.told = news

    def press(self, *keys: str) -> str:
        """Presses keys; waits for what comes of the request, if there is one, else returns the question."""
        self.told = ""
        sent = [self.dialog.press(key, self.bench.status, Units()) for key in keys]
        if not any(sent):
            return self.dialog.prompt
        self.link.request(next(request for request in sent if request))

        def answered() -> bool:
            self.look()
            return bool(self.told)

        wait_for(answered, f"what comes of {keys}")
        return self.told


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
        told = cab.press("t", *f"2 {1.02 * measured_kg:.4f}kg", "\r", "y")
        assert told == "ticket for load 2 taken: +2.0 % against what was measured"
        assert [anchor.load_number for anchor in bench.daemon.monitor.anchors] == [2]
        told = cab.press("t", *"1 9kg", "\r", "y")
        assert told == "ticket for load 1: nothing was measured for it; expected a load with a measured mass"
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

"""A load that is open as the others are measured again has its turn when it is closed."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.service.bench import START_S, running, wait_for
from tests.service.test_tickets_after_restart import TRUE, Season, ask
from yieldmon.service.storage.batch import Ticket
from yieldmon.service.tickets.action_log import ActionLog
from yieldmon.service.tickets.remeasuring_queue import Remeasuring

OPEN = 6
"""Number of the load that is open while tickets for others come and go."""
CONFIGURATION = "bus: {transmit_max_age_s: 60}\n"


def harvest_on(bench, seconds: int) -> None:
    bench.play(seconds, 60.0)
    bench.played()


def load(folder: Path, number: int) -> dict:
    return next(row for row in ask(folder, "load", "list")["loads"] if row["number"] == number)


def closed(season: Season, bench) -> dict:
    """The open load, stopped and measured again."""
    ask(season.folder, "load", "stop")

    def again() -> bool:
        bench.play(1, 0.0)
        bench.played()
        return load(season.folder, OPEN)["posted_mass_kg"] is not None

    wait_for(again, "the load to be measured again")
    return load(season.folder, OPEN)


@pytest.fixture(scope="module")
def plain(tmp_path_factory) -> float:
    """kg that twenty seconds of this grain are measured to be where no ticket has ever been entered."""
    season = Season(tmp_path_factory.mktemp("plain") / "a")
    with running(season.folder, CONFIGURATION) as bench:
        season.harvest(bench)
        ask(season.folder, "load", "start")
        harvest_on(bench, 20)
        ask(season.folder, "load", "stop")
        return float(load(season.folder, OPEN)["mass_kg"])


@pytest.mark.parametrize("restart", [False, True], ids=["", "after a restart"])
@pytest.mark.parametrize("factor", [0.4, 1.6])
def test_an_undo_reaches_the_open_load_once_it_is_closed(tmp_path, plain: float, factor: float, restart: bool) -> None:
    """Its seconds with what the wrong ticket led to were 60 % off, and stayed so."""
    season = Season(tmp_path / "a")
    with running(season.folder, CONFIGURATION) as bench:
        season.harvest(bench)
        ask(season.folder, "load", "start")
        harvest_on(bench, 4)
        assert season_ticket(season, 5, factor)["is_reference"]
        harvest_on(bench, 12)
        assert "moved the scale by" in bench.status["sweep"]["last_update"]
        assert ask(season.folder, "ticket", "undo", "1")["undone"] == 2
        harvest_on(bench, 4)
        assert bench.status["sweep"]["last_update"] is None, "what is taken back is not what the parameters rest on"
        if not restart:
            found = closed(season, bench)
        season.now_s = bench.now_s
    if restart:
        with running(season.folder, CONFIGURATION, start_s=season.now_s + 60.0) as bench:
            bench.play(3, 0.0)
            bench.played()
            found = closed(season, bench)
    assert found["mass_kg"] != pytest.approx(found["corrected_mass_kg"], rel=0.1)
    # Between the runs the last second is cut.
    assert found["corrected_mass_kg"] == pytest.approx(plain, rel=0.06 if restart else 0.01)


def season_ticket(season: Season, number: int, factor: float) -> dict:
    weighed_kg = factor * season.masses[number]
    return ask(season.folder, "ticket", str(number), f"{weighed_kg}kg", "--std-dev", f"{0.002 * weighed_kg}kg")


def test_what_a_ticket_changes_reaches_the_open_load_once_it_is_closed(tmp_path, plain: float) -> None:
    season = Season(tmp_path / "a")
    with running(season.folder, CONFIGURATION) as bench:
        season.harvest(bench)
        ask(season.folder, "load", "start")
        harvest_on(bench, 16)
        assert season_ticket(season, 5, TRUE)["is_reference"]
        harvest_on(bench, 4)
        found = closed(season, bench)
        assert found["corrected_mass_kg"] == pytest.approx(TRUE * plain, rel=0.01)
        assert found["mass_kg"] < 0.95 * found["corrected_mass_kg"]
        # The ticket goes, and with it what it made of the load.
        ask(season.folder, "ticket", "undo", "1")

        def back() -> bool:
            bench.play(1, 0.0)
            bench.played()
            return load(season.folder, OPEN)["corrected_mass_kg"] == pytest.approx(plain, rel=0.01)

        wait_for(back, "the load to be measured again without the ticket")


def test_the_first_closed_load_is_taken_and_the_newest_of_what_it_is_measured_by_counts() -> None:
    log = ActionLog([Ticket(START_S, 1, 1, 10.0, 10.0, "")], [], START_S, open_loads={7: Remeasuring((1,), 3)})
    assert log.closed_load(7) is None
    assert log.closed_load(None) == (7, Remeasuring((1,), 3))
    log.remeasured((), 5, {}, open_load=7)
    log.remeasured((), 5, {}, open_load=8)
    assert log.closed_load(8) == (7, Remeasuring((), 5))
    log.remeasured((), 6, {7: 1.1}, open_load=8, closed_load=7)
    assert log.remeasuring.open_loads == {8: Remeasuring((), 5)}
    assert log.history.ledger.factors == {7: 1.1}

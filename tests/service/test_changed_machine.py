"""A new chain, sensor or plate in mid-season: what was weighed before it says nothing of what is measured after it."""

from __future__ import annotations

import pytest

from tests.service.bench import running
from tests.service.test_tickets_after_restart import TRUE, Season, ask
from tests.service.test_undo_updates import RIGHT, enter, left, settle
from yieldmon.cli import main as cli
from yieldmon.service.config import configuration
from yieldmon.service.logs.measured_loads import read
from yieldmon.service.logs.recorded import changed_at
from yieldmon.service.storage.store import Store

WEAKER = 0.6
"""Signal of the new sensor over that of the old one."""


def harvest_on(season: Season, bench, signals_mv) -> list[int]:
    """Further loads with these signals, and their numbers."""
    before = set(season.masses)
    for signal_mv in signals_mv:
        ask(season.folder, "load", "start")
        bench.play(5, signal_mv)
        bench.played()
        bench.taken()
    ask(season.folder, "load", "stop")
    bench.play(2, 0.0)
    bench.played()
    season.masses = {row["number"]: row["mass_kg"] for row in ask(season.folder, "load", "list")["loads"]}
    return sorted(set(season.masses) - before)


def true_masses(season: Season, bench, signals_mv) -> dict[int, float]:
    """Further loads by the old sensor of the same machine: what they weigh."""
    numbers = harvest_on(season, bench, signals_mv)
    settle(season, bench)
    again = {row["number"]: row["corrected_mass_kg"] for row in ask(season.folder, "load", "list")["loads"]}
    return {number: again[number] for number in numbers}


def test_tickets_before_it_do_not_pull_those_after_it(tmp_path, capsys) -> None:
    season = Season(tmp_path / "a")
    with running(season.folder) as bench:
        season.harvest(bench)
        enter(season, bench, RIGHT)
        settle(season, bench)
        truth = list(true_masses(season, bench, (60.0, 90.0)).values())
        ask(season.folder, "load", "start")
        bench.play(3, 60.0)
        bench.played()
        capsys.readouterr()
        arguments = ["calibrations", "restart", "--note", "new sensor", "--socket", str(season.folder / "yieldmon.sock")]
        assert cli.main(arguments) == 0
        said = capsys.readouterr().out
        assert said.startswith("calibration starts over with version 5")
        assert "tickets 1, 2 and 3 no longer update it" in said
        assert "load 9 started" in said, "of an open load that both measured nothing could be said"
        assert "± 45 % until you weigh a load" in said
        assert bench.status["parameters"]["scale_error"] == pytest.approx(0.45)
        *_, first, second = harvest_on(season, bench, (60.0 * WEAKER, 90.0 * WEAKER))
        settle(season, bench)
        season.ticket(bench, first, truth[0] / season.masses[first])
        season.ticket(bench, second, truth[1] / season.masses[second])
        settle(season, bench)
        *_, third, fourth = harvest_on(season, bench, (60.0 * WEAKER, 90.0 * WEAKER))
        found = [season.masses[number] for number in (third, fourth)]
        assert found == pytest.approx(truth, rel=0.02), "an average with the old sensor is 20 % less"
        rows = ask(season.folder, "load", "list")["loads"]
        assert all(row["posted_mass_kg"] is not None for row in rows if row["number"] in (2, first)), "each by its own machine"
        season.now_s = bench.now_s
        answer = season.ticket(bench, 4, TRUE)
        assert answer["why_no_reference"] == "load 4 was measured before the machine was changed"
        with Store(season.folder / "yieldmon.sqlite") as store:
            assert changed_at(store) == 5


@pytest.mark.parametrize("restart", [False, True], ids=["", "after a restart"])
def test_nothing_is_kept_of_other_crops_and_an_undo_brings_all_back(tmp_path, restart: bool) -> None:
    season = Season(tmp_path / "a")
    with running(season.folder) as bench:
        season.harvest(bench)
        enter(season, bench, RIGHT[:2])
        settle(season, bench)
        ask(season.folder, "load", "start", "--crop", "wheat")
        (number,) = harvest_on(season, bench, (90.0,))
        season.ticket(bench, number, 1.4)
        settle(season, bench)
        wheat = dict(bench.daemon.monitor.estimator.parameters.values)
        ask(season.folder, "load", "start", "--crop", "corn")
        settle(season, bench)
        corn = dict(bench.daemon.monitor.estimator.parameters.values)
        version = ask(season.folder, "calibrations", "restart")["version"]
        assert dict(bench.daemon.monitor.estimator.parameters.values) != corn
        # The second in which it came was not measured.
        bench.play(3, 0.0)
        season.now_s = bench.now_s
        if not restart:
            check_crops(season, bench, version, corn, wheat)
    if restart:
        with running(season.folder, start_s=season.now_s + 60.0) as bench:
            bench.play(14, 0.0)
            bench.played()
            check_crops(season, bench, version, corn, wheat)


def check_crops(season: Season, bench, version: int, corn: dict, wheat: dict) -> None:
    for crop, before in (("wheat", wheat), ("corn", corn)):
        ask(season.folder, "load", "start", "--crop", crop)
        assert bench.daemon.monitor.estimator.parameters.scale_error == pytest.approx(0.45)
        assert dict(bench.daemon.monitor.estimator.parameters.values) != before
    ask(season.folder, "calibrations", "undo", str(version))
    settle(season, bench)
    assert dict(bench.daemon.monitor.estimator.parameters.values) == pytest.approx(corn)
    ask(season.folder, "load", "start", "--crop", "wheat")
    assert dict(bench.daemon.monitor.estimator.parameters.values) == pytest.approx(wheat)


def test_calibrate_refuses_tickets_of_loads_before_it(tmp_path) -> None:
    season = Season(tmp_path / "a")
    with running(season.folder) as bench:
        season.harvest(bench)
        ask(season.folder, "calibrations", "restart")
        (number,) = harvest_on(season, bench, (90.0,))
        left(season, bench)
        config = configuration.load(bench.daemon.configuration.path)
    found = read([str(season.folder / "yieldmon.sqlite")], config)
    assert {load.name: load.before_change for load in found} == {"2": True, "3": True, "4": True, "5": True, str(number): False}

"""A truck that two combines filled: its ticket less what the other one's monitor has of it."""

from __future__ import annotations

import sys
from math import sqrt

import pytest

from tests.service.bench import running
from tests.service.test_tickets_after_restart import TRUE, Season, ask
from yieldmon.cli import main as cli


def enter(season: Season, bench, load: int, other_kg: float, shown: float, *more: str) -> dict:
    """The ticket of a truck with a load and so much of another combine, whose monitor shows that times `shown`."""
    truck_kg = TRUE * season.masses[load] + other_kg
    words = ("ticket", str(load), f"{truck_kg}kg", "--other", f"{shown * other_kg}kg", *more)
    answer = ask(season.folder, *words)
    bench.play(2, 0.0)
    bench.played()
    return answer


def load_sd(run: Season, bench) -> float:
    """Relative standard deviation of a load's mass by the parameters in use."""
    mass_kg = TRUE * run.masses[2]
    return bench.daemon.monitor.ticket_departure(2, mass_kg, 1e-3 * mass_kg)[1]


@pytest.fixture
def season(tmp_path):
    season = Season(tmp_path / "a")
    with running(season.folder) as bench:
        season.harvest(bench)
        season.now_s = bench.now_s
        yield season, bench


def test_the_first_ticket_of_a_shared_truck_sets_the_scale_as_well_as_its_rest_is_known(season, capsys) -> None:
    run, bench = season
    whole_kg = TRUE * run.masses[4]
    answer = enter(run, bench, 4, whole_kg, 1.0)
    assert answer["is_reference"]
    # 3 % of the other's as much and 0.5 % of the truck are 3.2 % of its own.
    assert answer["own_std_dev_kg"] == pytest.approx(sqrt(0.03**2 + 0.01**2) * whole_kg, rel=1e-6)
    assert answer["weighed_mass_kg"] == pytest.approx(whole_kg, rel=0.01)
    shared = load_sd(run, bench)
    (row,) = [row for row in ask(run.folder, "load", "list")["loads"] if row["number"] == 4]
    assert row["corrected_mass_kg"] == pytest.approx(answer["weighed_mass_kg"])
    run.ticket(bench, 5, TRUE)
    assert load_sd(run, bench) < 0.8 * shared
    assert cli.main(["ticket", "list", "--socket", str(run.folder / "yieldmon.sock")]) == 0
    assert f"{2 * whole_kg:.1f} kg - {whole_kg:.1f} kg" in capsys.readouterr().out


def test_a_load_that_is_known_better_than_the_rest_of_its_truck_is_hardly_moved_and_the_truck_stays_whole(season) -> None:
    run, bench = season
    for number in (2, 3, 5):
        run.ticket(bench, number, TRUE)
    true_kg = TRUE * run.masses[4]
    answer = enter(run, bench, 4, 9.0 * true_kg, 1.03)
    assert answer["own_mass_kg"] == pytest.approx((1.0 - 0.27) * true_kg, rel=1e-6)
    assert answer["weighed_mass_kg"] == pytest.approx(true_kg, rel=0.03)
    assert answer["question"] == ""
    undone = ask(run.folder, "ticket", "undo", "1")
    assert 4 in undone["updated_again"]
    listed = ask(run.folder, "ticket", "list")["tickets"][-1]
    assert listed["truck"] == pytest.approx(
        {"truck_kg": 10.0 * true_kg, "other_kg": 9.27 * true_kg, "other_std_dev_kg": 0.03 * 9.27 * true_kg}
    )


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--other", "1e5kg"), "leaves -"),
        (("--other-std-dev", "3kg"), "is given without other_kg"),
        (("--other", "ten"), "--other"),
    ],
)
def test_what_leaves_nothing_is_refused(season, capsys, words, said) -> None:
    run, _ = season
    socket = ("--socket", str(run.folder / "yieldmon.sock"))
    with pytest.raises(SystemExit) as ended:
        sys.exit(cli.main(["ticket", "4", f"{run.masses[4]}kg", *words, *socket]))
    assert ended.value.code
    assert said in capsys.readouterr().err
    assert ask(run.folder, "ticket", "list")["tickets"] == []

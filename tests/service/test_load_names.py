"""Loads begun under a wrong crop: after the correction they count as if they had been begun under the right one."""

from __future__ import annotations

import pytest

from tests.service.bench import running
from tests.service.test_tickets_after_restart import Season, ask
from tests.service.test_undo_updates import enter, settle
from yieldmon.cli import main as cli

LOADS = ((5, 40.0), (4, 80.0), (5, 110.0))


def harvest(season: Season, bench, crops) -> None:
    """A load of each crop, each with its ticket, then the button for wheat. The first is corn in any case."""
    bench.play(14, 0.0)
    bench.played()
    for crop, (seconds, signal_mv) in zip(crops, LOADS, strict=True):
        ask(season.folder, "load", "start", "--crop", crop)
        bench.play(seconds, signal_mv)
        bench.played()
        bench.taken()
        ask(season.folder, "load", "stop")
        rows = ask(season.folder, "load", "list")["loads"]
        season.masses = {row["number"]: row["mass_kg"] for row in rows}
        if not season.truth.get(rows[-1]["number"]):
            season.truth[rows[-1]["number"]] = (1.1 + 0.003 * len(season.truth)) * rows[-1]["mass_kg"]
        number = rows[-1]["number"]
        enter(season, bench, [(number, season.truth[number] / season.masses[number])])
        settle(season, bench)
    ask(season.folder, "load", "start", "--crop", "wheat")
    settle(season, bench)


def known(season: Season, bench) -> dict:
    """What is learnt of each crop, and the loads."""
    settle(season, bench)
    found = {}
    for crop in ("corn", "wheat"):
        ask(season.folder, "load", "start", "--crop", crop)
        settle(season, bench)
        values = dict(bench.daemon.monitor.estimator.parameters.values)
        # What flow follows is 1 + e: of a small e, nearly nothing is a large share.
        values["gain"] = 1.0 + values.pop("restitution")
        found[crop] = values
    rows = ask(season.folder, "load", "list")["loads"]
    found["loads"] = {row["number"]: row for row in rows}
    return found


def test_a_corrected_crop_is_as_if_it_had_been_chosen(tmp_path, capsys) -> None:
    right, wrong = Season(tmp_path / "right"), Season(tmp_path / "wrong")
    wrong.truth = right.truth = {}
    with running(wrong.folder) as bench:
        harvest(wrong, bench, ("corn", "corn", "corn"))
        assert cli.main(["load", "correct", "3-4", "--crop", "wheat", "--socket", str(wrong.folder / "yieldmon.sock")]) == 0
        said = capsys.readouterr().out
        assert said.startswith("loads 3 to 4: wheat; loads 3 and 4 recomputed with the parameters of wheat")
        assert "the update of another crop by ticket 2 is taken back" in said
        assert said.endswith("the parameters of wheat are updated by tickets 2 and 3\n")
        found = known(wrong, bench)
    with running(right.folder) as bench:
        harvest(right, bench, ("corn", "wheat", "wheat"))
        expected = known(right, bench)
    assert found["corn"] == pytest.approx(expected["corn"], rel=5e-4)
    # Noise goes with the slope of the curve by which a load was measured at first, which corn and wheat have otherwise.
    assert found["wheat"] == pytest.approx(expected["wheat"], rel=1e-3, abs=1e-3)
    for number in (2, 3, 4):
        mine, theirs = found["loads"][number], expected["loads"][number]
        assert (mine["crop"], mine["corrected_mass_kg"]) == (theirs["crop"], pytest.approx(theirs["corrected_mass_kg"], rel=1e-6))
        assert mine["posted_mass_kg"] == pytest.approx(theirs["posted_mass_kg"], rel=1e-3)
        assert mine["corrected_dry_mass_kg"] == pytest.approx(theirs["corrected_dry_mass_kg"], rel=1e-6)


def test_a_crop_that_no_load_has_weighed_makes_no_load_better_known(tmp_path) -> None:
    season = Season(tmp_path / "a")
    with running(season.folder) as bench:
        bench.play(14, 0.0)
        bench.played()
        ask(season.folder, "load", "start", "--crop", "corn")
        bench.play(6, 80.0)
        bench.played()
        bench.taken()
        ask(season.folder, "load", "stop")

        def relative(mass: str, std_dev: str) -> float:
            (row,) = ask(season.folder, "load", "list")["loads"]
            return row[std_dev] / row[mass]

        measured = relative("mass_kg", "std_dev_kg")
        for crop in ("wheat", "corn"):
            ask(season.folder, "load", "correct", "2", "--crop", crop)
            assert relative("corrected_mass_kg", "corrected_std_dev_kg") >= 0.999 * measured, crop


def test_what_a_correction_refuses_is_said_in_one_line(tmp_path, capsys) -> None:
    season = Season(tmp_path / "a")
    season.truth = {}
    with running(season.folder) as bench:
        harvest(season, bench, ("corn", "corn", "corn"))
        ask(season.folder, "ticket", "2-3", "100kg")

        def refusal(*words: str) -> str:
            capsys.readouterr()
            with pytest.raises(SystemExit):
                cli.main(["load", "correct", *words, "--socket", str(season.folder / "yieldmon.sock")])
            (line,) = capsys.readouterr().err.strip().splitlines()
            return line

        assert "is still open" in refusal("5", "--crop", "wheat")
        assert "no such load" in refusal("77", "--crop", "wheat")
        assert "names nothing to correct" in refusal("2")
        assert "has 'corn' already" in refusal("2", "--crop", "corn")
        assert "load 3: is on ticket 4 with other loads; expected all of 2-3, or `yieldmon ticket undo 4` first" in refusal(
            "3-4", "--crop", "wheat"
        )
        rows = ask(season.folder, "load", "list")["loads"]
        assert {row["crop"] for row in rows if row["number"] in LOADED} == {"corn"}
        ask(season.folder, "load", "correct", "2", "--field", "north")
        listed = {row["number"]: row for row in ask(season.folder, "load", "list")["loads"]}
        assert listed[2]["field"] == "north"
        answer = ask(season.folder, "load", "correct", "4-5", "--field", "south")
        assert (answer["field"], answer["crop"], "measured_again" in answer) == ("south", None, False), "the open one too"
        assert ask(season.folder, "load", "start")["field"] == "south", "and those after it"
        rows = ask(season.folder, "load", "list", "--all")["loads"]
        assert [(row["number"], row["field"]) for row in rows[3:6]] == [(4, "south"), (5, "south"), (6, "south")]


LOADED = (2, 3, 4)

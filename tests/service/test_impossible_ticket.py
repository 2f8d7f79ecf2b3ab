"""Tickets in another unit, or without one: what stands for a load is not replaced by a mass that it cannot have."""

from __future__ import annotations

import pytest

from tests.service.bench import running
from tests.service.test_tickets_after_restart import TRUE, Season, ask
from tests.service.test_undo_updates import RIGHT, enter, settle
from yieldmon.cli import main as cli


def test_after_other_tickets_a_mass_five_times_off_is_refused_and_before_them_stated_as_doubtful(tmp_path, capsys) -> None:
    season = Season(tmp_path / "a")
    with running(season.folder) as bench:
        season.harvest(bench)

        def listed() -> dict:
            return {row["number"]: row for row in ask(season.folder, "load", "list")["loads"]}

        def refusal(*words: str) -> str:
            capsys.readouterr()
            with pytest.raises(SystemExit):
                cli.main(["ticket", *words, "--socket", str(season.folder / "yieldmon.sock")])
            (line,) = capsys.readouterr().err.strip().splitlines()
            return line

        # Nothing is known of the machine yet: it may be so far off, and is not corrected as surely as a scale weighs.
        ask(season.folder, "ticket", "5", f"{1000.0 * season.masses[5]}kg")
        row = listed()[5]
        assert row["corrected_std_dev_kg"] == pytest.approx(row["corrected_mass_kg"] - row["mass_kg"], rel=0.01)
        ask(season.folder, "ticket", "undo", "1")
        enter(season, bench, RIGHT)
        settle(season, bench)
        before = listed()
        for words in (("3", f"{0.001 * TRUE * season.masses[3]}kg"), ("3", f"{TRUE * season.masses[3]}t"), ("5", "1,234kg")):
            line = refusal(*words)
            assert f"load {words[0]}: weighs" in line
            assert "by the calibration of loads 2" in line
            assert "calibrations restart" in line
        assert listed() == before
        # A ticket in grams is as far off as one in tonnes; one that is merely another load's counts, and its load is stated so.
        answer = season.ticket(bench, 4, 0.4 * TRUE)
        assert answer["question"]
        settle(season, bench)
        row = listed()[4]
        assert row["corrected_std_dev_kg"] > 0.5 * abs(row["posted_mass_kg"] - row["corrected_mass_kg"])

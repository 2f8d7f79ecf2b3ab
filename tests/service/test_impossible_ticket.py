"""Tickets in another unit, or without one: what stands for a load is not replaced by a mass that it cannot have."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.service.bench import running
from tests.service.test_tickets_after_restart import TRUE, Season, ask
from tests.service.test_undo_updates import RIGHT, enter, settle
from yieldmon.cli import main as cli
from yieldmon.estimation.parameters import SCALE, WEIGHED
from yieldmon.files import parameter_file
from yieldmon.resources import shipped


def refused(season: Season, capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """The line with which a ticket is refused."""
    capsys.readouterr()
    with pytest.raises(SystemExit):
        cli.main(["ticket", *words, "--socket", str(season.folder / "yieldmon.sock")])
    (line,) = capsys.readouterr().err.strip().splitlines()
    return line


def test_after_other_tickets_a_mass_five_times_off_is_refused_and_before_them_stated_as_doubtful(tmp_path, capsys) -> None:
    season = Season(tmp_path / "a")
    with running(season.folder) as bench:
        season.harvest(bench)

        def listed() -> dict:
            return {row["number"]: row for row in ask(season.folder, "load", "list")["loads"]}

        def refusal(*words: str) -> str:
            return refused(season, capsys, *words)

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


@pytest.mark.parametrize("factor", [1000.0, 0.001, 0.1])
def test_a_slip_does_not_replace_the_only_ticket(tmp_path, capsys, factor: float) -> None:
    season = Season(tmp_path / "a")
    with running(season.folder) as bench:
        season.harvest(bench)
        season.ticket(bench, 3, TRUE)
        settle(season, bench)
        before = season.updates()
        line = refused(season, capsys, "3", f"{factor * TRUE * season.masses[3]}kg")
        assert "load 3: weighs" in line
        assert "by the calibration of load 3; expected" in line
        assert "if ticket 1 is wrong, `yieldmon ticket undo 1`" in line
        assert season.updates() == before
        # As wrong as that, the first one can be taken back.
        ask(season.folder, "ticket", "undo", "1")
        assert ask(season.folder, "ticket", "3", f"{factor * TRUE * season.masses[3]}kg")["ticket"] == 2


def test_a_slip_is_refused_where_the_parameter_file_was_weighed_until_a_restart_of_the_calibrations(tmp_path, capsys) -> None:
    season, weighed = Season(tmp_path / "a"), tmp_path / "weighed.yaml"
    known = parameter_file.load(shipped("config/parameters/corn.yaml"))
    parameter_file.save(replace(known, provenance={**known.provenance, SCALE: WEIGHED}), weighed)
    with running(season.folder, f"{{parameter_file: {weighed}, bus: {{transmit_max_age_s: 60}}}}") as bench:
        season.harvest(bench)
        words = ("3", f"{1000.0 * season.masses[3]}kg")
        assert "by the parameters in use, whose scale was weighed; expected" in refused(season, capsys, *words)
        ask(season.folder, "calibrations", "restart")
        assert ask(season.folder, "ticket", *words)["why_no_reference"]

"""A ticket that comes when another crop is harvested updates its own, as one that came in time."""

from __future__ import annotations

import contextlib
import io
import json
from pathlib import Path
from typing import Any

import pytest

from tests.service.bench import START_S, Bench, running, wait_for
from tests.service.test_tickets_after_restart import ask
from yieldmon.cli import main as cli
from yieldmon.files import parameter_file
from yieldmon.files.crops import crop
from yieldmon.service.storage.store import Store

TRUE = 1.12
"""Weighed over measured mass."""
FAR = 1.5
"""Beyond what is known of the crop, so that a ticket updates a curve."""


def said(folder: Path, *words: str) -> tuple[str, str]:
    """What a command prints, and what it warns of."""
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as warned:
        assert cli.main([*words, "--socket", str(folder / "yieldmon.sock")]) == 0
    return out.getvalue(), warned.getvalue()


def harvest(folder: Path, bench: Bench, named: str, seconds: int, signal_mv: float) -> None:
    ask(folder, "load", "start", "--crop", named)
    bench.play(seconds, signal_mv)
    bench.play(1, 0.0)
    bench.played()


def wheat_then_barley(folder: Path, bench: Bench) -> dict[int, float]:
    """Two loads of wheat, 2 and 3, and the first seconds of barley; masses as measured, by load."""
    bench.play(14, 0.0)
    bench.played()
    harvest(folder, bench, "wheat", 5, 60.0)
    harvest(folder, bench, "wheat", 4, 40.0)
    ask(folder, "load", "stop")
    return {row["number"]: row["mass_kg"] for row in ask(folder, "load", "list")["loads"]}


def settled(folder: Path, bench: Bench) -> dict[str, Any]:
    """What is learnt of wheat, and the loads' corrected masses, when all has been done."""

    def done() -> bool:
        bench.play(1, 0.0)
        bench.played()
        with Store(folder / "yieldmon.sqlite") as store:
            return not bench.daemon.monitor.masses_wait and not store.state()["unfinished_tickets"]

    wait_for(done, "tickets that update and loads that are measured again")
    rows = ask(folder, "load", "list")["loads"]
    return {
        "values": dict(bench.daemon.monitor.estimator.parameters.values),
        "corrected": {row["number"]: row["corrected_mass_kg"] for row in rows if row["crop"] == "wheat" and row["mass_kg"] > 0.0},
    }


def in_time(folder: Path) -> dict[str, Any]:
    folder.mkdir()
    with running(folder) as bench:
        masses = wheat_then_barley(folder, bench)
        assert ask(folder, "ticket", "2", f"{TRUE * masses[2]}kg")["waits_for_crop"] == ""
        settled(folder, bench)
        harvest(folder, bench, "barley", 3, 50.0)
        ask(folder, "load", "start", "--crop", "wheat")
        return settled(folder, bench)


@pytest.mark.parametrize("restart", [False, True], ids=["", "after a restart"])
def test_a_ticket_that_comes_after_its_crop_updates_it_when_it_returns(restart: bool, tmp_path: Path) -> None:
    expected = in_time(tmp_path / "in time")
    folder = tmp_path / "late"
    folder.mkdir()
    with running(folder) as bench:
        masses = wheat_then_barley(folder, bench)
        harvest(folder, bench, "barley", 3, 50.0)
        barley = dict(bench.daemon.monitor.estimator.parameters.values)
        told, warned = said(folder, "ticket", "2", f"{TRUE * masses[2]:.3f}kg")
        assert "a reference for wheat" in told
        assert "it updates the parameters of wheat" in told
        assert "`yieldmon load start --crop wheat`" in told
        assert "as the first ticket, it alone sets the scale" in warned
        bench.play(3, 0.0)
        bench.played()
        assert dict(bench.daemon.monitor.estimator.parameters.values) == barley
        assert ask(folder, "ticket", "list")["tickets"][0]["state"] == "to update the parameters of wheat"
        if not restart:
            ask(folder, "load", "start", "--crop", "wheat")
            found = settled(folder, bench)
    if restart:
        with running(folder, start_s=START_S + 60.0) as bench:
            bench.play(14, 0.0)
            bench.played()
            ask(folder, "load", "start", "--crop", "wheat")
            found = settled(folder, bench)
    assert found["corrected"][2] == pytest.approx(TRUE * masses[2], abs=0.001)
    assert found["corrected"][3] == pytest.approx(expected["corrected"][3], rel=1e-3)
    assert found["corrected"][3] > 1.05 * masses[3]
    assert found["values"] == pytest.approx(expected["values"], rel=1e-3)


def test_a_late_ticket_in_another_unit_is_asked_about_and_can_be_taken_back(tmp_path: Path) -> None:
    with running(tmp_path) as bench:
        masses = wheat_then_barley(tmp_path, bench)
        harvest(tmp_path, bench, "barley", 3, 50.0)
        pounds = masses[2] / 0.45359237
        _, warned = said(tmp_path, "ticket", "2", f"{pounds:.3f}kg")
        assert "as if" in warned
        assert "pounds" in warned
        ask(tmp_path, "ticket", "undo", "1")
        wheat = ask(tmp_path, "load", "start", "--crop", "wheat")
        assert wheat["parameters"]["crop"] == "wheat"
        found = settled(tmp_path, bench)
        assert [found["corrected"][number] for number in (2, 3)] == pytest.approx([masses[number] for number in (2, 3)])


def test_late_tickets_that_contradict_each_other_are_asked_about(tmp_path: Path) -> None:
    with running(tmp_path) as bench:
        masses = wheat_then_barley(tmp_path, bench)
        harvest(tmp_path, bench, "barley", 3, 50.0)
        _, warned = said(tmp_path, "ticket", "2", f"{TRUE * masses[2]:.3f}kg")
        assert "it alone sets the scale" in warned
        _, warned = said(tmp_path, "ticket", "3", f"{1.2 * TRUE * masses[3]:.3f}kg")
        assert "20.0 % more than" in warned
        assert "or ticket 1, the only one before it, is wrong (`yieldmon ticket undo 1`)" in warned
        _, warned = said(tmp_path, "ticket", "3", f"{1.02 * TRUE * masses[3]:.3f}kg")
        assert "more than" not in warned
        assert "the new ticket replaces ticket 2" in warned


def test_loads_of_a_crop_that_learnt_a_curve_calibrate_what_is_known_of_that_crop(tmp_path: Path) -> None:
    """The configured parameters, from before the curve, are corn's."""
    with running(tmp_path) as bench:
        masses = wheat_then_barley(tmp_path, bench)
        ask(tmp_path, "ticket", "2", f"{FAR * masses[2]}kg", "--std-dev", f"{0.002 * masses[2]}kg")
        settled(tmp_path, bench)
        assert "load_pattern" in bench.daemon.monitor.estimator.parameters.effects
        harvest(tmp_path, bench, "wheat", 4, 50.0)
        ask(tmp_path, "load", "stop")
        masses[4] = next(row["mass_kg"] for row in ask(tmp_path, "load", "list")["loads"] if row["number"] == 4)
        harvest(tmp_path, bench, "barley", 3, 50.0)
    rows = {2: FAR * masses[2], 3: FAR * masses[3], 4: masses[4]}
    tickets = tmp_path / "tickets.csv"
    tickets.write_text("load,weighed_kg\n" + "".join(f"{number},{kg}\n" for number, kg in rows.items()), encoding="utf-8")
    out, store = tmp_path / "wheat.yaml", str(tmp_path / "yieldmon.sqlite")
    with contextlib.redirect_stdout(io.StringIO()):
        assert cli.main(["calibrate", "--loads", store, "--tickets", str(tickets), "--out", str(out), "--json"]) == 0
    found = parameter_file.load(out)
    assert found.provenance["crop"] == "wheat"
    assert found.values["friction"] == crop("wheat").friction


def test_loads_of_a_crop_with_a_curve_carried_from_another_calibrate_what_measured_them(tmp_path: Path) -> None:
    with running(tmp_path) as bench:
        masses = wheat_then_barley(tmp_path, bench)
        ask(tmp_path, "ticket", "2", f"{FAR * masses[2]}kg", "--std-dev", f"{0.002 * masses[2]}kg")
        settled(tmp_path, bench)
        for signal_mv in (50.0, 80.0):
            harvest(tmp_path, bench, "barley", 25, signal_mv)
        used = bench.daemon.monitor.estimator.parameters
        assert (used.carried_from, "load_pattern" in used.effects) == ("wheat", True)
        ask(tmp_path, "load", "stop")
        masses = {row["number"]: row["mass_kg"] for row in ask(tmp_path, "load", "list")["loads"] if row["crop"] == "barley"}
    tickets = tmp_path / "tickets.csv"
    tickets.write_text(
        "load,weighed_kg\n" + "".join(f"{number},{1.05 * kg}\n" for number, kg in masses.items()), encoding="utf-8"
    )
    with contextlib.redirect_stdout(io.StringIO()) as out:
        cli.main(["calibrate", "--loads", str(tmp_path / "yieldmon.sqlite"), "--tickets", str(tickets), "--json"])
    before_kg = {int(load["load"]): load["before_kg"] for load in json.loads(out.getvalue())["loads"]}
    assert before_kg == pytest.approx(masses, rel=0.01)

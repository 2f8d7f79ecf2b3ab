"""What is stated of a load that is closed, when a ticket shows that it was measured wrong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.service.bench import Bench, running, wait_for
from tests.service.test_ticket_of_another_crop import harvest, said, settled
from tests.service.test_tickets_after_restart import ask
from yieldmon.files import parameter_file

TRUE = 1.2
"""Weighed over measured mass."""


def rows(folder: Path) -> dict[int, dict[str, Any]]:
    return {row["number"]: row for row in ask(folder, "load", "list")["loads"]}


def calibrated(folder: Path) -> str:
    """Configuration of a machine that weighed loads of corn have calibrated."""
    known = replace(parameter_file.load(), provenance={"scale": "weighed", "crop": "corn"})
    parameter_file.save(known, folder / "corn.yaml")
    return "{bus: {transmit_max_age_s: 60}, parameter_file: corn.yaml}"


def two_loads(folder: Path, bench: Bench, crop: str) -> None:
    """Numbers 2 and 3."""
    bench.play(14, 0.0)
    bench.played()
    harvest(folder, bench, crop, 5, 60.0)
    harvest(folder, bench, crop, 4, 60.0)


def weighed(folder: Path, bench: Bench, number: int) -> None:
    ask(folder, "ticket", str(number), f"{TRUE * rows(folder)[number]['mass_kg']}kg")
    settled(folder, bench)


def again(folder: Path, number: int) -> bool:
    return rows(folder)[number]["posted_mass_kg"] is not None


def test_status_states_the_last_load_as_the_list_does(tmp_path: Path) -> None:
    with running(tmp_path, calibrated(tmp_path)) as bench:
        two_loads(tmp_path, bench, "corn")
        ask(tmp_path, "load", "stop")
        assert rows(tmp_path)[3]["std_dev_kg"] < 0.1 * rows(tmp_path)[3]["mass_kg"]
        weighed(tmp_path, bench, 2)
        bench.play(1, 0.0)
        bench.played()
        listed, shown = rows(tmp_path)[3], ask(tmp_path, "status")["load"]
        assert listed["std_dev_kg"] > 0.15 * listed["mass_kg"]
        assert shown["std_dev_kg"] == pytest.approx(listed["std_dev_kg"])
        assert bench.published("MassStdDev")[-1]["LoadMassStdDev"] == pytest.approx(listed["std_dev_kg"], abs=0.01)
        wait_for(lambda: again(tmp_path, 3), "the load measured again")
        bench.play(1, 0.0)
        bench.played()
        text, _ = said(tmp_path, "status")
        assert f"corrected since: {rows(tmp_path)[3]['corrected_mass_kg']:.1f} kg" in text


def test_a_late_ticket_shows_the_scale_of_the_loads_before_another_crop_to_be_off(tmp_path: Path) -> None:
    with running(tmp_path, calibrated(tmp_path)) as bench:
        two_loads(tmp_path, bench, "corn")
        harvest(tmp_path, bench, "barley", 4, 50.0)
        barley = rows(tmp_path)[4]["std_dev_kg"]
        ask(tmp_path, "ticket", "2", f"{TRUE * rows(tmp_path)[2]['mass_kg']}kg")
        assert rows(tmp_path)[3]["std_dev_kg"] < 0.1 * rows(tmp_path)[3]["mass_kg"]
        harvest(tmp_path, bench, "corn", 3, 60.0)
        settled(tmp_path, bench)
        for number in (2, 3):
            load = rows(tmp_path)[number]
            assert load["std_dev_kg"] > 0.15 * load["mass_kg"], number
        assert rows(tmp_path)[4]["std_dev_kg"] == pytest.approx(barley, rel=0.02)


def test_the_second_of_two_updates_says_what_it_changed_itself(tmp_path: Path) -> None:
    """Also where both loads together determine the parameters."""
    with running(tmp_path) as bench:
        two_loads(tmp_path, bench, "barley")
        ask(tmp_path, "load", "stop")
        for number in (2, 3):
            weighed(tmp_path, bench, number)
        listed = ask(tmp_path, "calibrations", "list")["calibrations"]
        moved = [float(row["what"].split("moved the scale by ")[1].split(" %")[0]) for row in listed if row["origin"] == "ticket"]
        assert moved == pytest.approx([20.0, 0.0], abs=2.0)

"""Tickets for loads whose name is that of several machines' loads, and for rows of two machines without names."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from yieldmon.cli import main as cli

from .synthetic import EARTH_M_DEG, ag_leader

BESIDE_DEG = 24 * 6.0 / (EARTH_M_DEG * np.cos(np.radians(40.0)))


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def mapped(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, dict[str, Any], str]:
    code = cli.main(["map", *words, "--out", "unused", "--products", "none", "--json"])
    said = capsys.readouterr()
    return code, json.loads(said.out) if said.out else {}, said.err


def tickets(text: str) -> tuple[str, str]:
    Path("tickets.csv").write_text(text)
    return "--tickets", "tickets.csv"


def two_files() -> None:
    """Load 1 of two machines, whose files carry the same serial number 0, which is none."""
    ag_leader(Path("a.txt"), delay_s=9, seed=5, passes=6)
    ag_leader(Path("b.txt"), delay_s=9, seed=6, passes=6, longitude_deg=-90.0 + BESIDE_DEG)
    for name in ("a.txt", "b.txt"):
        Path(name).write_text(Path(name).read_text().replace(",4711,", ",0,"))


def mixed_rows(path: str, seed: int, name: str = "") -> None:
    """A CSV of two combines that work side by side at the same times, 12 to 40 m apart, rows as they come."""
    rng = np.random.default_rng(seed)
    rows = []
    for machine, (begin, load) in enumerate((("0", "1"), ("1", "1"))):
        east0 = float(begin) * rng.uniform(12.0, 40.0)
        for k in range(600):
            north, lane = (k % 200) * 2.0, k // 200
            east = east0 + lane * 6.0
            north = north if lane % 2 == 0 else 400.0 - north
            rows.append(
                (k + 0.1 * machine, -90.0 + east / (EARTH_M_DEG * np.cos(np.radians(40.0))), 40.0 + north / EARTH_M_DEG,
                 rng.normal(12.0, 0.5), load, f"{name}{machine}")
            )  # fmt: skip
    rows.sort()
    with Path(path).open("w", newline="") as stream:
        out = csv.writer(stream)
        out.writerow(["time(s)", "longitude", "latitude", "flow_kg_s", "width_m", "load", *(["machine"] if name else [])])
        out.writerows(
            [f"{t:.1f}", f"{x:.8f}", f"{y:.8f}", f"{f:.3f}", "6", load, *([m] if name else [])] for t, x, y, f, load, m in rows
        )


def test_a_load_number_that_two_machines_have_is_asked_about(capsys: pytest.CaptureFixture[str]) -> None:
    two_files()
    code, _, said = mapped(capsys, "a.txt", "b.txt", *tickets("load,weighed_kg\n1,5000\n"))
    assert code == 2
    assert "is of 2 machines or files: a.txt, b.txt" in said.splitlines()[-1]


def test_a_ticket_names_the_machine_whose_load_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    two_files()
    _, plain, _ = mapped(capsys, "a.txt", "b.txt")
    measured = {load["load"]: load["measured_kg"] for load in plain["loads"]}
    assert set(measured) == {"L1:<1>, a.txt", "L1:<1>, b.txt"}
    text = (
        f"load,weighed_kg,machine\n1,{1.1 * measured['L1:<1>, a.txt']:.1f},a.txt\n1,{0.9 * measured['L1:<1>, b.txt']:.1f},b.txt\n"
    )
    code, document, said = mapped(capsys, "a.txt", "b.txt", *tickets(text))
    assert code == 0, said
    assert [load["factor"] for load in document["loads"]] == pytest.approx([1.1, 0.9], abs=1e-4)


def test_a_cart_that_two_machines_filled_has_one_ticket(capsys: pytest.CaptureFixture[str]) -> None:
    two_files()
    _, plain, _ = mapped(capsys, "a.txt", "b.txt")
    whole = sum(load["measured_kg"] for load in plain["loads"])
    code, document, said = mapped(capsys, "a.txt", "b.txt", *tickets(f"load,weighed_kg,machine\n1,{1.05 * whole:.1f},all\n"))
    assert code == 0, said
    assert [load["factor"] for load in document["loads"]] == pytest.approx([1.05], abs=1e-4)


def test_of_a_truck_that_a_machine_without_a_file_filled_as_well_the_rest_counts(capsys: pytest.CaptureFixture[str]) -> None:
    ag_leader(Path("a.txt"), delay_s=9, seed=5, passes=6)
    _, document, _ = mapped(capsys, "a.txt", *tickets("load,weighed_kg,sd_kg,other_kg,other_sd_kg\n1,9000,30,4000,40\n"))
    (found,) = document["loads"]
    assert (found["weighed_kg"], found["factor_sd"] * found["measured_kg"]) == pytest.approx((5000.0, 50.0), rel=1e-3)


@pytest.mark.parametrize("other", [False, True], ids=["weighed alone", "shared trucks"])
def test_a_total_holds_the_error_of_one_monitor_in_all_trucks_that_it_shares(
    other: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    two_files()
    rows = ["1,9000,30,4000,400,a.txt", "1,9000,30,4000,300,b.txt"] if other else ["1,5000,30,,,a.txt", "1,5000,40,,,b.txt"]
    text = "\n".join(["load,weighed_kg,sd_kg,other_kg,other_sd_kg,machine", *rows, ""])
    _, document, said = mapped(capsys, "a.txt", "b.txt", *tickets(text))
    mass, expected = document["mass_kg"], (700.0**2 + 30.0**2 + 30.0**2) ** 0.5 if other else 50.0
    assert mass["corrected"] == pytest.approx(10_000.0, rel=1e-3), said
    assert (mass["high"] - mass["low"]) / (2 * 1.96) == pytest.approx(expected, rel=1e-3)


def test_a_ticket_of_no_such_machine_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    two_files()
    code, _, said = mapped(capsys, "a.txt", "b.txt", *tickets("load,weighed_kg,machine\n1,5000,c.txt\n"))
    assert code == 2
    assert "names the machine 'c.txt'; expected one of a.txt, b.txt, or all" in said.splitlines()[-1]


def test_a_ticket_may_name_the_file_with_or_without_its_ending(capsys: pytest.CaptureFixture[str]) -> None:
    two_files()
    Path("b.txt").write_text(Path("b.txt").read_text().replace(",0,", ",4711,"))
    text = "load,weighed_kg,machine\n1,5000,a\n1,6000,{}\n"
    for machine in ("4711", "b", "b.txt"):
        code, document, said = mapped(capsys, "a.txt", "b.txt", *tickets(text.format(machine)))
        assert code == 0, said
        assert {load["load"]: load["weighed_kg"] for load in document["loads"]} == {
            "L1:<1>, a.txt": 5000.0, "L1:<1>, 4711": 6000.0
        }  # fmt: skip


def test_a_load_number_that_begins_two_names_is_asked_about(capsys: pytest.CaptureFixture[str]) -> None:
    """Load 1 of two files, which write the rest of its name in different ways: the ticket went to the last one."""
    two_files()
    Path("b.txt").write_text(Path("b.txt").read_text().replace("L1:<1>", "L1:monday"))
    code, _, said = mapped(capsys, "a.txt", "b.txt", *tickets("load,weighed_kg\n1,5000\n"))
    assert code == 2
    assert "is of 2 machines or files: a.txt, b.txt" in said.splitlines()[-1]
    rows = "load,weighed_kg,machine\n1,5000,a.txt\n1,6000,b.txt\n"
    _, document, said = mapped(capsys, "a.txt", "b.txt", *tickets(rows))
    assert {load["load"]: load["weighed_kg"] for load in document["loads"]} == {"L1:<1>": 5000.0, "L1:monday": 6000.0}, said
    _, document, said = mapped(capsys, "a.txt", "b.txt", *tickets("load,weighed_kg,machine\n1,12000,all\n"))
    assert sum(load["corrected_kg"] for load in document["loads"]) == pytest.approx(12_000.0), said


def test_two_loads_of_one_number_on_one_machine_are_asked_about(capsys: pytest.CaptureFixture[str]) -> None:
    two_files()
    for name, load in (("a.txt", "<1>"), ("b.txt", "monday")):
        Path(name).write_text(Path(name).read_text().replace(",0,", ",4711,").replace("<1>", load))
    code, _, said = mapped(capsys, "a.txt", "b.txt", *tickets("load,weighed_kg\n1,5000\n"))
    assert code == 2
    assert "is of 2 loads of 4711; expected one of 'L1:<1>', 'L1:monday', or the file" in said.splitlines()[-1]
    for word in ("L1:monday,5000,", "monday,5000,", "1,5000,b"):
        code, document, said = mapped(capsys, "a.txt", "b.txt", *tickets(f"load,weighed_kg,machine\n{word}\n"))
        assert code == 0, said
        assert [load["weighed_kg"] for load in document["loads"]] == [None, 5000.0]


def test_one_machine_in_two_files_has_one_load(capsys: pytest.CaptureFixture[str]) -> None:
    ag_leader(Path("monday.txt"), delay_s=9, seed=5, passes=6)
    ag_leader(Path("tuesday.txt"), delay_s=9, seed=6, passes=6, longitude_deg=-90.0 + BESIDE_DEG, start_s=60_000)
    code, document, said = mapped(capsys, "monday.txt", "tuesday.txt", *tickets("load,weighed_kg\n1,12000\n"))
    assert code == 0, said
    assert [load["weighed_kg"] for load in document["loads"]] == [12_000.0]


@pytest.mark.parametrize("seed", range(71, 74))
def test_a_ticket_for_rows_of_two_machines_without_names_is_refused(seed: int, capsys: pytest.CaptureFixture[str]) -> None:
    mixed_rows("both.csv", seed)
    code, _, said = mapped(capsys, "both.csv")
    assert code == 0
    assert "taken apart by their places, as machines 1 (600 rows), 2 (600 rows)" in said
    code, _, said = mapped(capsys, "both.csv", *tickets("load,weighed_kg\n1,7300\n"))
    assert code == 2
    assert "is of 2 machines or files: 1, 2" in said.splitlines()[-1]
    code, document, said = mapped(capsys, "both.csv", *tickets("load,weighed_kg,machine\n1,7300,1\n1,7200,2\n"))
    assert code == 0, said
    assert [load["corrected_kg"] for load in document["loads"]] == pytest.approx([7300.0, 7200.0], abs=0.1)
    code, document, said = mapped(capsys, "both.csv", *tickets("load,weighed_kg,machine\n1,14500,all\n"))
    assert code == 0, said
    assert document["loads"][0]["corrected_kg"] == pytest.approx(14_500.0, abs=0.1)


def test_rows_of_two_machines_with_names_are_two_loads(capsys: pytest.CaptureFixture[str]) -> None:
    mixed_rows("both.csv", 71, "CR")
    code, document, said = mapped(capsys, "both.csv", *tickets("load,weighed_kg,machine\n1,7300,CR0\n1,7200,CR1\n"))
    assert code == 0, said
    assert [load["load"] for load in document["loads"]] == ["1, CR0", "1, CR1"]


@pytest.mark.parametrize("trouble", ["none", "wrong places", "ten paces of standing still", "rows lost"])
def test_one_machine_with_a_poor_receiver_is_no_mixture(trouble: str, capsys: pytest.CaptureFixture[str]) -> None:
    ag_leader(Path("field.txt"), delay_s=9, seed=8, passes=8)
    rows = [row.split(",") for row in Path("field.txt").read_text().splitlines()]
    rng = np.random.default_rng(9)
    if trouble == "wrong places":
        for number in rng.choice(len(rows), 80, replace=False):
            rows[number][0] = f"{float(rows[number][0]) + rng.normal(0.0, 4e-4):.8f}"
    if trouble == "ten paces of standing still":
        for begin in range(50, 650, 60):
            for number in range(begin, begin + 10):
                rows[number][:2] = rows[begin][:2]
    if trouble == "rows lost":
        rows = [row for row in rows if rng.random() > 0.4]
    Path("field.txt").write_text("\n".join(",".join(row) for row in rows))
    code, _, said = mapped(capsys, "field.txt", *tickets("load,weighed_kg\n1,7300\n"))
    assert code == 0, said

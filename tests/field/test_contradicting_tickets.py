"""Tickets of a map that the others contradict: another unit, another load; a load on two tickets."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from yieldmon.cli import main as cli

from .synthetic import EARTH_M_DEG

FLOWS = {1: 8.0, 2: 8.2, 3: 7.9, 4: 8.1, 5: 8.0, 6: 8.3, 7: 7.8}
SECONDS = 100
KG = {load: flow * SECONDS for load, flow in FLOWS.items()}


def harvest(path: Path, machines: str = "a") -> None:
    """Seven loads of each machine in passes of 200 m side by side, a row each second."""
    rows = ["time(s),longitude,latitude,flow_kg_s,width_m,load,machine"]
    for machine in machines:
        for second in range(SECONDS * len(FLOWS)):
            lane, along = divmod(second * 2.0, 200.0)
            north = along if lane % 2 == 0 else 200.0 - along
            east = 6.0 * lane + 300.0 * machines.index(machine)
            place = f"{east / (EARTH_M_DEG * math.cos(math.radians(48.0))):.8f},{48.0 + north / EARTH_M_DEG:.8f}"
            load = second // SECONDS + 1
            rows.append(f"{second},{place},{FLOWS[load]},6,{load},{machine}")
    path.write_text("\n".join(rows))


LB = 1.0 / 0.45359237
CASES = {
    "all right": ([("1", 1.05 * KG[1]), ("2", 1.03 * KG[2]), ("3", 1.04 * KG[3])], set(), "", 1.04),
    "in pounds": (
        [("1", 1.0 * KG[1]), ("2", LB * KG[2]), ("3", 1.01 * KG[3]), ("5", 0.99 * KG[5])], {2},
        "ticket of load 2 weighs 1808 kg, 2.2 times what the other tickets give for it, as if pounds were taken for kilograms",
        1.0,
    ),
    "of another load too": (
        [("1", KG[1]), ("2", KG[2] + KG[3]), ("4", KG[4])], {2}, "ticket of load 2 weighs 1610 kg, 1.96 times what", 1.0
    ),
    "in two parts": ([("1", KG[1]), ("2", 0.4 * KG[2], 1), ("2", 0.6 * KG[2], 2), ("5", KG[5])], set(), "", 1.0),
    "of two": (
        [("1", KG[1]), ("2", LB * KG[2])], set(), "tickets of loads 1 and 2 contradict each other, 1 and 2.2 times what", None
    ),
    "one alone": ([("1", 1.3 * KG[1])], set(), "", 1.3),
    "one alone in pounds": (
        [("1", LB * KG[1])], set(),
        "ticket of load 1 weighs 1764 kg, 2.2 times what was measured, as if pounds were taken for kilograms: are", LB,
    ),
    "one alone by a hundred times": (
        [("1", 0.01 * KG[1])], {1}, "ticket of load 1 weighs 8 kg, where 800 kg were measured: left out; is its unit,", 1.0,
    ),
    "of two by ten times": (
        [("1", 1.02 * KG[1]), ("2", 10.0 * KG[2])], {2}, "ticket of load 2 weighs 8200 kg, where 820 kg were measured: left out;",
        1.02,
    ),
}  # fmt: skip


@pytest.mark.parametrize(("given", "left_out", "said", "factor"), CASES.values(), ids=list(CASES))
def test_a_ticket_that_others_contradict_is_left_out_and_named(
    given: list[tuple[str, float] | tuple[str, float, int]],
    left_out: set[int],
    said: str,
    factor: float | None,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """factor: of the loads that were not weighed."""
    harvest(tmp_path / "h.csv")
    rows = [f"{load},{kg:.3f},{''.join(map(str, part))}" for load, kg, *part in given]
    (tmp_path / "t.csv").write_text("\n".join(["load,weighed_kg,part", *rows]))
    words = ["map", str(tmp_path / "h.csv"), "--tickets", str(tmp_path / "t.csv"), "--out", str(tmp_path / "map")]
    assert cli.main([*words, "--products", "none", "--json"]) == 0
    told = capsys.readouterr()
    found = json.loads(told.out)
    ranges = (name.partition("-") for name, *_ in given)
    ticketed = {load for first, _, last in ranges for load in range(int(first), int(last or first) + 1)}
    assert {int(one["load"]) for one in found["loads"] if one["weighed_kg"] is not None} == ticketed - left_out
    others = [one["factor"] for one in found["loads"] if one["weighed_kg"] is None]
    notes = [note for note in found["notes"] if note.startswith("ticket")]
    assert [note.startswith(said) for note in notes] == [True] * bool(said)
    assert all(f"yieldmon: {note}" in told.err for note in notes)
    mass = found["mass_kg"]
    if factor is None:
        assert mass["high"] - mass["low"] > mass["corrected"]
    else:
        assert others == pytest.approx([factor] * len(others), rel=0.005)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (
            "1,800,\n2,400,\n2,410,",
            "line 4, load: load 2 has a ticket already (line 3); expected one row for each load: the right",
        ),
        (
            "1,800,\n2,400,1\n2,410,",
            "line 4, load: load 2 has a ticket already (line 3); expected one row for each load: the right",
        ),
        ("1,800,\n2,400,1\n2,410,1", "line 4, load: load 2 has its part 1 already (line 3); expected"),
        ("2-4,2400,1\n5,800,\n3,800,2", "line 4, load: load 3 has a ticket already (line 2, as part of 2-4); expected"),
    ],
)
def test_a_load_on_two_rows_is_refused_unless_they_are_its_parts(
    rows: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    harvest(tmp_path / "h.csv")
    (tmp_path / "t.csv").write_text(f"load,weighed_kg,part\n{rows}\n")
    words = ["map", str(tmp_path / "h.csv"), "--tickets", str(tmp_path / "t.csv"), "--out", str(tmp_path / "map")]
    assert cli.main([*words, "--products", "none"]) == 2
    told = capsys.readouterr().err
    assert said in told.splitlines()[-1]


def test_each_machine_has_a_scale_of_its_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """By which its tickets are held against each other, and its other loads corrected."""
    harvest(tmp_path / "h.csv", machines="ab")
    rows = [f"{load},{factor * KG[load]:.3f},{machine}" for machine, factor in (("a", 1.0), ("b", 1.4)) for load in (1, 2, 3)]
    (tmp_path / "t.csv").write_text("load,weighed_kg,machine\n" + "\n".join(rows))
    words = ["map", str(tmp_path / "h.csv"), "--tickets", str(tmp_path / "t.csv"), "--out", str(tmp_path / "map")]
    assert cli.main([*words, "--products", "none", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [note for note in found["notes"] if note.startswith("ticket")] == []
    factors = {one["load"]: one["factor"] for one in found["loads"]}
    assert factors == pytest.approx(
        {f"{n}, {name}": factor for name, factor in (("a", 1.0), ("b", 1.4)) for n in FLOWS}, rel=0.01
    )

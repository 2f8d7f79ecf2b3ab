"""What is said of a ticket that replaces others."""

from __future__ import annotations

import pytest

from yieldmon.cli._answers import tickets_replaced
from yieldmon.cli.main import main


def answer(**more: object) -> dict[str, object]:
    rows = [{"ticket": 1, "first_load": 1, "last_load": 3}, {"ticket": 2, "first_load": 4, "last_load": 5}]
    known = {"ticket": 3, "first_load": 3, "last_load": 4, "replaces": [1, 2], "taken_back": rows, "without_ticket": [1, 2, 5]}
    return known | more


def test_several_tickets_and_loads_are_spoken_of_as_several() -> None:
    said = tickets_replaced(answer())
    assert said.startswith("the new ticket replaces tickets 1 and 2 (`yieldmon ticket undo 3` if it is for another load")
    assert "as if tickets 1 and 2 had never been entered" in said
    assert "; loads 1, 2 and 5 have no ticket any more: enter those, or one for all (`yieldmon ticket 1-5 MASS`)" in said
    assert "; load 2 has no ticket any more: enter one for it, or" in tickets_replaced(answer(without_ticket=[2]))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("9.1+8.4t", "MASS: '9.1+8.4t' has a unit at some parts only; expected a unit at each part, such as 9.1t+8.4t"),
        ("9.1t+", "MASS: '9.1t+' lacks the mass of a part; expected a mass on each side of +, such as 9.1t+8.4t"),
        ("9.1t++8.4t", "MASS: '9.1t++8.4t' lacks the mass of a part; expected a mass on each side of +"),
        ("9t+-3t", "mass: '-3t'; expected kilograms above 0"),
    ],
)
def test_parts_of_a_mass_that_cannot_be_added_are_refused(given: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ticket", "7", given, "--socket", "/nonexistent/yieldmon.sock"]) == 2
    assert said in capsys.readouterr().err

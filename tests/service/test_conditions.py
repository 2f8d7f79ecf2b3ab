"""Conditions with an end: each holds until its own, and no other is touched."""

from __future__ import annotations

import pytest

from yieldmon.service.conditions import Conditions

BOTH = ("bus-off", "dropped")


@pytest.mark.parametrize(
    ("now_s", "said"), [(9.875, ["off", "lost"]), (10.0, ["lost"]), (10.125, ["lost"]), (11.875, ["lost"]), (12.0, [])]
)
def test_a_condition_holds_until_its_end_and_not_at_it(now_s: float, said: list[str]) -> None:
    conditions = Conditions()
    assert conditions.details(now_s, BOTH) == []
    conditions.present("bus-off", 10.0, "off")
    conditions.present("dropped", 12.0, "lost")
    assert conditions.details(now_s, BOTH) == said
    assert conditions.details(now_s, BOTH[::-1]) == said[::-1]
    assert conditions.details(9.0, BOTH) == said, "what has ended once is forgotten"


def test_a_condition_that_is_seen_again_has_its_newest_end_and_words():
    conditions = Conditions()
    conditions.present("dropped", 12.0, "one lost")
    conditions.present("dropped", 10.0, "two lost")
    assert conditions.details(9.0, BOTH) == ["two lost"]
    assert conditions.details(11.0, BOTH) == []


def test_what_is_ended_is_gone_and_what_is_not_asked_about_stays():
    conditions = Conditions()
    conditions.present("bus-off", 10.0, "off")
    conditions.present("late", 1.0, "late")
    assert conditions.details(5.0, BOTH) == ["off"]
    assert conditions.details(0.5, ("late",)) == ["late"]
    conditions.ended("bus-off")
    conditions.ended("bus-off")
    assert conditions.details(5.0, BOTH) == []

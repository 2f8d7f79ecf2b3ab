"""Keys under their former names: read with a note, refused beside the present ones, and nothing else is touched."""

from __future__ import annotations

from typing import Any

import pytest

from yieldmon.errors import InputError
from yieldmon.service.config.former_keys import FORMER_KEYS, FORMER_SECTIONS, with_present_keys


@pytest.mark.parametrize("content", [None, [1], "text", 3, {}, {"sweep": None}, {"sweep": [1]}, {"zero": {"lying_ratio": 1}}])
def test_what_has_no_former_key_comes_back_as_it_is(content: Any) -> None:
    assert with_present_keys(content, "c.yaml") == (content, ())


def test_former_keys_are_read_in_their_place() -> None:
    given = {"sweep": {"enabled": True, "lying_ratio": 0.4, "lying_spread": 0.1, "interval_s": 5}, "zero": {}}
    found, notes = with_present_keys(given, "c.yaml")
    assert list(found["sweep"].items()) == [
        ("enabled", True), ("feedback_plausibility_force_ratio", 0.4), ("feedback_plausibility_flow_spread", 0.1),
        ("interval_s", 5),
    ]  # fmt: skip
    assert len(notes) == 2
    assert list(given["sweep"]) == ["enabled", "lying_ratio", "lying_spread", "interval_s"], "what was given is as it was"


def test_a_former_key_in_a_former_section_is_read_too() -> None:
    found, notes = with_present_keys({"learning": {"anchor_error": 0.01, "enabled": True}}, "c.yaml")
    assert found == {"self_calibration": {"reference_error": 0.01, "enabled": True}}
    assert len(notes) == 2


@pytest.mark.parametrize(("key", "present"), FORMER_KEYS.items())
def test_a_key_under_both_names_is_refused(key: tuple[str, str], present: str) -> None:
    section, former = key
    with pytest.raises(InputError, match=f"c.yaml: {section}.{former}: is given together with {section}.{present}"):
        with_present_keys({section: {former: 1, present: 2}}, "c.yaml")


@pytest.mark.parametrize(("former", "present"), FORMER_SECTIONS.items())
def test_a_former_section_is_read_in_its_place(former: str, present: str) -> None:
    given = {"zero": {}, former: {"keep": 3}, "sweep": {}}
    found, notes = with_present_keys(given, "c.yaml")
    assert list(found.items()) == [("zero", {}), (present, {"keep": 3}), ("sweep", {})]
    assert notes == (f"c.yaml: {former} is now called {present}; the next version reads that alone",)
    assert former in given, "what was given is as it was"
    with pytest.raises(InputError, match=f"c.yaml: {former}: is given together with {present}"):
        with_present_keys({former: {}, present: {}}, "c.yaml")

"""When faults are shown and withdrawn, against the seconds that the reference page gives for each."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from yieldmon.engine.faults import FaultCode
from yieldmon.engine.health import FaultBook, FaultEvent

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "faults.md"
SECONDS = {
    FaultCode(name): (int(shown), int(withdrawn))
    for name, shown, withdrawn in re.findall(r"^\|(\w+)\|\d+/\d+\|(\d+)/(\d+)\|", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
}


def test_the_page_has_every_fault() -> None:
    assert set(SECONDS) == set(FaultCode)


@pytest.mark.parametrize("code", FaultCode)
def test_a_condition_is_shown_and_withdrawn_after_its_seconds_and_not_one_before(code: FaultCode) -> None:
    shown, withdrawn = SECONDS[code]
    book = FaultBook()
    verdicts = [*[True] * (shown - 1), False, *[True] * shown, *[False] * (withdrawn - 1), True, *[False] * withdrawn]
    events = [book.observe(code, float(second), "why", present=verdict) for second, verdict in enumerate(verdicts)]
    begun, ended = 2 * shown - 1, len(verdicts) - 1
    assert [event for event in events if event is not None] == [
        FaultEvent(float(begun), code, True, "why"),
        FaultEvent(float(ended), code, False, "why"),
    ]
    assert (book.occurrences(code), book.since(code), book.detail(code)) == (1, float(ended), "why")
    assert not book.is_active(code)
    assert book.active == ()


CODES = sorted(FaultCode, key=lambda code: code.value)
SOME = st.lists(st.sets(st.sampled_from(CODES[::4])), max_size=14)


@given(SOME, st.lists(st.tuples(st.integers(0, 14), st.sampled_from(CODES[::4]), st.booleans()), max_size=4))
def test_any_sequence_of_verdicts_and_reports(seconds: list[set[FaultCode]], reports: list[tuple[int, FaultCode, bool]]) -> None:
    """A verdict counts once it has lasted; what the service reports holds until it says otherwise."""
    book, active, streak = FaultBook(), dict.fromkeys(CODES, False), dict.fromkeys(CODES, 0)
    reported: set[FaultCode] = set()
    for second, judged in enumerate(seconds):
        for _, code, present in (report for report in reports if report[0] == second):
            book.report(code, present, "reported")
            (reported.add if present else reported.discard)(code)
        events = book.observe_all(dict.fromkeys(judged, ""), float(second))
        changed = []
        for code in CODES:
            present = code in judged or code in reported
            streak[code] = streak[code] + 1 if present != active[code] else 0
            if streak[code] >= SECONDS[code][0 if present else 1]:
                active[code], streak[code] = present, 0
                changed.append((present, code.value))
        assert [(event.active, event.code.value) for event in events] == sorted(changed)
        assert {event.time_s for event in events} <= {float(second)}
        assert set(book.active) == {code for code in CODES if active[code]}
        assert list(book.active) == [code for code in FaultCode if active[code]] or len(book.active) > 1

"""Gaps, overlaps and missing inputs of a record, counted and said."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from tests.service.test_store import second
from yieldmon.service.logs.record_check import RecordCheck, record_lines

WHOLE: dict[str, Any] = {"coverage": 1.0, "moisture_pct": 15.0, "latitude_deg": 50.0, "ground_speed_m_s": 1.5, "mass_kg": 10.0}


def checked(*times_s: float, **changes: Any) -> RecordCheck:
    check = RecordCheck()
    for number, time_s in enumerate(times_s, 1):
        check.take(replace(second(number, time_s=time_s), **{**WHOLE, **changes}))
    return check


def test_a_whole_record_lacks_nothing():
    check = checked(1.0, 2.0, 3.0)
    assert (check.seconds, check.gaps, check.gap_s, check.overlap_s, check.overlap_kg, check.missing) == (3, 0, 0.0, 0.0, 0.0, {})


@pytest.mark.parametrize(
    ("coverage", "gaps", "gap_s"),
    [
        ((1.0, 0.4, 0.0, 0.0, 0.3, 1.0), 1, 3.3),
        ((1.0, 1.0, 0.0, 1.0, 1.0), 1, 1.0),
        ((0.0, 0.3, 0.5, 0.0), 2, 3.2),
        ((1.0, 0.6, 0.6, 1.0), 0, 0.0),
    ],
)
def test_a_gap_is_as_long_as_its_samples_lack(coverage, gaps, gap_s):
    check = RecordCheck()
    for number, share in enumerate(coverage, 1):
        check.take(replace(second(number, time_s=float(number)), **{**WHOLE, "coverage": share}))
    assert (check.gaps, check.gap_s) == (gaps, pytest.approx(gap_s))


@pytest.mark.parametrize(("times_s", "gaps", "gap_s"), [((1.0, 2.4), 0, 0.0), ((1.0, 3.0), 1, 1.0), ((1.0, 3.0, 10.0), 2, 7.0)])
def test_a_stretch_without_seconds_is_a_gap(times_s, gaps, gap_s):
    check = checked(*times_s)
    assert (check.gaps, check.gap_s) == (gaps, pytest.approx(gap_s))


def test_a_recorder_that_is_told_the_date_leaves_no_gap():
    """57 years without samples were said of it."""
    check = checked(1.0, 2.0, 1_790_000_003.0, 1_790_000_004.0)
    assert (check.gaps, check.gap_s) == (0, 0.0)


def test_a_second_with_the_machines_speed_in_place_of_a_measured_one_lacks_it():
    check = RecordCheck()
    for number, faults in enumerate(("", "SpeedMissing", "BusError SpeedMissing", "BusError"), 1):
        check.take(replace(second(number, time_s=float(number)), **WHOLE, faults=faults, elevator_speed_rpm=400.0))
    assert check.missing == {"elevator speed": 0.5}


def test_seconds_without_samples_are_one_gap_and_count_for_nothing_else():
    check = RecordCheck()
    for time_s, coverage in ((1.0, 1.0), (2.0, 0.0), (3.0, 0.0), (4.0, 1.0)):
        check.take(replace(second(1, time_s=time_s), **{**WHOLE, "coverage": coverage}))
    assert (check.seconds, check.gaps, check.gap_s) == (2, 1, 2.0)


def test_seconds_that_come_again_overlap():
    check = checked(1.0, 2.0, 3.0, 2.0, 3.0, 4.0)
    assert (check.overlap_s, check.overlap_kg) == (2.0, 20.0)
    assert checked(1.0, 2.0, 0.5, 1.5).overlap_kg == 20.0


def test_a_clock_that_begins_anew_overlaps_nothing():
    """As one of 32 bits of microseconds does after 4295 s; a second log of the same time does."""
    check = checked(4293.0, 4294.0, 4295.0, 1.0, 2.0, 3.0)
    assert (check.overlap_s, check.gaps) == (0.0, 0)
    for number, time_s in enumerate((4294.0, 4295.0, 4296.0), 7):
        check.take(replace(second(number, time_s=time_s), **WHOLE))
    assert check.overlap_s == 2.0


def test_a_clock_that_is_set_back_each_second_is_checked_in_time():
    assert checked(*(0.1 * number + 3.0 * (number % 2) for number in range(20_000))).overlap_s > 19_000.0


def test_missing_inputs_by_their_share():
    check = checked(1.0, 2.0, moisture_pct=None)
    check.take(replace(second(3, time_s=3.0), **WHOLE))
    check.take(replace(second(4, time_s=4.0), **WHOLE))
    assert check.missing == {"moisture": 0.5}


@pytest.mark.parametrize(
    ("document", "begins"),
    [
        ({}, []),
        ({"gaps": 0, "gap_s": 0.0, "overlap_s": 0.0, "missing": {}}, []),
        ({"gaps": 2, "gap_s": 7.4}, ["gaps: 2, 7 s in all without samples"]),
        ({"overlap_s": 3.0, "overlap_kg": 30.0}, ["overlap: 3 s with 30.0 kg lie before"]),
        ({"missing": {"moisture": 0.25, "position": 1.0}}, ["missing: moisture in 25 % of the seconds, position in 100 % of"]),
    ],
)
def test_it_is_reported_where_there_is_something_to_say(document, begins):
    lines = record_lines(document)
    assert len(lines) == len(begins)
    assert all(line.startswith(begin) for line, begin in zip(lines, begins, strict=True))


def test_grain_before_the_first_zero_is_counted_and_said():
    check = RecordCheck(12.0)
    for number, (pulse_mv, zero_mv) in enumerate(((5.0, None), (300.0, None), (310.0, None), (12.0, None), (300.0, 500.0)), 1):
        row = replace(second(number, time_s=float(number)), **WHOLE)
        check.take(replace(row, pulse_mv=pulse_mv, zero_mv=zero_mv))
    assert check.before_zero == 2
    (line,) = record_lines({"before_zero_s": check.before_zero})
    assert line == "before the first zero: 2 s of grain have no mass; --zero-mv gives a known zero"

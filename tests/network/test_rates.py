"""So many a second on the average and so many at once, against every second's count."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from yieldmon.network.rates import Budget

#: Steps of an eighth of a second, which sums of floats hold exactly.
STEPS = st.lists(st.integers(-4, 24), max_size=30)


@given(per_s=st.sampled_from([1, 2, 8]), at_once=st.sampled_from([1, 3, 10]), steps=STEPS)
def test_a_bucket_that_fills_at_its_rate(per_s: int, at_once: int, steps: list[int]) -> None:
    """A clock that runs back fills nothing and takes nothing away."""
    budget, left, newest, refused = Budget(float(per_s), float(at_once)), Fraction(at_once), None, 0
    now = Fraction(100)
    for step in steps:
        now += Fraction(step, 8)
        if newest is not None:
            left = min(Fraction(at_once), left + max(Fraction(0), now - newest) * per_s)
        newest = now if newest is None else max(newest, now)
        fits = left >= 1
        left -= 1 if fits else 0
        refused += not fits
        assert budget.take(float(now)) is fits
        assert budget.refused == refused


@pytest.mark.parametrize(("later_s", "exceeded"), [(0.0, True), (2.875, True), (3.0, False), (10.0, False)])
def test_what_did_not_fit_is_remembered_for_three_seconds(later_s: float, exceeded: bool) -> None:
    budget = Budget(1.0, 2.0)
    assert not budget.exceeded(50.0)
    assert [budget.take(50.0) for _ in range(3)] == [True, True, False]
    assert budget.exceeded(50.0 + later_s) is exceeded

"""What weighed masses alone say: a history of updates taken again as if its sweeps had updated nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.drift_updates import DriftUpdate, by_weighed_masses, ending
from yieldmon.estimation.self_calibration.steady_drift import Advance, begin, smoothed
from yieldmon.physics.numerics import Array

NAMES = ("friction", "restitution", "density")
START = np.array([0.2, 0.6, 1100.0])
COVARIANCE = np.array([[4e-4, 1e-4, 0.2], [1e-4, 9e-4, 0.1], [0.2, 0.1, 2500.0]])
WALK = np.diag([1e-4, 1e-6, 20.0])
MOVE = np.diag([1.02, 0.99, 1.0])
SWEEP, TICKET = np.array([5.0, 0.0, -1e-3]), np.array([0.7, -0.6, 9e-4])
"""What each reads: a sweep friction and fill, a weighed load their part in the flow."""


def wider(covariance: Array, widening: float, rates: int) -> Array:
    """With the parameters' block, all but the last `rates` states, multiplied."""
    found, count = covariance.copy(), len(covariance) - rates
    found[:count, :count] *= widening
    return found


def history(kinds: Sequence[str], readings: Sequence[float], widening: float = 1.0, rates: int = 0) -> list[DriftUpdate]:
    """Textbook Kalman updates by readings of one direction each, with a deviation of 0.01; a ticket of a widened prior."""
    updates, state, covariance = [], START, COVARIANCE
    for kind, reading in zip(kinds, readings, strict=True):
        after, wide = MOVE @ state, MOVE @ covariance @ MOVE.T + WALK
        advance = Advance(state, covariance, MOVE, after, wide)
        factor = widening if kind == "ticket" else 1.0
        row = TICKET if kind == "ticket" else SWEEP
        prior = wider(wide, factor, rates)
        tie = prior @ row
        gain = tie / (row @ tie + 1e-4)
        state = after + gain * (reading - row @ after)
        covariance = prior - np.outer(gain, tie)
        covariance = 0.5 * (covariance + covariance.T)
        updates.append(DriftUpdate(advance, state, covariance, factor, kind == "sweep", rates))
    return updates


def through(updates: Sequence[DriftUpdate]) -> Array:
    """Smoothed parameters at the beginning of each update's time and at the end."""
    last = updates[-1]
    known = begin(ParameterSet({**dict(zip(NAMES, last.state, strict=True)), "shape_ratio": 2.0}, NAMES, last.covariance), {})
    found = smoothed([update.advance for update in updates], ending(known, last))
    return np.array([[values[name] for name in NAMES] for values in found])


KINDS = ("sweep", "ticket", "sweep", "sweep", "ticket", "sweep")


@pytest.mark.parametrize("rates", [0, 1])
@pytest.mark.parametrize("widening", [1.0, 4.0])
@pytest.mark.parametrize("sweeps_say", [0.0, 3.0])
def test_sweeps_leave_no_trace_whatever_they_said(sweeps_say: float, widening: float, rates: int) -> None:
    """Against the same time in which no sweep was made at all."""
    tickets = [0.85, 0.9]
    said = iter(tickets)
    readings = [next(said) if kind == "ticket" else sweeps_say for kind in KINDS]
    found = by_weighed_masses(history(KINDS, readings, widening, rates))
    covariance, state, expected = COVARIANCE, START, []
    said = iter(tickets)
    for kind in KINDS:
        state, covariance = MOVE @ state, MOVE @ covariance @ MOVE.T + WALK
        if kind == "ticket":
            covariance = wider(covariance, widening, rates)
            gain = covariance @ TICKET / (TICKET @ covariance @ TICKET + 1e-4)
            state = state + gain * (next(said) - TICKET @ state)
            covariance = covariance - np.outer(gain, TICKET @ covariance)
        expected.append((state, covariance))
    for update, (alone, spread) in zip(found, expected, strict=True):
        assert update.state == pytest.approx(alone, rel=1e-6)
        assert update.covariance == pytest.approx(spread, rel=1e-5, abs=1e-12)


def test_smoothing_without_sweeps_is_that_of_the_tickets_alone() -> None:
    readings = [0.9, 0.85, 0.9, 1.4, 0.9, 0.2]
    found = through(by_weighed_masses(history(KINDS, readings)))
    others = through(
        by_weighed_masses(history(KINDS, [9.0 if kind == "sweep" else r for kind, r in zip(KINDS, readings, strict=True)]))
    )
    assert found == pytest.approx(others, rel=1e-5)
    with_sweeps = through(history(KINDS, readings))
    assert np.max(np.abs(with_sweeps[:, 0] / found[:, 0] - 1.0)) > 0.02


def test_a_history_without_sweeps_is_as_given() -> None:
    updates = history(("ticket",) * 3, (0.8, 0.85, 0.9))
    assert by_weighed_masses(updates) == updates


def test_what_came_before_the_first_sweep_stays_as_it_was() -> None:
    updates = history(("ticket", "sweep", "ticket"), (0.8, 0.9, 0.85))
    assert by_weighed_masses(updates)[0] is updates[0]


@pytest.mark.parametrize("kinds", [("sweep",), ("sweep", "sweep", "ticket")])
def test_an_update_that_replaces_what_was_known_replaces_it_here(kinds: tuple[str, ...]) -> None:
    """As weighed loads do that have to find the machine's scale anew: less is known of some directions after it."""
    updates = [*history(kinds, [0.9] * len(kinds)), *history(("ticket",), (0.8,))]
    anew = replace(updates[-1], state=1.3 * START, covariance=9.0 * COVARIANCE)
    found = by_weighed_masses([*updates[:-1], anew])
    assert found[-1].state == pytest.approx(1.3 * START)
    assert found[-1].covariance == pytest.approx(9.0 * COVARIANCE)


def test_one_exact_reading_and_one_parameter_known_already() -> None:
    """A parameter without doubt beside one that the ticket determines all but exactly."""
    known, unsure, swept, narrow = np.diag([0.0, 1.0]), np.array([1.0, 2.0]), np.array([1.0, 7.0]), np.diag([0.0, 0.5])
    move = Advance(unsure, known, np.eye(2), unsure, known)
    updates = [
        DriftUpdate(move, swept, narrow, sweep_alone=True),
        DriftUpdate(Advance(swept, narrow, np.eye(2), swept, narrow), np.array([1.0, 3.0]), np.diag([0.0, 1e-12])),
    ]
    found = by_weighed_masses(updates)
    assert found[0].state == pytest.approx(unsure)
    assert found[1].state == pytest.approx([1.0, 3.0])

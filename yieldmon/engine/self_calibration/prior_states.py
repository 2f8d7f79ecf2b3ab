"""Conversion between sets of parameters and their stored states."""

from __future__ import annotations

from dataclasses import replace
from math import isclose

import numpy as np

from yieldmon.engine.self_calibration.calibrator_state import PriorState
from yieldmon.estimation.parameters import CARRIED, CARRIED_FROM, SCALE, ParameterSet
from yieldmon.physics.numerics import Array

_ROUNDING = 1e-9
"""Relative rounding of stored parameters."""


def as_prior_state(known: ParameterSet) -> PriorState:
    """The state of a set."""
    values, covariance = tuple(known.values.items()), as_tuples(known.covariance)
    return PriorState(known.version, values, known.covariance_names, covariance, known.carried_from)


def as_set(state: PriorState, like: ParameterSet) -> ParameterSet:
    """The set of a state, with the version and provenance of `like`, except a scale carried from another crop."""
    covariance = np.reshape(state.covariance, (len(state.covariance_names),) * 2)
    known = replace(like, values=dict(state.values), covariance_names=state.covariance_names, covariance=covariance)
    if not state.carried_from:
        return known
    return replace(known, provenance={**like.provenance, SCALE: CARRIED, CARRIED_FROM: state.carried_from})


def agrees_with(known: ParameterSet, state: PriorState) -> bool:
    """Whether a set has values and covariance of a state; version and provenance do not count."""
    values = dict(state.values)
    if known.values.keys() != values.keys() or known.covariance_names != state.covariance_names:
        return False
    same = all(isclose(value, values[name], rel_tol=_ROUNDING) for name, value in known.values.items())
    return same and np.allclose(known.covariance, state.covariance, rtol=_ROUNDING, atol=0.0)


def as_tuples(rows: Array) -> tuple[tuple[float, ...], ...]:
    """A matrix as nested tuples."""
    return tuple(tuple(map(float, row)) for row in rows)

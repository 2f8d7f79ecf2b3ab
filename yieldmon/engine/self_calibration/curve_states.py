"""Alignment of states before and after an update that changes which parameters there are: weighed loads may add the weights of
`load_pattern` or the bias of another combine's monitor, or change the form of the impact gain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from yieldmon.engine.self_calibration.calibrator import CalibrationStep
from yieldmon.estimation.load_pattern import NAMES, with_weights
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.self_calibration.steady_drift import Advance, DriftingParameters
from yieldmon.estimation.weighing.density_and_gain import in_form_of
from yieldmon.physics.effects import effect_parameter
from yieldmon.physics.effects.other_monitor import BIAS
from yieldmon.physics.numerics import Array

_ADDED = (*NAMES, BIAS)
"""Parameters that weighed loads may add to a set."""


@dataclass(frozen=True)
class _Change:
    """From states (parameters, then rates) of some names to those of others: select @ state + shift; begun: (m,) variances of
    parameters that appear. The gain 1 + restitution may turn into k2, which is as much, and back."""

    select: Array
    shift: Array
    begun: Array

    def state(self, state: Array) -> Array:
        return np.asarray(self.select @ state + self.shift)

    def covariance(self, covariance: Array) -> Array:
        return np.asarray(self.select @ covariance @ self.select.T + np.diag(self.begun))

    def advance(self, step: Advance) -> Advance:
        return Advance(
            self.state(step.before),
            self.covariance(step.covariance_before),
            self.select @ step.transition @ self.select.T + np.diag((self.begun > 0.0).astype(float)),
            self.state(step.after),
            self.covariance(step.covariance_after),
        )


def _change(have: Sequence[str], names: Sequence[str], rates: int) -> _Change | None:
    """None where the names differ by more than added parameters and the form of the gain."""
    gone, come = ([name for name in these if name not in (*those, *_ADDED)] for these, those in ((have, names), (names, have)))
    if (gone, come) not in (([], []), (["restitution"], ["k2"]), (["k2"], ["restitution"])):
        return None
    of = dict(zip(come, gone, strict=True))
    count = len(names) + rates
    select, shift, begun = np.zeros((count, len(have) + rates)), np.zeros(count), np.zeros(count)
    select[len(names) :, len(have) :] = np.eye(rates)
    for i, name in enumerate(names):
        if of.get(name, name) in have:
            select[i, list(have).index(of.get(name, name))] = 1.0
            shift[i] = 0.0 if name not in of else 1.0 if name == "k2" else -1.0
        else:
            begun[i] = effect_parameter(name).prior_sd ** 2
    return _Change(select, shift, begun)


def aligned(drifting: DriftingParameters, step: Advance, to: ParameterSet) -> tuple[DriftingParameters, Advance]:
    """The state before an update, and the step to it, in the parameter names after the update.

    Parameters
    ----------
    drifting : DriftingParameters
    step : Advance
        That led to it.
    to : ParameterSet
        The set after the update.

    Returns
    -------
    DriftingParameters, Advance
        As given where the names are the same, or differ by more than that.
    """
    known, names = drifting.parameters, to.covariance_names
    have = known.covariance_names
    if have == names or step.after.size != drifting.state.size:
        return drifting, step
    known = in_form_of(known, to)
    change = _change(have, names, len(drifting.names))
    if change is None or not known.values.keys() >= {name for name in names if name not in _ADDED}:
        return drifting, step
    if any(name in NAMES for name in names):
        values = dict(with_weights(known).values)
    else:
        values = {name: value for name, value in known.values.items() if name not in NAMES}
    if BIAS in names:
        values = {BIAS: 0.0, **values}
    joint, count = change.covariance(drifting.joint), len(names)
    rates = tuple("k2" if name == "restitution" and "k2" in names else name for name in drifting.names)
    parameters = replace(known, values=values, covariance_names=names, covariance=joint[:count, :count])
    return DriftingParameters(parameters, rates, drifting.rates, joint), change.advance(step)


def in_names(step: CalibrationStep, names: Sequence[str]) -> CalibrationStep | None:
    """A step with its states in other parameter names; None where these are other parameters, or not known."""
    if tuple(names) == step.names:
        return step
    change = _change(step.names, names, len(step.state) - len(step.names)) if step.names else None
    if change is None:
        return None
    state = tuple(map(float, change.state(np.array(step.state))))
    return replace(step, advance=change.advance(step.advance), state=state, names=tuple(names))

"""States of the parameters in which the weights of `load_pattern` appear or vanish, so that updates before and after follow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from yieldmon.estimation.load_pattern import NAMES, with_weights
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.steady_drift import Advance, DriftingParameters
from yieldmon.physics.effects import effect_parameter


def aligned(drifting: DriftingParameters, step: Advance, to: ParameterSet) -> tuple[DriftingParameters, Advance]:
    """What was known before an update, and how it came, in the names of the set that the update led to.

    Parameters
    ----------
    drifting : DriftingParameters
    step : Advance
        That led to it.
    to : ParameterSet
        With the pattern's weights in its covariance or without them.

    Returns
    -------
    DriftingParameters, Advance
        As given where the names are the same, or differ by more than the pattern's weights.
    """
    known, names = drifting.parameters, to.covariance_names
    have = known.covariance_names
    plain = [name for name in have if name not in NAMES]
    if have == names or plain != [name for name in names if name not in NAMES] or step.after.size != drifting.state.size:
        return drifting, step
    rates = len(drifting.names)
    select = np.zeros((len(names) + rates, len(have) + rates))
    select[len(names) :, len(have) :] = np.eye(rates)
    begun = np.zeros(len(names) + rates)
    for i, name in enumerate(names):
        if name in have:
            select[i, have.index(name)] = 1.0
        else:
            begun[i] = effect_parameter(name).prior_sd ** 2
    new = np.diag((begun > 0.0).astype(float))
    joint = select @ drifting.joint @ select.T + np.diag(begun)
    if any(name in NAMES for name in names):
        values = dict(with_weights(known).values)
    else:
        values = {name: value for name, value in known.values.items() if name not in NAMES}
    count = len(names)
    parameters = replace(known, values=values, covariance_names=names, covariance=joint[:count, :count])
    advanced = Advance(
        select @ step.before,
        select @ step.covariance_before @ select.T + np.diag(begun),
        select @ step.transition @ select.T + new,
        select @ step.after,
        select @ step.covariance_after @ select.T + np.diag(begun),
    )
    return DriftingParameters(parameters, drifting.names, drifting.rates, joint), advanced

"""Density and impact gain: the parameters of a set that weighed loads can determine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from yieldmon.estimation.parameters import ParameterSet

from .load_inputs import LoadSettings

DENSITY = "density"


def widened(prior: ParameterSet, settings: LoadSettings) -> ParameterSet:
    """The set with density and gain at least as uncertain as those of a machine that was never calibrated."""
    names = list(prior.covariance_names)
    names += [n for n in (DENSITY, *gain_names(prior)) if n not in names]
    covariance = prior.covariance_of(names)
    for name, sd in ((DENSITY, settings.density_sd), *((n, settings.gain_sd) for n in gain_names(prior))):
        i = names.index(name)
        size = 1.0 + prior.values[name] if name == "restitution" else abs(prior.values[name])
        covariance[i, i] = max(covariance[i, i], (sd * size) ** 2)
    return replace(prior, covariance_names=tuple(names), covariance=covariance)


def shifted(values: Mapping[str, float], name: str, step: float) -> dict[str, float]:
    """A copy of the values in which one is changed by a step."""
    return {**values, name: values[name] + step}


def gain_names(known: ParameterSet) -> tuple[str, ...]:
    """Names of the parameters that form the impact gain: `restitution`, or `k1` and `k2`."""
    return ("restitution",) if "restitution" in known.values else ("k1", "k2")


def moved(known: ParameterSet, ln_density: float, ln_gain: float) -> ParameterSet:
    """The set with density and impact gain multiplied by exp of the arguments; the covariance stays the same.

    If the restitution would leave the range 0 to 1, the gain is expressed as k2 instead, with k1 = 0.
    """
    values = dict(known.values)
    values[DENSITY] *= float(np.exp(ln_density))
    factor = float(np.exp(ln_gain))
    if "k2" in values:
        return replace(known, values=values | {"k1": values["k1"] * factor, "k2": values["k2"] * factor})
    gain = (1.0 + values["restitution"]) * factor
    if 1.0 <= gain <= 2.0:
        return replace(known, values=values | {"restitution": gain - 1.0})
    del values["restitution"]
    names = tuple("k2" if n == "restitution" else n for n in known.covariance_names)
    return replace(known, values=values | {"k1": 0.0, "k2": gain}, covariance_names=names)


def in_form_of(known: ParameterSet, other: ParameterSet) -> ParameterSet:
    """The set with its impact gain written as k1 and k2 if the other set uses these; unchanged if both have the same form."""
    if "restitution" not in known.values or "k2" not in other.values:
        return known
    values = {name: value for name, value in known.values.items() if name != "restitution"}
    names = tuple("k2" if n == "restitution" else n for n in known.covariance_names)
    return replace(known, values=values | {"k1": 0.0, "k2": 1.0 + known.values["restitution"]}, covariance_names=names)

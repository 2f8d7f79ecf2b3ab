"""Whether an effect of another package is one that calibration and diagnosis can use.

What the tests hold the package's own effects to: a whole description, null values at which nothing changes, hooks that take
arrays, give numbers, and carry the complex numbers by which derivatives are taken.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from yieldmon.errors import InputError

from .effects.effect import PLACES, Effect
from .machine import RPM, Machine
from .numerics import COMPLEX_STEP, AnyArray, Array, real
from .stages import STAGES
from .throw import Throw, ThrowModel

_GRAIN = {"friction": 0.3, "density": 1200.0, "shape_ratio": 2.0, "restitution": 0.6}
_ANGLES_RAD, _MASSES_KG = (np.ravel(a) for a in np.meshgrid(np.radians([58.0, 74.0, 88.0]), [0.3, 1.2]))
_SPEEDS_RAD_S = np.resize([330.0 * RPM, 470.0 * RPM], _ANGLES_RAD.shape)
_STEP = 1e-6
"""Of the size of the parameter, for differences."""
_DERIVATIVE_AGREES = 1e-3
"""Of the largest derivative of the table of conditions."""
_NULL_AGREES = 1e-9


def check(effect: Effect, where: str) -> None:
    """Refuse an effect that could not be fitted.

    Parameters
    ----------
    effect : Effect
    where : str
        Where it comes from, for the message.

    Raises
    ------
    InputError
        Naming the effect and what is wrong with it.
    """
    _check_description(effect, where)
    null = {p.name: p.null for p in effect.parameters}
    typical = {p.name: p.typical for p in effect.parameters}
    with np.errstate(all="ignore"):
        try:
            without = _momentum((), {})
            at_null, at_typical = _momentum((effect,), null), _momentum((effect,), typical)
            slopes = [(_complex_slope(effect, typical, name), _difference_slope(effect, typical, name)) for name in typical]
        except Exception as error:
            hint = "hooks that take and give numpy arrays, of complex numbers too"
            raise InputError(where, f"fails with {type(error).__name__}: {error}", hint) from error
    if not np.all(np.isfinite(at_typical)):
        raise InputError(where, "gives no number at its typical size", f"momenta at {_described(typical)}")
    if not np.allclose(at_null, without, rtol=_NULL_AGREES, atol=0.0):
        raise InputError(where, f"changes the force at {_described(null)}, its null", "the published model there")
    for name, (by_complex, by_difference) in zip(typical, slopes, strict=True):
        most = max(float(np.max(np.abs(by_complex))), float(np.max(np.abs(by_difference))))
        if not np.all(np.abs(by_complex - by_difference) <= _DERIVATIVE_AGREES * most):
            raise InputError(
                where,
                f"loses the derivative by {name}",
                "hooks that keep complex numbers: no abs, maximum, clip or float of what depends on a parameter",
            )


def _check_description(effect: Effect, where: str) -> None:
    parameters = effect.parameters
    if not effect.name.isidentifier():
        raise InputError(where, f"has the name {effect.name!r}", "letters, digits and underscores")
    if effect.stage not in PLACES:
        raise InputError(where, f"has the stage {effect.stage!r}", f"one of {', '.join(PLACES)}")
    if not parameters or len({p.name for p in parameters}) < len(parameters):
        raise InputError(where, "has no parameters, or two of one name", "at least one, each with a name of its own")
    if all(getattr(effect, hook) is None for hook in STAGES):
        raise InputError(where, "changes nothing", f"one of the hooks {', '.join(STAGES)}")
    for p in parameters:
        if not p.name.isidentifier():
            raise InputError(where, f"has a parameter {p.name!r}", "letters, digits and underscores")
        if not (p.lower <= p.null <= p.upper and p.lower <= p.typical <= p.upper and p.typical != p.null):
            sizes = f"null {p.null:g}, typical {p.typical:g}, bounds {p.lower:g} to {p.upper:g}"
            raise InputError(where, f"{p.name} has {sizes}", "null and typical apart, both within the bounds")
        if not p.prior_sd > 0.0:
            raise InputError(where, f"{p.name} has prior_sd {p.prior_sd:g}", "a number above 0")


def _momentum(effects: tuple[Effect, ...], values: Mapping[str, float | complex]) -> AnyArray:
    """kg m/s, at each of the conditions."""
    named = {f"{effect.name}.{name}": np.asarray(value) for effect in effects for name, value in values.items()}
    grain = {name: np.asarray(value) for name, value in _GRAIN.items()}
    moisture_pct = np.full(_ANGLES_RAD.shape, 21.0)
    throw = Throw(ThrowModel(Machine(), effects, 20), _ANGLES_RAD, _SPEEDS_RAD_S, grain | named, moisture_pct)
    return np.broadcast_to(throw.momentum(_MASSES_KG), _ANGLES_RAD.shape)


def _complex_slope(effect: Effect, values: dict[str, float], name: str) -> Array:
    moved = _momentum((effect,), {**values, name: values[name] + 1j * COMPLEX_STEP})
    return np.asarray(np.imag(moved) / COMPLEX_STEP)


def _difference_slope(effect: Effect, values: dict[str, float], name: str) -> Array:
    step = _STEP * (abs(values[name]) or 1.0)
    up, down = (real(_momentum((effect,), {**values, name: values[name] + s})) for s in (step, -step))
    return np.asarray((up - down) / (2.0 * step))


def _described(values: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:g}" for name, value in values.items())

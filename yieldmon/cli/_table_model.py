"""Which model a calibration by a table fits, what of it is free and from where: what the arguments say, checked."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

from yieldmon.cli import _named_files, model_options
from yieldmon.errors import InputError
from yieldmon.estimation.fitting.calibration import default_start
from yieldmon.estimation.fitting.measurements import Measurements
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files.table import Table
from yieldmon.physics.effects import get_effect
from yieldmon.physics.grain import fitted
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import EXCHANGE_FORM, RESTITUTION_FORM, ForwardModel
from yieldmon.physics.stages import GRAVITY_M_S2
from yieldmon.repeats import repeated

_GRAVITY = "gravity.acceleration_m_s2"
_CONSTANTS = (_GRAVITY,)
"""Parameters of effects that no table is to move, unless --free names them."""


@dataclass(frozen=True)
class Asked:
    """What is to be fitted.

    Parameters
    ----------
    model : ForwardModel
    start : dict of str to float
        Of every parameter, fixed ones too.
    free : tuple of str
        Names of those that are fitted.
    prior : ParameterSet, optional
        Of --prior.
    scaled : bool
        The reading is a `response` of unknown scale.
    """

    model: ForwardModel
    start: dict[str, float]
    free: tuple[str, ...]
    prior: ParameterSet | None
    scaled: bool


def asked(args: argparse.Namespace, machine: Machine, data: Table, rows: Measurements, impact: str | None) -> Asked:
    """What the arguments ask for; impact: "restitution" or "exchange", None: what suits the reading. Raises InputError."""
    prior = _named_files.parameters(args.prior, "--prior") if args.prior is not None else None
    effects = _names(args.effects)
    if not effects and prior is not None:
        # The prior's belong to the model: left out, its other parameters would stand for them.
        effects = list(prior.effects)
    scaled = data.reading == model_options.RESPONSE and args.response_scale is None
    impact = impact or ("exchange" if scaled else "restitution")
    if scaled and impact == "restitution":
        raise InputError(
            "--impact restitution", "cannot represent the scale of a `response`", "--impact exchange, or --response-scale S"
        )
    model = _model(machine, effects)
    fixed = model_options.assignments(args.fix, "--fix")
    for name, value in fixed.items():
        model_options.check_parameter(name, value, "--fix")
    given = dict(prior.values) if prior is not None else {}
    start = default_start(model, rows, RESTITUTION_FORM if impact == "restitution" else EXCHANGE_FORM, given | fixed)
    unknown = [name for name in fixed if name not in start]
    if unknown:
        raise InputError("--fix", f"{unknown[0]} is not in this model", f"one of {', '.join(start)}")
    held = {n for n in model.effect_parameters if n in _CONSTANTS or (not args.effects and n in given)}
    if _GRAVITY in held and _GRAVITY not in given.keys() | fixed.keys():
        start[_GRAVITY] = GRAVITY_M_S2
    if args.free is not None:
        free = _named_free(args.free, start, fixed)
    else:
        free = [n for n in (*fitted(impact), *model.effect_parameters) if n not in fixed and n not in held]
    if not free:
        raise InputError("--fix", "leaves nothing to fit", "at least one parameter that is free")
    return Asked(model, start, tuple(free), prior, scaled)


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _model(machine: Machine, effects: Sequence[str]) -> ForwardModel:
    try:
        for name in effects:
            get_effect(name)
        return ForwardModel(machine, effects)
    except ValueError as error:
        raise InputError("--effects", str(error)) from error


def _named_free(text: str, start: dict[str, float], fixed: dict[str, float]) -> list[str]:
    """The parameters that --free names."""
    free = _names(text)
    if twice := repeated(free):
        raise InputError("--free", f"names {twice[0]} twice", "each parameter once")
    wrong = [name for name in free if name not in start]
    if wrong or set(free) & set(fixed):
        raise InputError("--free", f"is {text!r}", f"some of {', '.join(name for name in start if name not in fixed)}")
    return free


def bounds(texts: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Search ranges by parameter name, from texts NAME=LOW:HIGH. Raises InputError."""
    out = {}
    for given in texts:
        name, _, limits = given.partition("=")
        low, colon, high = limits.partition(":")
        if not colon:
            raise InputError("--bounds", f"is {given!r}", "NAME=LOW:HIGH")
        first, last = model_options.finite(low, f"--bounds {name}"), model_options.finite(high, f"--bounds {name}")
        if first >= last:
            raise InputError(f"--bounds {name}", f"is {limits}", "the lower end first")
        model_options.check_parameter(name, first, "--bounds")
        model_options.check_parameter(name, last, "--bounds")
        out[name] = (first, last)
    return out

"""Arguments that several verbs share: machine, parameters, changes to them, lists of numbers."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yieldmon.cli import _named_files, _notes
from yieldmon.errors import InputError
from yieldmon.estimation.fitting.measurements import Measurements
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files import parameter_file
from yieldmon.files.checked import load_mapping
from yieldmon.files.parameter_file import GRAIN_LIMITS
from yieldmon.files.speeds import LEAST_SPEED_RPM
from yieldmon.files.table import Table
from yieldmon.physics.effects import effect_parameter, get_effect
from yieldmon.physics.grain import GRAIN
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import Conditions
from yieldmon.physics.numerics import Array
from yieldmon.resources import shipped

RESPONSE = "response"
"""response_unit of parameters fitted to a table of `response`; N, and kg m/s per paddle, go together as "N"."""


def add_model_arguments(parser: argparse.ArgumentParser) -> None:
    """--machine, --params and --set."""
    parser.add_argument("--machine", metavar="FILE", help="file or shipped name (default: sprocket-8)")
    parser.add_argument("--params", metavar="FILE", help=f"file or shipped name (default: {Path(parameter_file.DEFAULT).stem})")
    add_set_argument(parser)


def add_set_argument(parser: argparse.ArgumentParser) -> None:
    """--set name=value, any number of times."""
    parser.add_argument(
        "--set",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        help="change one parameter, e.g. friction=0.3 or gravity.acceleration_m_s2=9.81 (adds the effect)",
    )


def machine(args: argparse.Namespace) -> Machine:
    """The machine that the arguments name."""
    return _named_files.machine(args.machine)


def parameters(args: argparse.Namespace) -> ParameterSet:
    """The parameters that the arguments name, as they hold on a machine, with --set applied."""
    path = _named_files.parameters_path(args.params) if args.params else shipped(parameter_file.DEFAULT)
    return with_values(parameter_file.on_a_machine(parameter_file.load(path), machine(args)), assignments(args.set, "--set"))


def note_unknown_errors(known: ParameterSet) -> None:
    """On standard error, what of the parameters' error is assumed: the scale's, or the model's own."""
    if known.scale_error > 0.0:
        _notes.note(_notes.not_calibrated(known.scale_error, known.carried_from))
    if known.curve is None and known.model_error is None and known.own_error > 0.0:
        _notes.note(
            "the parameters do not state the model's own error (model_error): "
            f"{100.0 * known.own_error:g} % of the force is assumed"
        )


def assignments(texts: Iterable[str], option: str) -> dict[str, float]:
    """name=value texts as a mapping. Raises InputError for a bad one."""
    out: dict[str, float] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise InputError(option, f"is {text!r}", "NAME=VALUE")
        if name.strip() in out:
            raise InputError(option, f"names {name.strip()} twice", "each parameter once")
        out[name.strip()] = finite(value, f"{option} {name.strip()}")
    return out


def finite(text: str, where: str) -> float:
    """A finite number. Raises InputError."""
    try:
        number = float(text)
    except ValueError:
        number = np.nan
    if not isfinite(number):
        raise InputError(where, f"is {text.strip()!r}", "a finite number")
    return number


def check_parameter(name: str, value: float, where: str) -> None:
    """Raises InputError for a name that does not exist or a value outside its limits."""
    if "." in name:
        try:
            known = effect_parameter(name)
        except ValueError as error:
            raise InputError(where, str(error)) from error
        unit, low, high = known.unit, known.lower, known.upper
    elif name in GRAIN_LIMITS:
        unit, low, high = GRAIN_LIMITS[name]
    else:
        raise InputError(where, f"{name} is not a parameter", f"one of {', '.join(GRAIN_LIMITS)} or effect.parameter")
    if not low <= value <= high:
        raise InputError(f"{where} {name}", f"is {value:g}", f"{low:g} to {high:g} {unit}".rstrip())


def with_values(known: ParameterSet, changes: Mapping[str, float]) -> ParameterSet:
    """The set with some values replaced; they count as exactly known.

    A name of an effect that the set lacks adds that effect, its other parameters without effect; restitution replaces k1 and k2
    and the other way round. Raises InputError.
    """
    if not changes:
        return known
    values = dict(known.values)
    for name, value in changes.items():
        check_parameter(name, value, "--set")
        form = GRAIN[name].form if name in GRAIN else ""
        if form:
            values = {k: v for k, v in values.items() if k not in GRAIN or GRAIN[k].form in ("", form)}
        elif "." in name:
            effect = name.partition(".")[0]
            for parameter in get_effect(effect).parameters:
                values.setdefault(f"{effect}.{parameter.name}", parameter.null)
        values[name] = value
    kept = tuple(n for n in known.covariance_names if n in values and n not in changes)
    try:
        return replace(known, values=values, covariance_names=kept, covariance=known.covariance_of(kept))
    except ValueError as error:
        raise InputError("--set", str(error)) from error


def check_moisture(moisture_pct: float | None) -> None:
    """Raises InputError for a --moisture that is none."""
    if moisture_pct is not None and not 0.0 <= moisture_pct <= 100.0:
        raise InputError("--moisture", f"is {moisture_pct:g}", "0 to 100 %")
    if moisture_pct is not None and 0.0 < moisture_pct < 1.0:
        raise InputError(
            "--moisture", f"is {moisture_pct:g}", f"per cent; this looks like a fraction: {100.0 * moisture_pct:g} %"
        )


def check_each(good: np.ndarray, values: np.ndarray, option: str, expected: str) -> None:
    """Raises InputError naming the first of an option's values that is not good."""
    if not np.all(good):
        raise InputError(option, f"is {values[np.argmin(good)]:g}", expected)


def check_operating_points(flow_kg_s: np.ndarray, angle_deg: np.ndarray, speed_rpm: np.ndarray) -> None:
    """Raises InputError for a --mass-flow, --plate-angle or --elevator-speed at which no model says anything."""
    check_each(flow_kg_s >= 0.0, flow_kg_s, "--mass-flow", "0 kg/s or more")
    check_each((angle_deg > 0.0) & (angle_deg < 180.0), angle_deg, "--plate-angle", "0 to 180 deg, both excluded")
    check_each((speed_rpm > 0.0) & (speed_rpm < np.inf), speed_rpm, "--elevator-speed", "above 0 rpm")
    slow = f"{LEAST_SPEED_RPM:g} rpm or more at the upper shaft: slower paddles do not throw"
    check_each(speed_rpm >= LEAST_SPEED_RPM, speed_rpm, "--elevator-speed", slow)
    if float(angle_deg.max()) <= np.pi:
        raise InputError("--plate-angle", f"has nothing above {angle_deg.max():g}", "degrees; these look like radians")


def numbers(texts: Sequence[str], option: str) -> Array:
    """Numbers from words such as `2 5 9`, `2,5,9` or `40:90:5` (first:last:step, last included). Raises InputError."""
    out: list[float] = []
    for text in (part for word in texts for part in word.split(",") if part.strip()):
        bounds = [finite(part, option) for part in text.split(":")]
        if len(bounds) == 1:
            out += bounds
        elif len(bounds) == 3 and bounds[2] > 0.0 and bounds[1] >= bounds[0]:
            count = int(np.floor((bounds[1] - bounds[0]) / bounds[2] * (1.0 + 1e-12) + 1e-9)) + 1
            if count > 1_000_000:
                raise InputError(option, f"is {text!r}, {count} numbers", "at most a million")
            out += [bounds[0] + i * bounds[2] for i in range(count)]
        else:
            raise InputError(option, f"is {text!r}", "a number, or first:last:step with a step above 0")
    if not out:
        raise InputError(option, "is empty", "numbers")
    return np.array(out)


def momentum(data: Table, machine: Machine, response_scale: float | None = None) -> tuple[Array, Array]:
    """(momentum, sigma) of each row in kg m/s per paddle, or in the response's own unit without a scale; nan where unknown.

    response_scale: units of `response` in one kg m/s. Raises InputError for a scale that is not above 0 or has nothing to scale.
    """
    if response_scale is None:
        scale = 1.0
    elif data.reading != RESPONSE:
        raise InputError("--response-scale", f"given, but {data.path} holds {data.reading}", "a table of `response`")
    elif not 0.0 < response_scale < np.inf:
        raise InputError("--response-scale", f"is {response_scale:g}", "a number above 0")
    else:
        scale = response_scale
    values = data.momentum(machine) / scale
    sigma = data.columns.get("sigma", np.full(len(data), np.nan)) / scale
    if data.reading == "force_n":
        sigma = machine.per_paddle(sigma, data.speed_rad_s(machine))
    return values, sigma


def measurements(data: Table, machine: Machine, response_scale: float | None = None) -> Measurements:
    """Rows for a calibration; rows without a reading are left out. Raises InputError when none is left or sigma is partial."""
    values, sigma = momentum(data, machine, response_scale)
    load = loads(data)
    usable = np.isfinite(values) & np.isfinite(load)
    if not np.any(usable):
        raise InputError(data.path, "has no row with both a load and a reading", "at least one")
    known = np.isfinite(sigma[usable])
    if np.any(known) and not np.all(known & (sigma[usable] > 0.0)):
        raise InputError(data.path, "column sigma has gaps or zeros", "a number above 0 in each row, or no such column")
    at = np.flatnonzero(usable)
    return Measurements(conditions_at(data, machine, at), values[at], sigma[at] if np.all(known) else None, at)


def loads(data: Table) -> Array:
    """The loads of a table's rows, shape (n,); nan where it has no column of them."""
    return data.columns[data.load] if data.load is not None else np.full(len(data), np.nan)


def conditions_at(data: Table, machine: Machine, rows: NDArray[np.intp]) -> Conditions:
    """The conditions of some rows."""
    conditions = data.conditions(machine)
    given = {field.name: getattr(conditions, field.name) for field in fields(conditions)}
    return Conditions(**{name: np.asarray(column)[rows] for name, column in given.items() if column is not None})


def at_plate_angle(rows: Measurements, angle_deg: float, data: Table) -> Measurements:
    """Those of the rows at one plate angle. Raises InputError where there is none."""
    chosen = np.isclose(rows.columns()[0], np.radians(angle_deg), atol=1e-6)
    if not np.any(chosen):
        raise InputError("--plate-angle", f"is {angle_deg:g}", f"an angle that {data.path} holds")
    return rows.select(chosen)


def in_unit_of(data: Table, known: ParameterSet, args: argparse.Namespace) -> ParameterSet:
    """The parameters, in the reading's own unit where they are k1 and k2 of a file that names none.

    Raises InputError when their scale is not that of the table's reading.
    """
    unit = RESPONSE if data.reading == RESPONSE else "N"
    if unit == RESPONSE and "k1" in known.values and not _names_unit(args):
        return replace(known, response_unit=RESPONSE)
    if (known.response_unit == "N") != (unit == "N"):
        raise InputError(
            data.path,
            f"holds {data.reading}, but the parameters are in the unit {known.response_unit!r}",
            f"parameters in {unit!r} (calibrate them on this kind of reading)",
        )
    return known


def _names_unit(args: argparse.Namespace) -> bool:
    """Whether the parameter file says of which reading it is."""
    return not args.params or "response_unit" in load_mapping(_named_files.parameters_path(args.params))

"""Parameter files: versioned YAML with values, effects, covariance, calibrated range and provenance.

Numbers are written with Python's shortest exact representation, so a file read and written again is the same to the bit.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from yaml.representer import RepresenterError

from yieldmon.arguments import require_path, require_type
from yieldmon.errors import InputError
from yieldmon.estimation.model_error import LARGEST as LARGEST_MODEL_ERROR
from yieldmon.estimation.parameters import NOT_CALIBRATED, SCALE, WEIGHED, ParameterSet
from yieldmon.physics.effects import effect_parameter, get_effect
from yieldmon.physics.grain import GRAIN
from yieldmon.physics.machine import Machine
from yieldmon.resources import shipped

from . import calibrated_machine, flow_curve_file, strict_yaml, whole_file
from .calibrated_range import calibrated_document, calibrated_range
from .checked import known_format, known_keys, load_mapping, mapping, number, texts

DEFAULT = "config/parameters/corn.yaml"
FORMAT = 1
_LARGEST_VERSION = 10**15

#: Physical limits: unit, lowest, highest. Parameters in the response's own unit are only finite.
GRAIN_LIMITS: Mapping[str, tuple[str, float, float]] = {
    p.name: (p.unit, -1e9, 1e9) if p.follows_response else (p.unit, *p.limits) for p in GRAIN.values()
}
_LEAST_DENSITY_KG_M3 = 20.0
"""No grain is lighter; a number below it is in another unit."""
_BEYOND_BOUNDS = 0.05
"""Share of an effect's range by which an updated value may lie beyond it."""
_KEYS = ("format", "version", "effects", "covariance", "calibrated_range", "response_unit", "model_error", "curve", "provenance")
#: All keys of a parameter file.
KEYS = frozenset((*GRAIN_LIMITS, *_KEYS))


def load(path: str | Path | None = None) -> ParameterSet:
    """The parameters in a YAML file.

    Parameters
    ----------
    path : path, optional
        None: the shipped corn.

    Returns
    -------
    ParameterSet

    Raises
    ------
    InputError
        Naming file, key, value and range.

    Examples
    --------
    >>> api.load_parameters().effects
    ('gravity',)
    """
    path = shipped(DEFAULT) if path is None else path
    require_path(path)
    return _plausible(load_mapping(path), str(path))


def _plausible(document: Mapping[str, Any], where: str) -> ParameterSet:
    """ParameterSet from the mapping of a parameter file, with the limits that only a file's values have. Raises InputError."""
    known = from_document(document, where)
    if known.values["density"] < _LEAST_DENSITY_KG_M3:
        raise InputError(f"{where}: density", f"is {known.values['density']:g}", "kg/m3; this looks like g/cm3 or t/m3")
    if known.model_error is not None:
        number(known.model_error, f"{where}: model_error", "as a share of the force, 0.05 for 5 %", 0.0, LARGEST_MODEL_ERROR)
    _check_effects(known, where)
    return known


def digest(parameters: ParameterSet) -> str:
    """Identifies a parameter file's content, whether or not it is marked as `on_a_machine` does."""
    document = to_document(parameters)
    if document["provenance"].get(SCALE) == NOT_CALIBRATED:
        del document["provenance"][SCALE]
        # Of files that name a geometry only those of weighed loads are marked.
        if calibrated_machine.names_geometry(parameters):
            document["provenance"][SCALE] = WEIGHED
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()


def on_a_machine(known: ParameterSet, machine: Machine) -> ParameterSet:
    """The parameters as they hold on a machine.

    The shipped corn was calibrated on the virtual test facility, which has the shipped machine: on one of another geometry it is
    marked as not calibrated (see `ParameterSet.scale_error`). So are parameters of weighed loads, on a machine of another
    geometry than that of their provenance. Others are left as they are.
    """
    if known.is_weighed and calibrated_machine.is_of_other_geometry(known, machine):
        return not_calibrated(known)
    if machine.geometry_m == Machine().geometry_m or SCALE in known.provenance or digest(known) != _shipped_digest():
        return known
    return not_calibrated(known)


def not_calibrated(known: ParameterSet) -> ParameterSet:
    """The parameters, marked as calibrated on another machine than where they are used."""
    return replace(known, provenance={**known.provenance, SCALE: NOT_CALIBRATED})


@cache
def _shipped_digest() -> str:
    return digest(load())


def from_document(document: Mapping[str, Any], where: str) -> ParameterSet:
    """ParameterSet from the mapping of a parameter file. Raises InputError as `load`."""
    if "estimator" in document:
        expected = "a parameter file; the configuration takes a curve as estimator_file, `estimate` and `process` as --estimator"
        raise InputError(where, f"is a curve ({document['estimator']})", expected)
    known_keys(document, f"{where}: ", (*GRAIN_LIMITS, *_KEYS))
    known_format(document, FORMAT, where)
    values = {k: number(document[k], f"{where}: {k}", *GRAIN_LIMITS[k]) for k in GRAIN_LIMITS if k in document}
    values |= _effect_values(mapping(document, "effects", where), where)
    names, covariance = _covariance(document.get("covariance"), where)
    provenance = texts(document.get("provenance"), f"{where}: provenance")
    unit = document.get("response_unit", "N")
    version = document.get("version", 1)
    if not isinstance(unit, str):
        raise InputError(f"{where}: response_unit", f"is {unit!r}", "a text such as N")
    if not isinstance(version, int) or isinstance(version, bool) or not 1 <= version <= _LARGEST_VERSION:
        raise InputError(f"{where}: version", f"is {version!r}", f"a whole number from 1 to {_LARGEST_VERSION}")
    error = document.get("model_error")
    model_error = None if error is None else number(error, f"{where}: model_error", "", 0.0, 10.0)
    curve = flow_curve_file.from_document(document["curve"], f"{where}: curve") if "curve" in document else None
    calibrated = calibrated_range(mapping(document, "calibrated_range", where), where)
    try:
        return ParameterSet(
            values=values,
            covariance_names=names,
            covariance=covariance,
            calibrated=calibrated,
            response_unit=unit,
            version=version,
            provenance=provenance,
            model_error=model_error,
            curve=curve,
        )
    except ValueError as error:
        raise InputError(where, str(error)) from error


def to_document(parameters: ParameterSet) -> dict[str, Any]:
    """The mapping that `from_document` reads back to an equal set."""
    document: dict[str, Any] = {"format": FORMAT, "version": parameters.version}
    document |= {k: float(v) for k, v in parameters.values.items() if "." not in k}
    effects: dict[str, dict[str, float]] = {}
    for name, value in parameters.values.items():
        effect, _, short = name.partition(".")
        if short:
            effects.setdefault(effect, {})[short] = float(value)
    document["effects"] = effects
    document["response_unit"] = parameters.response_unit
    if parameters.model_error is not None:
        document["model_error"] = float(parameters.model_error)
    if parameters.curve is not None:
        document["curve"] = flow_curve_file.to_document(parameters.curve)
    document["covariance"] = {
        "names": list(parameters.covariance_names),
        "matrix": [[float(v) for v in row] for row in parameters.covariance],
    }
    document["calibrated_range"] = calibrated_document(parameters.calibrated)
    document["provenance"] = dict(parameters.provenance)
    return document


def save(parameters: ParameterSet, path: str | Path) -> None:
    """Write a parameter file atomically.

    Parameters
    ----------
    parameters : ParameterSet
    path : path
        Replaced where there is such a file.

    Raises
    ------
    InputError
        For values that `load_parameters` refuses, in its words; a folder that is missing or takes no file; and an argument of
        another type.
    OSError
        As the system gives it.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     api.save_parameters(api.load_parameters(), pathlib.Path(folder, "mine.yaml"))
    ...     again = api.load_parameters(pathlib.Path(folder, "mine.yaml"))
    >>> again.values == api.load_parameters().values
    True
    """
    require_type("parameters", parameters, ParameterSet, "a ParameterSet; the path comes after it")
    require_path(path)
    try:
        text = strict_yaml.dump(to_document(parameters))
    except RepresenterError as error:
        problem = f"holds {error.args[-1]!r}, of type {type(error.args[-1]).__name__}"
        raise InputError(str(path), problem, "parameters of texts and Python's own numbers") from error
    _plausible(strict_yaml.parse(text, str(path)), str(path))
    whole_file.write(path, text, durable=True, mode=whole_file.READABLE)


def _check_effects(known: ParameterSet, where: str) -> None:
    """Raises InputError for an effect's parameter beyond its physical bounds; those in a unit of the reading have none."""
    for name, value in known.values.items():
        if "." not in name:
            continue
        parameter = effect_parameter(name)
        beyond = _BEYOND_BOUNDS * (parameter.upper - parameter.lower)
        in_other_unit = known.response_unit != "N" and get_effect(name.partition(".")[0]).unit_follows_response
        if not in_other_unit and not parameter.lower - beyond <= value <= parameter.upper + beyond:
            expected = f"a number from {parameter.lower:g} to {parameter.upper:g} {parameter.unit}".rstrip()
            raise InputError(f"{where}: effects.{name}", f"is {value:g}", expected)


def _effect_values(effects: Mapping[str, Any], where: str) -> dict[str, float]:
    values: dict[str, float] = {}
    for effect, parameters in effects.items():
        if not isinstance(parameters, dict):
            raise InputError(f"{where}: effects.{effect}", f"is {parameters!r}", "a mapping of parameter names to values")
        if not parameters:
            raise InputError(f"{where}: effects.{effect}", "has no parameter", _parameters_of(effect, where))
        for name, value in parameters.items():
            qualified = f"{effect}.{name}"
            try:
                known = effect_parameter(qualified)
            except ValueError as error:
                raise InputError(f"{where}: effects.{qualified}", str(error)) from error
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not isfinite(value):
                raise InputError(f"{where}: effects.{qualified}", f"is {value!r}", f"a finite number, {known.unit}")
            values[qualified] = float(value)
    return values


def _parameters_of(effect: str, where: str) -> str:
    """Names of an effect's parameters. Raises InputError for an effect that is not known."""
    try:
        return ", ".join(parameter.name for parameter in get_effect(effect).parameters)
    except ValueError as error:
        raise InputError(f"{where}: effects.{effect}", str(error)) from error


def _covariance(document: Any, where: str) -> tuple[tuple[str, ...], np.ndarray]:
    if document is None:
        return (), np.zeros((0, 0))
    if not isinstance(document, dict) or set(document) != {"names", "matrix"}:
        raise InputError(f"{where}: covariance", f"is {document!r}", "a mapping with names and matrix")
    names, rows = document["names"], document["matrix"]
    if not isinstance(names, list) or not all(isinstance(n, str) for n in names):
        raise InputError(f"{where}: covariance.names", f"is {names!r}", "a list of parameter names")
    if not isinstance(rows, list) or not all(isinstance(r, list) and len(r) == len(names) for r in rows):
        raise InputError(f"{where}: covariance.matrix", "is not square", f"{len(names)} rows of {len(names)} numbers")
    flat = [number(v, f"{where}: covariance.matrix", "", -1e30, 1e30) for row in rows for v in row]
    if len(rows) != len(names):
        raise InputError(f"{where}: covariance.matrix", f"has {len(rows)} rows", f"{len(names)}")
    return tuple(names), np.array(flat).reshape(len(names), len(names))

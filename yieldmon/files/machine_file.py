"""Machine geometry files: YAML with lengths in m, angles in degrees, speeds in rpm, as people measure them."""

from __future__ import annotations

from math import degrees, radians
from pathlib import Path
from typing import Any

from yieldmon.errors import InputError
from yieldmon.physics.machine import RPM, ImpactSensor, Machine
from yieldmon.resources import shipped

from .checked import load_mapping, number

DEFAULT = "config/machines/sprocket-8.yaml"

_LENGTHS = {
    "sprocket_pitch_radius_m": (0.01, 0.5),
    "paddle_length_m": (0.02, 1.0),
    "paddle_width_m": (0.02, 1.0),
    "plate_pivot_x_m": (0.0, 5.0),
    "plate_pivot_y_m": (-5.0, 5.0),
    "plate_length_m": (0.02, 2.0),
}
_ANGLES = ("home_plate_angle_deg", "min_plate_angle_deg", "max_plate_angle_deg")
_SPEEDS = ("nominal_elevator_speed_rpm", "min_elevator_speed_rpm", "max_elevator_speed_rpm")
_SENSOR = {"gain_n_per_mv": ("N/mV", 1e-4, 1e3), "full_scale_mv": ("mV", 1.0, 1e5)}


def load(path: str | Path | None = None) -> Machine:
    """The machine in a YAML file, or the shipped 8-tooth machine. Raises InputError naming file, key, value and range."""
    path = shipped(DEFAULT) if path is None else path
    document = load_mapping(path)
    known = {"name", "paddle_spacings_m", "sensor", *_LENGTHS, *_ANGLES, *_SPEEDS}
    for key in document:
        if key not in known:
            raise InputError(f"{path}: {key}", "unknown key", f"one of {', '.join(sorted(known))}")
    for key in sorted(known):
        if key not in document:
            raise InputError(f"{path}: {key}", "missing")
    values: dict[str, Any] = {key: number(document[key], f"{path}: {key}", "m", *limits) for key, limits in _LENGTHS.items()}
    for key in _ANGLES:
        values[key.replace("_deg", "_rad")] = radians(number(document[key], f"{path}: {key}", "deg", 5.0, 120.0))
    for key in _SPEEDS:
        values[key.replace("_rpm", "_rad_s")] = number(document[key], f"{path}: {key}", "rpm", 1.0, 5000.0) * RPM
    spacings = document["paddle_spacings_m"]
    if not isinstance(spacings, list) or not spacings:
        raise InputError(f"{path}: paddle_spacings_m", f"is {spacings!r}", "a list of distances in m")
    values["paddle_spacings_m"] = tuple(
        number(d, f"{path}: paddle_spacings_m[{i}]", "m", 0.01, 2.0) for i, d in enumerate(spacings)
    )
    values["sensor"] = _sensor(document["sensor"], path)
    if not isinstance(document["name"], str):
        raise InputError(f"{path}: name", f"is {document['name']!r}", "a text")
    try:
        return Machine(name=document["name"], **values)
    except ValueError as error:
        raise InputError(str(path), str(error)) from error


def to_document(machine: Machine) -> dict[str, Any]:
    """The mapping that `load` reads back, with angles in degrees and speeds in rpm."""
    document: dict[str, Any] = {"name": machine.name, "paddle_spacings_m": list(machine.paddle_spacings_m)}
    document |= {key: getattr(machine, key) for key in _LENGTHS}
    document |= {key: degrees(getattr(machine, key.replace("_deg", "_rad"))) for key in _ANGLES}
    document |= {key: getattr(machine, key.replace("_rpm", "_rad_s")) / RPM for key in _SPEEDS}
    document["sensor"] = {key: getattr(machine.sensor, key) for key in _SENSOR}
    return document


def _sensor(document: Any, path: str | Path) -> ImpactSensor:
    if not isinstance(document, dict) or set(document) != set(_SENSOR):
        raise InputError(f"{path}: sensor", f"is {document!r}", f"a mapping with {', '.join(_SENSOR)}")
    return ImpactSensor(**{k: number(document[k], f"{path}: sensor.{k}", *limits) for k, limits in _SENSOR.items()})

"""Machine geometry files: YAML with lengths in m, angles in degrees, speeds in rpm, as people measure them."""

from __future__ import annotations

from collections.abc import Mapping
from math import degrees, radians
from pathlib import Path
from typing import Any

from yieldmon.arguments import require_path
from yieldmon.errors import InputError
from yieldmon.physics.machine import LONGEST_RESPONSE_S, RPM, ImpactSensor, Implement, Machine
from yieldmon.resources import shipped

from .checked import known_keys, load_mapping, name, number, numbers
from .speeds import LARGEST_SPEED_RPM

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

#: Of the sensor, where it is stated.
_SENSOR_OPTIONAL = {"response_s": ("s", 0.0, LONGEST_RESPONSE_S)}

_OPTIONAL = {"implement", "plate_travel_m"}

#: Of the optional section: unit and range.
_IMPLEMENT = {
    "working_width_m": ("m", 0.1, 30.0),
    "header_offset_m": ("m", -20.0, 20.0),
    "connector_type": ("", 0, 10),
    "grain_delay_s": ("s", 0.0, 60.0),
}

_NEEDED = frozenset({"name", "paddle_spacings_m", "sensor", *_LENGTHS, *_ANGLES, *_SPEEDS})

#: All keys, those within its sections too.
KEYS = _NEEDED | _OPTIONAL | set(_SENSOR) | set(_SENSOR_OPTIONAL) | set(_IMPLEMENT)


def load(path: str | Path | None = None) -> Machine:
    """The machine in a YAML file.

    Parameters
    ----------
    path : path, optional
        None: the shipped 8-tooth machine.

    Returns
    -------
    Machine

    Raises
    ------
    InputError
        Naming file, key, value and range.

    Examples
    --------
    >>> api.load_machine().name
    'sprocket-8'
    """
    path = shipped(DEFAULT) if path is None else path
    require_path(path)
    return from_document(load_mapping(path), path)


def from_document(document: Mapping[str, Any], path: str | Path) -> Machine:
    """Machine from the mapping of a file; path: for errors. Raises InputError as `load`."""
    known_keys(document, f"{path}: ", sorted(_NEEDED | _OPTIONAL))
    for key in sorted(_NEEDED):
        if key not in document:
            raise InputError(f"{path}: {key}", "missing", f"a value as in {DEFAULT}")
    values: dict[str, Any] = {key: number(document[key], f"{path}: {key}", "m", *limits) for key, limits in _LENGTHS.items()}
    for key in _ANGLES:
        values[key.replace("_deg", "_rad")] = radians(number(document[key], f"{path}: {key}", "deg", 5.0, 120.0))
    for key in _SPEEDS:
        values[key.replace("_rpm", "_rad_s")] = number(document[key], f"{path}: {key}", "rpm", 1.0, LARGEST_SPEED_RPM) * RPM
    values["paddle_spacings_m"] = numbers(document["paddle_spacings_m"], f"{path}: paddle_spacings_m", "m", 0.01, 2.0)
    values["plate_travel_m"] = _travel(document.get("plate_travel_m", [0.0, 0.0]), f"{path}: plate_travel_m")
    values["sensor"] = _sensor(document["sensor"], path)
    values["implement"] = _implement(document.get("implement", {}), path)
    machine_name = name(document["name"], f"{path}: name")
    try:
        return Machine(name=machine_name, **values)
    except ValueError as error:
        raise InputError(str(path), str(error)) from error


def to_document(machine: Machine) -> dict[str, Any]:
    """The mapping that `load` reads back, with angles in degrees and speeds in rpm."""
    document: dict[str, Any] = {"name": machine.name, "paddle_spacings_m": list(machine.paddle_spacings_m)}
    document |= {key: getattr(machine, key) for key in _LENGTHS}
    document |= {key: degrees(getattr(machine, key.replace("_deg", "_rad"))) for key in _ANGLES}
    document |= {key: getattr(machine, key.replace("_rpm", "_rad_s")) / RPM for key in _SPEEDS}
    document["sensor"] = {key: getattr(machine.sensor, key) for key in _SENSOR}
    if machine.sensor.response_s != ImpactSensor().response_s:
        document["sensor"]["response_s"] = machine.sensor.response_s
    if machine.plate_travel_m != (0.0, 0.0):
        document["plate_travel_m"] = list(machine.plate_travel_m)
    implement = {key: getattr(machine.implement, key) for key in _IMPLEMENT}
    if machine.implement != Implement():
        document["implement"] = {key: value for key, value in implement.items() if value is not None}
    return document


def _travel(value: Any, where: str) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise InputError(where, f"is {value!r}", "[towards the elevator, away from it] in m, e.g. [-0.03, 0.05]")
    low, high = (number(v, where, "m", -2.0, 2.0) for v in value)
    return low, high


def _implement(document: Any, path: str | Path) -> Implement:
    where = f"{path}: implement"
    if not isinstance(document, dict):
        raise InputError(where, f"is {document!r}", f"a mapping with any of {', '.join(_IMPLEMENT)}")
    known_keys(document, f"{where}.", _IMPLEMENT)
    values: dict[str, Any] = {key: number(value, f"{where}.{key}", *_IMPLEMENT[key]) for key, value in document.items()}
    if values.get("connector_type", 0) % 1:
        raise InputError(f"{where}.connector_type", f"is {values['connector_type']:g}", "a whole number from 0 to 10")
    return Implement(**{**values, "connector_type": int(values.get("connector_type", 0))})


def _sensor(document: Any, path: str | Path) -> ImpactSensor:
    if not isinstance(document, dict) or set(document) - set(_SENSOR_OPTIONAL) != set(_SENSOR):
        expected = f"a mapping with {', '.join(_SENSOR)} (and {', '.join(_SENSOR_OPTIONAL)} where it is known)"
        raise InputError(f"{path}: sensor", f"is {document!r}", expected)
    limits = _SENSOR | _SENSOR_OPTIONAL
    return ImpactSensor(**{key: number(value, f"{path}: sensor.{key}", *limits[key]) for key, value in document.items()})

"""Moisture map files: YAML with moistures and the parameter values at each of them."""

from __future__ import annotations

from pathlib import Path

from yieldmon.errors import InputError
from yieldmon.estimation.self_calibration.moisture import MoistureMap
from yieldmon.files.parameter_file import GRAIN_LIMITS
from yieldmon.resources import shipped

from . import strict_yaml, whole_file
from .checked import known_keys, load_mapping, number, numbers

PUBLISHED = "config/moisture/corn-published.yaml"


def load(path: str | Path | None = None) -> MoistureMap:
    """The map in a YAML file, or the shipped published one. Raises InputError naming file, key, value and range."""
    path = shipped(PUBLISHED) if path is None else path
    document = load_mapping(path)
    known_keys(document, f"{path}: ", ("moisture_pct", "values", "doubt"))
    moistures = numbers(document.get("moisture_pct"), f"{path}: moisture_pct", "%", 0.0, 100.0)
    values = document.get("values")
    if not isinstance(values, dict) or not values:
        raise InputError(f"{path}: values", f"is {values!r}", "a mapping of parameter names to lists")
    rows = {}
    for name, row in values.items():
        if name not in GRAIN_LIMITS:
            raise InputError(f"{path}: values.{name}", "unknown parameter", f"one of {', '.join(GRAIN_LIMITS)}")
        rows[name] = numbers(row, f"{path}: values.{name}", *GRAIN_LIMITS[name])
    doubt = number(document.get("doubt", 0.5), f"{path}: doubt", "", 0.0, 10.0)
    try:
        return MoistureMap(moistures, rows, doubt)
    except ValueError as error:
        raise InputError(str(path), str(error)) from error


def save(known: MoistureMap, path: str | Path) -> None:
    """Write a file that `load` reads back."""
    document = {
        "moisture_pct": list(known.moisture_pct),
        "values": {name: list(row) for name, row in known.values.items()},
        "doubt": known.doubt,
    }
    whole_file.write(path, strict_yaml.dump(document), durable=True, mode=whole_file.READABLE)

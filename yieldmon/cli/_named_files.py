"""Files that arguments name by path, or by the name of a shipped one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from yieldmon.resources import file_or_shipped

if TYPE_CHECKING:
    from yieldmon.estimation.parameters import ParameterSet
    from yieldmon.physics.machine import Machine


def machine(name: str | None, option: str = "--machine") -> Machine:
    """The machine that an argument names; None: the shipped 8-tooth machine. Raises InputError."""
    from yieldmon.files import machine_file

    return machine_file.load(None if name is None else file_or_shipped(name, "config/machines", option))


def parameters_path(name: str, option: str = "--params") -> Path:
    """Of the parameter file that an argument names. Raises InputError."""
    return file_or_shipped(name, "config/parameters", option)


def parameters(name: str, option: str = "--params") -> ParameterSet:
    """The parameters that an argument names. Raises InputError."""
    from yieldmon.files import parameter_file

    return parameter_file.load(parameters_path(name, option))


def scenario_path(name: str) -> Path:
    """Of the scenario that --scenario names. Raises InputError."""
    return file_or_shipped(name, "config/scenarios", "--scenario")

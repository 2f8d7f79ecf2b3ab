"""A force cell held against its machine: figures in units that were mistaken are far from it."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files.crops import crops
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array
from yieldmon.service.config.configuration import Configuration

_NEARLY_FULL = 0.99
_MOST_OVER_FULL = 10.0
"""Full scale over the force of full paddles, at most; of a cell that resolves grain it is 2 to 7."""
_ANGLES = 9


def implausible(configuration: Configuration) -> list[tuple[str, str, str]]:
    """What cannot be of the force cell.

    Parameters
    ----------
    configuration : Configuration

    Returns
    -------
    list of tuple of str
        (where, problem, expected); empty for figures that can be.
    """
    machine, problems = configuration.machine, []
    found = cell_problem(machine, configuration.parameters)
    if found is not None:
        problems.append((f"{configuration.machine_path}: sensor", *found))
    return problems


def cell_problem(machine: Machine, known: ParameterSet) -> tuple[str, str] | None:
    """A full scale in newtons that full paddles cannot give, as (problem, expected); None for a cell that can be.

    At least it is the force of the grain in question at home, and at most ten times that of the heaviest shipped crop at any
    angle of the plate: the cell stays where the crop changes. Of a plate that does not turn the angles from its own to upright
    count, for which its cell was made.
    """
    heaviest = max(item.parameters().values["density"] for item in crops().values())
    heavy = {**known.values, "density": max(heaviest, known.values["density"])}
    model, home_rad = ForwardModel(machine, known.effects), machine.home_plate_angle_rad
    full_n = float(_full_force_n(machine, model, home_rad, known.values))
    low, high = machine.min_plate_angle_rad, machine.max_plate_angle_rad
    if low == high:
        high = max(high, math.pi / 2.0)
    forces_n = _full_force_n(machine, model, low + (high - low) * np.arange(_ANGLES) / (_ANGLES - 1), heavy)
    most_n = _MOST_OVER_FULL * max(forces_n[np.isfinite(forces_n)], default=full_n)
    sensor = machine.sensor
    end_n = sensor.gain_n_per_mv * sensor.full_scale_mv
    if not full_n > 0.0 or full_n <= end_n <= most_n:
        return None
    return (
        f"gain_n_per_mv {sensor.gain_n_per_mv:g} times full_scale_mv {sensor.full_scale_mv:g} is {end_n:.0f} N",
        f"{full_n:.0f} to {most_n:.0f} N, as full paddles press with {full_n:.0f} N: gain in N (not kgf, lbf) "
        "per mV, full scale in mV at the cell",
    )


def _full_force_n(machine: Machine, model: ForwardModel, angle_rad: Array | float, values: Mapping[str, float]) -> Array:
    speed = machine.nominal_elevator_speed_rad_s
    full_kg = machine.full_paddle_mass_kg(values["density"], values["shape_ratio"])
    flow = _NEARLY_FULL * full_kg * machine.passes_per_s(speed)
    at = Conditions(angle_rad, speed, mass_flow_kg_s=flow, moisture_pct=15.0)
    return np.asarray(np.abs(model.force(at, values, overfull="nan").real))

"""A force cell held against the machine that it is on: gain and full scale in units that were mistaken are far from it."""

from __future__ import annotations

import math

from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.service.configuration import Configuration

_NEARLY_FULL = 0.99
_MOST_OVER_FULL = 10.0
"""Full scale over the force of full paddles, at most; of a cell that resolves grain it is 2 to 7."""
_ANGLES = 9


def implausible(configuration: Configuration) -> list[tuple[str, str, str]]:
    """What cannot be of the force cell, from its full scale in newtons against the force of full paddles.

    Parameters
    ----------
    configuration : Configuration

    Returns
    -------
    list of tuple of str
        (where, problem, expected); empty for a cell that can be.
    """
    machine, known = configuration.machine, configuration.parameters
    speed = machine.nominal_elevator_speed_rad_s
    shape = known.values["density"], known.values["shape_ratio"]
    flow = _NEARLY_FULL * machine.full_paddle_mass_kg(*shape) * machine.passes_per_s(speed)
    model = ForwardModel(machine, known.effects)

    def full_at(angle_rad: float) -> float:
        at = Conditions(angle_rad, speed, mass_flow_kg_s=flow, moisture_pct=15.0)
        return abs(float(model.force(at, known.values, overfull="nan").real))

    full_n = full_at(machine.home_plate_angle_rad)
    # The cell of a plate that presses little at its home, such as one that is bolted on, was made for the other angles too.
    low, high = machine.min_plate_angle_rad, machine.max_plate_angle_rad
    forces_n = (full_at(low + (high - low) * step / (_ANGLES - 1)) for step in range(_ANGLES))
    most_n = _MOST_OVER_FULL * max((force for force in forces_n if math.isfinite(force)), default=full_n)
    sensor = machine.sensor
    end_n = sensor.gain_n_per_mv * sensor.full_scale_mv
    if not full_n > 0.0 or full_n <= end_n <= most_n:
        return []
    return [(
        f"{configuration.machine_path}: sensor",
        f"gain_n_per_mv {sensor.gain_n_per_mv:g} times full_scale_mv {sensor.full_scale_mv:g} is {end_n:.0f} N",
        f"{full_n:.0f} to {most_n:.0f} N, as full paddles press with {full_n:.0f} N: gain in N (not kgf, lbf) "
        "per mV, full scale in mV at the cell",
    )]  # fmt: skip

"""A force cell held against the machine that it is on: gain and full scale in units that were mistaken are far from it."""

from __future__ import annotations

from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.service.configuration import Configuration

_NEARLY_FULL = 0.99
_MOST_OVER_FULL = 10.0
"""Full scale over the force of full paddles, at most; of a cell that resolves grain it is 2 to 7."""


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
    at = Conditions(machine.home_plate_angle_rad, speed, mass_flow_kg_s=flow, moisture_pct=15.0)
    full_n = abs(float(ForwardModel(machine, known.effects).force(at, known.values, overfull="nan").real))
    sensor = machine.sensor
    end_n = sensor.gain_n_per_mv * sensor.full_scale_mv
    if not full_n > 0.0 or full_n <= end_n <= _MOST_OVER_FULL * full_n:
        return []
    return [(
        f"{configuration.machine_path}: sensor",
        f"gain_n_per_mv {sensor.gain_n_per_mv:g} times full_scale_mv {sensor.full_scale_mv:g} is {end_n:.0f} N",
        f"{full_n:.0f} to {_MOST_OVER_FULL * full_n:.0f} N, as full paddles press with {full_n:.0f} N: gain in N (not kgf, lbf) "
        "per mV, full scale in mV at the cell",
    )]  # fmt: skip

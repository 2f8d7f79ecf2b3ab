"""Fill from the two loads that alternating paddle spacings throw from one flow.

A paddle behind a longer gap carries more. The impulses' ratio over the loads' ratio is the local exponent of impulse over load,
which falls as the paddle fills; the scale of force drops out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array


@dataclass(frozen=True, slots=True)
class LoadContrast:
    """The exponent between the loads of the shortest and the longest gap; exponent_sd from the pulses' scatter."""

    exponent: float
    exponent_sd: float


@dataclass(frozen=True, slots=True)
class ContrastFlow:
    """Volume flow (mass flow over density) that an exponent means; nan where none does. relative_sd: of its logarithm."""

    volume_flow_m3_s: float
    relative_sd: float


def contrast(impulses_n_s: Array, spacings_m: Array, *, impulse_sd: Array) -> LoadContrast:
    """Exponent of impulse over load.

    Parameters
    ----------
    impulses_n_s : ndarray (paddles,)
        Mean impulse behind each gap.
    spacings_m : ndarray (paddles,)
        The gaps.
    impulse_sd : ndarray (paddles,)
        Relative standard deviations of the means.

    Raises
    ------
    ValueError
        Where all gaps are equal: they throw one load, not two.
    """
    short, long = int(np.argmin(spacings_m)), int(np.argmax(spacings_m))
    step = float(np.log(spacings_m[long] / spacings_m[short]))
    if not step > 0.0:
        raise ValueError(f"paddle spacings {np.asarray(spacings_m).tolist()} m: expected two that differ")
    exponent = float(np.log(impulses_n_s[long] / impulses_n_s[short])) / step
    return LoadContrast(exponent, float(np.hypot(impulse_sd[long], impulse_sd[short])) / step)


def expected_exponent(
    model: ForwardModel,
    parameters: Mapping[str, float],
    volume_flow_m3_s: Array,
    *,
    plate_angle_rad: float,
    elevator_speed_rad_s: float,
) -> Array:
    """The model's exponent at volume flows (n,); nan where a load would not fit its paddle."""
    gaps = np.asarray(model.machine.paddle_spacings_m)
    ends = np.array([gaps.min(), gaps.max()])
    speed = model.machine.paddle_speed_m_s(elevator_speed_rad_s)
    mass = np.asarray(volume_flow_m3_s)[:, None] * parameters["density"] * ends / speed
    momentum = model.paddle_momentum(
        Conditions(plate_angle_rad, elevator_speed_rad_s, paddle_mass_kg=mass), parameters, overfull="nan"
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.log(momentum[:, 1] / momentum[:, 0]) / np.log(ends[1] / ends[0]))


def flow_of(
    found: LoadContrast,
    model: ForwardModel,
    parameters: Mapping[str, float],
    *,
    plate_angle_rad: float,
    elevator_speed_rad_s: float,
) -> ContrastFlow:
    """The volume flow at which the model has this exponent, with the parameters held."""
    full = 0.5 * parameters["shape_ratio"] * model.machine.paddle_width_m * model.machine.paddle_length_m**2
    most = full * model.machine.paddle_speed_m_s(elevator_speed_rad_s) / max(model.machine.paddle_spacings_m)
    where = {"plate_angle_rad": plate_angle_rad, "elevator_speed_rad_s": elevator_speed_rad_s}

    def off(log_flow: float) -> float:
        return float(expected_exponent(model, parameters, np.exp([log_flow]), **where)[0]) - found.exponent

    # The exponent falls from where grain begins to miss to where the paddle is nearly full; beyond that it says nothing.
    grid = np.linspace(np.log(1e-2 * most), np.log(0.97 * most), 80)
    exponents = expected_exponent(model, parameters, np.exp(grid), **where)
    least = int(np.nanargmin(exponents))
    most_steep = int(np.nanargmax(exponents[: least + 1]))
    low, high = float(grid[most_steep]), float(grid[least])
    if not off(low) * off(high) < 0.0:
        return ContrastFlow(float("nan"), float("inf"))
    log_flow = float(brentq(off, low, high, xtol=1e-9))
    slope = (off(log_flow + 1e-4) - off(log_flow - 1e-4)) / 2e-4
    return ContrastFlow(float(np.exp(log_flow)), abs(found.exponent_sd / slope))

"""Flow at each window of a sweep, interpolated between the visits home before and after it (`home_flow`).

The force away from home is not used for it. The daemon's test of the model and the table for a diagnosis are based on these
flows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.machine import SAME_ANGLE_RAD
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array, real

from .home_flow import Visits, bracketed, wander_per_s


@dataclass(frozen=True, slots=True)
class SweepWindows:
    """Windows of one sweep with a force above 0 and a known angle and speed, arrays (windows,).

    relative_sd: relative standard deviation of the force. moisture_pct: of the whole sweep, nan if it is not known.
    """

    time_s: Array
    plate_angle_rad: Array
    elevator_speed_rad_s: Array
    force_n: Array
    relative_sd: Array
    moisture_pct: float

    def at_home(self, home_plate_angle_rad: float) -> NDArray[np.bool_]:
        """Windows at the home angle."""
        return np.asarray(np.abs(self.plate_angle_rad - home_plate_angle_rad) <= SAME_ANGLE_RAD)


@dataclass(frozen=True, slots=True)
class WindowFlows:
    """ln(flow, kg/s) at each window and its standard deviation, arrays (windows,), nan if not between two visits; and the
    visits."""

    log_flow: Array
    sd: Array
    visits: Visits


def window_flows(model: ForwardModel, parameters: ParameterSet, sweeps: Sequence[SweepWindows]) -> list[WindowFlows]:
    """Flows of sweeps. The random walk between visits is estimated over all sweeps. nan if a required moisture is not known."""
    loop = OpenLoop(model, parameters)
    homes = [sweep.at_home(model.machine.home_plate_angle_rad) for sweep in sweeps]
    visits = []
    for sweep, home in zip(sweeps, homes, strict=True):
        moisture = np.full(np.count_nonzero(home), sweep.moisture_pct)
        known = not model.needs_moisture or np.isfinite(sweep.moisture_pct)
        at = (sweep.force_n[home], sweep.plate_angle_rad[home], sweep.elevator_speed_rad_s[home])
        flow = loop.invert(*at, moisture) if known else moisture * np.nan
        visits.append(Visits.of(sweep.time_s[home], flow, sweep.relative_sd[home]))
    wander = wander_per_s(visits)
    return [
        WindowFlows(*bracketed(around, sweep.time_s, wander, at_home=home), around)
        for sweep, home, around in zip(sweeps, homes, visits, strict=True)
    ]


def force_n(
    model: ForwardModel,
    values: Mapping[str, float],
    plate_angle_rad: Array,
    elevator_speed_rad_s: Array | float,
    mass_flow_kg_s: Array | float,
    moisture_pct: Array | float,
) -> Array:
    """The model's force at each angle, N; nan above a full paddle."""
    shape = plate_angle_rad.shape
    conditions = Conditions(
        plate_angle_rad,
        np.broadcast_to(elevator_speed_rad_s, shape),
        mass_flow_kg_s=np.broadcast_to(mass_flow_kg_s, shape),
        moisture_pct=np.broadcast_to(moisture_pct, shape),
    )
    return real(np.asarray(model.force(conditions, values, overfull="nan")))

"""The machines of the study: what is hidden in them, and their weighed loads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.weighing.fleet_prior import MachineLoads
from yieldmon.estimation.weighing.load_departures import spread
from yieldmon.estimation.weighing.load_inputs import LoadSettings, WeighedLoad
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array

CROPS = ("corn", "soybean", "wheat")
GAIN_SD, ANGLE_SD_DEG, FIELD_DENSITY_SD = 0.03, 1.0, 0.02
SCATTER_SD, SCALE_SD = 0.005, 0.003
WINDOWS, WINDOW_S = 30, 20.0
OWN = ("gain", "angle", "field")


@dataclass(frozen=True)
class Hidden:
    """What a machine has: the model its forces come from and its values, the sensor's gain, and the plate's angle over the
    reported one."""

    model: ForwardModel
    values: Mapping[str, float]
    gain: float
    bent_rad: float

    def force(self, plate_angle_rad: Array, elevator_speed_rad_s: Array, mass_flow_kg_s: Array) -> Array:
        """Mean force as it is reported at these reported angles, N."""
        at = Conditions(plate_angle_rad + self.bent_rad, elevator_speed_rad_s, mass_flow_kg_s=mass_flow_kg_s)
        return np.asarray(np.real(self.model.force(at, self.values)) * self.gain)


def mean_std_dev(model: ForwardModel, known: ParameterSet, loads: Sequence[WeighedLoad]) -> float:
    """Mean relative standard deviation of loads by the parameters' covariance alone."""
    return float(np.mean([spread(model, known, load, LoadSettings(load_error=0.0)) for load in loads]))


def hidden_crop(shipped: ParameterSet, chance: np.random.Generator) -> dict[str, float]:
    """The crop as it is."""
    values = dict(shipped.values)
    for name in shipped.covariance_names:
        values[name] += chance.uniform(-1.0, 1.0) * 1.5 * shipped.standard_deviation(name)
    values["restitution"] = float(np.clip(values["restitution"], 0.05, 0.95))
    return values


def machine_of(name: str, truth: Mapping[str, float], chance: np.random.Generator, own: tuple[str, ...] = OWN) -> MachineLoads:
    """A machine and its weighed loads; own: what of its own it has, the same numbers being drawn whatever that is."""
    return drawn(name, truth, chance, own)[0]


def drawn(
    name: str,
    truth: Mapping[str, float],
    chance: np.random.Generator,
    own: tuple[str, ...] = OWN,
    effects: Mapping[str, float] = {},
) -> tuple[MachineLoads, Hidden]:
    """The same, and what is hidden; effects: values of effects that the machine has and the estimator's model lacks."""
    model = ForwardModel(Machine(), ("gravity",))
    gain = float(np.exp(chance.normal(0.0, GAIN_SD) * ("gain" in own)))
    bent_rad = float(np.radians(chance.normal(0.0, ANGLE_SD_DEG)) * ("angle" in own))
    denser = float(np.exp(chance.normal(0.0, FIELD_DENSITY_SD) * ("field" in own)))
    true = model.with_effects((*model.effects, *dict.fromkeys(key.partition(".")[0] for key in effects)))
    hidden = Hidden(true, {**truth, "density": truth["density"] * denser, **effects}, gain, bent_rad)
    angle, speed = model.machine.home_plate_angle_rad, model.machine.nominal_elevator_speed_rad_s
    loads = []
    for number in range(int(chance.integers(2, 11))):
        flow = chance.uniform(5.0, 12.0) * np.exp(chance.normal(0.0, 0.15, WINDOWS))
        force = hidden.force(np.full(WINDOWS, angle), np.full(WINDOWS, speed), flow) * np.exp(chance.normal(0.0, SCATTER_SD))
        weighed = float(np.sum(flow) * WINDOW_S * np.exp(chance.normal(0.0, SCALE_SD)))
        loads.append(
            WeighedLoad(
                str(number),
                weighed,
                SCALE_SD * weighed,
                np.full(WINDOWS, WINDOW_S),
                force,
                np.full(WINDOWS, angle),
                np.full(WINDOWS, speed),
            )
        )
    return MachineLoads(name, model, tuple(loads)), hidden

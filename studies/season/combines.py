"""The five combines of the season: one that is as the estimator believes, and four that are not."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from yieldmon.estimation.fitting.calibration import calibrate
from yieldmon.estimation.fitting.measurements import Measurements
from yieldmon.physics.machine import RPM, Machine
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.plant.effects import Effects, JetShielding, PlateFriction, ResidualRadialSpeed
from yieldmon.plant.scenario import Scenario, ScenarioCrop

Array = NDArray[np.float64]
Ratio = Callable[[Array, Array, Array], Array]
"""Force over that of the virtual combine, by plate angle (rad), paddle mass (kg) and friction."""
CAMPAIGN = Path(__file__).resolve().parents[2] / "tests" / "data" / "dem_campaign.csv"
START = {"friction": 0.3, "density": 1000.0, "shape_ratio": 2.0, "restitution": 0.5, "gravity.acceleration_m_s2": 9.81}


@dataclass(frozen=True)
class Combine:
    """What a season's combine does beside the defaults. ratio: None where its force is the virtual combine's."""

    name: str
    effects: Effects
    shape_ratio: float = 2.0
    ratio: Ratio | None = None

    def scenario(self, base: Scenario) -> Scenario:
        """The base's crop and sensor with this combine's effects."""
        crop: ScenarioCrop = base.crop.model_copy(update={"shape_ratio": self.shape_ratio})
        kept = {"moisture_dependence": base.effects.moisture_dependence}
        return base.model_copy(update={"crop": crop, "effects": self.effects.model_copy(update=kept)})


AS_MODELLED = Combine("as modelled", Effects())


def _with(**effects: object) -> Effects:
    return Effects().model_copy(update=effects)


def five() -> dict[str, Combine]:
    """The combines by name."""
    friction = PlateFriction(friction=0.15)
    both = _with(plate_friction=friction, jet_shielding=JetShielding(), residual_radial_speed=ResidualRadialSpeed())
    return {
        combine.name: combine
        for combine in (
            AS_MODELLED,
            Combine("plate friction", _with(plate_friction=friction)),
            Combine("friction, shielding, radial speed", both),
            Combine("h_f 3", Effects(), shape_ratio=3.0),
            Combine("discrete elements", Effects(), ratio=discrete_elements),
        )
    }


@lru_cache(maxsize=1)
def _surfaces() -> tuple[Array, RegularGridInterpolator]:
    """Frictions of the campaign, and ln(force over the model's best fit of each) by friction, angle and paddle mass."""
    with CAMPAIGN.open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if float(row["elevator_speed_rpm"]) == 400.0]
    columns = {
        name: np.array([float(row[name]) for row in rows])
        for name in ("plate_angle_deg", "paddle_mass_kg", "momentum_total_kg_m_s", "friction")
    }
    frictions = np.unique(columns["friction"])
    angles, masses = np.unique(columns["plate_angle_deg"]), np.unique(columns["paddle_mass_kg"])
    values = np.empty((frictions.size, angles.size, masses.size))
    model = ForwardModel(Machine(), ("gravity",))
    for number, friction in enumerate(frictions):
        here = columns["friction"] == friction
        angle, mass, seen = (columns[n][here] for n in ("plate_angle_deg", "paddle_mass_kg", "momentum_total_kg_m_s"))
        conditions = Conditions(np.radians(angle), np.full(angle.shape, 400.0 * RPM), paddle_mass_kg=mass)
        found = calibrate(
            model, Measurements(conditions, seen, 0.02 * seen), START, ("friction", "restitution", "density"), intervals=False
        )
        away = np.log(seen / np.real(model.paddle_momentum(conditions, found.parameter_set.values, overfull="nan")))
        for i, a in enumerate(angles):
            for k, m in enumerate(masses):
                values[number, i, k] = np.mean(away[(angle == a) & (mass == m)])
    filled = np.nan_to_num(values)
    grid = (frictions, np.radians(angles), np.sqrt(masses))
    return values, RegularGridInterpolator(grid, filled, bounds_error=False, fill_value=None)


def discrete_elements(plate_angle_rad: Array, paddle_mass_kg: Array, friction: Array) -> Array:
    """Ratio of the discrete-element campaign's force to the model's best fit of it; held at the campaign's ends."""
    _, surface = _surfaces()
    low, high = (np.array([axis[end] for axis in surface.grid]) for end in (0, -1))
    at = np.stack(np.broadcast_arrays(friction, plate_angle_rad, np.sqrt(np.maximum(paddle_mass_kg, 0.0))), axis=-1)
    return np.asarray(np.exp(surface(np.clip(at, low, high))))

"""Empirical models that users know, as baselines: load from reading without a picture of the machine.

All three, and the physical model beside them, answer the same question (which load made this reading?) and are compared by
leaving each load out in turn.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from yieldmon.estimation.flow_curve import AlphaBeta
from yieldmon.estimation.open_loop import OpenLoop
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.machine import Machine
from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import Array
from yieldmon.units import counted

from .measurements import Measurements


class LoadModel(Protocol):
    """Load from reading."""

    def load_kg(self, columns: Array, momentum: Array) -> Array:
        """Paddle mass, kg, (n,); nan where the model has no answer. columns: (4, n) as in `Measurements.columns`."""


@dataclass(frozen=True)
class ForceProportional:
    """Paddle mass = constant x momentum: the commercial one-constant calibration."""

    kg_per_momentum: float

    @classmethod
    def fit(cls, data: Measurements, mass_kg: Array) -> ForceProportional:
        """Least squares of mass."""
        return cls(float(data.momentum @ mass_kg / (data.momentum @ data.momentum)))

    def load_kg(self, columns: Array, momentum: Array) -> Array:
        """See LoadModel."""
        return self.kg_per_momentum * momentum


@dataclass(frozen=True)
class AlphaBetaLoad:
    """The alpha-beta model's flow as a load of each paddle; one pair of coefficients for all angles."""

    law: AlphaBeta
    machine: Machine

    @classmethod
    def fit(cls, data: Measurements, mass_kg: Array, machine: Machine) -> AlphaBetaLoad:
        """Least squares of flow's relative error, over loads above 0."""
        used = mass_kg > 0.0
        angle, speed = data.columns()[:2, used]
        passes = machine.passes_per_s(speed)
        return cls(AlphaBeta.fit(data.momentum[used] * passes, mass_kg[used] * passes, speed, float(angle.mean())), machine)

    def load_kg(self, columns: Array, momentum: Array) -> Array:
        """See LoadModel."""
        passes = self.machine.passes_per_s(columns[1])
        return np.asarray(self.law.flow(momentum * passes, columns[0], columns[1]) / passes)


@dataclass(frozen=True)
class InterpolatedTable:
    """Mean momentum of each known load at each angle, interpolated monotonically from the empty paddle upwards.

    Above the heaviest known load the last slope goes on; angles and speeds other than the table's have no answer.
    """

    curves: Mapping[tuple[float, float], tuple[Array, Array]]

    @classmethod
    def fit(cls, data: Measurements, mass_kg: Array) -> InterpolatedTable:
        """Means by angle, speed and load."""
        columns = data.columns()
        curves = {}
        for angle, speed in np.unique(columns[:2], axis=1).T:
            here = (columns[0] == angle) & (columns[1] == speed)
            masses = np.unique(mass_kg[here])
            means = np.array([data.momentum[here & (mass_kg == m)].mean() for m in masses])
            # Noise may turn two neighbours round; the larger reading so far stands for both.
            rising = np.maximum.accumulate(np.maximum(means, 0.0))
            keep = np.concatenate(([True], np.diff(rising) > 0.0)) & (rising > 0.0)
            curves[float(angle), float(speed)] = (np.concatenate(([0.0], rising[keep])), np.concatenate(([0.0], masses[keep])))
        return cls(curves)

    def load_kg(self, columns: Array, momentum: Array) -> Array:
        """See LoadModel."""
        from scipy.interpolate import PchipInterpolator  # It brings scipy.optimize along, half of a short command's time.

        out = np.full(momentum.shape, np.nan)
        for (angle, speed), (readings, masses) in self.curves.items():
            here = (columns[0] == angle) & (columns[1] == speed)
            if readings.size < 2 or not np.any(here):
                continue
            inside = PchipInterpolator(readings, masses)(np.clip(momentum[here], 0.0, readings[-1]))
            slope = (masses[-1] - masses[-2]) / (readings[-1] - readings[-2])
            out[here] = inside + slope * np.maximum(momentum[here] - readings[-1], 0.0)
        return out


@dataclass(frozen=True)
class Physical:
    """The forward model, inverted."""

    model: ForwardModel
    parameters: ParameterSet

    def load_kg(self, columns: Array, momentum: Array) -> Array:
        """See LoadModel."""
        machine = self.model.machine
        passes = machine.passes_per_s(columns[1])
        moisture = None if np.all(np.isnan(columns[3])) else columns[3]
        flow = OpenLoop(self.model, self.parameters).invert(momentum * passes, columns[0], columns[1], moisture)
        return np.asarray(flow / passes)


@dataclass(frozen=True, slots=True)
class Comparison:
    """One model, each load left out in turn. rms over rows as a share of the largest load; errors in per cent on cell means."""

    model: str
    rms_over_max_pct: float
    mean_abs_pct: float
    max_abs_pct: float
    unanswered: int


def paddle_mass(data: Measurements, machine: Machine) -> Array:
    """Paddle mass of each row, kg."""
    columns = data.columns()
    if data.conditions.paddle_mass_kg is not None:
        return np.asarray(columns[2])
    return np.asarray(machine.per_paddle(columns[2], columns[1]))


def compare(
    data: Measurements, machine: Machine, others: Mapping[str, Callable[[Measurements], LoadModel]] | None = None
) -> list[Comparison]:
    """The empirical models and `others` (name -> fit), cross-validated over loads. Raises ValueError for fewer than 3 loads."""
    mass = paddle_mass(data, machine)
    loads = np.unique(data.columns()[2])
    if loads.size < 3:
        raise ValueError(f"{counted(loads.size, 'load')}; cross-validation over loads needs 3 or more")
    fits: dict[str, Callable[[Measurements], LoadModel]] = {
        "force-proportional (1 constant)": lambda d: ForceProportional.fit(d, paddle_mass(d, machine)),
        "alpha-beta (2 coefficients)": lambda d: AlphaBetaLoad.fit(d, paddle_mass(d, machine), machine),
        "interpolated table": lambda d: InterpolatedTable.fit(d, paddle_mass(d, machine)),
        **(others or {}),
    }
    return [_validate(name, fit, data, mass, loads) for name, fit in fits.items()]


def _validate(name: str, fit: Callable[[Measurements], LoadModel], data: Measurements, mass: Array, loads: Array) -> Comparison:
    columns = data.columns()
    found = np.full(mass.shape, np.nan)
    cell_errors = []
    for load in loads:
        out = columns[2] == load
        model = fit(data.select(~out))
        found[out] = model.load_kg(columns[:, out], data.momentum[out])
        part = data.select(out)
        cells, index = part.cells()
        means = np.bincount(index, part.momentum) / np.bincount(index)
        cell_columns = np.stack(
            [
                np.broadcast_to(np.nan if v is None else np.asarray(v), means.shape)
                for v in (
                    cells.plate_angle_rad,
                    cells.elevator_speed_rad_s,
                    cells.mass_flow_kg_s if cells.paddle_mass_kg is None else cells.paddle_mass_kg,
                    cells.moisture_pct,
                )
            ]
        )
        true = np.bincount(index, mass[out]) / np.bincount(index)
        cell_errors.append(100.0 * (model.load_kg(cell_columns, means) / true - 1.0))
    errors = np.abs(np.concatenate(cell_errors))
    errors = errors[np.isfinite(errors)]
    known = np.isfinite(found)
    return Comparison(
        name,
        100.0 * float(np.sqrt(np.mean((found[known] - mass[known]) ** 2)) / mass.max()) if np.any(known) else float("nan"),
        float(errors.mean()) if errors.size else float("nan"),
        float(errors.max()) if errors.size else float("nan"),
        int(np.sum(~known)),
    )

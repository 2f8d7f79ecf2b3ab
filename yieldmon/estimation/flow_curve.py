"""Flow from force by a calibrated curve, without a picture of the machine: the alpha-beta model and the look-up table.

Both know one grain and the conditions they were calibrated in; neither follows the plate, and no sweep updates them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from yieldmon.physics.machine import SAME_ANGLE_RAD
from yieldmon.physics.numerics import Array

from .beyond_range import speed_error_beyond
from .model_error import LEAST_LEVEL
from .open_loop import FlowEstimate, broadcast_inputs, with_status
from .parameters import CalibratedRange, ParameterSet

LEAST_RELATIVE_STD_DEV = 0.002
"""Of a curve: no table is better, whatever its rows agree to."""
OFFSET_SHARE = 0.1
"""Errors are relative to the flow plus this share of the highest calibrated flow, because no curve is accurate for a thin
stream."""
ANGLE_STD_DEV_PER_RAD = 1.5
"""Relative standard deviation of flow for each radian between the plate and the nearest calibrated angle: what the force of the
published model changes by about 70 deg (table 11.2, 9 kg/s), over what the flow changes it by."""
_STEP = 1e-4


@dataclass(frozen=True, slots=True)
class AlphaBeta:
    """Mass flow = alpha x + beta x^2 with x = mean force / elevator speed (N s / rad), at one plate angle.

    Attributes
    ----------
    alpha : float
        kg/s for each N s.
    beta : float
        kg/s for each (N s)^2.
    plate_angle_rad : float
        At which it was calibrated.
    """

    kind: ClassVar[str] = "alpha_beta"
    alpha: float
    beta: float
    plate_angle_rad: float

    @classmethod
    def fit(cls, force_n: Array, mass_flow_kg_s: Array, elevator_speed_rad_s: Array, plate_angle_rad: float) -> AlphaBeta:
        """Least squares of the flow's error, relative to the flow and OFFSET_SHARE of the highest."""
        x = force_n / elevator_speed_rad_s
        scale = mass_flow_kg_s + OFFSET_SHARE * mass_flow_kg_s.max()
        design = np.stack((x, x * x), axis=-1) / scale[:, None]
        alpha, beta = np.linalg.lstsq(design, mass_flow_kg_s / scale, rcond=None)[0]
        return cls(float(alpha), float(beta), plate_angle_rad)

    @property
    def angles_rad(self) -> tuple[float, ...]:
        """Plate angles at which it was calibrated."""
        return (self.plate_angle_rad,)

    @property
    def coefficients(self) -> Mapping[str, float]:
        """By name."""
        return {"alpha": self.alpha, "beta": self.beta}

    def flow(self, force_n: Array, plate_angle_rad: Array, elevator_speed_rad_s: Array) -> Array:
        """Mass flow, kg/s, of forces above 0; nan beyond the top of the parabola."""
        x = force_n / elevator_speed_rad_s
        rising = self.alpha + 2.0 * self.beta * x > 0.0
        return np.where(rising, (self.alpha + self.beta * x) * x, np.nan)


@dataclass(frozen=True, slots=True)
class TableColumn:
    """The table at one plate angle: forces (n,) at the table's speed and their mass flows (n,), both rising from above 0."""

    plate_angle_rad: float
    force_n: tuple[float, ...]
    mass_flow_kg_s: tuple[float, ...]

    def __post_init__(self) -> None:
        for name in ("force_n", "mass_flow_kg_s"):
            values = (0.0, *getattr(self, name))
            if len(values) < 3 or any(b <= a for a, b in pairwise(values)):
                raise ValueError(f"table: {name} is {list(values[1:])}; expected two or more numbers that rise from above 0")
        if len(self.force_n) != len(self.mass_flow_kg_s):
            raise ValueError(f"table: {len(self.force_n)} forces and {len(self.mass_flow_kg_s)} flows; expected as many")


@dataclass(frozen=True, slots=True)
class LookUpTable:
    """Mass flow read off a table of force, interpolated monotonically, and linearly between plate angles.

    At another elevator speed a paddle load gives momentum in proportion to the speed, so that force goes with its square and
    flow with the speed itself. Above the last force the last slope goes on.

    Attributes
    ----------
    elevator_speed_rad_s : float
        To which force and flow belong.
    columns : tuple of TableColumn
        By rising plate angle.
    """

    kind: ClassVar[str] = "table"
    elevator_speed_rad_s: float
    columns: tuple[TableColumn, ...]

    def __post_init__(self) -> None:
        angles = [column.plate_angle_rad for column in self.columns]
        if not angles or any(b - a <= SAME_ANGLE_RAD for a, b in pairwise(angles)):
            raise ValueError("table: expected one or more plate angles that rise")

    @property
    def angles_rad(self) -> tuple[float, ...]:
        """Plate angles at which it was calibrated."""
        return tuple(column.plate_angle_rad for column in self.columns)

    @property
    def coefficients(self) -> Mapping[str, float]:
        """A table has none."""
        return {}

    def flow(self, force_n: Array, plate_angle_rad: Array, elevator_speed_rad_s: Array) -> Array:
        """Mass flow, kg/s, of forces above 0."""
        faster = elevator_speed_rad_s / self.elevator_speed_rad_s
        force = force_n / faster**2
        found = np.stack([_read_off(column, force) for column in self.columns])
        angles = np.array(self.angles_rad)
        place = np.interp(plate_angle_rad, angles, np.arange(float(angles.size)))
        left = np.minimum(place.astype(int), max(angles.size - 2, 0))
        right = np.minimum(left + 1, angles.size - 1)
        share = place - left
        low, high = (np.take_along_axis(found, index[None], axis=0)[0] for index in (left, right))
        return np.asarray((low + share * (high - low)) * faster)


_CURVE_N = np.geomspace(0.1, 2000.0, 200)
"""Forces at which a curve is given, each 5 % above the one before."""

KINDS = (AlphaBeta.kind, LookUpTable.kind)
"""Names of the laws."""


def _read_off(column: TableColumn, force_n: Array) -> Array:
    from scipy.interpolate import PchipInterpolator  # It brings scipy.optimize along, half of a short command's time.

    forces, flows = np.array([0.0, *column.force_n]), np.array([0.0, *column.mass_flow_kg_s])
    inside = PchipInterpolator(forces, flows)(np.minimum(force_n, forces[-1]))
    slope = (flows[-1] - flows[-2]) / (forces[-1] - forces[-2])
    return np.asarray(inside + slope * np.maximum(force_n - forces[-1], 0.0))


@dataclass(frozen=True)
class FlowCurve:
    """A calibrated curve. relative_std_dev: of the error at a load that is not in the calibration, relative to the flow and
    OFFSET_SHARE of the highest calibrated one; provenance: plain text. exponent_std_dev: of the power of the flow by which the
    true curve may differ, about the flow about_kg_s."""

    law: AlphaBeta | LookUpTable
    relative_std_dev: float
    calibrated: CalibratedRange = field(default_factory=CalibratedRange)
    provenance: Mapping[str, str] = field(default_factory=dict)
    exponent_std_dev: float = 0.0
    about_kg_s: float = 10.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))

    def __reduce__(self) -> tuple[Any, ...]:
        # Read-only views of mappings cannot be pickled as they are.
        provenance = dict(self.provenance)
        return FlowCurve, (
            self.law, self.relative_std_dev, self.calibrated, provenance, self.exponent_std_dev, self.about_kg_s,
        )  # fmt: skip


class CurveEstimator:
    """Force to mass flow by the curve of a parameter set, as `open_loop.OpenLoop` does by its physics. Raises ValueError for a
    set without a curve."""

    def __init__(self, parameters: ParameterSet) -> None:
        if parameters.curve is None:
            raise ValueError("these parameters have no curve")
        self.parameters = parameters
        self._curve = parameters.curve

    def invert(
        self,
        force_n: ArrayLike,
        plate_angle_rad: ArrayLike,
        elevator_speed_rad_s: ArrayLike,
        moisture_pct: ArrayLike | None = None,
    ) -> Array:
        """Mass flow alone, kg/s: 0 for no force, nan where the curve has no answer. Finite input only."""
        inputs = (np.asarray(v, dtype=float) for v in (force_n, plate_angle_rad, elevator_speed_rad_s))
        return self._flow(*np.broadcast_arrays(*inputs))

    def estimate(
        self,
        force_n: ArrayLike,
        plate_angle_rad: ArrayLike,
        elevator_speed_rad_s: ArrayLike,
        force_std_dev_n: ArrayLike = 0.0,
        moisture_pct: ArrayLike | None = None,
    ) -> FlowEstimate:
        """Mass flow with standard deviation and status; scalars or arrays that broadcast, any of them nan where unknown."""
        (force, angle, speed, noise, moist), usable = broadcast_inputs(
            force_n, plate_angle_rad, elevator_speed_rad_s, force_std_dev_n, moisture_pct
        )
        force, angle, speed, noise = (
            np.where(usable, v, other) for v, other in ((force, 0.0), (angle, 1.0), (speed, 1.0), (noise, 0.0))
        )
        flow = self._flow(force, angle, speed)
        thin = np.maximum(force, 1e-3)
        slope = (self._flow(thin * (1.0 + _STEP), angle, speed) - self._flow(thin * (1.0 - _STEP), angle, speed)) / (
            2.0 * _STEP * thin
        )
        noise_sd = noise * np.abs(slope)
        away = np.min(np.abs(angle[..., None] - np.array(self._curve.law.angles_rad)), axis=-1)
        between = (angle > self._curve.law.angles_rad[0]) & (angle < self._curve.law.angles_rad[-1])
        away = np.where(between | (away <= SAME_ANGLE_RAD), 0.0, away)
        beyond = np.hypot(
            ANGLE_STD_DEV_PER_RAD * away, speed_error_beyond(self._curve.calibrated, self._curve.relative_std_dev, speed)
        )
        share = flow / self._curve.about_kg_s
        # Upwards as far as the parabola of another slope goes.
        apart = np.where(share > 1.0, share - 1.0, 0.5 * np.log(np.square(share) + LEAST_LEVEL**2))
        beyond = np.hypot(beyond, self._curve.exponent_std_dev * apart)
        sd = np.hypot(noise_sd, np.hypot(self._own_std_dev(flow), beyond * flow))
        outside = (away > 0.0) | self._curve.calibrated.outside(flow, None, speed, moist)
        return with_status(flow, sd, noise_sd, outside=outside, empty=force <= 0.0, usable=usable)

    def force_curve(
        self, plate_angle_rad: float, elevator_speed_rad_s: float, moisture_pct: float = float("nan")
    ) -> tuple[Array, Array]:
        """Force, N, and mass flow, kg/s, (g,) each, as `OpenLoop.force_curve`: flow nan where the curve has no answer."""
        return _CURVE_N, self.invert(_CURVE_N, plate_angle_rad, elevator_speed_rad_s)

    def _flow(self, force: Array, angle: Array, speed: Array) -> Array:
        shape = np.shape(force)
        flat = [np.ravel(v) for v in (np.maximum(force, 0.0), angle, speed)]
        return np.asarray(self._curve.law.flow(*flat).reshape(shape))

    def _own_std_dev(self, flow: Array) -> Array:
        """Of the curve, kg/s; growing above the highest calibrated flow, where that is known."""
        limits = self._curve.calibrated.mass_flow_kg_s
        high = np.full(flow.shape, limits[1]) if limits is not None else flow
        scale = flow + OFFSET_SHARE * high
        least = max(self._curve.relative_std_dev, LEAST_RELATIVE_STD_DEV)
        return np.asarray(least * scale * np.maximum(flow, high) / np.maximum(high, 1e-9))


def with_curve(parameters: ParameterSet, curve: FlowCurve) -> ParameterSet:
    """The set with a curve that gives the flow from now on; its own values stay for what else needs a picture of the machine."""
    facts = {**curve.provenance, "estimator": curve.law.kind}
    if "crop" in parameters.provenance:
        facts.setdefault("crop", parameters.provenance["crop"])
    return replace(parameters, curve=curve, calibrated=curve.calibrated, provenance=facts)

"""A calibrated set of parameters: values, what is known of their errors, where they hold and where they came from."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from math import isfinite
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from yieldmon.physics.effects import changes_force, effect_parameter
from yieldmon.physics.grain import EXCHANGE_FORM, GRAIN, REQUIRED
from yieldmon.physics.machine import SAME_ANGLE_RAD
from yieldmon.physics.numerics import Array

from .clusters import SAME_LOAD
from .model_error import UNKNOWN

if TYPE_CHECKING:
    from .flow_curve import FlowCurve

SPEED_MARGIN = 0.05
"""Relative change of the elevator speed that a calibration at one speed covers."""
MOISTURE_MARGIN_PCT = 1.0
"""How much wetter or drier than was calibrated grain may be: a meter on the combine repeats no better, and a weighed load has one
mean moisture."""
SCALE, WEIGHED, BY_KERNELS, NOT_CALIBRATED, CARRIED = "scale", "weighed", "kernel noise", "not calibrated", "another crop"
"""Key of the provenance, and its values for parameters whose scale weighed masses or kernel noise have set, for those of
another machine, and for those whose scale is that of this machine in another crop."""
CARRIED_FROM = "scale_from"
"""Key of the provenance for that crop's name."""
METHOD, PUBLISHED, POOLED = "method", "published properties", "pooled over machines (empirical Bayes)"
"""Key of the provenance, and its values for a crop's parameters from the literature and from the loads of other machines."""
UNCALIBRATED_SD = 0.45
"""Relative standard deviation of the force on a machine that nothing was calibrated on: docs/internals/standard-deviations.md."""
CARRIED_SD = 0.12
"""The same where the machine's scale was set in another crop: studies/crop_change."""

_LARGEST_CORRELATION = 1.0 + 1e-6
_ROUNDING = 1e-9
"""Of a covariance, over the largest variance."""
_LEAST_EIGENVALUE = -1e-3
"""Of a matrix of correlations: those written with three digits may be as far from one that is possible."""


@dataclass(frozen=True, slots=True)
class CalibratedRange:
    """Where the calibration data lay: (lowest, highest), SI and radians; None where it is not known."""

    mass_flow_kg_s: tuple[float, float] | None = None
    plate_angle_rad: tuple[float, float] | None = None
    elevator_speed_rad_s: tuple[float, float] | None = None
    moisture_pct: tuple[float, float] | None = None

    def outside(
        self,
        mass_flow_kg_s: Array,
        plate_angle_rad: Array | None = None,
        elevator_speed_rad_s: Array | None = None,
        moisture_pct: Array | None = None,
    ) -> NDArray[np.bool_]:
        """Where conditions lie outside the range; False for what is nan, not given, or whose range is not known.

        Parameters
        ----------
        mass_flow_kg_s, plate_angle_rad, elevator_speed_rad_s, moisture_pct : ndarray
            Of one shape. An angle or a flow may lie as far outside as two may that count as the same, since an actuator reaches
            the outermost angle to its accuracy only; a speed by SPEED_MARGIN, since no elevator holds that of a test facility; a
            moisture by MOISTURE_MARGIN_PCT.

        Returns
        -------
        ndarray of bool
        """
        outside = np.zeros(np.shape(mass_flow_kg_s), dtype=bool)
        for value, limits, same, share in (
            (mass_flow_kg_s, self.mass_flow_kg_s, 0.0, SAME_LOAD),
            (plate_angle_rad, self.plate_angle_rad, SAME_ANGLE_RAD, 0.0),
            (elevator_speed_rad_s, self.elevator_speed_rad_s, 0.0, SPEED_MARGIN),
            (moisture_pct, self.moisture_pct, MOISTURE_MARGIN_PCT, 0.0),
        ):
            if value is not None and limits is not None:
                low, high = ((1.0 + sign * (share + 1e-9)) * end + sign * same for sign, end in zip((-1, 1), limits, strict=True))
                outside |= (value < low) | (value > high)
        return outside


@dataclass(frozen=True)
class ParameterSet:
    """Calibrated parameters: values, errors, range and origin.

    Parameters
    ----------
    values : mapping of str to float
        `friction`, `density` (kg/m3), `shape_ratio`, `restitution` or `k1` and `k2`, and `effect.parameter` for each effect.
    covariance_names : tuple of str
        n of the values; the others count as exactly known.
    covariance : ndarray
        (n, n) in the order of covariance_names.
    calibrated : CalibratedRange
        Where the calibration data lay.
    response_unit : str
        Unit of the reading, "N" for a force.
    version : int
        Counts the sets of a machine.
    provenance : mapping of str to str
        Hash of the data file, date, method, parent version.
    model_error : float or None
        Relative standard deviation of a predicted force that is the model's own and no parameter's; 0: none beside the
        covariance; None: not known, so that the calibrated range bounds no error beyond it (see also `own_error`).
    curve : FlowCurve, optional
        What gives the flow in place of the physics; None: the physics.

    Raises
    ------
    ValueError
        When the pieces do not fit together, and for values and covariances that nothing can have.

    Examples
    --------
    >>> grain = {"friction": 0.2, "restitution": 0.6, "density": 1100.0, "shape_ratio": 2.0}
    >>> known = api.ParameterSet(grain, ("friction", "density"), np.diag([0.02**2, 50.0**2]))
    >>> known.standard_deviation("density"), known.standard_deviation("shape_ratio")
    (50.0, 0.0)
    """

    values: Mapping[str, float]
    covariance_names: tuple[str, ...] = ()
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    calibrated: CalibratedRange = CalibratedRange()
    response_unit: str = "N"
    version: int = 1
    provenance: Mapping[str, str] = field(default_factory=dict)
    model_error: float | None = 0.0
    curve: FlowCurve | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", MappingProxyType(dict(self.values)))
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))
        covariance = np.array(self.covariance, dtype=float)
        covariance.setflags(write=False)
        object.__setattr__(self, "covariance", covariance)
        count = len(self.covariance_names)
        if covariance.shape != (count, count):
            raise ValueError(f"covariance has shape {covariance.shape}; expected ({count}, {count}) for its names")
        missing = [name for name in self.covariance_names if name not in self.values]
        if missing:
            raise ValueError(f"covariance names {missing} have no value; expected some of {list(self.values)}")
        if twice := sorted({name for name in self.covariance_names if self.covariance_names.count(name) > 1}):
            raise ValueError(f"covariance names {twice} more than once; expected each parameter once")
        _refuse_impossible(self.covariance_names, covariance)
        _refuse_unknown(self.values)
        _refuse_values(self.values)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, ParameterSet):
            return NotImplemented
        return all(np.array_equal(getattr(self, f.name), getattr(other, f.name)) for f in fields(self))

    def __hash__(self) -> int:
        return hash((frozenset(self.values.items()), self.version))

    def __reduce__(self) -> tuple[Any, ...]:
        # Read-only views of mappings cannot be pickled as they are.
        return ParameterSet, (
            dict(self.values), self.covariance_names, np.array(self.covariance), self.calibrated, self.response_unit,
            self.version, dict(self.provenance), self.model_error, self.curve,
        )  # fmt: skip

    @cached_property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects with values in the set that change a force, in alphabetical order."""
        named = {name.partition(".")[0] for name in self.values if "." in name}
        return tuple(sorted(name for name in named if changes_force(name)))

    @property
    def is_weighed(self) -> bool:
        """Whether weighed masses have set the scale: at the angle where these were measured it is that of the machine, whatever
        the model lacks."""
        return self.provenance.get(SCALE) == WEIGHED

    @property
    def own_error(self) -> float:
        """Of `model_error` within the calibrated range. Where it is not known: 0 beside a stated covariance or range, or where
        weighed masses have led to these parameters, else that of the published tables."""
        if self.model_error is not None:
            return self.model_error
        stated = self.covariance_names or self.calibrated != CalibratedRange()
        return 0.0 if stated or self.is_weighed else UNKNOWN

    @property
    def scale_error(self) -> float:
        """Relative standard deviation of the force, alike at all angles and flows, where the parameters are not this machine's:
        from published properties or calibrated on another machine, until weighed masses or kernel noise set the scale; or where
        these have set it in another crop; else 0."""
        scale = self.provenance.get(SCALE, NOT_CALIBRATED if self.provenance.get(METHOD) == PUBLISHED else "")
        if self.curve is not None:
            return 0.0
        return {NOT_CALIBRATED: UNCALIBRATED_SD, CARRIED: CARRIED_SD}.get(scale, 0.0)

    @property
    def scale_is_measured(self) -> bool:
        """Whether a weighed load or a calibration set the scale: neither a prior alone nor kernel noise, whose flow is
        proportional to the thousand-kernel weight that was entered."""
        return self.scale_error == 0.0 and self.provenance.get(SCALE) != BY_KERNELS

    @property
    def carried_from(self) -> str:
        """The crop in which the scale was set, where it is that of another one (`weighing.other_crop`); else ""."""
        return self.provenance.get(CARRIED_FROM, "") if self.provenance.get(SCALE) == CARRIED else ""

    def standard_deviation(self, name: str) -> float:
        """Standard deviation of one parameter.

        Parameters
        ----------
        name : str

        Returns
        -------
        float
            In the parameter's unit; 0 where it counts as exactly known.
        """
        if name not in self.covariance_names:
            return 0.0
        index = self.covariance_names.index(name)
        return float(np.sqrt(self.covariance[index, index]))

    def covariance_of(self, names: Iterable[str]) -> Array:
        """Covariance of some parameters.

        Parameters
        ----------
        names : iterable of str
            m of them.

        Returns
        -------
        ndarray
            (m, m) in the order of `names`; zero rows for parameters that count as exactly known.
        """
        wanted = list(names)
        out = np.zeros((len(wanted), len(wanted)))
        for i, a in enumerate(wanted):
            for j, b in enumerate(wanted):
                if a in self.covariance_names and b in self.covariance_names:
                    out[i, j] = self.covariance[self.covariance_names.index(a), self.covariance_names.index(b)]
        return out


def _refuse_unknown(values: Mapping[str, float]) -> None:
    """Raises ValueError where a parameter is missing, one too many, or of no grain and no effect."""
    for name in REQUIRED:
        if name not in values:
            raise ValueError(f"parameter {name} is missing; given are {list(values)}")
    exchange = sum(name in values for name in EXCHANGE_FORM)
    if exchange != (0 if "restitution" in values else len(EXCHANGE_FORM)):
        raise ValueError("parameters need either restitution, or k1 and k2")
    for name in values:
        if changes_force(name.partition(".")[0]) and name not in GRAIN:
            if "." not in name:
                raise ValueError(f"parameter {name!r}: unknown; expected one of {', '.join(GRAIN)} or effect.parameter")
            effect_parameter(name)


def _refuse_values(values: Mapping[str, float]) -> None:
    """Raises ValueError for values that nothing can have."""
    for name, value in values.items():
        # A search may pass through a restitution below 0; nothing has a density of 0 or less.
        above_0 = name in GRAIN and not GRAIN[name].follows_response and GRAIN[name].limits[0] > 0.0
        if not isfinite(value) or (above_0 and not value > 0.0):
            raise ValueError(f"{name} is {value:g}; expected a number{' above 0' if above_0 else ''}")


def _refuse_impossible(names: tuple[str, ...], covariance: Array) -> None:
    """Raises ValueError for a matrix that is no covariance of any quantities."""
    if not np.all(np.isfinite(covariance)):
        raise ValueError("covariance holds numbers that are not finite")
    exactly = np.array_equal(covariance, covariance.T)
    if not exactly and not np.allclose(covariance, covariance.T, rtol=1e-9, atol=0.0):
        raise ValueError("covariance is not symmetric")
    variance = np.diag(covariance)
    if np.any(variance < 0.0):
        raise ValueError("covariance has a negative variance")
    std_dev = np.sqrt(variance)
    largest = _LARGEST_CORRELATION * np.outer(std_dev, std_dev) + _ROUNDING * variance.max(initial=0.0)
    for i, j in np.argwhere(np.abs(covariance) > largest):
        first, second = (names[k] for k in sorted((i, j)))
        problem = f"{first} and {second}: {covariance[i, j]:g} with variances {std_dev[i] ** 2:g} and {std_dev[j] ** 2:g}"
        raise ValueError(f"covariance.matrix: {problem}; expected a correlation from -1 to 1")
    known_to_vary = np.flatnonzero(std_dev > 0.0)
    if known_to_vary.size:
        part = np.ix_(known_to_vary, known_to_vary)
        lowest = float(np.linalg.eigvalsh(covariance[part] / np.outer(std_dev, std_dev)[part])[0])
        if lowest < _LEAST_EIGENVALUE:
            problem = f"has correlations that cannot all be: their lowest eigenvalue is {lowest:.2g}"
            raise ValueError(f"covariance.matrix: {problem}; expected 0 or more")

"""Measurements for the closed loop: sweeps of the plate, weighed masses, an independent density."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.model import Conditions, ForwardModel, refuse_impossible
from yieldmon.physics.numerics import Array

_LEAST_NOISE = 1e-9
"""Least standard deviation relative to the largest force; smaller ones cause rounding errors in all else."""
_SWEEP = ("time_s", "plate_angle_rad", "elevator_speed_rad_s", "force_n", "force_std_dev_n")
SWEEP_COLUMNS = (*_SWEEP, "moisture_pct")
"""Columns of a sweep's windows, including the optional ones."""
WEIGHED_COLUMNS = ("duration_s", "force_n", "plate_angle_rad", "elevator_speed_rad_s")
"""Columns of the windows of a weighed mass or load."""


def joined(weighed: Sequence[object]) -> tuple[Array, Array, Array, Array]:
    """`WEIGHED_COLUMNS` of several weighed masses or loads, one after the other."""
    duration, force, angle, speed = (np.concatenate([getattr(one, name) for one in weighed]) for name in WEIGHED_COLUMNS)
    return duration, force, angle, speed


def _as_arrays(windows: Sweep | WeighedMass, names: tuple[str, ...]) -> None:
    """Lists of numbers become arrays."""
    for name in (*names, "moisture_pct"):
        value = getattr(windows, name)
        if value is not None or name != "moisture_pct":
            object.__setattr__(windows, name, np.asarray(value, dtype=float))


def _refuse_uneven(windows: Sweep | WeighedMass, what: str, names: tuple[str, ...]) -> None:
    shape = windows.force_n.shape
    for name in names:
        value = getattr(windows, name)
        if value.shape != shape or len(shape) != 1 or not shape[0] or not np.all(np.isfinite(value)):
            raise ValueError(f"{what}: {name} must hold one finite number for each window")
    if windows.moisture_pct is not None and windows.moisture_pct.shape != shape:
        raise ValueError(f"{what}: moisture_pct must hold one number for each window")


@dataclass(frozen=True)
class Sweep:
    """Windows of one sweep of the plate.

    Parameters
    ----------
    time_s : array_like
        (n,) s, of any epoch.
    plate_angle_rad : array_like
        (n,) rad.
    elevator_speed_rad_s : array_like
        (n,) rad/s.
    force_n, force_std_dev_n : array_like
        (n,) mean horizontal force and its standard deviation, N.
    moisture_pct : array_like, optional
        (n,) %, where an effect needs it.

    Raises
    ------
    ValueError
        For shapes that differ, values that are not finite, or standard deviations that are 0 or negligible against the forces.

    Examples
    --------
    >>> angle = np.radians([40.0, 60.0, 80.0])
    >>> sweep = api.Sweep(np.arange(3.0), angle, np.full(3, 400.0 * api.RPM), np.array([91.0, 92.0, 88.0]), np.ones(3))
    >>> sweep.force_n.shape
    (3,)
    """

    time_s: Array
    plate_angle_rad: Array
    elevator_speed_rad_s: Array
    force_n: Array
    force_std_dev_n: Array
    moisture_pct: Array | None = None

    def __post_init__(self) -> None:
        _as_arrays(self, _SWEEP)
        _refuse_uneven(self, "sweep", _SWEEP)
        if np.any(self.force_std_dev_n <= 0.0):
            raise ValueError("sweep: force_std_dev_n must be above 0")
        if np.any(self.force_std_dev_n < _LEAST_NOISE * np.max(np.abs(self.force_n))):
            raise ValueError(f"sweep: force_std_dev_n must be at least {_LEAST_NOISE:g} of the largest force")


@dataclass(frozen=True)
class WeighedMass:
    """A weighed mass and the windows in which it was harvested.

    Parameters
    ----------
    reference_kg, std_dev_kg : float
        Weighed mass and its standard deviation, kg.
    duration_s : array_like
        (n,) duration of each window, s.
    force_n, plate_angle_rad, elevator_speed_rad_s : array_like
        (n,) N, rad, rad/s.
    moisture_pct : array_like, optional
        (n,) %, where an effect needs it.
    common_kg : float
        The part of std_dev_kg that comes from another combine's monitor, kg. Its error is the same in all masses.

    Examples
    --------
    >>> seconds = np.ones(3000)
    >>> load = api.WeighedMass.from_windows(9000.0, 45.0, seconds, 28.0 * seconds, 1.22 * seconds, 41.9 * seconds)
    >>> float(load.duration_s.sum())
    3000.0
    """

    reference_kg: float
    std_dev_kg: float
    duration_s: Array
    force_n: Array
    plate_angle_rad: Array
    elevator_speed_rad_s: Array
    moisture_pct: Array | None = None
    common_kg: float = 0.0

    def __post_init__(self) -> None:
        _as_arrays(self, WEIGHED_COLUMNS)

    def require_usable(self) -> None:
        """Raise an error if the data are not usable.

        Raises
        ------
        ValueError
            For shapes that differ, values that are not finite, a standard deviation that is not above 0, and an angle or a speed
            outside its range.
        """
        _refuse_uneven(self, "weighed mass", WEIGHED_COLUMNS)
        refuse_impossible("weighed mass", self.plate_angle_rad, self.elevator_speed_rad_s)
        if not (np.isfinite(self.reference_kg) and 0.0 <= self.common_kg < self.std_dev_kg < np.inf):
            known = f"{self.reference_kg:g} kg within {self.std_dev_kg:g} kg"
            raise ValueError(f"weighed mass: {known}: expected a mass, and a standard deviation above 0 and common_kg")

    @classmethod
    def from_windows(
        cls,
        reference_kg: float,
        std_dev_kg: float,
        duration_s: Array,
        force_n: Array,
        plate_angle_rad: Array,
        elevator_speed_rad_s: Array,
        *,
        moisture_pct: Array | None = None,
        common_kg: float = 0.0,
        groups: int = 12,
    ) -> WeighedMass:
        """Build it from many windows: at each plate angle, windows of similar force are replaced by their mean.

        Parameters
        ----------
        reference_kg, std_dev_kg, duration_s, force_n, plate_angle_rad, elevator_speed_rad_s, moisture_pct, common_kg
            As in `WeighedMass`.
        groups : int
            Largest number of groups at each plate angle.

        Returns
        -------
        WeighedMass

        Raises
        ------
        ValueError
            For shapes that differ, values that are not finite, and groups below 1.
        """
        if groups < 1:
            raise ValueError(f"weighed mass: groups {groups}: expected 1 or more")
        each = cls(reference_kg, std_dev_kg, duration_s, force_n, plate_angle_rad, elevator_speed_rad_s, moisture_pct, common_kg)
        _refuse_uneven(each, "weighed mass", WEIGHED_COLUMNS)
        duration_s, force_n, plate_angle_rad, elevator_speed_rad_s = (getattr(each, name) for name in WEIGHED_COLUMNS)
        moisture_pct = each.moisture_pct
        bins = np.round(plate_angle_rad / np.radians(2.0)).astype(int)
        parts = []
        for value in np.unique(bins):
            here = np.flatnonzero(bins == value)
            order = here[np.argsort(force_n[here], kind="stable")]
            parts += [p for p in np.array_split(order, min(groups, order.size)) if duration_s[p].sum() > 0.0]
        weight = [duration_s[p] / duration_s[p].sum() for p in parts]

        def mean(column: Array) -> Array:
            return np.array([w @ column[p] for p, w in zip(parts, weight, strict=True)])

        return cls(
            reference_kg,
            std_dev_kg,
            np.array([duration_s[p].sum() for p in parts]),
            mean(force_n),
            mean(plate_angle_rad),
            mean(elevator_speed_rad_s),
            None if moisture_pct is None else mean(moisture_pct),
            common_kg,
        )

    @classmethod
    def from_total(
        cls,
        reference_kg: float,
        std_dev_kg: float,
        measured_kg: float,
        *,
        model: ForwardModel,
        parameters: ParameterSet,
        mass_flow_kg_s: float,
        plate_angle_rad: float,
        elevator_speed_rad_s: float,
    ) -> WeighedMass:
        """Build it from a measured total alone.

        Parameters
        ----------
        reference_kg, std_dev_kg : float
            Weighed mass and its standard deviation, kg.
        measured_kg : float
            Measured mass, kg.
        model : ForwardModel
        parameters : ParameterSet
            Parameters with which it was measured.
        mass_flow_kg_s, plate_angle_rad, elevator_speed_rad_s : float
            Approximate conditions of the measurement, kg/s, rad, rad/s.

        Returns
        -------
        WeighedMass

        Raises
        ------
        ValueError
            For a mass flow that is not above 0, and as `ForwardModel.force`.
        """
        if not mass_flow_kg_s > 0.0:
            raise ValueError(f"weighed mass: mass_flow_kg_s {mass_flow_kg_s:g}: expected a flow above 0")
        conditions = Conditions(plate_angle_rad, elevator_speed_rad_s, mass_flow_kg_s=mass_flow_kg_s)
        force = np.atleast_1d(np.real(model.force(conditions, parameters.values)))
        return cls(
            reference_kg,
            std_dev_kg,
            np.array([measured_kg / mass_flow_kg_s]),
            force,
            np.array([plate_angle_rad]),
            np.array([elevator_speed_rad_s]),
        )


@dataclass(frozen=True, slots=True)
class MeasuredDensity:
    """An independent measurement of the density.

    Parameters
    ----------
    density_kg_m3, std_dev_kg_m3 : float
        Value of the parameter `density` and its standard deviation, kg/m3; both above 0.

    Examples
    --------
    >>> api.MeasuredDensity.from_test_weight(720.0, 10.0, 1.5, 0.06).density_kg_m3
    1080.0
    """

    density_kg_m3: float
    std_dev_kg_m3: float

    def require_usable(self) -> None:
        """Raise an error if the data are not usable.

        Raises
        ------
        ValueError
            For a density or a standard deviation that is not above 0.
        """
        for name in ("density_kg_m3", "std_dev_kg_m3"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ValueError(f"density: {name} {getattr(self, name):g}: expected a number above 0")

    @classmethod
    def from_test_weight(
        cls, test_weight_kg_m3: float, std_dev_kg_m3: float, ratio: float, ratio_std_dev: float
    ) -> MeasuredDensity:
        """Build it from a test weight. The fitted density differs from it, since it is that of the heap on a paddle.

        Parameters
        ----------
        test_weight_kg_m3, std_dev_kg_m3 : float
            Test weight and its standard deviation, kg/m3.
        ratio, ratio_std_dev : float
            Fitted density over test weight in a calibration, and its standard deviation.

        Returns
        -------
        MeasuredDensity

        Raises
        ------
        ValueError
            For a test weight or a ratio that is not above 0.
        """
        for name, value in (("test_weight_kg_m3", test_weight_kg_m3), ("ratio", ratio)):
            if not 0.0 < value < np.inf:
                raise ValueError(f"density: {name} {value:g}: expected a number above 0")
        relative = np.hypot(std_dev_kg_m3 / test_weight_kg_m3, ratio_std_dev / ratio)
        return cls(ratio * test_weight_kg_m3, float(ratio * test_weight_kg_m3 * relative))

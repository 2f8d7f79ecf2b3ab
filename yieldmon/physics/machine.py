"""Machine geometry.

Axes: origin at the upper sprocket's centre, x to the right, y down, angles clockwise from +x; the paddle points straight up at
3 pi/2. Source: "Self-Calibrating Mass Flow Sensor" (Univ. of Illinois / Deere), tables 8.1 and 11.1, figure 8.1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import cos, inf, pi
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Speed = TypeVar("Speed", float, "NDArray[np.float64]", "NDArray[np.float64] | NDArray[np.complex128]")
"""A number or an array."""

SAME_ANGLE_RAD = 0.75 * pi / 180.0
"""Plate angles within this of each other count as one angle, in tables and in sweeps."""

RPM = 2.0 * pi / 60.0
"""rad/s in one revolution per minute."""

FASTEST_ELEVATOR_RPM = 1900.0
"""No elevator turns as fast; its revolutions per minute, taken for rad/s, lie above."""

LONGEST_RESPONSE_S = 0.1
"""Time constant of plate and cell, s, beyond which no force cell answers."""


_LONGEST_M = 10.0
"""No part of an elevator is as long; lengths in mm are."""
_SPEEDS = f"above 0, up to {FASTEST_ELEVATOR_RPM * RPM:.0f} ({FASTEST_ELEVATOR_RPM:g} rpm)"


@dataclass(frozen=True, slots=True)
class ImpactSensor:
    """The force cell behind the plate: horizontal force, linear in voltage above its zero-load voltage."""

    gain_n_per_mv: float = 0.4448
    full_scale_mv: float = 4000.0
    response_s: float = 0.008
    """Time constant of plate and cell, critically damped."""


@dataclass(frozen=True, slots=True)
class Implement:
    """The combine around the elevator, as described to a task controller; None: not known.

    working_width_m: of the header. header_offset_m: its cutting edge ahead of the connector. connector_type: ISO 11783-11
    DDI 157, 0 is unknown. grain_delay_s: from the cutting edge to the impact plate.
    """

    working_width_m: float | None = None
    header_offset_m: float | None = None
    connector_type: int = 0
    grain_delay_s: float | None = None


@dataclass(frozen=True, slots=True)
class Machine:
    """Clean-grain elevator head and impact plate.

    Parameters
    ----------
    name : str
    sprocket_pitch_radius_m : float
        Of the upper sprocket, m.
    paddle_spacings_m : tuple of float
        Repeating pattern of distances between paddles along the chain, m.
    paddle_length_m, paddle_width_m : float
        From the sprocket's centre to the tip, and across, m.
    plate_pivot_x_m, plate_pivot_y_m : float
        Top edge of the plate, about which it turns, m.
    plate_length_m : float
        m.
    home_plate_angle_rad, min_plate_angle_rad, max_plate_angle_rad : float
        Where the plate is while it measures, and its range, rad.
    nominal_elevator_speed_rad_s, min_elevator_speed_rad_s, max_elevator_speed_rad_s : float
        Of the upper sprocket, rad/s.
    sensor : ImpactSensor
        The force cell behind the plate: N per mV, full scale in mV, response time in s.
    implement : Implement
        The combine around it, as described to a task controller.
    plate_travel_m : tuple of float
        How far the plate can be moved level from its pivot: towards the elevator (at most 0) and away from it (at least 0), m.

    Raises
    ------
    ValueError
        For a length that is not above 0 or not in m, an angle that is not in radians, a speed that is not in rad/s, a home angle
        outside the plate's range, or a plate in the paddles' way.

    Notes
    -----
    Axes: origin at the upper sprocket's centre, x to the right, y down, angles clockwise from +x.

    References
    ----------
    "Self-Calibrating Mass Flow Sensor" (Univ. of Illinois / Deere), tables 8.1 and 11.1, figure 8.1.

    Examples
    --------
    >>> machine = api.Machine()
    >>> round(machine.passes_per_s(400.0 * api.RPM), 2)
    12.16
    """

    name: str = "sprocket-8"
    sprocket_pitch_radius_m: float = 0.0541
    paddle_spacings_m: tuple[float, ...] = (0.1656, 0.2071)
    paddle_length_m: float = 0.16
    paddle_width_m: float = 0.21
    plate_pivot_x_m: float = 0.4
    plate_pivot_y_m: float = -0.16
    plate_length_m: float = 0.1887
    home_plate_angle_rad: float = 70.0 * pi / 180.0
    min_plate_angle_rad: float = 40.0 * pi / 180.0
    max_plate_angle_rad: float = 90.0 * pi / 180.0
    nominal_elevator_speed_rad_s: float = 400.0 * RPM
    min_elevator_speed_rad_s: float = 250.0 * RPM
    max_elevator_speed_rad_s: float = 599.0 * RPM
    sensor: ImpactSensor = ImpactSensor()
    implement: Implement = Implement()
    plate_travel_m: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        self._refuse_other_units()
        if not self.min_plate_angle_rad <= self.home_plate_angle_rad <= self.max_plate_angle_rad:
            raise ValueError(f"machine {self.name}: the home plate angle lies outside the plate's range")
        if not self.plate_travel_m[0] <= 0.0 <= self.plate_travel_m[1]:
            raise ValueError(f"machine {self.name}: plate_travel_m is {self.plate_travel_m}, expected [at most 0, at least 0] m")
        if self.plate_reach_m(self.plate_travel_m[0]) <= self.paddle_length_m < self.plate_reach_m(0.0):
            raise ValueError(f"machine {self.name}: plate_travel_m lets the plate into the paddles' way")

    def _refuse_other_units(self) -> None:
        for key in ("sprocket_pitch_radius_m", "paddle_length_m", "paddle_width_m", "plate_length_m"):
            if not 0.0 < getattr(self, key) <= _LONGEST_M:
                limit = f"expected a length above 0 m, up to {_LONGEST_M:g} m"
                raise ValueError(f"machine {self.name}: {key} is {getattr(self, key)}, {limit}")
        for key in ("plate_pivot_x_m", "plate_pivot_y_m"):
            if not abs(getattr(self, key)) <= _LONGEST_M:
                raise ValueError(
                    f"machine {self.name}: {key} is {getattr(self, key)}, expected m, {-_LONGEST_M:g} to {_LONGEST_M:g}"
                )
        if not self.paddle_spacings_m or not all(0.0 < spacing < inf for spacing in self.paddle_spacings_m):
            raise ValueError(f"machine {self.name}: paddle_spacings_m is {self.paddle_spacings_m}, expected lengths above 0 m")
        for key in ("home_plate_angle_rad", "min_plate_angle_rad", "max_plate_angle_rad"):
            if not 0.0 < getattr(self, key) < pi:
                raise ValueError(f"machine {self.name}: {key} is {getattr(self, key)}, expected radians, 0 to pi")
        for key in ("nominal_elevator_speed_rad_s", "min_elevator_speed_rad_s", "max_elevator_speed_rad_s"):
            if not 0.0 < getattr(self, key) <= FASTEST_ELEVATOR_RPM * RPM:
                raise ValueError(f"machine {self.name}: {key} is {getattr(self, key)}, expected rad/s, {_SPEEDS}")

    def plate_reach_m(self, plate_position_m: float) -> float:
        """Level distance from the sprocket's centre to the nearest point of the plate over its angles.

        Parameters
        ----------
        plate_position_m : float
            Of the plate from its pivot, away from the elevator, m.

        Returns
        -------
        float
            m.
        """
        low_edge_m = self.plate_length_m * min(0.0, cos(self.max_plate_angle_rad))
        return self.plate_pivot_x_m + plate_position_m + low_edge_m

    def with_plate_at(self, plate_position_m: float) -> Machine:
        """The machine with its plate moved for good.

        Parameters
        ----------
        plate_position_m : float
            Away from the elevator, m.

        Returns
        -------
        Machine
        """
        low, high = self.plate_travel_m
        travel = (min(0.0, low - plate_position_m), max(0.0, high - plate_position_m))
        return replace(self, plate_pivot_x_m=self.plate_pivot_x_m + plate_position_m, plate_travel_m=travel)

    @property
    def geometry_m(self) -> tuple[float, ...]:
        """Lengths that decide how its grain strikes the plate, m: two machines with the same ones share a calibration."""
        plate = self.plate_pivot_x_m, self.plate_pivot_y_m, self.plate_length_m
        return (self.sprocket_pitch_radius_m, self.paddle_length_m, self.paddle_width_m, *plate, *self.paddle_spacings_m)

    @property
    def paddle_spacing_m(self) -> float:
        """Mean distance between paddles, m."""
        return sum(self.paddle_spacings_m) / len(self.paddle_spacings_m)

    @property
    def pattern_length_m(self) -> float:
        """Chain travel after which the paddle pattern repeats, m."""
        return sum(self.paddle_spacings_m)

    def paddle_speed_m_s(self, elevator_speed_rad_s: Speed) -> Speed:
        """Chain speed.

        Parameters
        ----------
        elevator_speed_rad_s : float or ndarray
            Of the upper sprocket, rad/s.

        Returns
        -------
        float or ndarray
            m/s.
        """
        return elevator_speed_rad_s * self.sprocket_pitch_radius_m

    def passes_per_s(self, elevator_speed_rad_s: Speed) -> Speed:
        """Paddles that pass in a second, on average.

        Parameters
        ----------
        elevator_speed_rad_s : float or ndarray
            Of the upper sprocket, rad/s.

        Returns
        -------
        float or ndarray
            1/s.
        """
        return elevator_speed_rad_s * self.sprocket_pitch_radius_m / self.paddle_spacing_m

    def per_paddle(self, rate_per_s: Speed, elevator_speed_rad_s: Speed) -> Speed:
        """What each paddle has of a rate.

        Parameters
        ----------
        rate_per_s : float or ndarray
            A mass flow, kg/s, or a force, N.
        elevator_speed_rad_s : float or ndarray
            Of the upper sprocket, rad/s.

        Returns
        -------
        float or ndarray
            kg of a mass flow, kg m/s of a force.
        """
        return rate_per_s * self.paddle_spacing_m / (elevator_speed_rad_s * self.sprocket_pitch_radius_m)

    def full_paddle_mass_kg(self, density_kg_m3: Speed, shape_ratio: Speed) -> Speed:
        """Mass of a heap that reaches from the sprocket's centre to the tip [8.9].

        Parameters
        ----------
        density_kg_m3, shape_ratio : float or ndarray
            Of the grain.

        Returns
        -------
        float or ndarray
            kg.
        """
        return 0.5 * shape_ratio * density_kg_m3 * self.paddle_width_m * self.paddle_length_m**2

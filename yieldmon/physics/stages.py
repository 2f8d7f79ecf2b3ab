"""What passes from stage to stage of one throw; a named effect alters one of these and hands it on.

Every array carries a trailing axis for the quadrature nodes (length 1 where a quantity is the same for all of them), so that
anything broadcasts with anything. SI units and radians.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from .machine import Machine
from .numerics import AnyArray, distinct, perturbed

GRAVITY_M_S2 = 9.81
"""Default where gravity acts and its strength is not a parameter."""
STAGES = ("setting", "load", "jet", "arrival", "impulse", "reading")


@dataclass(frozen=True, slots=True)
class Setting:
    """What holds before any grain comes: geometry, operating point and grain."""

    machine: Machine
    plate_angle_rad: AnyArray
    elevator_speed_rad_s: AnyArray
    moisture_pct: AnyArray
    """nan where unknown; an effect that needs it refuses then."""
    paddle_length_m: AnyArray
    plate_pivot_x_m: AnyArray
    plate_pivot_y_m: AnyArray
    friction: AnyArray
    density: AnyArray
    """kg/m3"""
    shape_ratio: AnyArray
    restitution: AnyArray | None
    k1: AnyArray | None
    k2: AnyArray | None
    grain: Mapping[str, AnyArray] = field(default_factory=dict)
    """The grain's further parameters by name (`grain.OPTIONAL`)."""
    gravity_m_s2: AnyArray | None = None
    """None in the published model, which drops gravity."""
    release_angle_rad: AnyArray | None = None
    """Paddle angle at release, past the vertical in the sense of rotation; None in the published model: at the vertical."""
    radial_speed: AnyArray | None = None
    """Radial speed at release over (elevator speed x radius of the grain); None in the published model: at rest."""

    steady_drag_m_s: AnyArray | None = None
    """Part of the friction on the paddle that does not grow with the sliding speed, over twice the elevator speed and mass; None
    in the published model, whose friction is all in proportion to it."""

    @property
    def speed_ratio(self) -> AnyArray:
        """Elevator speed over the machine's nominal one."""
        return self.elevator_speed_rad_s / self.machine.nominal_elevator_speed_rad_s

    @property
    def perturbed(self) -> bool:
        """Whether a quantity carries a complex perturbation."""
        return bool(self._perturbed())

    def unperturbed(self) -> Setting:
        """The same setting without complex perturbations; one of several that differ in nothing else is kept."""
        changed: dict[str, Any] = {name: distinct(value.real) for name, value in self._perturbed().items()}
        return replace(self, **changed) if changed else self

    def _perturbed(self) -> dict[str, AnyArray]:
        values = ((name, getattr(self, name)) for name in _QUANTITIES)
        return {name: value for name, value in values if value is not None and perturbed(value)}

    @property
    def paddle_speed_m_s(self) -> AnyArray:
        """Chain speed."""
        return self.elevator_speed_rad_s * self.machine.sprocket_pitch_radius_m

    @property
    def passes_per_s(self) -> AnyArray:
        """Mean number of paddles that pass in a second."""
        return self.machine.passes_per_s(self.elevator_speed_rad_s)

    @property
    def full_paddle_mass_kg(self) -> AnyArray:
        """M_full [8.9]: the heap that reaches from the sprocket's centre to the tip."""
        full: AnyArray = 0.5 * self.shape_ratio * self.density * self.machine.paddle_width_m * self.paddle_length_m**2
        return full


_QUANTITIES = tuple(item.name for item in fields(Setting) if item.name not in ("machine", "grain"))
"""The arrays of a setting."""


@dataclass(frozen=True, slots=True)
class Load:
    """The grain on one paddle after filling."""

    paddle_mass_kg: AnyArray
    """What reaches the release point; at first what the mass flow brings to each paddle [8.1]."""


@dataclass(frozen=True, slots=True)
class Jet:
    """The heap as it leaves the tip, node by node from the tip inwards."""

    load: Load
    inner_radius: AnyArray
    """h0 / l"""
    release_radius: AnyArray
    """rho_0 / l"""
    mass_kg: AnyArray
    """Mass that each node stands for (quadrature weight included)."""
    travel_angle_rad: AnyArray
    """tau_d: paddle rotation from release to the tip."""
    x_m: AnyArray
    y_m: AnyArray
    vx_m_s: AnyArray
    vy_m_s: AnyArray


@dataclass(frozen=True, slots=True)
class Arrival:
    """The jet where it meets the plate's line."""

    jet: Jet
    from_low_edge_m: AnyArray
    """kappa: along the plate, negative above its low edge."""
    flight_time_s: AnyArray
    normal_speed_m_s: AnyArray
    """Into the plate."""
    tangential_speed_m_s: AnyArray
    """Along the plate, positive towards its low edge."""
    landing_share: AnyArray
    """Share of the node's mass that strikes the plate."""
    edge_blur_m: AnyArray | float = 0.0
    """Width (sqrt 2 standard deviations) over which the low edge has cut the stream; 0: a sharp cut."""

    @property
    def flight_length_m(self) -> AnyArray:
        """Length of the path from the tip at the speed there; inf for a path that never meets the plate's line."""
        length: AnyArray = self.flight_time_s * np.sqrt(self.jet.vx_m_s**2 + self.jet.vy_m_s**2)
        return length


@dataclass(frozen=True, slots=True)
class Impulse:
    """What each node's grain gives to the plate, per mass that strikes, m/s."""

    arrival: Arrival
    normal_gain: AnyArray
    """Normal impulse over normal momentum: 1 + e, or k1 M / M_full + k2."""
    tangential_m_s: AnyArray
    """Tangential impulse per mass, positive towards the low edge."""
    weight: AnyArray
    """Response of the sensor to a unit of horizontal impulse at the node's place on the plate."""


@dataclass(frozen=True, slots=True)
class Reading:
    """The sensor's reading of one paddle; here the node axis has length 1."""

    impulse: Impulse
    momentum_kg_m_s: AnyArray
    """Horizontal momentum per paddle pass, in the sensor's scale."""

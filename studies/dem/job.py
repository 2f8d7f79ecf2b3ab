"""What is thrown: grain, walls, contact law, load, speed, release and plate, with the published values as defaults.

Source of the defaults: "Self-Calibrating Mass Flow Sensor" (Univ. of Illinois / Deere), tables 7.1-7.3. Lengths in m, angles in
rad (clockwise from +x, y down, as in `yieldmon.physics.machine`), speeds in rad/s, moduli in Pa.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from math import isfinite, pi
from typing import Any, Literal, get_args, get_type_hints

from studies.dem.clump import Clump, clump_of_volume
from yieldmon.physics.machine import RPM, ImpactSensor, Machine

STANDARD_GRAVITY_M_S2 = 9.80665
TOP_RAD = 1.5 * pi
"""Direction of a paddle that points straight up."""

HEAP_FORMAT = 2
"""Raised when the walls or groups of a settled heap's file change, so that no older file is taken for it."""

ReleaseKind = Literal["edge", "open"]
KernelKind = Literal["sphere", "clump"]


def _require(condition: bool, name: str, value: object, expected: str) -> None:
    if not condition:
        raise ValueError(f"{name} is {value}, expected {expected}")


@dataclass(frozen=True, slots=True)
class Grain:
    """A kernel as the sphere of its volume (table 7.1: 4.048e-4 kg, 3.037e-7 m3), or as a clump of spheres of that volume.

    size_spread: radii are uniform within +- this share of the mean, which keeps equal spheres from stacking like a crystal.
    kernel: "sphere", or "clump" for the shape of `clump.published_clump`, with `kernel_defaults` for what goes with it.
    """

    mass_kg: float = 4.048e-4
    volume_m3: float = 3.037e-7
    shear_modulus_pa: float = 6.3e6
    poisson: float = 0.4
    size_spread: float = 0.05
    kernel: KernelKind = "sphere"

    def __post_init__(self) -> None:
        for key in ("mass_kg", "volume_m3", "shear_modulus_pa"):
            _require(getattr(self, key) > 0.0, f"grain.{key}", getattr(self, key), "a value above 0")
        _require(0.0 <= self.poisson < 0.5, "grain.poisson", self.poisson, "0 to below 0.5")
        _require(0.0 <= self.size_spread <= 0.3, "grain.size_spread", self.size_spread, "0 to 0.3")
        _require(self.kernel in get_args(KernelKind), "grain.kernel", self.kernel, "sphere or clump")

    @property
    def radius_m(self) -> float:
        """Radius of the sphere of the same volume, m."""
        return float((3.0 * self.volume_m3 / (4.0 * pi)) ** (1.0 / 3.0))

    @property
    def clump(self) -> Clump | None:
        """The mean grain's spheres about its centre of mass; None where the grain is one sphere."""
        return clump_of_volume(self.volume_m3) if self.kernel == "clump" else None

    @property
    def sphere_count(self) -> int:
        """Spheres that a grain is made of."""
        return 1 if self.clump is None else self.clump.count

    @property
    def smallest_sphere_m(self) -> float:
        """Radius of the mean grain's smallest sphere, m."""
        return self.radius_m if self.clump is None else float(self.clump.radius_m.min())

    @property
    def reach_m(self) -> float:
        """Distance of the mean grain's farthest point from its centre of mass, m."""
        return self.radius_m if self.clump is None else self.clump.reach_m

    @property
    def youngs_modulus_pa(self) -> float:
        """E = 2 G (1 + nu), Pa."""
        return 2.0 * self.shear_modulus_pa * (1.0 + self.poisson)


@dataclass(frozen=True, slots=True)
class Walls:
    """Paddle, housing and plate (table 7.2: steel)."""

    shear_modulus_pa: float = 8.0e10
    poisson: float = 0.3

    @property
    def youngs_modulus_pa(self) -> float:
        """E = 2 G (1 + nu), Pa."""
        return 2.0 * self.shear_modulus_pa * (1.0 + self.poisson)


@dataclass(frozen=True, slots=True)
class Contact:
    """Contact law, the same between grains and against walls (table 7.3).

    Hertz-Mindlin with Coulomb friction; damping by the coefficient of restitution; rolling resistance as spring, dashpot and
    slider, its slider at rolling_friction times the normal force.
    """

    friction: float = 0.3
    rolling_friction: float = 0.1
    restitution: float = 0.75
    rolling_stiffness_n_m: float = 1000.0
    rolling_damping_n_s_m: float = 0.2

    def __post_init__(self) -> None:
        _require(0.0 <= self.friction <= 2.0, "contact.friction", self.friction, "0 to 2")
        _require(0.0 <= self.rolling_friction <= 2.0, "contact.rolling_friction", self.rolling_friction, "0 to 2")
        _require(0.05 <= self.restitution <= 1.0, "contact.restitution", self.restitution, "0.05 to 1")


@dataclass(frozen=True, slots=True)
class Release:
    """How the housing lets the load go.

    kind "edge": the housing ends at `angle_rad` and each grain is free once its centre has passed that direction.
    kind "open": the whole housing vanishes when the paddle points in the direction `angle_rad`, as on the bench.
    """

    kind: ReleaseKind = "edge"
    angle_rad: float = TOP_RAD

    def __post_init__(self) -> None:
        _require(self.kind in get_args(ReleaseKind), "release.kind", self.kind, "edge or open")
        _require(pi <= self.angle_rad <= 2.0 * pi, "release.angle_rad", self.angle_rad, "pi to 2 pi (180 to 360 deg)")


@dataclass(frozen=True, slots=True)
class Throw:
    """One load of one paddle, settled and thrown; the same throw can meet many plate angles.

    settle_revolutions: turns in the closed housing before the release. start_shape_ratio: angle/height of the wedge in which
    grains are laid before they settle. stiffness_factor softens (below 1) grain and wall moduli.
    side_walls: whether the closed part has cheeks at the paddle's two ends; without them z is periodic.
    """

    paddle_mass_kg: float
    elevator_speed_rad_s: float = 400.0 * RPM
    seed: int = 1
    machine: Machine = field(default_factory=Machine)
    grain: Grain = field(default_factory=Grain)
    walls: Walls = field(default_factory=Walls)
    contact: Contact = field(default_factory=Contact)
    release: Release = field(default_factory=Release)
    settle_revolutions: float = 1.0
    start_shape_ratio: float = 2.0
    time_step_s: float = 3.0e-5
    stiffness_factor: float = 1.0
    gravity_m_s2: float = STANDARD_GRAVITY_M_S2
    plate_width_m: float = 0.30

    def __post_init__(self) -> None:
        _require(self.paddle_mass_kg >= self.grain.mass_kg, "paddle_mass_kg", self.paddle_mass_kg, "at least one grain")
        _require(self.grain_count <= 12000, "paddle_mass_kg", self.paddle_mass_kg, "at most 12000 grains")
        _require(0.0 < self.elevator_speed_rad_s < 100.0, "elevator_speed_rad_s", self.elevator_speed_rad_s, "0 to 100 rad/s")
        _require(
            0.0 < self.time_step_s <= self.critical_time_step_s,
            "time_step_s",
            self.time_step_s,
            f"at most {self.critical_time_step_s:.2g} s, a fifth of the Rayleigh time",
        )
        _require(self.settle_revolutions > 0.0, "settle_revolutions", self.settle_revolutions, "a value above 0")
        _require(0.0 < self.stiffness_factor <= 10.0, "stiffness_factor", self.stiffness_factor, "above 0, at most 10")
        _require(isfinite(self.gravity_m_s2), "gravity_m_s2", self.gravity_m_s2, "a finite value")
        _require(self.seed >= 0, "seed", self.seed, "0 or above")

    @property
    def grain_count(self) -> int:
        """Grains whose masses add up to the load."""
        return max(1, round(self.paddle_mass_kg / self.grain.mass_kg))

    @property
    def critical_time_step_s(self) -> float:
        """A fifth of the time a Rayleigh wave needs round the smallest sphere, s (Ning 1995; Thornton)."""
        g = self.grain
        density = g.mass_kg / g.volume_m3
        radius = g.smallest_sphere_m * (1.0 - g.size_spread)
        shear = g.shear_modulus_pa * self.stiffness_factor
        return 0.2 * pi * radius * float((density / shear) ** 0.5) / (0.163 * g.poisson + 0.8766)

    def heap_key(self) -> str:
        """Digest of all that the settled heap depends on: throws with the same key share it."""
        relevant = {k: v for k, v in to_dict(self).items() if k not in ("release", "plate_width_m")}
        return digest([HEAP_FORMAT, relevant])

    def throw_key(self) -> str:
        """Digest of all that the throw depends on, plate angle apart."""
        return digest(to_dict(self))


def paddle_mass_kg(machine: Machine, mass_flow_kg_s: float, elevator_speed_rad_s: float) -> float:
    """Load of a mean paddle at a flow: M = mass flow * spacing / chain speed, kg (thesis 8.3)."""
    return mass_flow_kg_s * machine.paddle_spacing_m / machine.paddle_speed_m_s(elevator_speed_rad_s)


def to_dict(value: Any) -> dict[str, Any]:
    """A dataclass as plain JSON-able values. The kernel of a throw's grain is named where it is not the sphere."""
    plain: dict[str, Any] = json.loads(json.dumps(asdict(value)))
    machine = plain.get("machine")
    if isinstance(machine, dict):
        # None of these bears on a throw.
        machine.pop("implement", None)
        machine.pop("plate_travel_m", None)
        machine.get("sensor", {}).pop("response_s", None)
    if isinstance(value, Throw) and value.grain.kernel == "sphere":
        del plain["grain"]["kernel"]
    return plain


def kernel_defaults(kernel: str) -> dict[str, Any]:
    """Fields of a `Throw` that go with a kernel, nested as for `throw_from_dict`; none for the sphere.

    The clump's are those of the published validation runs (tables 11.8-11.10): mass, volume, rolling friction, plastic walls. The
    time step is within a fifth of its smallest sphere's Rayleigh time. Raises ValueError for an unknown kernel.
    """
    _require(kernel in get_args(KernelKind), "kernel", kernel, "sphere or clump")
    if kernel == "sphere":
        return {}
    return {
        "grain": {"kernel": "clump", "mass_kg": 4.000e-4, "volume_m3": 3.001e-7},
        "walls": {"shear_modulus_pa": 5.309e8, "poisson": 0.46},
        "contact": {"rolling_friction": 0.01},
        "time_step_s": 2.0e-5,
    }


def merged(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """Nested fields of `base`, replaced by those of `over`."""
    out = dict(base)
    for key, value in over.items():
        below = out.get(key)
        out[key] = merged(below, value) if isinstance(below, dict) and isinstance(value, dict) else value
    return out


def digest(values: object) -> str:
    """First 16 hex digits of the SHA-256 of the canonical JSON."""
    text = json.dumps(values, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _build(cls: type, values: dict[str, Any]) -> Any:
    hints = get_type_hints(cls)
    known = {f.name for f in fields(cls)}
    unknown = sorted(set(values) - known)
    if unknown:
        raise ValueError(f"{unknown[0]}: not a key of {cls.__name__}, expected one of {', '.join(sorted(known))}")
    arguments = {}
    for key, value in values.items():
        hint = hints[key]
        if is_dataclass(hint) and isinstance(value, dict):
            arguments[key] = _build(hint, value) if isinstance(hint, type) else value
        else:
            arguments[key] = tuple(value) if isinstance(value, list) else value
    return cls(**arguments)


def throw_from_dict(values: dict[str, Any]) -> Throw:
    """Inverse of `to_dict`; raises ValueError naming an unknown key or a value out of range."""
    throw: Throw = _build(Throw, values)
    return throw


__all__ = [
    "RPM",
    "STANDARD_GRAVITY_M_S2",
    "TOP_RAD",
    "Contact",
    "Grain",
    "ImpactSensor",
    "Machine",
    "Release",
    "Throw",
    "Walls",
    "digest",
    "kernel_defaults",
    "merged",
    "paddle_mass_kg",
    "throw_from_dict",
    "to_dict",
]

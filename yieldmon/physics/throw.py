"""A throw: heaps of any load at one setting, through the four stages and the effects that act on them.

Source: "Self-Calibrating Mass Flow Sensor" (Univ. of Illinois / Deere), chapter 8. Evaluated by Gauss-Legendre quadrature over
the paddle's rotation at release, split where grain begins to pass below the plate. At the default order the momentum is right to
1e-8 with a shape ratio of 2, and to 5e-5 with ratios up to 4: worst for a thin heap whose inner surface is nearly square to the
paddle, where the heap's width rises like a square root.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import flight, impact, release, settling
from .effects import Effect
from .grain import GRAIN, OPTIONAL
from .machine import Machine
from .numerics import AnyArray, first_root, gauss_legendre, minimum, perturbed
from .stages import Arrival, Jet, Load, Reading, Setting

LATEST_ROTATION_RAD = 2.0 * np.pi

Parameters = Mapping[str, ArrayLike]
"""Name -> value: friction, density (kg/m3), shape_ratio, restitution or k1 and k2, and `effect.parameter` for effects."""


_MOST_KEPT = 1 << 18
"""Values of an array, a tenth of those of a path, up to which it is kept."""


@dataclass(slots=True)
class _Path:
    """How the grain of heaps leaves the paddle, whatever their mass, and meets the plate where no effect alters that."""

    rotation_rad: AnyArray
    width_rad: AnyArray
    flow: release.Outflow
    opening_rad: AnyArray
    at_tip: tuple[AnyArray, AnyArray, AnyArray, AnyArray]
    meeting: flight.Meeting | None = None


@dataclass(frozen=True)
class ThrowModel:
    """What all throws of one machine share.

    effects: in alphabetical order. nodes: Gauss-Legendre order of each panel of a throw.
    """

    machine: Machine
    effects: tuple[Effect, ...]
    nodes: int

    @cached_property
    def acting(self) -> tuple[Effect, ...]:
        """The effects as they act within a stage: by rank, then by name."""
        return tuple(sorted(self.effects, key=lambda effect: effect.rank))

    @cached_property
    def misses(self) -> bool:
        """Whether grain that misses the plate matters to an effect."""
        return any(effect.needs_misses for effect in self.effects)

    @cached_property
    def alters_load(self) -> bool:
        """Whether an effect acts on filling."""
        return any(effect.load is not None for effect in self.effects)


class Throw:
    """The part of a throw that holds for any load: setting, and the rotation at which grain starts to miss the plate.

    Inverting force to flow evaluates many loads at one setting; this keeps what they share. Shapes: every public method takes
    and gives arrays without the node axis.
    """

    def __init__(
        self,
        model: ThrowModel,
        plate_angle_rad: ArrayLike,
        elevator_speed_rad_s: ArrayLike,
        parameters: Parameters,
        moisture_pct: ArrayLike | None = None,
        plate_position_m: ArrayLike | None = None,
        *,
        miss_rotation_rad: AnyArray | None = None,
        like: Throw | None = None,
    ) -> None:
        """miss_rotation_rad: that of these settings, where another throw has found it. like: a throw of the same model; how grain
        moves is kept from it where only density, gain or the reading differ."""
        self._model = model
        self._values = _effect_values(model.effects, parameters)
        machine = model.machine
        pivot_x: AnyArray = np.asarray([machine.plate_pivot_x_m])
        if plate_position_m is not None:
            pivot_x = pivot_x + _with_nodes(plate_position_m)
        setting = Setting(
            machine=machine,
            plate_angle_rad=_with_nodes(plate_angle_rad),
            elevator_speed_rad_s=_with_nodes(elevator_speed_rad_s),
            moisture_pct=_with_nodes(np.nan if moisture_pct is None else moisture_pct),
            paddle_length_m=np.asarray([machine.paddle_length_m]),
            plate_pivot_x_m=pivot_x,
            plate_pivot_y_m=np.asarray([machine.plate_pivot_y_m]),
            friction=_parameter(parameters, "friction"),
            density=_parameter(parameters, "density"),
            shape_ratio=_parameter(parameters, "shape_ratio"),
            restitution=_parameter(parameters, "restitution") if "restitution" in parameters else None,
            k1=_parameter(parameters, "k1") if "k1" in parameters else None,
            k2=_parameter(parameters, "k2") if "k2" in parameters else None,
            grain={name: _with_nodes(parameters.get(name, GRAIN[name].default or 0.0)) for name in OPTIONAL},
        )
        for effect in model.effects:
            if effect.setting is not None:
                setting = effect.setting(setting, self._values[effect.name])
        if (setting.restitution is None) == (setting.k1 is None or setting.k2 is None):
            raise ValueError("parameters: give either restitution, or k1 and k2")
        self.setting = setting
        self._heap_scale_kg = setting.density * machine.paddle_width_m * setting.paddle_length_m**2
        self._slides = release.slides_of(setting)
        self._paths: dict[bytes, _Path] = {}
        """Of grain over a grid of the load curve; kept for throws that are like this one."""
        self._keeps = like is not None
        if like is not None and miss_rotation_rad is None and _move_alike(setting, like.setting):
            miss_rotation_rad = like.miss_rotation_rad
            if _equal(setting.shape_ratio, like.setting.shape_ratio):
                self._paths = like._paths
        self.miss_rotation_rad: AnyArray = self._find_miss_rotation() if miss_rotation_rad is None else miss_rotation_rad
        """At which grain starts to miss the plate, with the node axis."""

    @property
    def passes_per_s(self) -> AnyArray:
        """Paddle passes per second."""
        return self.setting.passes_per_s[..., 0]

    @property
    def full_mass_kg(self) -> AnyArray:
        """Mass of a full paddle, kg [8.9]."""
        return self.setting.full_paddle_mass_kg[..., 0]

    def load_mass(self, offered_mass_kg: AnyArray) -> AnyArray:
        """Mass on the paddle at release, kg, after the effects that act on filling."""
        return self._load(np.asarray(offered_mass_kg)[..., None]).paddle_mass_kg[..., 0]

    def momentum(self, offered_mass_kg: AnyArray) -> AnyArray:
        """Horizontal momentum per paddle, kg m/s; nan above a full paddle."""
        return self.reading(offered_mass_kg).momentum_kg_m_s[..., 0]

    def load_curve(self, q: AnyArray) -> tuple[AnyArray, AnyArray]:
        """Offered mass, kg, and momentum, kg m/s, along the load curve from an empty (q = 0) to a full paddle (q = 1).

        Works from the heap's thickness q = 1 - h0/l, for which the mass is explicit, unless an effect acts on filling; then
        from the offered mass q^2 M_full, where loads that overfill the paddle give nan.
        """
        mass = self.offered_along_curve(q)
        if self._model.alters_load:
            return mass, self.momentum(mass)
        q = np.asarray(q)
        inner = 1.0 - q[..., None]
        load = Load(mass[..., None])
        if not self._keeps or q.ndim != 1:
            return mass, self._read(self._jet(load, inner)).momentum_kg_m_s[..., 0]
        key = q.tobytes()
        path = self._paths.get(key) or self._path(inner)
        reading = self._read(self._jet(load, inner, path), path)
        if path.rotation_rad.size <= _MOST_KEPT:
            self._paths[key] = path
        return mass, reading.momentum_kg_m_s[..., 0]

    def offered_along_curve(self, q: AnyArray) -> AnyArray:
        """The offered mass of `load_curve`, kg."""
        thickness = np.asarray(q)[..., None]
        if self._model.alters_load:
            mass: AnyArray = thickness * thickness * self.setting.full_paddle_mass_kg
        else:
            mass = self._heap_scale_kg * settling.filled_fraction(1.0 - thickness, self.setting.shape_ratio)
        return mass[..., 0]

    def reading(self, offered_mass_kg: AnyArray) -> Reading:
        """The whole chain of states of one throw, for inspection of any stage."""
        load = self._load(np.asarray(offered_mass_kg)[..., None])
        inner = settling.inner_radius(load.paddle_mass_kg / self._heap_scale_kg, self.setting.shape_ratio)
        return self._read(self._jet(load, inner))

    def _read(self, jet: Jet, path: _Path | None = None) -> Reading:
        arrival = self._arrival(jet, path)
        impulse = self._alter("impulse", impact.strike(arrival, self.setting))
        reading: Reading = self._alter("reading", impact.read(impulse, self.setting))
        return reading

    def _alter(self, stage: str, state):  # type: ignore[no-untyped-def]
        for effect in self._model.acting:
            hook = getattr(effect, stage)
            if hook is not None:
                state = hook(state, self._values[effect.name], self.setting)
        return state

    def _load(self, offered_mass_kg: AnyArray) -> Load:
        load: Load = self._alter("load", Load(offered_mass_kg))
        return load

    def _path(self, inner: AnyArray) -> _Path:
        setting = self.setting
        # Grain released after LATEST leaves the tip heading back; where misses do not count, nothing after them does.
        limit = np.full(1, LATEST_ROTATION_RAD) if self._model.misses else self.miss_rotation_rad
        emptied = release.rotation_to_empty(inner, setting, limit, self._slides)
        points, weights = gauss_legendre(self._model.nodes)
        hit_end = minimum(emptied, self.miss_rotation_rad)
        tau, width = hit_end * points, hit_end * weights
        if self._model.misses:
            rest = emptied - hit_end
            tau = np.concatenate((tau, hit_end + rest * points), axis=-1)
            width = np.concatenate((width, rest * weights), axis=-1)
        flow = release.outflow(tau, setting, self._slides[0])
        psi = settling.opening_angle(flow.release_radius, inner, setting.shape_ratio)
        return _Path(tau, width, flow, psi, release.at_tip(flow, setting))

    def _jet(self, load: Load, inner: AnyArray, path: _Path | None = None) -> Jet:
        path = self._path(inner) if path is None else path
        flow = path.flow
        mass = self._heap_scale_kg * path.width_rad * flow.inward_rate * flow.release_radius * path.opening_rad
        jet: Jet = self._alter("jet", Jet(load, inner, flow.release_radius, mass, path.rotation_rad, *path.at_tip))
        return jet

    def _arrival(self, jet: Jet, path: _Path | None = None) -> Arrival:
        at_tip = jet.x_m, jet.y_m, jet.vx_m_s, jet.vy_m_s
        # An effect on release may have altered what the path has.
        known = path if path is not None and all(a is b for a, b in zip(at_tip, path.at_tip, strict=True)) else None
        meeting = known.meeting if known is not None else None
        if meeting is None:
            meeting = flight.meet_plate(*at_tip, self.setting)
        if known is not None:
            known.meeting = meeting
        share: AnyArray = np.ones(1)
        if self._model.misses:
            share = np.repeat([1.0, 0.0], self._model.nodes)
            # An effect on release may have parted each node's grain.
            share = np.tile(share, jet.mass_kg.shape[-1] // len(share))
        arrival: Arrival = self._alter(
            "arrival",
            Arrival(
                jet,
                meeting.from_low_edge_m,
                meeting.time_s,
                meeting.normal_speed_m_s,
                meeting.tangential_speed_m_s,
                share,
            ),
        )
        return arrival

    def _find_miss_rotation(self) -> AnyArray:
        fewer, place = _frictions_once(self.setting)
        if place is None:
            return _miss_rotation(self.setting, self._slides)
        return np.take(_miss_rotation(fewer, release.slides_of(fewer)), place, axis=-self.setting.friction.ndim)


def _frictions_once(setting: Setting) -> tuple[Setting, NDArray[np.intp] | None]:
    """The setting with each of several frictions, (k, 1) or (k, 1, 1), once, and where each is; None where nothing is gained.

    Of all that sets of parameters differ by, only friction changes at which rotation grain starts to miss the plate.
    """
    friction = setting.friction
    axes = friction.ndim
    if axes < 2 or friction.size != friction.shape[0] or perturbed(friction):
        return setting, None
    # Not numpy.unique, which costs more than the few values that there usually are.
    frictions = friction.ravel().tolist()
    once = sorted(set(frictions))
    others = _moving(setting)
    if len(once) == len(frictions) or any(v is not None and v.ndim >= axes and v.shape[-axes] > 1 for v in others):
        return setting, None
    place = {value: index for index, value in enumerate(once)}
    fewer = replace(setting, friction=np.array(once).reshape(-1, *friction.shape[1:]))
    return fewer, np.array([place[value] for value in frictions])


def _moving(setting: Setting) -> tuple[AnyArray | None, ...]:
    """What, beside friction, decides how grain moves from the paddle to the plate."""
    return (
        setting.plate_angle_rad, setting.elevator_speed_rad_s, setting.paddle_length_m, setting.plate_pivot_x_m,
        setting.plate_pivot_y_m, setting.gravity_m_s2, setting.release_angle_rad, setting.radial_speed,
        setting.steady_drag_m_s,
    )  # fmt: skip


def _move_alike(setting: Setting, other: Setting) -> bool:
    """Whether grain moves the same in both, bit for bit; not said of perturbed ones."""
    if setting.perturbed or other.perturbed:
        return False
    pairs = zip((setting.friction, *_moving(setting)), (other.friction, *_moving(other)), strict=True)
    return all(a is b or (a is not None and b is not None and _equal(a, b)) for a, b in pairs)


def _equal(a: AnyArray, b: AnyArray) -> bool:
    return a.dtype == b.dtype and np.array_equal(a, b)


def _miss_rotation(setting: Setting, slides: tuple[release.Slide, Setting, release.Slide]) -> AnyArray:
    # Beyond this rotation the path runs along the plate or away from it (radial speed stays below the tip speed).
    upper = setting.plate_angle_rad + 0.25 * np.pi
    if setting.release_angle_rad is not None:
        upper = upper - setting.release_angle_rad
    if setting.radial_speed is not None:
        upper = upper + 0.5 * setting.radial_speed
    slide, still, still_slide = slides

    def miss(tau: AnyArray, setting: Setting = setting, slide: release.Slide = slide) -> AnyArray:
        flow = release.outflow(tau, setting, slide)
        return flight.miss_measure(*release.at_tip(flow, setting), setting)

    unperturbed = None if still is setting else lambda tau: miss(tau, still, still_slide)
    return first_root(miss, upper, unperturbed=unperturbed)


def _with_nodes(value: ArrayLike) -> AnyArray:
    return np.asarray(value)[..., None] * 1.0


def _parameter(parameters: Parameters, name: str) -> AnyArray:
    try:
        return _with_nodes(parameters[name])
    except KeyError:
        raise ValueError(f"parameters: {name} is missing; given are {', '.join(parameters)}") from None


def _effect_values(effects: Sequence[Effect], parameters: Parameters) -> dict[str, dict[str, AnyArray]]:
    return {
        effect.name: {p.name: _parameter(parameters, f"{effect.name}.{p.name}") for p in effect.parameters} for effect in effects
    }

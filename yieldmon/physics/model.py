"""The forward model: mass flow to force on the plate, through the four stages and any named effects.

Source: "Self-Calibrating Mass Flow Sensor" (Univ. of Illinois / Deere), chapter 8.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike

from yieldmon.arguments import all_of_type, require_type

from .effects import changes_force, get_effect
from .grain import EXCHANGE_FORM, GRAIN, RESTITUTION_FORM
from .machine import FASTEST_ELEVATOR_RPM, RPM, Machine
from .numerics import COMPLEX_STEP, AnyArray, Array, real, refuse_shapes
from .stages import STAGES
from .throw import Parameters, Throw, ThrowModel


@dataclass(frozen=True, slots=True)
class Conditions:
    """What the machine does while it is measured; arrays that broadcast.

    Parameters
    ----------
    plate_angle_rad : array_like
        rad, -pi to pi.
    elevator_speed_rad_s : array_like
        Of the upper sprocket, rad/s, above 0, up to 1900 rpm.
    mass_flow_kg_s, paddle_mass_kg : array_like, optional
        The load: one of the two, kg/s or kg.
    moisture_pct : array_like, optional
        Wet basis, %; needed only where an effect asks for it (`ForwardModel.needs_moisture`).
    plate_position_m : array_like, optional
        Distance of the plate from its nominal position, positive away from the elevator, m; None: nominal position.

    Raises
    ------
    ValueError
        Unless one of mass_flow_kg_s and paddle_mass_kg is given.

    Examples
    --------
    >>> api.Conditions(plate_angle_rad=1.22, elevator_speed_rad_s=400.0 * api.RPM, mass_flow_kg_s=10.0).paddle_mass_kg is None
    True
    """

    plate_angle_rad: ArrayLike
    elevator_speed_rad_s: ArrayLike
    mass_flow_kg_s: ArrayLike | None = None
    paddle_mass_kg: ArrayLike | None = None
    moisture_pct: ArrayLike | None = None
    plate_position_m: ArrayLike | None = None

    def __post_init__(self) -> None:
        if (self.mass_flow_kg_s is None) == (self.paddle_mass_kg is None):
            raise ValueError("conditions: exactly one of mass_flow_kg_s and paddle_mass_kg is needed")


def refuse_impossible(where: str, plate_angle_rad: ArrayLike, elevator_speed_rad_s: ArrayLike) -> None:
    """Refuse angles that are no radians, a standing elevator and speeds that are no rad/s; nan is none of them.

    Parameters
    ----------
    where : str
        Begins the message.
    plate_angle_rad, elevator_speed_rad_s : array_like
        As in `Conditions`.

    Raises
    ------
    ValueError
        With the first value outside -pi to pi, not above 0, or above `FASTEST_ELEVATOR_RPM`.
    """
    angle, speed = np.ravel(np.real(plate_angle_rad)), np.ravel(np.real(elevator_speed_rad_s))
    for value in angle[np.abs(angle) > np.pi][:1]:
        raise ValueError(f"{where}: plate_angle_rad {value:g}: expected radians, -pi to pi")
    for value in speed[speed <= 0.0][:1]:
        raise ValueError(f"{where}: elevator_speed_rad_s {value:g}: expected rad/s above 0")
    for value in speed[speed > FASTEST_ELEVATOR_RPM * RPM][:1]:
        limit = f"expected at most {FASTEST_ELEVATOR_RPM * RPM:.0f} rad/s; one rpm is {RPM:.4g} rad/s"
        raise ValueError(f"{where}: elevator_speed_rad_s {value:g}: {limit}")


class ForwardModel:
    """Force on the plate of one machine, with zero or more named effects.

    Parameters
    ----------
    machine : Machine
    effects : iterable of str
        Names of effects, see `effects`.
    nodes : int
        Gauss-Legendre order of each panel of a throw.

    Attributes
    ----------
    machine : Machine
    nodes : int

    Raises
    ------
    ValueError
        For a machine that is no Machine, and for an effect that is no name, not known or named twice.

    Notes
    -----
    Parameters are given at each call, so one model serves any grain: a mapping of `friction`, `density` (kg/m3), `shape_ratio`,
    `restitution` or `k1` and `k2`, and `effect.parameter` for each effect, with values that broadcast against the conditions.
    They may be complex (complex-step derivatives).

    References
    ----------
    "Self-Calibrating Mass Flow Sensor" (Univ. of Illinois / Deere), chapter 8; numbers in brackets are its equations.

    Examples
    --------
    >>> model = api.ForwardModel(api.Machine(), ["gravity"])
    >>> grain = {"friction": 0.2, "restitution": 0.6, "density": 1100.0, "shape_ratio": 2.0, "gravity.acceleration_m_s2": 9.81}
    >>> at = api.Conditions(np.radians([50.0, 70.0]), 400.0 * api.RPM, mass_flow_kg_s=10.0)
    >>> model.force(at, grain).round(1)
    array([40.9, 82.4])
    """

    def __init__(self, machine: Machine, effects: Iterable[str] = (), *, nodes: int = 20) -> None:
        require_type("machine", machine, Machine, "a Machine")
        names = (effects,) if isinstance(effects, str) else all_of_type("effects", effects, str, "names such as 'gravity'")
        if len(set(names)) != len(names):
            raise ValueError(f"effects {names}: each may be named once")
        self.machine = machine
        self.nodes = nodes
        chosen = [get_effect(name) for name in names]
        self._throws = ThrowModel(machine, tuple(sorted(chosen, key=lambda effect: effect.name)), nodes)
        self._effects = tuple(effect.name for effect in self._throws.effects)

    def __repr__(self) -> str:
        return f"ForwardModel({self.machine.name!r}, effects={list(self.effects)!r}, nodes={self.nodes})"

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects, in alphabetical order; within a stage they act by rank, then in this order."""
        return self._effects

    @property
    def effect_parameters(self) -> tuple[str, ...]:
        """Qualified names (`effect.parameter`) of the effects' parameters."""
        return tuple(f"{e.name}.{p.name}" for e in self._throws.effects for p in e.parameters)

    @property
    def needs_moisture(self) -> bool:
        """Whether an effect needs the grain's moisture in every condition."""
        return any(effect.needs_moisture for effect in self._throws.effects)

    def with_effects(self, effects: Iterable[str]) -> ForwardModel:
        """The same machine and order with other effects.

        Parameters
        ----------
        effects : iterable of str

        Returns
        -------
        ForwardModel
        """
        return ForwardModel(self.machine, effects, nodes=self.nodes)

    def throw(
        self,
        plate_angle_rad: ArrayLike,
        elevator_speed_rad_s: ArrayLike,
        parameters: Parameters,
        moisture_pct: ArrayLike | None = None,
        plate_position_m: ArrayLike | None = None,
        *,
        miss_rotation_rad: AnyArray | None = None,
        like: Throw | None = None,
    ) -> Throw:
        """The part of the model that does not depend on the load, computed once; see `Throw`.

        Parameters
        ----------
        plate_angle_rad, elevator_speed_rad_s, moisture_pct, plate_position_m : array_like
            As in `Conditions`.
        parameters : mapping of str to array_like
        miss_rotation_rad : ndarray, optional
            That of another throw at these settings, rad.
        like : Throw, optional
            Of this model. What it has found is used where grain moves the same: where density, gain or the reading differ only.

        Returns
        -------
        Throw

        Raises
        ------
        ValueError
            For a parameter that is missing, or for both of restitution and k1, k2.
        """
        return Throw(
            self._throws,
            plate_angle_rad,
            elevator_speed_rad_s,
            parameters,
            moisture_pct,
            plate_position_m,
            miss_rotation_rad=miss_rotation_rad,
            like=like,
        )

    def paddle_momentum(self, conditions: Conditions, parameters: Parameters, *, overfull: str = "raise") -> AnyArray:
        """Horizontal momentum given to the plate per paddle.

        Parameters
        ----------
        conditions : Conditions
        parameters : mapping of str to array_like
        overfull : {"raise", "nan"}
            What to do with a load above a full paddle [8.9], and with an angle, a speed or a parameter that cannot be.

        Returns
        -------
        ndarray
            kg m/s, or the response's unit where k1, k2 carry it; of the shape to which conditions and parameters broadcast. nan
            where a condition is nan.

        Raises
        ------
        ValueError
            For a load above a full paddle, an angle, a speed, a plate position or a parameter outside its range, and a parameter
            that the model does not have, unless `overfull` is "nan"; for a parameter that is missing, and for shapes that do not
            broadcast.
        """
        return self._momentum(conditions, parameters, overfull)[0]

    def force(self, conditions: Conditions, parameters: Parameters, *, overfull: str = "raise") -> AnyArray:
        """Mean horizontal force: momentum per paddle times paddle passes per second [8.24].

        Parameters
        ----------
        conditions, parameters, overfull
            As in `paddle_momentum`.

        Returns
        -------
        ndarray
            N, of the shape to which conditions and parameters broadcast.

        Raises
        ------
        ValueError
            As `paddle_momentum`.
        """
        momentum, passes_per_s = self._momentum(conditions, parameters, overfull)
        return momentum * passes_per_s

    def derivatives(
        self, conditions: Conditions, parameters: Parameters, names: Sequence[str], *, of: str = "momentum"
    ) -> tuple[Array, Array]:
        """Value and exact first derivatives by complex step, one forward pass a name.

        Parameters
        ----------
        conditions : Conditions
        parameters : mapping of str to array_like
        names : sequence of str
            n parameters, or "mass_flow_kg_s" / "paddle_mass_kg" for the load.
        of : {"momentum", "force"}

        Returns
        -------
        value : ndarray
            Of some shape S, kg m/s or N; nan where the load is above a full paddle.
        jacobian : ndarray
            S + (n,), in the value's unit per unit of each name.

        Raises
        ------
        ValueError
            For a name that is neither a parameter nor the load that the conditions give, and for another `of`.

        References
        ----------
        Squire and Trapp, "Using complex variables to estimate derivatives of real functions", SIAM Review 40 (1998).

        Examples
        --------
        >>> model = api.ForwardModel(api.Machine())
        >>> grain = {"friction": 0.2, "restitution": 0.6, "density": 1100.0, "shape_ratio": 2.0}
        >>> at = api.Conditions(np.radians(70.0), 400.0 * api.RPM, mass_flow_kg_s=10.0)
        >>> value, jacobian = model.derivatives(at, grain, ["mass_flow_kg_s", "restitution"], of="force")
        >>> jacobian.round(2)
        array([ 6.77, 56.33])
        """
        if of not in ("momentum", "force"):
            raise ValueError(f"derivatives of {of!r}: expected 'momentum' or 'force'")
        evaluate = self.paddle_momentum if of == "momentum" else self.force
        value = real(np.asarray(evaluate(conditions, parameters, overfull="nan")))
        columns = []
        for name in names:
            if name in ("mass_flow_kg_s", "paddle_mass_kg"):
                load = getattr(conditions, name)
                if load is None:
                    raise ValueError(f"derivative by {name}: the conditions do not give it")
                moved = replace(conditions, **{name: np.asarray(load, dtype=complex) + 1j * COMPLEX_STEP})
                perturbed = evaluate(moved, parameters, overfull="nan")
            else:
                if name not in parameters:
                    raise ValueError(f"derivative by {name}: not among the parameters {', '.join(parameters)}")
                shifted = dict(parameters)
                shifted[name] = np.asarray(parameters[name], dtype=complex) + 1j * COMPLEX_STEP
                perturbed = evaluate(conditions, shifted, overfull="nan")
            columns.append(np.broadcast_to(np.imag(perturbed) / COMPLEX_STEP, value.shape))
        jacobian = np.stack(columns, axis=-1) if columns else np.empty((*value.shape, 0))
        return value, np.where(np.isnan(value)[..., None], np.nan, jacobian)

    def _throw(self, conditions: Conditions, parameters: Parameters) -> Throw:
        return self.throw(
            conditions.plate_angle_rad,
            conditions.elevator_speed_rad_s,
            parameters,
            conditions.moisture_pct,
            conditions.plate_position_m,
        )

    def _momentum(self, conditions: Conditions, parameters: Parameters, overfull: str) -> tuple[AnyArray, AnyArray]:
        """Momentum per paddle and paddle passes per second."""
        if overfull not in ("raise", "nan"):
            raise ValueError(f"overfull {overfull!r}: expected 'raise' or 'nan'")
        refuses = overfull == "raise"
        if refuses:
            require_type("conditions", conditions, Conditions, "Conditions")
            require_type("parameters", parameters, Mapping, "values by name, such as the `values` of a ParameterSet")
            refuse_impossible("conditions", conditions.plate_angle_rad, conditions.elevator_speed_rad_s)
            self._refuse_position(conditions)
            self._refuse_other_names(parameters)
            _refuse_impossible_grain(parameters)
            arrays = {field.name: getattr(conditions, field.name) for field in fields(conditions)}
            refuse_shapes("conditions", arrays | dict(parameters))
        throw = self._throw(conditions, parameters)
        momentum = throw.momentum(_offered_kg(throw, conditions))
        if conditions.plate_position_m is not None:
            momentum = np.where(np.isnan(real(np.asarray(conditions.plate_position_m))), np.nan, momentum)
        if refuses:
            self._refuse_overfull(throw, conditions)
        return momentum, throw.passes_per_s

    def _refuse_position(self, conditions: Conditions) -> None:
        machine = self.machine
        place = np.ravel(real(np.asarray(conditions.plate_position_m if conditions.plate_position_m is not None else 0.0)))
        nearest = machine.paddle_length_m - machine.plate_reach_m(0.0)
        for value in place[place <= nearest][:1] if nearest < 0.0 else ():
            raise ValueError(
                f"conditions: plate_position_m {value:g}: expected above {nearest:.3g} m, where it clears the paddles"
            )

    def _refuse_other_names(self, parameters: Parameters) -> None:
        own, known = self.effects, (*GRAIN, *self.effect_parameters)
        for name in parameters:
            effect, dot, _ = name.partition(".")
            if dot and effect not in own and changes_force(effect):
                raise ValueError(f"parameters: {name}: the model does not have this effect; expected effects {own}")
            if name not in known and changes_force(effect):
                raise ValueError(f"parameters: {name}: unknown; expected some of {', '.join(known)}")

    def _refuse_overfull(self, throw: Throw, conditions: Conditions) -> None:
        mass, full = np.broadcast_arrays(real(throw.load_mass(_offered_kg(throw, conditions))), real(throw.full_mass_kg))
        over = (mass > full * (1.0 + 1e-12)) | (mass < 0.0)
        if np.any(over):
            first = np.flatnonzero(over)[0]
            raise ValueError(
                f"load of {mass.ravel()[first]:.6g} kg a paddle: expected 0 to {full.ravel()[first]:.6g} kg, a full paddle"
            )


def _refuse_impossible_grain(parameters: Parameters) -> None:
    """Raises ValueError for a value of grain that is no number or outside what is possible."""
    for name in (name for name in parameters if name in GRAIN):
        value = np.asarray(parameters[name])
        if value.dtype.kind not in "iufc":
            raise ValueError(f"parameters: {name}: {parameters[name]!r}: expected numbers")
        low, high = (-np.inf, np.inf) if GRAIN[name].follows_response else GRAIN[name].limits
        if GRAIN[name].offset:
            # A search may pass through any restitution with a gain 1 + e that is not below 0, and scales may trade with it.
            low, high = -GRAIN[name].offset, np.inf
        numbers = np.ravel(real(value))
        for wrong in numbers[~((numbers >= low) & (numbers <= high))][:1]:
            raise ValueError(f"parameters: {name} {wrong:g}: expected {low:g} to {high:g} {GRAIN[name].unit}".rstrip())


def _offered_kg(throw: Throw, conditions: Conditions) -> AnyArray:
    """Mass that each paddle is offered [8.1]."""
    if conditions.paddle_mass_kg is not None:
        return np.asarray(conditions.paddle_mass_kg)
    return np.asarray(conditions.mass_flow_kg_s) / throw.passes_per_s


__all__ = ["EXCHANGE_FORM", "RESTITUTION_FORM", "STAGES", "Conditions", "ForwardModel"]

"""Momentum and its derivatives for many parameter vectors at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from yieldmon.physics.grain import OPTIONAL
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import COMPLEX_STEP, Array

_CHUNK = 3000
"""Throws worked out in one go: few enough for the CPU's cache, many enough to hide Python's own cost."""


LOAD = "load"
"""Stands for the load among the names to differentiate by."""


class MomentumBatch:
    """Momentum per paddle of N rows for B parameter vectors.

    names: the free parameters, in the order of the vectors; fixed: the others. Rows are the conditions, 1-D arrays or scalars.
    """

    def __init__(self, model: ForwardModel, conditions: Conditions, names: Sequence[str], fixed: Mapping[str, float]) -> None:
        self.model = model
        self.names = tuple(names)
        self.fixed = dict(fixed)
        self._by_flow = conditions.paddle_mass_kg is None
        self._knows_moisture = conditions.moisture_pct is not None
        self._knows_position = conditions.plate_position_m is not None
        self.angle, self.speed, self.load, self.moisture, self.position = np.broadcast_arrays(
            *(
                np.atleast_1d(np.asarray(v, dtype=float))
                for v in (
                    conditions.plate_angle_rad,
                    conditions.elevator_speed_rad_s,
                    conditions.mass_flow_kg_s if self._by_flow else conditions.paddle_mass_kg,
                    conditions.moisture_pct if self._knows_moisture else np.nan,
                    conditions.plate_position_m if self._knows_position else 0.0,
                )
            )
        )
        self.passes_per_s = model.machine.passes_per_s(self.speed)

    @property
    def rows(self) -> int:
        """N"""
        return int(self.load.size)

    def __call__(self, theta: Array) -> tuple[Array, Array]:
        """Momentum (B, N) and its derivatives (B, N, len(names)); nan where a load is above a full paddle. theta: (B, n)."""
        step = max(1, _CHUNK // (self.rows * max(1, len(self.names))))
        parts = [self._evaluate(theta[i : i + step], self.load, self.names) for i in range(0, len(theta), step)]
        return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])

    def value(self, theta: Array) -> Array:
        """Momentum (B, N) alone."""
        step = max(1, _CHUNK // self.rows)
        return np.concatenate([self._evaluate(theta[i : i + step], self.load, ())[0] for i in range(0, len(theta), step)])

    def at_load(self, theta: Array, load: Array) -> tuple[Array, Array, Array]:
        """The same for one vector (n,) at other loads (N,): momentum (N,), derivatives (N, n), derivative by the load (N,)."""
        value, jacobian = self._evaluate(theta[None], load, (*self.names, LOAD))
        return value[0], jacobian[0, :, :-1], jacobian[0, :, -1]

    def _evaluate(self, theta: Array, load: Array, by: Sequence[str]) -> tuple[Array, Array]:
        values: dict[str, Array] = {name: np.asarray(value) for name, value in self.fixed.items()}
        for j, name in enumerate(self.names):
            values[name] = theta[:, j, None]
        if self.model.effects or any(name in values for name in OPTIONAL):
            return self._stepped(values, load, by, len(theta))
        return self._by_gain(values, load, by, len(theta))

    def _stepped(self, values: Mapping[str, Array], load: Array, by: Sequence[str], count: int) -> tuple[Array, Array]:
        """Momentum (B, N) and derivatives (B, N, len(by)): one slice a name, each with its own imaginary step."""
        slices = max(1, len(by))
        unit = 1j * COMPLEX_STEP * np.eye(slices)[:, :, None, None]
        moved = dict(values)
        amount: Array = load
        for j, name in enumerate(by):
            if name == LOAD:
                amount = load + unit[j]
            else:
                moved[name] = values[name] + unit[j]
        conditions = Conditions(
            self.angle,
            self.speed,
            amount if self._by_flow else None,
            None if self._by_flow else amount,
            self.moisture if self._knows_moisture else None,
            self.position if self._knows_position else None,
        )
        # Complex division warns about the nan of an overfull paddle, which is the answer asked for.
        with np.errstate(invalid="ignore"):
            momentum = self.model.paddle_momentum(conditions, moved, overfull="nan")
        out = np.broadcast_to(momentum, (slices, count, self.rows))
        value = np.real(out[0])
        if not by:
            return value, np.empty((count, self.rows, 0))
        return value, np.where(np.isnan(value)[..., None], np.nan, np.moveaxis(np.imag(out), 0, -1) / COMPLEX_STEP)

    def _by_gain(self, values: Mapping[str, Array], load: Array, by: Sequence[str], count: int) -> tuple[Array, Array]:
        """The published model: momentum is the impact gain (1 + e, or k1 x + k2) times that of a perfectly inelastic plate.

        The latter is density x a function of load / density, which saves a step where both derivatives are wanted.
        """
        gain_names = ("restitution", "k1", "k2")
        plain = {k: v for k, v in values.items() if k not in gain_names} | {"restitution": np.asarray(0.0)}
        saved = "density" if LOAD in by else ""
        stepped = [n for n in by if n not in gain_names and n != saved]
        base, slopes = self._stepped(plain, load, stepped, count)
        by_base = {name: slopes[..., j] for j, name in enumerate(stepped)}
        if saved:
            by_base[saved] = (base - load * by_base[LOAD]) / values["density"]
        machine = self.model.machine
        per_load = 1.0 / self.passes_per_s if self._by_flow else np.ones(self.rows)
        full = machine.full_paddle_mass_kg(values["density"], values["shape_ratio"])
        fill = load * per_load / full
        by_gain: dict[str, Array]
        if "restitution" in values:
            gain, by_gain = 1.0 + values["restitution"], {"restitution": np.asarray(1.0)}
        else:
            gain = values["k1"] * fill + values["k2"]
            bend = values["k1"] * fill
            by_gain = {
                "k1": fill,
                "k2": np.asarray(1.0),
                "density": -bend / values["density"],
                "shape_ratio": -bend / values["shape_ratio"],
                LOAD: values["k1"] * per_load / full,
            }
        jacobian = np.zeros((*base.shape, len(by)))
        for j, name in enumerate(by):
            if name in by_base:
                jacobian[..., j] = gain * by_base[name]
            if name in by_gain:
                jacobian[..., j] += by_gain[name] * base
        return gain * base, jacobian

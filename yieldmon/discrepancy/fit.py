"""Bounded least squares of the forward model on whitened cell means, for many candidate effects in a row.

With exact complex-step derivatives; a fit keeps its whitened residuals and Jacobian, from which screening, cross-validation and
bootstraps work in the tangent plane.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from yieldmon.estimation.least_squares import levenberg_marquardt
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.effects import registry
from yieldmon.physics.grain import GRAIN, GrainParameter, evenly, fitted
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import COMPLEX_STEP, Array, real

from .observations import Cells, Rows

SEARCH_NODES = 12
_REFERENCE_FORCE_N = 60.0
"""Largest force of a table in N for which the effects' own bounds in N are meant."""


@dataclass(frozen=True)
class Parameter:
    """A free parameter: start is the published value, or the null of an effect."""

    name: str
    lower: float
    upper: float
    start: float
    scale: float
    unit: str = ""
    typical: float = 0.0
    prior_sd: float = np.inf


@dataclass(frozen=True)
class Frame:
    """What every fit to one set of cells shares: cells, their sd (of a mean), base parameters and fixed ones.

    unit: size of the reading's unit relative to SI (1 for N and kg m/s), which stretches the bounds of effects that are stated in
    the reading's unit.
    """

    cells: Cells
    sd: Array
    base: tuple[Parameter, ...]
    fixed: Mapping[str, float]
    unit: float
    nodes: int = SEARCH_NODES

    @property
    def known(self) -> tuple[str, ...]:
        """Effects that belong to the model from the start, their parameters among the fixed ones."""
        return tuple(sorted({name.partition(".")[0] for name in self.fixed if "." in name}))

    def with_cells(self, cells: Cells, sd: Array) -> Frame:
        """The same questions about other cells."""
        return Frame(cells, sd, self.base, self.fixed, self.unit, self.nodes)


@dataclass(frozen=True)
class Fit:
    """A model with `effects` at its least chi-square.

    residual: (prediction - mean) / sd, shape (cells,); jacobian: its derivatives, shape (cells, parameters).
    """

    effects: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    x: Array
    chi2: float
    residual: Array
    jacobian: Array
    frame: Frame = field(repr=False)

    @property
    def values(self) -> dict[str, float]:
        """Every parameter by name, the fixed ones too."""
        return dict(self.frame.fixed) | {p.name: float(v) for p, v in zip(self.parameters, self.x, strict=True)}

    @property
    def dof(self) -> int:
        """Cells less parameters, those at a bound included: F then errs on the large side."""
        return len(self.residual) - len(self.parameters)

    @property
    def at_bound(self) -> tuple[str, ...]:
        """Names of parameters that ended at a bound."""
        return tuple(
            p.name
            for p, v in zip(self.parameters, self.x, strict=True)
            if v <= p.lower + 1e-3 * (p.upper - p.lower) or v >= p.upper - 1e-3 * (p.upper - p.lower)
        )

    def covariance(self) -> Array:
        """Covariance of the parameters in the tangent plane, shape (parameters, parameters).

        Where chi-square exceeds its degrees of freedom the cells miss by more than their sd, and it is that much wider (Birge's
        ratio). No parameter's sd exceeds the width of its bounds; what is at a bound may lie anywhere between them.
        """
        scale = np.array([p.scale for p in self.parameters])
        scaled = self.jacobian * scale
        ratio = max(self.chi2 / max(self.dof, 1), 1.0)
        width = np.array([p.upper - p.lower for p in self.parameters])
        inverse = np.linalg.inv(scaled.T @ scaled / ratio + np.diag((scale / width) ** 2))
        return 0.5 * (inverse + inverse.T) * np.outer(scale, scale)

    def tangent(self) -> Array:
        """Orthonormal basis of what small changes of the parameters can do to the whitened prediction, shape (cells, rank)."""
        return orthonormal(self.jacobian * np.array([p.scale for p in self.parameters]))

    def predict(self, rows: Rows | Conditions, of: str | None = None) -> Array:
        """Prediction for other rows."""
        conditions = rows.conditions() if isinstance(rows, Rows) else rows
        model = ForwardModel(self.frame.cells.rows.machine, (*self.frame.known, *self.effects))
        evaluate = model.force if (of or self.frame.cells.rows.of) == "force" else model.paddle_momentum
        with np.errstate(invalid="ignore"):
            return real(np.asarray(evaluate(conditions, self.values, overfull="nan")))


def orthonormal(columns: Array) -> Array:
    """Orthonormal basis of the columns' span."""
    norms = np.linalg.norm(columns, axis=0)
    u, s, _ = np.linalg.svd(columns / np.where(norms > 0.0, norms, 1.0), full_matrices=False)
    return u[:, s > 1e-9 * s[0]] if s.size and s[0] > 0.0 else u[:, :0]


def effect_parameters(effect: str, unit: float) -> tuple[Parameter, ...]:
    """Free parameters of an effect, with bounds in the reading's unit where the effect is stated in it."""
    known = registry()[effect]
    out = []
    for p in known.parameters:
        stretch = 1.0
        if known.unit_follows_response:
            stretch = 1.0 / unit if p.unit.startswith("1/") else unit
        out.append(
            Parameter(
                f"{effect}.{p.name}",
                p.lower * stretch,
                p.upper * stretch,
                p.null * stretch,
                abs(p.typical - p.null) * stretch,
                p.unit,
                p.typical * stretch,
                p.prior_sd * stretch,
            )
        )
    return tuple(out)


def predictions(frame: Frame, effects: Iterable[str], values: Mapping[str, ArrayLike]) -> Array:
    """Prediction for each cell of the frame, shape (..., cells); values are numbers or carry leading axes of shape (..., 1)."""
    cells = frame.cells
    model = ForwardModel(cells.rows.machine, (*frame.known, *effects), nodes=frame.nodes)
    evaluate = model.force if cells.rows.of == "force" else model.paddle_momentum
    grid = cells.layout
    conditions = Conditions(
        grid.plate_angle_rad, grid.elevator_speed_rad_s, moisture_pct=grid.moisture_pct, **{cells.rows.load_name: grid.load}
    )
    spread = {
        name: np.asarray(v)[..., None] if np.ndim(v) else np.asarray(v) for name, v in (dict(frame.fixed) | dict(values)).items()
    }
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        out = np.asarray(evaluate(conditions, spread, overfull="nan"))
    return out.reshape(*out.shape[:-2], -1)[..., grid.place]


def fit(
    frame: Frame,
    effects: Iterable[str],
    start: Mapping[str, float] | None = None,
    *,
    iterations: int = 60,
    tolerance: float = 1e-3,
    held: Mapping[str, float] | None = None,
) -> Fit | None:
    """Least squares from one start (base and null values where `start` is silent); None where no start fits on the paddles.

    held: parameters that may not move from the given values. Ends when a step gains less than `tolerance` in chi-square relative
    to 1 + chi2 / dof.
    """
    effects = tuple(effects)
    parameters = frame.base + tuple(p for e in effects for p in effect_parameters(e, frame.unit))
    lower, upper = np.array([p.lower for p in parameters]), np.array([p.upper for p in parameters])
    scale = np.array([p.scale for p in parameters])
    names = [p.name for p in parameters]
    given = dict(start or {}) | dict(held or {})
    movable = np.array([name not in (held or {}) for name in names])
    x = np.clip(np.array([given.get(p.name, p.start) for p in parameters]), lower, upper)

    def whitened(points: Array, _: NDArray[np.intp]) -> tuple[Array, Array]:
        moved = points[0][:, None] + 1j * COMPLEX_STEP * np.eye(len(names))
        values = predictions(frame, effects, {n: moved[i][:, None] for i, n in enumerate(names)})
        values = np.broadcast_to(values, (len(names), len(frame.cells)))
        slopes = np.nan_to_num(np.imag(values).T / COMPLEX_STEP, nan=0.0, posinf=0.0, neginf=0.0) / frame.sd[:, None]
        return ((real(values[0]) - frame.cells.mean) / frame.sd)[None], slopes[None]

    found = levenberg_marquardt(
        whitened, x[None], lower, upper, held=~movable[None], scale=scale, iterations=iterations, least_gain=tolerance
    )
    chi2 = 2.0 * float(found.cost[0])
    if not np.isfinite(chi2):
        return None
    return Fit(effects, parameters, found.theta[0], chi2, found.residual[0], found.jacobian[0], frame)


def base_frame(cells: Cells, sd: Array, parameters: ParameterSet, form: str, *, keep_effects: bool = False) -> Frame:
    """Frame for the published model in `form` ("restitution" or "exchange"); friction and density free, the shape ratio fixed.

    keep_effects: effects that the parameters speak of belong to the model, at their values. Bounds and starts are the registry's.
    """
    top = float(np.max(np.abs(cells.mean)))
    force = top if cells.rows.of == "force" else top * float(np.median(_passes(cells)))
    unit = 1.0 if cells.rows.si else force / _REFERENCE_FORCE_N
    given = parameters.values
    base = tuple(_base(GRAIN[name], unit) for name in fitted(form))
    held = {p.name: float(given[p.name]) for p in GRAIN.values() if not p.form and not p.fitted and p.name in given}
    kept = {name: float(value) for name, value in given.items() if keep_effects and "." in name}
    return Frame(cells, sd, base, held | kept, unit)


def fit_base(frame: Frame, effects: tuple[str, ...] = ()) -> Fit:
    """Best of several starts over friction and density; raises ValueError when the loads overfill every admissible paddle."""
    first = {p.name: p.start for p in frame.base}
    densities = (*evenly("density", 3), GRAIN["density"].search[1])
    starts = [first] + [first | {"friction": f, "density": d} for f in evenly("friction", 3) for d in densities]
    found = []
    for start in starts:
        linear = _solve_gain(frame, effects, start)
        if linear is not None:
            found.append(linear)
    if not found:
        raise ValueError("the loads overfill the paddles at every admissible density")
    found.sort(key=lambda pair: pair[0])
    fits = [f for _, start in found[:3] if (f := fit(frame, effects, start)) is not None]
    return min(fits, key=lambda f: f.chi2)


def _solve_gain(frame: Frame, effects: tuple[str, ...], start: dict[str, float]) -> tuple[float, dict[str, float]] | None:
    """chi2 and start with the best gain (1 + e, or k1 and k2) at this friction and density; the reading is linear in it."""
    y = frame.cells.mean / frame.sd
    if "restitution" in start:
        unit = real(predictions(frame, effects, start | {"restitution": 0.0})) / frame.sd
        if not np.all(np.isfinite(unit)):
            return None
        gain = float(np.clip((unit @ y) / (unit @ unit), 1.0, 2.0))
        return float(np.sum((gain * unit - y) ** 2)), start | {"restitution": gain - 1.0}
    first = real(predictions(frame, effects, start | {"k1": 1.0, "k2": 0.0})) / frame.sd
    second = real(predictions(frame, effects, start | {"k1": 0.0, "k2": 1.0})) / frame.sd
    columns = np.stack((first, second), axis=-1)
    if not np.all(np.isfinite(columns)):
        return None
    gains = np.linalg.lstsq(columns, y, rcond=None)[0]
    limits = {p.name: (p.lower, p.upper) for p in frame.base}
    gains = np.array([np.clip(g, *limits[n]) for g, n in zip(gains, ("k1", "k2"), strict=True)])
    return float(np.sum((columns @ gains - y) ** 2)), start | {"k1": float(gains[0]), "k2": float(gains[1])}


def _base(known: GrainParameter, unit: float) -> Parameter:
    """Where it starts is the registry's matter, so that no verdict depends on the parameters that one begins with."""
    stretch = unit if known.follows_response else 1.0
    low, high = known.search
    return Parameter(known.name, low * stretch, high * stretch, known.typical * stretch, known.step * stretch)


def _passes(cells: Cells) -> Array:
    machine = cells.rows.machine
    return machine.passes_per_s(cells.elevator_speed_rad_s)

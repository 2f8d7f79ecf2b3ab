"""Bounded least squares of the forward model on whitened cell means.

Derivatives are exact (complex step). A fit keeps its whitened residuals and Jacobian, so that screening, cross-validation and
bootstraps can work in the tangent plane.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from yieldmon.estimation import model_error
from yieldmon.estimation.fitting.least_squares import levenberg_marquardt
from yieldmon.physics.effects import get_effect
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import COMPLEX_STEP, Array, real

from .frame import Frame, Parameter, effect_parameters, predictions
from .observations import Rows

LAW_SD = 0.1
"""Relative standard deviation of an effect's true law from the one in the library, smooth over angle, load and speed."""
LAW_SD_OF_FREE_SHAPES = 0.05
"""The same if restitution is fitted; it is smaller, since there are also laws of free shape (`effect.where_restitution`)."""
LAW_DEGREE = 2
"""Total degree of the polynomial in angle, load and speed that describes the difference."""
MOST_SEEN = 1.0
"""Largest ratio of a law's error to the part of the effect's change that recalibration cannot compensate."""


@dataclass(frozen=True)
class Fit:
    """A model with `effects` at its least chi-square, including that of the frame's prior if there is one.

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
    def beside_prior(self) -> float:
        """-2 log of the frame's prior at the base parameters relative to its maximum; not part of chi2."""
        columns, mean = prior_rows(self.frame, [p.name for p in self.parameters])
        return float(np.sum((columns @ (self.x - mean)) ** 2))

    @property
    def dof(self) -> int:
        """Number of cells minus number of parameters. Those at a bound are counted, so that F is rather too large."""
        return len(self.residual) - len(self.parameters)

    @property
    def at_bound(self) -> tuple[str, ...]:
        """Names of parameters that ended at a bound."""
        return tuple(
            p.name
            for p, v in zip(self.parameters, self.x, strict=True)
            if v <= p.lower + 1e-3 * (p.upper - p.lower) or v >= p.upper - 1e-3 * (p.upper - p.lower)
        )

    @property
    def leading_at_bound(self) -> tuple[str, ...]:
        """Names of the effects' first parameters, their sizes, that ended at a bound."""
        sizes = {effect_parameters(effect, self.frame.unit)[0].name for effect in self.effects}
        return tuple(name for name in self.at_bound if name in sizes)

    @property
    def shapes(self) -> list[int]:
        """Indices of the parameters that determine the shape of an effect's law and not its size: all but the first one of a
        further law."""
        out, at = list[int](), len(self.frame.base)
        for effect in self.effects:
            count = len(get_effect(effect).parameters)
            out += range(at + 1, at + count) if get_effect(effect).law else ()
            at += count
        return out

    def covariance(self) -> Array:
        """Covariance of the parameters in the tangent plane, shape (parameters, parameters).

        It includes the model error, with the size estimated from angles and loads left out (`estimated_error`), and the errors of
        the effects' laws. If chi-square is still too large, the covariance is scaled up by Birge's ratio. Standard deviations are
        at most the width of a parameter's bounds, and a parameter at a bound may have any value between them.
        """
        scale = np.array([p.scale for p in self.parameters])
        scaled = self.jacobian * scale
        error = self.columns_of_error(self.estimated_error)
        ratio = max(self.marginal(error)[0] / max(self.dof, 1), 1.0)
        width = np.array([p.upper - p.lower for p in self.parameters])
        inverse = np.linalg.inv(scaled.T @ scaled / ratio + np.diag((scale / width) ** 2))
        wide = model_error.widened(0.5 * (inverse + inverse.T), scaled / ratio, error)
        limit = np.minimum(1.0, (width / scale) / np.sqrt(np.diag(wide)))
        return wide * np.outer(limit * scale, limit * scale)

    @cached_property
    def level(self) -> Array:
        """Reading to which a relative model error refers, divided by sd, (cells,)."""
        frame = self.frame
        return np.asarray(model_error.level(frame.cells.mean + self.residual * frame.sd) / frame.sd)

    @cached_property
    def free(self) -> Array:
        """Columns that a relative model error consists of, (cells, columns)."""
        cells = self.frame.cells
        return model_error.basis(cells.plate_angle_rad, cells.load, cells.elevator_speed_rad_s)

    @cached_property
    def shown_error(self) -> float | None:
        """Relative model error, estimated from angles and loads left out; None if these do not determine it."""
        return model_error.estimated(self.residual, self.tangent(), 1.0 / self.level, self.frame.groups)

    @property
    def estimated_error(self) -> float:
        """`shown_error`, at least the floor."""
        return model_error.FLOOR if self.shown_error is None else self.shown_error

    @cached_property
    def shape_error(self) -> Array:
        """Whitened columns, with independent unit weights, of the errors of the effects' laws, (cells, columns).

        An effect's law may rise faster or slower with angle, load and speed than written: its change of the prediction times a
        smooth factor about 1 (`LAW_SD`, `LAW_SD_OF_FREE_SHAPES`).
        """
        cells = self.frame.cells
        smooth = model_error.basis(cells.plate_angle_rad, cells.load, cells.elevator_speed_rad_s, most=LAW_DEGREE)
        columns = []
        for change in self.changes:
            # A large change that recalibration mostly compensates must not lead to an error that explains everything.
            seen = float(np.linalg.norm(model_error.off(change, self.calibrating)))
            share = min(1.0, MOST_SEEN * seen / max(float(np.linalg.norm(change)), 1e-300))
            columns.append(self._law_sd * share * smooth * change[:, None])
        return np.concatenate(columns, axis=1) if columns else np.zeros((len(self.residual), 0))

    @property
    def _law_sd(self) -> float:
        """Relative error of an effect's law."""
        return LAW_SD_OF_FREE_SHAPES if any(p.name == "restitution" for p in self.frame.base) else LAW_SD

    @cached_property
    def changes(self) -> Array:
        """Whitened change of the prediction by each effect, given the others, (effects, cells)."""
        frame = self.frame
        whole = real(predictions(frame, self.effects, self.values)) if self.effects else frame.cells.mean
        out = np.zeros((len(self.effects), len(self.residual)))
        for number, effect in enumerate(self.effects):
            null = {p.name: p.start for p in effect_parameters(effect, frame.unit)}
            change = (whole - real(predictions(frame, self.effects, self.values | null))) / frame.sd
            out[number] = np.where(np.isfinite(change), change, 0.0)
        return out

    @cached_property
    def calibrating(self) -> Array:
        """Orthonormal basis of the changes of the whitened prediction by the base parameters, (cells, rank)."""
        known = len(self.frame.base)
        return model_error.orthonormal(self.jacobian[:, :known] * np.array([p.scale for p in self.parameters[:known]]))

    @property
    def cancelled(self) -> float:
        """Share of the effects' changes, in squares and beyond recalibration, that cancels out between them; 0 for one effect."""
        beyond = model_error.off(self.changes.T, self.calibrating)
        each, together = float(np.sum(beyond**2)), float(np.sum(np.sum(beyond, axis=1) ** 2))
        return max(1.0 - together / each, 0.0) if each > 0.0 else 0.0

    @cached_property
    def own_error(self) -> Array:
        """Whitened columns of the model's own error, with the frame's size of it."""
        return np.asarray(self.frame.model_error * self.free * self.level[:, None])

    def columns_of_error(self, size: float) -> Array:
        """Whitened columns, with independent unit weights, of the model's own error of a relative size and of the laws."""
        return np.concatenate((size * self.free * self.level[:, None], self.shape_error), axis=1)

    @cached_property
    def error(self) -> Array:
        """`columns_of_error` with the frame's size of the model's error."""
        return self.columns_of_error(self.frame.model_error)

    def marginal(self, columns: Array) -> tuple[float, float]:
        """Chi-square and log determinant when the weights of error columns are integrated out, off the tangent plane."""
        free = model_error.off(columns, self.tangent())
        small = np.eye(free.shape[1]) + free.T @ free
        along = free.T @ self.residual
        return self.chi2 - float(along @ np.linalg.solve(small, along)), float(np.linalg.slogdet(small)[1])

    def beside(self, columns: Array, scale: float, per_parameter: float) -> float:
        """-2 log evidence of the model with further whitened columns of free size, (cells, columns).

        scale: unit of differences in chi-square. per_parameter: what each parameter and column costs.
        """
        tangent = model_error.orthonormal(np.column_stack((self.tangent(), columns)))
        left, error = model_error.off(self.residual, tangent), model_error.off(self.error, tangent)
        small = np.eye(error.shape[1]) + error.T @ error
        along = error.T @ left
        chi2 = float(left @ left - along @ np.linalg.solve(small, along))
        cost = per_parameter * float(len(self.parameters) + columns.shape[1])
        return chi2 / scale + float(np.linalg.slogdet(small)[1]) + cost

    @cached_property
    def integrated(self) -> tuple[float, float]:
        """`marginal` over `error`."""
        return self.marginal(self.error)

    def tangent(self) -> Array:
        """Orthonormal basis of the changes of the whitened prediction by small changes of the parameters, (cells, rank)."""
        return model_error.orthonormal(self.jacobian * np.array([p.scale for p in self.parameters]))

    def predict(self, rows: Rows | Conditions) -> Array:
        """Prediction for other rows."""
        conditions = rows.conditions() if isinstance(rows, Rows) else rows
        model = ForwardModel(self.frame.cells.rows.machine, (*self.frame.known, *self.effects))
        evaluate = model.force if self.frame.cells.rows.of == "force" else model.paddle_momentum
        with np.errstate(invalid="ignore"):
            return real(np.asarray(evaluate(conditions, self.values, overfull="nan")))


def fit(
    frame: Frame,
    effects: Iterable[str],
    start: Mapping[str, float] | None = None,
    *,
    iterations: int = 60,
    tolerance: float = 1e-3,
    held: Mapping[str, float] | None = None,
) -> Fit | None:
    """`fit_all` from one start, with base and null values for parameters not in `start`; None if the loads overfill paddles
    there."""
    return fit_all(frame, effects, [start or {}], iterations=iterations, tolerance=tolerance, held=held)[0]


def fit_all(
    frame: Frame,
    effects: Iterable[str],
    starts: Sequence[Mapping[str, float]],
    *,
    iterations: int = 60,
    tolerance: float = 1e-3,
    held: Mapping[str, float] | None = None,
) -> list[Fit | None]:
    """Least squares from several starts at once; None for a start at which the loads overfill the paddles.

    held: parameters that stay at the given values. The iteration ends when the expected gain of a step in chi-square is less than
    `tolerance` times 1 + chi2 / dof.
    """
    effects = tuple(effects)
    parameters = frame.base + tuple(p for e in effects for p in effect_parameters(e, frame.unit))
    lower, upper = np.array([p.lower for p in parameters]), np.array([p.upper for p in parameters])
    names = [p.name for p in parameters]
    movable = np.array([name not in (held or {}) for name in names])
    first = np.array([[{**start, **(held or {})}.get(p.name, p.start) for p in parameters] for start in starts])
    count, cells = len(names), len(frame.cells)
    columns, mean = prior_rows(frame, names)

    def whitened(points: Array, _: NDArray[np.intp]) -> tuple[Array, Array]:
        moved = points + 1j * COMPLEX_STEP * np.eye(count)[:, None, :]
        values = predictions(frame, effects, {n: moved[..., i, None] for i, n in enumerate(names)})
        values = np.broadcast_to(values, (count, len(points), cells))
        slopes = np.moveaxis(np.imag(values), 0, -1) / COMPLEX_STEP
        slopes = np.nan_to_num(slopes, nan=0.0, posinf=0.0, neginf=0.0) / frame.sd[:, None]
        away = (real(values[0]) - frame.cells.mean) / frame.sd
        if not len(columns):
            return away, slopes
        known = np.broadcast_to(columns, (len(points), *columns.shape))
        return np.concatenate((away, (points - mean) @ columns.T), axis=-1), np.concatenate((slopes, known), axis=-2)

    found = levenberg_marquardt(
        whitened, np.clip(first, lower, upper), lower, upper, held=np.broadcast_to(~movable, first.shape),
        scale=np.array([p.scale for p in parameters]), iterations=iterations, least_gain=tolerance,
    )  # fmt: skip
    out: list[Fit | None] = []
    for theta, cost, residual, jacobian in zip(found.theta, found.cost, found.residual, found.jacobian, strict=True):
        if not np.isfinite(cost):
            out.append(None)
            continue
        chi2 = float(np.sum(residual[:cells] ** 2)) if len(columns) else 2.0 * float(cost)
        out.append(Fit(effects, parameters, theta, chi2, residual[:cells], jacobian[:cells], frame))
    return out


def prior_rows(frame: Frame, names: Sequence[str]) -> tuple[Array, Array]:
    """Rows that whiten the frame's prior, (rows, parameters), and its mean, (parameters,); no row without a prior."""
    if frame.prior is None:
        return np.zeros((0, len(names))), np.zeros(len(names))
    return frame.prior.whitening(names)

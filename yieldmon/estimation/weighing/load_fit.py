"""Density and impact gain fitted to weighed loads, and each load compared with the others.

Sources: Huber and Ronchetti, "Robust Statistics"; Stone, "Cross-validatory choice and assessment of statistical predictions",
J. R. Statist. Soc. B 36 (1974), for loads left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yieldmon.estimation.load_pattern import following
from yieldmon.estimation.open_loop import invert_force, inverted
from yieldmon.estimation.other_monitor import with_bias, with_new_bias
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.recent import Recent
from yieldmon.physics.effects.other_monitor import BIAS
from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array
from yieldmon.physics.throw import Throw

from .density_and_gain import DENSITY, gain_names, moved, shifted
from .load_inputs import LoadSettings, WeighedLoad
from .load_windows import LoadWindows
from .mass_errors import MassErrors

_ITERATIONS = 12
_SETTLED = 1e-5
_STEP = 1e-4
_RECENT = 64
"""Number of flow inversions kept: leave-one-out fits often ask for the same parameters."""
_SIGNIFICANT = 0.01
"""p value below which loads contradict a fit."""


@dataclass(frozen=True)
class LoadFit:
    """A fit of density and gain.

    Attributes
    ----------
    step : ndarray (2,)
        ln density and ln gain relative to the start.
    error : ndarray (n,)
        ln(measured / weighed mass) of each load.
    by_step : ndarray (n, 2)
        Derivatives of `error` with respect to the step.
    """

    step: Array
    error: Array
    by_step: Array


@dataclass(frozen=True)
class LeftOut:
    """Each load compared with a fit of the other active loads; nan if there is no other.

    Attributes
    ----------
    error : ndarray (n,)
        ln(predicted / weighed mass).
    away : ndarray (n,)
        Deviation from the prediction in standard deviations.
    cost : ndarray (n,)
        Cost of the fit of the others (`LoadProblem.cost`).
    """

    error: Array
    away: Array
    cost: Array


class LoadProblem:
    """One calibration by loads; coordinates are ln density and ln gain relative to `start`.

    Attributes
    ----------
    model : ForwardModel
    given, start : ParameterSet
        The parameters to calibrate, and those with the prior of the calibration.
    loads : tuple of WeighedLoad (n,)
    weighed : ndarray (n,)
        Weighed masses, kg.
    windows : LoadWindows
        The windows of all loads.
    errors : MassErrors
        Errors of measured and weighed masses apart from the parameters'.
    settings : LoadSettings
    beside : tuple of str
        Parameters that are neither fitted here nor held, because the caller fits them.
    held : tuple of str
        Parameters that keep their values but whose uncertainty counts.
    prior : ndarray
        Covariance of (held..., ln density, ln gain).
    """

    def __init__(
        self,
        model: ForwardModel,
        given: ParameterSet,
        start: ParameterSet,
        loads: Sequence[WeighedLoad],
        settings: LoadSettings,
        beside: tuple[str, ...] = (),
    ) -> None:
        self.beside = beside
        self.model = following(model, start)
        self.loads, self.settings = tuple(loads), settings
        shared = any(load.common_kg > 0.0 for load in loads)
        self.given, self.start = (with_bias(given), with_new_bias(start)) if shared else (given, start)
        self.windows = LoadWindows.of(loads)
        self.weighed = np.array([load.weighed_kg for load in loads])
        self.errors = MassErrors.of(loads, settings, moisture_in_model=self.model.needs_moisture)
        self.held, self.prior = self._coordinates()
        self._throw: Throw | None = None
        """The last throw, from which the next one is computed faster."""
        self._flows: Recent[tuple[Array, Array]] = Recent(_RECENT)
        self._fits: dict[tuple[bytes, int], LoadFit] = {}
        """Fits that began at the start, by active loads and number of directions."""

    def _coordinates(self) -> tuple[tuple[str, ...], Array]:
        """Names of the held parameters, and prior covariance of (held..., ln density, ln gain)."""
        known = self.start
        gain = gain_names(known)
        moving = (DENSITY, *gain, *self.beside)
        held = tuple(n for n in known.covariance_names if n not in moving and known.standard_deviation(n) > 0.0)
        size = known.values[DENSITY], (1.0 + known.values["restitution"]) if len(gain) == 1 else known.values["k2"]
        names = (*held, DENSITY, gain[-1])
        scale = np.array([1.0] * len(held) + list(size))
        return held, known.covariance_of(names) / np.outer(scale, scale)

    def flow(self, known: ParameterSet) -> tuple[Array, Array]:
        """Mass flow of every window with these parameters (nan above a full paddle), and d(force)/d(flow) there."""
        return self._flows.of(tuple(known.values.items()), lambda: self._inverted(known))

    def _inverted(self, known: ParameterSet) -> tuple[Array, Array]:
        force, angle, speed = self.windows.force_n, self.windows.plate_angle_rad, self.windows.elevator_speed_rad_s
        moisture = self.windows.moisture_pct
        if known is self.start:
            # The set is in use, so its load curve is already cached.
            return inverted(self.model, known.values, force, angle, speed, moisture)
        column = None if moisture is None else moisture[:, None]
        self._throw = self.model.throw(angle[:, None], speed[:, None], known.values, column, like=self._throw)
        return invert_force(self._throw, force)

    def mass(self, known: ParameterSet) -> Array:
        """Mass of each load measured with these parameters, kg, (n,)."""
        return self.windows.total_kg(self.flow(known)[0])

    def slopes(self, values: Sequence[Mapping[str, float]], flow: Array, by_flow: Array, steps: Sequence[float]) -> Array:
        """Difference quotients of ln mass, (n, k).

        Parameters
        ----------
        values : sequence of mapping (k,)
            Changed parameter values, each with all parameters.
        flow, by_flow : ndarray
            Results of `flow` with the unchanged parameters.
        steps : sequence of float (k,)
            Size of each change.
        """
        windows = self.windows
        at = Conditions(
            windows.plate_angle_rad, windows.elevator_speed_rad_s, mass_flow_kg_s=flow, moisture_pct=windows.moisture_pct
        )
        alike = len({tuple(item) for item in values}) == 1
        forces = (
            list(np.real(self.model.force(at, _in_rows(values), overfull="nan")))
            if alike
            else [np.real(self.model.force(at, item, overfull="nan")) for item in values]
        )
        total_kg = windows.total_kg(flow)
        changes_kg = [windows.total_kg((windows.force_n - force) / by_flow) for force in forces]
        return np.stack([change_kg / total_kg / step for change_kg, step in zip(changes_kg, steps, strict=True)], axis=1)

    def held_slopes(self, centre: ParameterSet) -> Array:
        """Derivatives of ln mass with respect to each held parameter, (n, held)."""
        flow, by_flow = self.flow(centre)
        if not self.held:
            return np.zeros((len(self.loads), 0))
        steps = [1e-2 * self.start.standard_deviation(name) for name in self.held]
        each = [shifted(centre.values, name, step) for name, step in zip(self.held, steps, strict=True)]
        return np.asarray(np.nan_to_num(self.slopes(each, flow, by_flow, steps)))

    def ticket_slopes(self) -> Array:
        """Derivatives of ln(measured / weighed mass) with respect to the held parameters through the weighed mass, (n, held)."""
        return np.outer(-self.errors.common, [float(name == BIAS) for name in self.held])

    def fit(self, active: NDArray[np.bool_], directions: int, near: LoadFit | None = None) -> LoadFit:
        """Most likely step, given the active loads.

        Parameters
        ----------
        active : ndarray of bool (n,)
        directions : int
            0, 1 or 2: the step lies along so many directions, the best determined ones.
        near : LoadFit, optional
            First step of the search.

        Raises
        ------
        ValueError
            If a load's force exceeds that of a full paddle.
        """
        if near is not None:
            return self._fit(active, directions, near)
        key = active.tobytes(), directions
        if key not in self._fits:
            self._fits[key] = self._fit(active, directions, None)
        return self._fits[key]

    def _fit(self, active: NDArray[np.bool_], directions: int, near: LoadFit | None) -> LoadFit:
        step = np.zeros(2) if near is None else near.step
        error, slope = self._slopes(step) if near is None else (near.error, near.by_step)
        weight = active.astype(float)
        for _ in range(_ITERATIONS):
            weight = active / np.maximum(np.abs(error) / self._far, 1.0) if np.any(active) else weight
            basis = self.basis(slope, weight)[:, :directions]
            h = slope @ basis
            information = h.T @ self.errors.informed(h, weight) + np.eye(directions)
            # The residual that would be left at the start, in the linear model about this step.
            target = error - slope @ step
            against = h.T @ self.errors.informed(target[:, None], weight)[:, 0]
            wanted = -basis @ np.linalg.solve(information, against) if directions else np.zeros(2)
            change = wanted - step
            for _ in range(8):
                after, after_slope = self._slopes(step + change)
                if np.all(np.isfinite(after)):
                    break
                change = 0.5 * change
            else:
                worst = int(np.argmin(np.where(np.isfinite(after), np.inf, error)))
                masses = f"weighed {self.weighed[worst]:.0f} kg, measured {self.mass(self.given)[worst]:.0f} kg"
                problem = "a weighed load holds more force than a full paddle gives with these parameters"
                raise ValueError(f"{problem}: load {self.loads[worst].name}, {masses}")
            step, error, slope = step + change, after, after_slope
            if float(np.max(np.abs(change))) < _SETTLED:
                break
        return LoadFit(step, error, slope)

    @property
    def _far(self) -> Array:
        """ln error beyond which a load loses weight, (n,)."""
        return np.asarray(self.settings.huber_sds * np.hypot(self.errors.sd, self.errors.moist))

    def _slopes(self, step: Array) -> tuple[Array, Array]:
        """ln(measured / weighed mass), (n,), nan above a full paddle; and its derivatives with respect to the step, (n, 2)."""
        flow, by_flow = self.flow(moved(self.start, float(step[0]), float(step[1])))
        with np.errstate(divide="ignore", invalid="ignore"):
            error = np.log(self.windows.total_kg(flow) / self.weighed)
            beside = [moved(self.start, *map(float, step + _STEP * d)).values for d in np.eye(2)]
            slopes = self.slopes(beside, flow, by_flow, (_STEP, _STEP))
        return error, slopes

    def basis(self, slope: Array, weight: Array) -> Array:
        """Directions with a prior standard deviation of 1 in columns, (2, 2), the one that the loads determine best first."""
        root = np.linalg.cholesky(self.prior[-2:, -2:])
        _, vectors = np.linalg.eigh(root.T @ slope.T @ self.errors.informed(slope, weight) @ root)
        return np.asarray(root @ vectors[:, ::-1])

    def information(self, fit: LoadFit, active: NDArray[np.bool_]) -> Array:
        """Information of the loads relative to the prior's, along the directions of `basis`, (2,)."""
        basis = self.basis(fit.by_step, active.astype(float))
        h = fit.by_step @ basis
        return np.asarray(np.sum(h * self.errors.informed(h, active.astype(float)), axis=0))

    def cost(self, fit: LoadFit, active: NDArray[np.bool_]) -> float:
        """Half the sum of the active loads' losses (Huber) and the prior's square."""
        limit = self.settings.huber_sds
        far = np.abs(fit.error[active]) / self._far[active] * limit
        loss = np.where(far > limit, 2.0 * limit * far - limit**2, far**2)
        away = np.linalg.solve(np.linalg.cholesky(self.prior[-2:, -2:]), fit.step)
        return 0.5 * float(loss.sum() + away @ away)

    def left_out(self, active: NDArray[np.bool_], directions: int) -> LeftOut:
        """Each load compared with a fit of the other active loads along so many directions."""
        count = len(self.loads)
        errors, away, costs = (np.full(count, np.nan) for _ in range(3))
        near = self.fit(active, directions)
        for k in range(count):
            others = active.copy()
            others[k] = False
            if not np.any(others):
                continue
            fit = near if not active[k] else self.fit(others, min(directions, int(others.sum())), near)
            errors[k], costs[k] = fit.error[k], self.cost(fit, others)
            away[k] = self._away(fit, others, k)
        return LeftOut(errors, away, costs)

    def last_against_others(self) -> float | None:
        """Relative error of the last load as `wrong_tickets.contradicted` returns it; None if scatter explains it."""
        others = np.arange(len(self.loads)) < len(self.loads) - 1
        fit = self.fit(others, min(2, int(others.sum())))
        away = self._away(fit, others, len(self.loads) - 1)
        return float(np.expm1(-fit.error[-1])) if away >= self.settings.outlier_sds else None

    def _away(self, fit: LoadFit, others: NDArray[np.bool_], k: int) -> float:
        """Deviation of load k from its prediction by the others, in standard deviations that include `law`."""
        error = fit.error - fit.by_step @ fit.step
        h = fit.by_step @ np.linalg.cholesky(self.prior[-2:, -2:])
        limit = self.settings.huber_sds * np.hypot(self.errors.sd, self.settings.law_error)
        law, apart = self.errors.law, self.errors.apart
        covariance = h @ h.T + law + np.diag(apart**2 * np.maximum(np.abs(fit.error) / limit, 1.0))
        between = np.linalg.solve(covariance[np.ix_(others, others)], covariance[others, k])
        variance = h[k] @ h[k] + law[k, k] + apart[k] ** 2 - between @ covariance[others, k]
        return float(abs(error[k] - between @ error[others]) / np.sqrt(variance))

    def contradicts(self, fit: LoadFit, active: NDArray[np.bool_], directions: int) -> bool:
        """Whether the active loads contradict a fit along so many directions, by a chi-square test."""
        from scipy.special import chdtrc  # slow to import: not needed by commands without loads

        misfit = float(fit.error @ self.errors.informed(fit.error[:, None], active.astype(float))[:, 0])
        return bool(chdtrc(max(float(active.sum()) - directions, 1.0), misfit) < _SIGNIFICANT)

    def spread(self, known: ParameterSet, active: NDArray[np.bool_]) -> tuple[float, float]:
        """Relative standard deviation of a further load, and of the active loads' mean, from a set's own covariance."""
        rows = self._own_slopes(known)[active]
        spread = np.einsum("ki,ij,kj->k", rows, known.covariance, rows)
        mean = rows.mean(axis=0)
        further = spread.mean() + np.mean(self.errors.own[active] ** 2)
        return float(np.sqrt(further)), float(np.sqrt(mean @ known.covariance @ mean))

    def spreads(self, known: ParameterSet) -> Array:
        """Relative standard deviation of each measured mass from a set's own covariance, (n,)."""
        rows = self._own_slopes(known)
        return np.asarray(np.sqrt(np.einsum("ki,ij,kj->k", rows, known.covariance, rows) + self.errors.own**2))

    def _own_slopes(self, known: ParameterSet) -> Array:
        """Derivatives of ln mass with respect to each parameter of a set's covariance, (n, k); 0 if a load has no flow."""
        flow, by_flow = self.flow(known)
        steps = [1e-2 * known.standard_deviation(name) for name in known.covariance_names]
        each = [shifted(known.values, name, step) for name, step in zip(known.covariance_names, steps, strict=True)]
        return np.asarray(np.nan_to_num(self.slopes(each, flow, by_flow, steps)))


def _in_rows(values: Sequence[Mapping[str, float]]) -> dict[str, Array]:
    """Each value as an array (k, 1), so that k parameter sets are evaluated in one call."""
    return {name: np.array([[item[name]] for item in values]) for name in values[0]}

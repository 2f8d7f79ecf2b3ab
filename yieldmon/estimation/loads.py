"""Calibration by loads: what weighed loads determine of a machine that measured them.

Loads at one plate angle determine two things: how much the monitor weighs altogether, and how that changes with the flow. Both
live in density and impact gain (1 + restitution, or k1 and k2), which move in their logarithms; all others are held with their
standard deviations, and go on counting in the covariance of the result (a consider filter after Schmidt). A direction
about which the loads say less than was known before is held as well.

The scale counts: density and gain start with the standard deviations in `LoadSettings`, whatever the parameters claim. One
load among four or more that the others contradict is named and left out; smaller departures lose weight (Huber).

Sources: Huber and Ronchetti, "Robust Statistics"; Schmidt, "Application of state-space methods to navigation problems" (1966);
Stone, "Cross-validatory choice and assessment of statistical predictions", J. R. Statist. Soc. B 36 (1974), for loads left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from yieldmon.physics.model import Conditions, ForwardModel
from yieldmon.physics.numerics import Array

from .closed_loop import self_calibrate
from .closed_loop_inputs import MassAnchor, Sweep
from .closed_loop_settings import ClosedLoopSettings
from .open_loop import invert_force
from .parameters import CalibratedRange, ParameterSet

DENSITY = "density"
LEAST_LOADS = 3
"""Fewer weighed loads say nothing against a further one."""
_ITERATIONS = 12
_SETTLED = 1e-5
_STEP = 1e-4
_SIGNIFICANT = 0.01
"""Probability by chance below which loads speak against a fit."""
_LEFT_OUT_WEIGHT = 0.632
_PRIOR_LOADS = 4.0
"""What `LoadSettings.load_error` counts for, in loads, beside the scatter that the loads themselves show."""


@dataclass(frozen=True, slots=True)
class LoadSettings:
    """What is assumed before the loads.

    load_error: relative standard deviation of a load's measured mass beside the scale's. density_sd, gain_sd: relative, of a
    machine that was never calibrated. least_information: of the loads on a direction, over what was known; below it, it is held.
    outlier_sds: departure from the other loads that is no scatter. huber_sds: departure from which a load loses weight.
    """

    load_error: float = 0.002
    density_sd: float = 0.2
    gain_sd: float = 0.2
    least_information: float = 1.0
    outlier_sds: float = 4.0
    outlier_least: int = 4
    """Loads below which it is not known which one is wrong."""
    huber_sds: float = 1.5


@dataclass(frozen=True)
class WeighedLoad:
    """A weighed mass and the windows in which it was harvested, all arrays (n,).

    duration_s: time that each window stands for. Raises ValueError for shapes that differ or values that are not finite.
    """

    name: str
    weighed_kg: float
    std_dev_kg: float
    duration_s: Array
    force_n: Array
    plate_angle_rad: Array
    elevator_speed_rad_s: Array
    moisture_pct: Array | None = None

    def __post_init__(self) -> None:
        if not (0.0 < self.weighed_kg < np.inf and 0.0 < self.std_dev_kg < np.inf):
            raise ValueError(f"load {self.name}: weighed {self.weighed_kg} kg, sd {self.std_dev_kg} kg; expected above 0")
        for name in ("duration_s", "force_n", "plate_angle_rad", "elevator_speed_rad_s"):
            value = getattr(self, name)
            if value.shape != self.force_n.shape or value.ndim != 1 or not value.size or not np.all(np.isfinite(value)):
                raise ValueError(f"load {self.name}: {name} must hold one finite number for each window")

    @property
    def relative_sd(self) -> float:
        """Of the weighed mass."""
        return self.std_dev_kg / self.weighed_kg

    def condensed(self, groups: int = 12) -> WeighedLoad:
        """Windows of like force, at like angle and speed, replaced by their mean: at most `groups` for each angle and speed."""
        key = np.stack((np.round(self.plate_angle_rad / np.radians(2.0)), np.round(np.log(self.elevator_speed_rad_s) / 0.03)))
        _, place = np.unique(key, axis=1, return_inverse=True)
        parts: list[NDArray[np.intp]] = []
        for value in np.unique(place):
            here = np.flatnonzero(place.ravel() == value)
            order = here[np.argsort(self.force_n[here], kind="stable")]
            parts += [p for p in np.array_split(order, min(groups, order.size)) if self.duration_s[p].sum() > 0.0]

        def mean(column: Array) -> Array:
            return np.array([np.average(column[p], weights=self.duration_s[p]) for p in parts])

        return replace(
            self,
            duration_s=np.array([self.duration_s[p].sum() for p in parts]),
            force_n=mean(self.force_n),
            plate_angle_rad=mean(self.plate_angle_rad),
            elevator_speed_rad_s=mean(self.elevator_speed_rad_s),
            moisture_pct=None if self.moisture_pct is None else mean(self.moisture_pct),
        )


@dataclass(frozen=True, slots=True)
class LoadResult:
    """One load, kg. left_out_error: relative error of the mass as the other loads alone would have it, nan for the only load.

    outlier: the other loads contradict it, and it changed nothing.
    """

    name: str
    weighed_kg: float
    before_kg: float
    after_kg: float
    left_out_error: float
    outlier: bool


@dataclass(frozen=True)
class LoadCalibration:
    """The result of `calibrate_loads`.

    parameter_set: to use from now on; the one given where refused. names: the parameters that moved. scale: measured mass after
    over before, of all loads. next_load_sd: relative standard deviation of a further load like these. load_dependence: whether
    the loads determine how the error changes with flow. held: parameters that stayed as they were.
    """

    parameter_set: ParameterSet
    names: tuple[str, ...]
    held: tuple[str, ...]
    loads: tuple[LoadResult, ...]
    scale: float
    scale_sd: float
    load_dependence: bool
    next_load_sd: float
    rms_before: float
    rms_left_out: float
    refused: bool
    sweeps_used: int
    sentences: tuple[str, ...] = field(default=())

    @property
    def outliers(self) -> tuple[str, ...]:
        """Names of the loads that the others contradict."""
        return tuple(load.name for load in self.loads if load.outlier)


def calibrate_loads(
    model: ForwardModel,
    prior: ParameterSet,
    loads: Sequence[WeighedLoad],
    *,
    sweeps: Sequence[Sweep] = (),
    settings: LoadSettings | None = None,
    sweep_settings: ClosedLoopSettings | None = None,
) -> LoadCalibration:
    """Density and impact gain from weighed loads, and with `sweeps` what these determine of the rest first.

    Parameters
    ----------
    model : ForwardModel
        Of the machine that measured the loads, with the prior's effects.
    prior : ParameterSet
        What measured the loads, or the crop's shipped parameters.
    loads : sequence of WeighedLoad
        One or more.
    sweeps : sequence of Sweep
        Of the same grain: fitted together with the loads that do not contradict each other, as in `self_calibrate`.

    Returns
    -------
    LoadCalibration
        With `refused` where loads left out are measured worse than before.

    Raises
    ------
    ValueError
        Without loads, or where a load holds more force than a full paddle gives.
    """
    if not loads:
        raise ValueError("no weighed load to learn from")
    settings = LoadSettings() if settings is None else settings
    problem = _Problem(model, prior, widened(prior, settings), [load.condensed() for load in loads], settings)
    return problem.solve(
        sweeps, ClosedLoopSettings(flow="process", model_error=0.01) if sweep_settings is None else sweep_settings
    )


def contradicted(
    model: ForwardModel,
    prior: ParameterSet,
    before: Sequence[WeighedLoad],
    load: WeighedLoad,
    settings: LoadSettings | None = None,
    *,
    least: int = LEAST_LOADS,
) -> float | None:
    """Relative error of a weighed mass by what the loads before it say, where that is beyond any scatter; else None.

    Nothing is said with fewer than `least` loads before it. Raises ValueError as `calibrate_loads`.
    """
    if len(before) < least:
        return None
    settings = LoadSettings() if settings is None else settings
    problem = _Problem(model, prior, widened(prior, settings), [w.condensed() for w in (*before, load)], settings)
    return problem.last_against_others()


def departure(
    model: ForwardModel, known: ParameterSet, load: WeighedLoad, settings: LoadSettings | None = None
) -> tuple[float, float]:
    """Relative error of a load as these parameters measure it, and its standard deviation by their covariance and the scale.

    Both are nan where the load holds more force than a full paddle gives.
    """
    settings = LoadSettings() if settings is None else settings
    problem = _Problem(model, known, known, [load.condensed()], settings)
    error = float(np.log(problem.mass(known)[0] / load.weighed_kg))
    return float(np.expm1(error)), float(np.hypot(problem.spread(known, np.ones(1, dtype=bool))[1], problem.sd[0]))


def widened(prior: ParameterSet, settings: LoadSettings) -> ParameterSet:
    """The set with density and gain at least as uncertain as those of a machine that was never calibrated."""
    names = list(prior.covariance_names)
    names += [n for n in (DENSITY, *_gain_names(prior)) if n not in names]
    covariance = prior.covariance_of(names)
    for name, sd in ((DENSITY, settings.density_sd), *((n, settings.gain_sd) for n in _gain_names(prior))):
        i = names.index(name)
        size = 1.0 + prior.values[name] if name == "restitution" else abs(prior.values[name])
        covariance[i, i] = max(covariance[i, i], (sd * size) ** 2)
    return replace(prior, covariance_names=tuple(names), covariance=covariance)


def _shifted(known: ParameterSet, name: str, step: float) -> ParameterSet:
    return replace(known, values=dict(known.values) | {name: known.values[name] + step})


def _in_rows(known: Sequence[ParameterSet]) -> dict[str, Array]:
    """Values of sets that name the same, (k, 1) each: to be evaluated together."""
    return {name: np.array([[item.values[name]] for item in known]) for name in known[0].values}


def _gain_names(known: ParameterSet) -> tuple[str, ...]:
    return ("restitution",) if "restitution" in known.values else ("k1", "k2")


def moved(known: ParameterSet, ln_density: float, ln_gain: float) -> ParameterSet:
    """The set with density and impact gain multiplied by exp of the arguments; covariance as it was.

    A restitution that no longer lies between 0 and 1 is no restitution: such a gain is carried by k2, and k1 is 0.
    """
    values = dict(known.values)
    values[DENSITY] *= float(np.exp(ln_density))
    factor = float(np.exp(ln_gain))
    if "k2" in values:
        return replace(known, values=values | {"k1": values["k1"] * factor, "k2": values["k2"] * factor})
    gain = (1.0 + values["restitution"]) * factor
    if 1.0 <= gain <= 2.0:
        return replace(known, values=values | {"restitution": gain - 1.0})
    del values["restitution"]
    names = tuple("k2" if n == "restitution" else n for n in known.covariance_names)
    return replace(known, values=values | {"k1": 0.0, "k2": gain}, covariance_names=names)


@dataclass(frozen=True)
class _Fit:
    """ln density and ln gain relative to the start (2,), and ln of each load's mass over the weighed one (n,)."""

    step: Array
    error: Array
    by_step: Array
    """(n, 2)"""


@dataclass(frozen=True)
class _LeftOut:
    """Of each load, (n,): ln error as the other active loads have it and its standard deviation, nan where there is no other;
    what the others' own fit costs without it."""

    error: Array
    std_dev: Array
    cost: Array


class _Problem:
    """One calibration by loads; coordinates are ln density and ln gain relative to `start`."""

    def __init__(
        self, model: ForwardModel, given: ParameterSet, start: ParameterSet, loads: Sequence[WeighedLoad], settings: LoadSettings
    ) -> None:
        self.model, self.given, self.start, self.loads, self.settings = model, given, start, tuple(loads), settings
        self.sd = np.hypot([load.relative_sd for load in loads], settings.load_error)
        self.force, self.angle, self.speed, self.duration = (
            np.concatenate([getattr(load, name) for load in loads])
            for name in ("force_n", "plate_angle_rad", "elevator_speed_rad_s", "duration_s")
        )
        known = all(load.moisture_pct is not None for load in loads)
        self.moisture = np.concatenate([np.asarray(load.moisture_pct) for load in loads]) if known else None
        self.of_load = np.repeat(np.arange(len(loads)), [load.force_n.size for load in loads])
        self.weighed = np.array([load.weighed_kg for load in loads])
        self.held, self.prior = self._coordinates()

    def _coordinates(self) -> tuple[tuple[str, ...], Array]:
        """Names of what is held, and the covariance of (held..., ln density, ln gain)."""
        known = self.start
        gain = _gain_names(known)
        held = tuple(n for n in known.covariance_names if n != DENSITY and n not in gain and known.standard_deviation(n) > 0.0)
        size = known.values[DENSITY], (1.0 + known.values["restitution"]) if len(gain) == 1 else known.values["k2"]
        names = (*held, DENSITY, gain[-1])
        scale = np.array([1.0] * len(held) + list(size))
        return held, known.covariance_of(names) / np.outer(scale, scale)

    def flow(self, known: ParameterSet) -> tuple[Array, Array]:
        """Mass flow of every window with these parameters, nan above a full paddle, and d(force)/d(flow) there."""
        moisture = None if self.moisture is None else self.moisture[:, None]
        throw = self.model.throw(self.angle[:, None], self.speed[:, None], known.values, moisture)
        return invert_force(throw, self.force)

    def total(self, flow: Array) -> Array:
        """(n,) kg of each load."""
        return np.asarray(np.bincount(self.of_load, self.duration * flow, minlength=len(self.loads)), dtype=float)

    def mass(self, known: ParameterSet) -> Array:
        """(n,) kg that these parameters make of each load."""
        return self.total(self.flow(known)[0])

    def slopes(self, known: Sequence[ParameterSet], flow: Array, by_flow: Array, steps: Sequence[float]) -> Array:
        """(n, k) change of ln mass by what turns the parameters into each of `known`, over its step; flow: given before."""
        at = Conditions(self.angle, self.speed, mass_flow_kg_s=flow, moisture_pct=self.moisture)
        alike = len({tuple(item.values) for item in known}) == 1
        forces = (
            list(np.real(self.model.force(at, _in_rows(known), overfull="nan")))
            if alike
            else [np.real(self.model.force(at, item.values, overfull="nan")) for item in known]
        )
        shifts = [(self.force - force) / by_flow for force in forces]
        return np.stack([self.total(shift) / self.total(flow) / step for shift, step in zip(shifts, steps, strict=True)], axis=1)

    def fit(self, active: NDArray[np.bool_], directions: int, near: _Fit | None = None) -> _Fit:
        """Most likely step from the active loads, along the best determined `directions` (0, 1 or 2). near: where to begin."""
        step = np.zeros(2) if near is None else near.step
        error, slope = self._slopes(step) if near is None else (near.error, near.by_step)
        weight = active.astype(float)
        for _ in range(_ITERATIONS):
            weight = active / np.maximum(np.abs(error) / (self.settings.huber_sds * self.sd), 1.0) if np.any(active) else weight
            basis = self._basis(slope, weight)[:, :directions]
            h = slope @ basis
            information = h.T @ (h * (weight / self.sd**2)[:, None]) + np.eye(directions)
            # The residual that would be left at the start, in the linear model about this step.
            target = error - slope @ step
            wanted = -basis @ np.linalg.solve(information, h.T @ (weight / self.sd**2 * target)) if directions else np.zeros(2)
            change = wanted - step
            for _ in range(8):
                after, after_slope = self._slopes(step + change)
                if np.all(np.isfinite(after)):
                    break
                change = 0.5 * change
            else:
                raise ValueError("a weighed load holds more force than a full paddle gives with these parameters")
            step, error, slope = step + change, after, after_slope
            if float(np.max(np.abs(change))) < _SETTLED:
                break
        return _Fit(step, error, slope)

    def _slopes(self, step: Array) -> tuple[Array, Array]:
        """(n,) ln of measured over weighed mass, nan where a paddle would be more than full, and (n, 2) by the step."""
        flow, by_flow = self.flow(moved(self.start, float(step[0]), float(step[1])))
        with np.errstate(divide="ignore", invalid="ignore"):
            error = np.log(self.total(flow) / self.weighed)
            beside = [moved(self.start, *map(float, step + _STEP * d)) for d in np.eye(2)]
            slopes = self.slopes(beside, flow, by_flow, (_STEP, _STEP))
        return error, slopes

    def _basis(self, slope: Array, weight: Array) -> Array:
        """(2, 2): directions of unit prior standard deviation, the one that the loads determine best first."""
        root = np.linalg.cholesky(self.prior[-2:, -2:])
        _, vectors = np.linalg.eigh(root.T @ slope.T @ (slope * (weight / self.sd**2)[:, None]) @ root)
        return np.asarray(root @ vectors[:, ::-1])

    def information(self, fit: _Fit, active: NDArray[np.bool_]) -> Array:
        """(2,) of the loads over what was known, along the directions of `_basis`."""
        basis = self._basis(fit.by_step, active.astype(float))
        h = fit.by_step[active] @ basis / self.sd[active, None]
        return np.asarray(np.sum(h * h, axis=0))

    def cost(self, fit: _Fit, active: NDArray[np.bool_]) -> float:
        """Half the squares of what the active loads (by Huber's loss) and the prior say against a fit."""
        far = np.abs(fit.error[active]) / self.sd[active]
        limit = self.settings.huber_sds
        loss = np.where(far > limit, 2.0 * limit * far - limit**2, far**2)
        away = np.linalg.solve(np.linalg.cholesky(self.prior[-2:, -2:]), fit.step)
        return 0.5 * float(loss.sum() + away @ away)

    def left_out(self, active: NDArray[np.bool_], directions: int) -> _LeftOut:
        """Each load as the other active ones have it."""
        count = len(self.loads)
        errors, deviations, costs = (np.full(count, np.nan) for _ in range(3))
        near = self.fit(active, directions)
        for k in range(count):
            others = active.copy()
            others[k] = False
            if not np.any(others):
                continue
            fit = near if not active[k] else self.fit(others, min(directions, int(others.sum())), near)
            errors[k], costs[k] = fit.error[k], self.cost(fit, others)
            deviations[k] = self._predicted_sd(fit, others, k)
        return _LeftOut(errors, deviations, costs)

    def last_against_others(self) -> float | None:
        """See `contradicted`."""
        others = np.arange(len(self.loads)) < len(self.loads) - 1
        fit = self.fit(others, min(2, int(others.sum())))
        error, deviation = fit.error[-1], self._predicted_sd(fit, others, -1)
        return float(np.expm1(-error)) if abs(error) >= self.settings.outlier_sds * deviation else None

    def _predicted_sd(self, fit: _Fit, others: NDArray[np.bool_], k: int) -> float:
        """Of the ln error of load k, by the others."""
        h = fit.by_step @ self._basis(fit.by_step, others.astype(float))
        information = h[others].T @ (h[others] / self.sd[others, None] ** 2) + np.eye(2)
        return float(np.sqrt(h[k] @ np.linalg.solve(information, h[k]) + self.sd[k] ** 2))

    def inliers(self) -> NDArray[np.bool_]:
        """Loads that the others do not contradict; at least three, and more than half of them, are left.

        The one to go is that without which the others agree best.
        """
        active = np.ones(len(self.loads), dtype=bool)
        while active.sum() >= self.settings.outlier_least and 2 * (active.sum() - 1) > active.size:
            found = self.left_out(active, 2)
            worst = int(np.argmin(np.where(active, found.cost, np.inf)))
            if abs(found.error[worst]) < self.settings.outlier_sds * found.std_dev[worst]:
                break
            active[worst] = False
        return active

    def solve(self, sweeps: Sequence[Sweep], sweep_settings: ClosedLoopSettings) -> LoadCalibration:
        """See `calibrate_loads`."""
        active = self.inliers()
        fit, directions, errors, full = self._fitted(active)
        posterior, next_sd, level_sd = self._posterior(fit, active, directions, full)
        after = self.weighed * np.exp(fit.error)
        together = self._together(fit, sweeps, active, sweep_settings) if sweeps else None
        if together is not None:
            posterior, after = together, self.mass(together)
            errors = self._left_out_together(fit, sweeps, active, sweep_settings)
            next_sd, level_sd = self.spread(posterior, active)
        before = self.mass(self.given)
        rms_before, rms_after = _rms(np.log(before / self.weighed)[active]), _rms(errors[active])
        expected = _expected_rms(np.log(after / self.weighed)[active], errors[active])
        refused = bool(active.sum() > 1 and expected > rms_before)
        chosen, after = (self.given, before) if refused else (posterior, after)
        results = tuple(
            LoadResult(load.name, load.weighed_kg, float(b), float(a), float(np.expm1(e)), not bool(ok))
            for load, b, a, e, ok in zip(self.loads, before, after, errors, active, strict=True)
        )
        moving = () if refused else tuple(n for n, v in chosen.values.items() if self.given.values.get(n) != v)
        calibration = LoadCalibration(
            parameter_set=chosen,
            names=moving,
            held=tuple(n for n in chosen.values if n not in moving),
            loads=results,
            scale=float(after[active].sum() / before[active].sum()),
            scale_sd=level_sd,
            load_dependence=directions == 2 and not refused,
            next_load_sd=next_sd,
            rms_before=rms_before,
            rms_left_out=rms_after,
            refused=refused,
            sweeps_used=0 if together is None else len(sweeps),
        )
        return replace(calibration, sentences=tuple(_sentences(calibration, len(sweeps))))

    def _fitted(self, active: NDArray[np.bool_]) -> tuple[_Fit, int, Array, _Fit | None]:
        """The fit, along how many directions it moved, and the errors of loads left out; and the fit along both where the loads
        determine both but one is enough."""
        both = self.fit(active, 2)
        directions = int(np.sum(self.information(both, active) >= self.settings.least_information))
        errors = self.left_out(active, directions).error
        if directions == 2 and not self.contradicts(one := self.fit(active, 1), active):
            simpler = self.left_out(active, 1).error
            if _rms(simpler[active]) < _rms(errors[active]):
                return one, 1, simpler, both
        return (both if directions == 2 else self.fit(active, directions)), directions, errors, None

    def contradicts(self, fit: _Fit, active: NDArray[np.bool_]) -> bool:
        """Whether the active loads speak against a fit along one direction."""
        from scipy.special import chdtrc  # a quarter of a second that commands without loads do without

        misfit = float(np.sum((fit.error[active] / self.sd[active]) ** 2))
        return bool(chdtrc(max(float(active.sum()) - 1.0, 1.0), misfit) < _SIGNIFICANT)

    def _together(
        self, near: _Fit, sweeps: Sequence[Sweep], active: NDArray[np.bool_], settings: ClosedLoopSettings
    ) -> ParameterSet | None:
        """Sweeps and loads in one fit that begins where the loads alone lead; None where it learns nothing."""
        anchors = [
            MassAnchor(
                load.weighed_kg,
                float(sd) * load.weighed_kg,
                load.duration_s,
                load.force_n,
                load.plate_angle_rad,
                load.elevator_speed_rad_s,
                load.moisture_pct,
            )
            for load, sd, ok in zip(self.loads, self.sd, active, strict=True)
            if ok
        ]
        centre = moved(self.start, *map(float, near.step))
        outcome = self_calibrate(self.model, centre, sweeps, anchors=anchors, settings=settings)
        if not outcome.updated:
            return None
        return replace(outcome.parameter_set, version=self.given.version + 1)

    def _left_out_together(
        self, near: _Fit, sweeps: Sequence[Sweep], active: NDArray[np.bool_], settings: ClosedLoopSettings
    ) -> Array:
        errors = np.full(len(self.loads), np.nan)
        for k in range(len(self.loads)):
            others = active & (np.arange(len(self.loads)) != k)
            found = self._together(near, sweeps, others, settings) if np.any(others) else None
            if found is not None:
                errors[k] = np.log(self.mass(found)[k] / self.weighed[k])
        return errors

    def spread(self, known: ParameterSet, active: NDArray[np.bool_]) -> tuple[float, float]:
        """Relative standard deviations of a further load and of these loads' common level, from a set's own covariance."""
        flow, by_flow = self.flow(known)
        steps = [1e-2 * known.standard_deviation(name) for name in known.covariance_names]
        shifted = [_shifted(known, name, step) for name, step in zip(known.covariance_names, steps, strict=True)]
        rows = np.nan_to_num(self.slopes(shifted, flow, by_flow, steps))[active]
        spread = np.einsum("ki,ij,kj->k", rows, known.covariance, rows)
        mean = rows.mean(axis=0)
        return float(np.sqrt(spread.mean() + self.settings.load_error**2)), float(np.sqrt(mean @ known.covariance @ mean))

    def _posterior(
        self, fit: _Fit, active: NDArray[np.bool_], directions: int, full: _Fit | None
    ) -> tuple[ParameterSet, float, float]:
        """The new set, and relative standard deviations of a further load and of these loads' common level.

        full: the fit along both directions where `fit` moved along one of the two that the loads determine. What they say of the
        other counts in the covariance, with the distance between the fits as an error of its own.
        """
        centre = moved(self.start, *map(float, fit.step))
        h = np.column_stack((self._held_slopes(centre), fit.by_step))
        rows = h[active]
        determined = directions if full is None else 2
        basis = np.zeros((h.shape[1], determined))
        basis[-2:] = self._basis(fit.by_step, active.astype(float))[:, :determined]
        noise = self.sd[active] ** 2
        moving = rows @ basis
        gain = basis @ moving.T @ np.linalg.inv(moving @ moving.T + np.diag(noise))
        left = np.eye(h.shape[1]) - gain @ rows
        chi2, dof = float(np.sum(fit.error[active] ** 2 / noise)), max(int(active.sum()) - directions, 0)
        inflation = (_PRIOR_LOADS + chi2) / (_PRIOR_LOADS + dof)
        covariance = left @ self.prior @ left.T + inflation * gain @ np.diag(noise) @ gain.T
        if full is not None:
            covariance[-2:, -2:] += np.outer(full.step - fit.step, full.step - fit.step)
        spread = np.einsum("ki,ij,kj->k", rows, covariance, rows)
        next_sd = float(np.sqrt(np.mean(spread) + inflation * self.settings.load_error**2))
        mean = rows.mean(axis=0)
        return self._as_set(centre, covariance), next_sd, float(np.sqrt(mean @ covariance @ mean))

    def _held_slopes(self, centre: ParameterSet) -> Array:
        """(n, held): change of ln mass with each held parameter."""
        flow, by_flow = self.flow(centre)
        if not self.held:
            return np.zeros((len(self.loads), 0))
        steps = [1e-2 * self.start.standard_deviation(name) for name in self.held]
        shifted = [_shifted(centre, name, step) for name, step in zip(self.held, steps, strict=True)]
        return np.asarray(np.nan_to_num(self.slopes(shifted, flow, by_flow, steps)))

    def _as_set(self, centre: ParameterSet, covariance: Array) -> ParameterSet:
        values, gain = centre.values, _gain_names(centre)
        size = 1.0 + values["restitution"] if len(gain) == 1 else 1.0
        rows: list[Array] = list(np.eye(len(covariance))[: len(self.held)])
        unit = np.eye(len(covariance))
        rows.append(unit[-2] * values[DENSITY])
        names: list[str] = [*self.held, DENSITY]
        for name in gain:
            weight = size if name == "restitution" else values[name]
            if weight != 0.0:
                rows.append(unit[-1] * weight)
                names.append(name)
        # k1 and k2 move together here; a hair of their own keeps the covariance of both positive definite.
        own = np.zeros(len(names))
        if "k1" in names and "k2" in names:
            own[-2:] = [(1e-3 * values[n]) ** 2 for n in ("k1", "k2")]
        to = np.stack(rows)
        full = to @ covariance @ to.T + np.diag(own)
        full = 0.5 * (full + full.T)
        return replace(
            centre, covariance_names=tuple(names), covariance=full, calibrated=self._range(centre), version=self.given.version + 1
        )

    def _range(self, centre: ParameterSet) -> CalibratedRange:
        """The crop's own range, as far as it is known; loads at a few flows do not narrow what the model covers."""
        return centre.calibrated


def _expected_rms(fitted: Array, left_out: Array) -> float:
    """Of a further load: fitted errors are too small and, where three loads are two without the one, those of left-out loads too
    large. Source: the 0.632 estimator, B. Efron, J. American Statistical Association 78 (1983) 316."""
    return float(np.hypot(np.sqrt(1.0 - _LEFT_OUT_WEIGHT) * _rms(fitted), np.sqrt(_LEFT_OUT_WEIGHT) * _rms(left_out)))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


def _sentences(found: LoadCalibration, sweeps: int) -> list[str]:
    out = []
    for load in found.loads:
        if load.outlier:
            out.append(
                f"load {load.name} contradicts the others by {-100.0 * load.left_out_error:+.1f} % and counts for nothing: "
                "another truck's grain, a wrong number or a part of the load that was not measured?"
            )
    if found.refused:
        out.append(
            f"refused: on loads left out the new calibration errs by {100.0 * found.rms_left_out:.2f} %, the present one by "
            f"{100.0 * found.rms_before:.2f} %; the parameters stay."
        )
        return out
    out.append(f"the loads weigh {100.0 * (found.scale - 1.0):+.2f} % against what was measured.")
    if found.load_dependence:
        out.append("they also determine how the error changes with the flow: density and impact gain moved apart.")
    else:
        out.append("they do not determine how the error changes with the flow: held; weigh a load at another flow.")
    if found.sweeps_used:
        out.append(f"{found.sweeps_used} sweeps of the plate are fitted with them; held: {', '.join(found.held)}.")
    else:
        out.append(f"held, because weighed loads cannot tell them from scale: {', '.join(found.held)}.")
    if sweeps and not found.sweeps_used:
        out.append("the sweeps contradict the model or say too little beside the loads; they are left out.")
    if len(found.loads) == 1:
        out.append("one load alone cannot be checked against others; weigh two more.")
    out.append(f"a next load like these is expected within {100.0 * found.next_load_sd:.2f} % (one standard deviation).")
    return out

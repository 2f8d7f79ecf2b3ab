"""Candidates for missing effects: screening by signatures beyond recalibration, then refits with all base parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from yieldmon.estimation.model_error import off
from yieldmon.physics.effects import laws, registry
from yieldmon.physics.grain import evenly
from yieldmon.physics.numerics import Array, real

from .fit import Fit, fit, fit_all
from .frame import Frame, Parameter, effect_parameters, predictions
from .noise import Noise

#: Sizes at which a signature is computed, in typical sizes from the null value.
SIZES = (0.35, 1.0, 2.5)
DRAWS = 4000


@dataclass(frozen=True)
class Signature:
    """Change of the prediction by an effect beyond recalibration.

    Attributes
    ----------
    points : ndarray (points, parameters)
        Values of the effect's parameters.
    change : ndarray (points, cells)
        Whitened change of the prediction at each point, orthogonal to the tangent space of the model without the effect.
    size : ndarray (points,)
        Size of the effect at each point, in typical sizes.
    """

    effect: str
    parameters: tuple[Parameter, ...]
    points: Array
    change: Array
    size: Array

    @property
    def directions(self) -> Array:
        """Signatures of unit length of the points with a detectable change, (visible, cells)."""
        norm = np.linalg.norm(self.change, axis=1)
        return np.asarray(self.change[norm > 1e-6] / norm[norm > 1e-6, None])


@dataclass(frozen=True)
class Score:
    """Result of linear screening of an effect: expected gain in chi-square, and the parameters that give it."""

    effect: str
    gain: float
    start: dict[str, float]


def library(frame: Frame, without: Iterable[str] = ()) -> tuple[str, ...]:
    """Effects that can be tested with these cells: all except those in `without`, in the model, measured, or without input."""
    out = [name for name, effect in registry().items() if name not in {*without, *frame.known} and not effect.measured]
    if not np.all(np.isfinite(frame.cells.moisture_pct)):
        out = [name for name in out if registry()[name].stage != "crop"]
    return tuple(out)


def lawful(effects: Iterable[str]) -> tuple[str, ...]:
    """Every law of the effects (`physics.effects.laws`). An effect that is given by one of its laws has only this one."""
    return tuple(law for e in effects for law in (laws(e) if e in registry() else (e,)))


def signature(current: Fit, effect: str) -> Signature:
    """Signature of adding `effect` to a fitted model."""
    frame = current.frame
    parameters = effect_parameters(effect, frame.unit)
    points, sizes = _points(parameters)
    values = {p.name: float(v) for p, v in zip(current.parameters, current.x, strict=True)}
    batch: dict[str, ArrayLike] = dict(values)
    for i, p in enumerate(parameters):
        batch[p.name] = points[:, i][:, None]
    with_effect = real(predictions(frame, (*current.effects, effect), batch))
    without = current.residual + frame.cells.mean / frame.sd
    change = np.broadcast_to(with_effect, (len(points), len(frame.cells))) / frame.sd - without
    change = np.where(np.all(np.isfinite(change), axis=1, keepdims=True), change, 0.0)
    tangent = current.tangent()
    return Signature(effect, parameters, points, change - (change @ tangent) @ tangent.T, sizes)


def _points(parameters: tuple[Parameter, ...]) -> tuple[Array, Array]:
    points, sizes = [], []
    for i, p in enumerate(parameters):
        for size in SIZES:
            for sense in (1.0, -1.0):
                value = p.start + sense * size * (p.typical - p.start)
                if p.lower <= value <= p.upper:
                    point = [q.start for q in parameters]
                    point[i] = value
                    points.append(point)
                    sizes.append(size)
    return np.array(points), np.array(sizes)


def score(current: Fit, drawn: Signature) -> Score:
    """Gain in chi-square with the best of the effect's points, scaled within its bounds."""
    norm2 = np.sum(drawn.change**2, axis=1)
    along = -(drawn.change @ current.residual)
    best_gain, best = 0.0, {p.name: p.typical for p in drawn.parameters}
    for i, (n2, a) in enumerate(zip(norm2, along, strict=True)):
        if n2 <= 1e-12 or a <= 0.0:
            continue
        # A signature is nonlinear in size; beyond 1.5 times its own size the next point is used.
        amplitude = min(a / n2, 1.5)
        gain = 2.0 * amplitude * a - amplitude**2 * n2
        if gain > best_gain:
            best_gain = gain
            best = {
                p.name: float(np.clip(p.start + amplitude * (v - p.start), p.lower, p.upper))
                for p, v in zip(drawn.parameters, drawn.points[i], strict=True)
            }
    # Span of the detectable changes; an effect without any change here would add directions of rounding.
    if len(drawn.parameters) > 1 and drawn.directions.size:
        _, singular, rows = np.linalg.svd(drawn.change, full_matrices=False)
        rows = rows[singular > 1e-6 * singular[0]][: len(drawn.parameters)]
        best_gain = max(best_gain, float(np.sum((rows @ current.residual) ** 2)))
    return Score(drawn.effect, best_gain, best)


def refit(
    current: Fit, found: Score, *, starts: int = 1, beside: Mapping[str, float] | None = None, iterations: int = 60
) -> Fit | None:
    """Fit of the model with the effect added, starting at the linear guess and, with more starts, at typical sizes.

    beside: other values of the present parameters for a further start. It is needed for parameters that are at their null value
    in `current`, where their derivative may vanish.
    """
    values = {p.name: float(v) for p, v in zip(current.parameters, current.x, strict=True)}
    effects = (*current.effects, found.effect)
    options = [found.start]
    parameters = effect_parameters(found.effect, current.frame.unit)
    for size in (1.0, -1.0, 0.3, 3.0)[: max(starts - 1, 0)]:
        options.append({p.name: float(np.clip(p.start + size * (p.typical - p.start), p.lower, p.upper)) for p in parameters})
    points = [_moved(current, found.effect, values | option) for option in options]
    if beside is not None:
        points.append(values | dict(beside) | found.start)
    fits = [f for f in fit_all(current.frame, effects, points, iterations=iterations) if f is not None]
    return min(fits, key=lambda f: f.chi2) if fits else None


def polished(rough: Fit) -> Fit:
    """Continue the fit after a short search until it converges."""
    found = fit(rough.frame, rough.effects, rough.values)
    return found if found is not None and found.chi2 <= rough.chi2 else rough


def _elsewhere(p: Parameter, at: float) -> list[float]:
    """The points at a quarter and three quarters between the bounds, except those near `at`."""
    return [v for share in (0.25, 0.75) if abs((v := p.lower + share * (p.upper - p.lower)) - at) > 0.1 * (p.upper - p.lower)]


def refit_from_restarts(found: Fit) -> Fit:
    """The best of `found` and fits of the same model from other frictions, densities, sizes of effects and shapes of laws.

    A fit that needs a bound of an effect's leading parameter is not better than one that does not.
    """
    names = [leading(e, found.frame.unit) for e in found.effects]
    null = {p.name: p.start for p in found.parameters}
    points = [{"friction": mu, "density": rho} for mu in evenly("friction", 3) for rho in evenly("density", 2)]
    points += [{name: null[name] + share * (found.values[name] - null[name])} for name in names for share in (0.4, 2.0)]
    points += [{found.parameters[i].name: v} for i in found.shapes for v in _elsewhere(found.parameters[i], float(found.x[i]))]
    # A few steps decide which starts are continued.
    begun = [f for f in fit_all(found.frame, found.effects, [found.values | p for p in points], iterations=5) if f is not None]
    begun = sorted(begun, key=lambda f: f.chi2)[:3]
    best = found
    for other in fit_all(found.frame, found.effects, [f.values for f in begun], iterations=25):
        if other is None or set(names) & (set(other.at_bound) - set(found.at_bound)):
            continue
        if other.chi2 < best.chi2 - 0.5:
            best = other
    return best


def only_at_bound(found: Fit, effect: str, allowance: float) -> str:
    """Reason for the refusal of a fit: the bounds that its effects need; "" if there are none.

    A bound is needed if chi-square increases by more than `allowance` when the effect's leading parameter is fixed at three
    quarters of the way to it. For effects other than `effect`, any leading parameter at a bound is a reason.
    """
    needed = []
    for p, v in zip(found.parameters, found.x, strict=True):
        name = p.name.partition(".")[0]
        if p.name not in found.at_bound or p.name != leading(name, found.frame.unit):
            continue
        if name == effect:
            inside = fit(
                found.frame, found.effects, found.values, held={p.name: p.start + 0.75 * (float(v) - p.start)}, iterations=6
            )
            if inside is not None and inside.chi2 - found.chi2 <= allowance * max(found.chi2 / max(found.dof, 1), 1.0):
                continue
        needed.append(name)
    return f"only with {', '.join(sorted(set(needed)))} at a bound" if needed else ""


def leading(effect: str, unit: float) -> str:
    """Qualified name of an effect's first, leading parameter; "" for a base parameter's name."""
    try:
        return effect_parameters(effect, unit)[0].name
    except ValueError:
        return ""


def _moved(current: Fit, effect: str, start: dict[str, float]) -> dict[str, float]:
    """The start, with the base parameters changed in the tangent plane to compensate for the effect."""
    frame = current.frame
    with_effect = real(predictions(frame, (*current.effects, effect), start))
    if not np.all(np.isfinite(with_effect)):
        return start
    residual = (with_effect - frame.cells.mean) / frame.sd
    scale = np.array([p.scale for p in current.parameters])
    scaled = current.jacobian * scale
    # Damped, since the tangent plane is valid over about one typical size of each parameter.
    count = max(float(np.linalg.norm(scaled, axis=0).max()), 1e-300)
    step = -np.linalg.lstsq(
        np.vstack((scaled, 0.02 * count * np.eye(len(scale)))), np.concatenate((residual, 0.0 * scale)), rcond=None
    )[0]
    step = np.clip(step, -1.0, 1.0) * scale
    moved = dict(start)
    for p, s in zip(current.parameters, step, strict=True):
        moved[p.name] = float(np.clip(start[p.name] + s, p.lower, p.upper))
    better = real(predictions(frame, (*current.effects, effect), moved))
    trial = (better - frame.cells.mean) / frame.sd
    return moved if np.all(np.isfinite(better)) and trial @ trial < residual @ residual else start


def errors(current: Fit, noise: Noise, rng: np.random.Generator, draws: int) -> Array:
    """Random whitened errors of the cells by noise and the model error, (cells, draws)."""
    z = rng.standard_normal((len(current.residual), draws)) / np.sqrt(rng.chisquare(noise.dof, draws) / noise.dof)
    return np.asarray(z + current.error @ rng.standard_normal((current.error.shape[1], draws)))


def second(current: Fit) -> bool:
    """Whether an effect added to `current` would be the second one; its gain is tested with the error of the first one's law
    integrated out.

    A third effect is compared with all possible errors of the laws, since it could compensate for two laws, and three causes at
    once are rare.
    """
    return len(current.effects) == 1


def gained(current: Fit, added: Fit, *, own: bool = False) -> float:
    """Gain in chi-square by an effect added to `current`.

    For a second effect the error of the first one's law is integrated out of both fits, so that a gain that another shape of this
    law would give as well does not count. own: whether the model error is also integrated out.
    """
    if not second(current):
        return current.chi2 - added.chi2
    columns = current.error if own else current.shape_error
    return current.marginal(columns)[0] - added.marginal(columns)[0]


def _white(current: Fit) -> Callable[[Array], Array]:
    """Whiten columns (cells, columns) with the covariance of the laws' errors outside the tangent plane.

    The model error is not included, since its form is not known well enough.
    """
    axes, length, _ = np.linalg.svd(off(current.shape_error, current.tangent()), full_matrices=False)
    shrunk = 1.0 - 1.0 / np.sqrt(1.0 + length**2)
    return lambda columns: np.asarray(columns - axes @ (shrunk[:, None] * (axes.T @ columns)))


def false_alarm(
    signatures: Iterable[Signature], current: Fit, noise: Noise, rng: np.random.Generator
) -> Callable[[float], float]:
    """p value of a gain in chi-square (`gained`), corrected for the number of candidates.

    It is found by Monte Carlo in the tangent plane of the model without the candidates (`current`), as the distribution of the
    largest gain over all points of all signatures (each with one sign) and over the span of those with several parameters. It
    includes the uncertainty of the noise estimate and the model error.
    """
    chosen = [s for s in signatures if s.directions.size]
    draws = errors(current, noise, rng, DRAWS)
    white = _white(current) if second(current) else None
    if white is not None:
        draws = white(draws)
    largest = np.zeros(DRAWS)
    for s in chosen:
        directions = s.directions
        if white is not None:
            directions = white(directions.T).T
            directions = directions / np.linalg.norm(directions, axis=1)[:, None]
        gains = np.maximum(directions @ draws, 0.0) ** 2
        np.maximum(largest, gains.max(axis=0), out=largest)
        if len(s.parameters) > 1:
            _, singular, rows = np.linalg.svd(directions, full_matrices=False)
            rows = rows[singular > 1e-6 * singular[0]][: len(s.parameters)]
            np.maximum(largest, np.sum((rows @ draws) ** 2, axis=0), out=largest)
    ordered = np.sort(largest)

    def p_value(gain: float) -> float:
        return float((1 + DRAWS - np.searchsorted(ordered, gain, side="left")) / (1 + DRAWS))

    return p_value

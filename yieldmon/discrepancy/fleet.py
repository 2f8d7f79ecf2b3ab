"""What many machines' sweeps say together: what all show is the model's, what one shows beside the others its own.

A machine is held against the others: its forces over theirs, at equal force at home, angle and speed. That needs no model, so
that what the model lacks for all does not count against one. Machines that cut one crop share its grain; how much friction and
density differ between them is learnt from them all (empirical Bayes), and is the prior of each machine's own. An effect's
signature is the model's change by it, loads following, with grain free within that prior.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from yieldmon.estimation import model_error
from yieldmon.physics.effects import family_of, get_effect
from yieldmon.physics.numerics import Array, real

from .candidates import lawful, library
from .fit import LAW_DEGREE, LAW_SD, Fit, Frame, Parameter, effect_parameters, fit_base, predictions
from .lattice import Lattice
from .noise import Noise
from .observations import cells
from .policy import Policy
from .selection import Choice, choose

LEAST_MACHINES = 3
SIZES = (0.1, 0.2, 0.35, 0.6, 1.0, 1.7, 3.0)
"""At which a signature is drawn, in typical sizes from the null value."""
_SURFACE = (3, 2)
"""Degrees in load and speed, at each angle by itself, of what all machines may show beside the model."""
_SURFACE_SD = 0.1
_DRAWS = 2000
_STATED = 1e6
_SHORTLIST, _POINTS = 24, 3
_GRAIN_SD = 0.1
"""In steps that matter (`physics.grain`): scale of how far grain of one crop differs between machines, before that is learnt."""
_SCATTER_GRID = np.concatenate(([0.0], np.geomspace(0.01, 4.0, 40)))
_SCATTER_SWEEPS = 3
_UNLIKELY = 2.0 * float(np.log(20.0))
"""-2 log of the odds that one machine has an effect `of_grain` for itself."""
_STATE_STEPS = 3
_POWER_80 = 0.84
"""Standard deviations beyond a limit at which 80 of 100 exceed it."""


@dataclass(frozen=True)
class Signature:
    """What an effect changes of ln(force) in each cell, at several sizes: points (points, parameters), change (points, cells)."""

    law: str
    parameters: tuple[Parameter, ...]
    points: Array
    change: Array


@dataclass(frozen=True)
class Explanation:
    """An effect that explains a machine: by which law, its values, and -2 log evidence by which the best one is better."""

    effect: str
    law: str
    values: Mapping[str, float]
    behind: float


@dataclass(frozen=True)
class Own:
    """What a machine shows beside the others. p_value: of its best explanation when all machines are alike, over all effects and
    all machines; best first; gain: in chi-square."""

    p_value: float
    gain: float
    explanations: tuple[Explanation, ...]


@dataclass(frozen=True)
class Visible:
    """The least distance from its null value at which an effect of one machine's own is found in 80 of 100 fleets; inf: at no
    physical size.

    parameter: the one that the effect is known by.
    """

    effect: str
    parameter: str
    size: float
    unit: str


@dataclass(frozen=True)
class Found:
    """shared: what the model lacks for all; own: by machine; misfit: variance of the visits over what is stated."""

    shared: Choice
    own: Mapping[str, Own]
    deviating: tuple[str, ...]
    misfit: float
    visible_from: tuple[Visible, ...] = ()


def examine(lattice: Lattice, rng: np.random.Generator, policy: Policy) -> Found:
    """What the machines of a lattice share, and what each has beside the others."""
    kept = np.ones(len(lattice.machines), dtype=bool)
    base = fit_base(_consensus(lattice, kept, 1.0))
    kept = _Comparison(lattice, base, rng, policy).settled(kept)
    comparison = _Comparison(lattice, base, rng, policy)
    scale = comparison.state(kept).misfit
    shared = _shared(lattice, kept, scale, rng, policy)
    # What describes the fleet best gives the shapes, named or not.
    comparison = _Comparison(lattice, shared.best, rng, policy)
    again = comparison.settled(kept)
    if not np.array_equal(again, kept):
        kept = again
        shared = _shared(lattice, kept, comparison.state(kept).misfit, rng, policy)
        comparison = _Comparison(lattice, shared.best, rng, policy)
    state = comparison.state(kept)
    tail = comparison.tail(state)
    own = {placed.name: comparison.own(i, state, tail) for i, placed in enumerate(lattice.machines)}
    names = tuple(placed.name for placed, keep in zip(lattice.machines, kept, strict=True) if not keep)
    return Found(shared, own, names, state.misfit, comparison.visible_from(state, tail))


def _shared(lattice: Lattice, kept: NDArray[np.bool_], misfit: float, rng: np.random.Generator, policy: Policy) -> Choice:
    frame = _consensus(lattice, kept, misfit)
    base = fit_base(frame)
    return choose(base, Noise(0.0, 1.0, _STATED, "stated"), library(frame), rng, policy)


def _consensus(lattice: Lattice, kept: NDArray[np.bool_], misfit: float) -> Frame:
    """The lattice's frame with the mean force of the machines that are kept, in the cells that they measured."""
    machines = [m for m, keep in zip(lattice.machines, kept, strict=True) if keep]
    frame = lattice.frame
    count = len(frame.cells)
    total, weight, spread = np.zeros(count), np.zeros(count), np.zeros(count)
    for m in machines:
        for first, factor in m.blocks:
            # Visits of one sweep share the visits home that bracket them, and several of them may be of one cell.
            place = m.cell[first : first + len(factor)]
            covariance = np.linalg.inv(factor.T @ factor)
            w = 1.0 / np.diag(covariance)
            shared = (place[:, None] == place) * covariance * np.outer(w, w)
            total += np.bincount(place, w * m.log_force[first : first + len(factor)], minlength=count)
            weight += np.bincount(place, w, minlength=count)
            spread += np.bincount(place, shared.sum(axis=1), minlength=count)
    seen = weight > 0.0
    rows = frame.cells.rows
    value = np.where(seen, np.exp(np.divide(total, weight, out=np.zeros(count), where=seen)), rows.value)
    # A cell that none of them measured says nothing.
    sigma = value * np.where(seen, np.sqrt(misfit * spread) / np.where(seen, weight, 1.0), 1e3)
    grouped = cells(replace(rows, value=value, sigma=sigma))
    return replace(frame, cells=grouped, sd=sigma)


@dataclass(frozen=True)
class _State:
    """Of a set of machines that are kept: variances of grain between machines, as the others of each show them, (machines,
    parameters), and misfit."""

    kept: NDArray[np.bool_]
    grain: Array
    misfit: float


class _Comparison:
    """Machines against each other, with a model for the shape of effects."""

    def __init__(self, lattice: Lattice, known: Fit, rng: np.random.Generator, policy: Policy) -> None:
        self.machines = lattice.machines
        self.known = known
        self.policy = policy
        self.rng = rng
        frame = known.frame
        self.level = np.log(real(predictions(frame, known.effects, known.values)))
        grain = known.jacobian[:, : len(frame.base)] * frame.sd[:, None] / np.exp(self.level)[:, None]
        self.steps = np.array([p.scale for p in frame.base])
        self.grain = grain * self.steps
        self.surface = _surface(frame)
        self.smooth = model_error.basis(
            frame.cells.plate_angle_rad, frame.cells.load, frame.cells.elevator_speed_rad_s, most=LAW_DEGREE
        )
        ok = np.isfinite(self.level)
        self.level = np.where(ok, self.level, 0.0)
        self._z = [m.whitened(m.log_force - self.level[m.cell]) for m in self.machines]
        self._b = [m.whitened(self.surface[m.cell]) for m in self.machines]
        self._j = [m.whitened(np.nan_to_num(self.grain)[m.cell]) for m in self.machines]

    @cached_property
    def signatures(self) -> tuple[Signature, ...]:
        """Of every law of every effect that one machine may have, more or less of the shared ones included."""
        return tuple(s for s in (_signature(self.known, law) for law in self._laws()) if s is not None)

    def _laws(self) -> tuple[str, ...]:
        frame = self.known.frame
        others = {family_of(e) for e in self.known.effects}
        return (*self.known.effects, *lawful(e for e in library(frame) if e not in others))

    def settled(self, kept: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Which machines are like the others: the one that differs most is left out until none is, then those alike come back."""
        kept = kept.copy()
        most = (len(kept) - 1) // 2
        for _ in range(2 * most):
            state = self.state(kept)
            gains = [float(self._gains(i, state)[0].max()) for i in range(len(kept))]
            limit = self.tail(state).limit(self.policy.next_p / len(kept))
            away = [i for i in np.flatnonzero(kept) if gains[i] > limit]
            back = [i for i in np.flatnonzero(~kept) if gains[i] <= limit]
            if back:
                kept[back] = True
                if not away:
                    break
            elif away and np.count_nonzero(~kept) < most:
                kept[max(away, key=lambda i: gains[i])] = False
            else:
                break
        return kept

    def state(self, kept: NDArray[np.bool_]) -> _State:
        """What the kept machines say of their grain's differences and of the visits' noise."""
        places = [int(i) for i in np.flatnonzero(kept)]
        state = _State(kept, np.full((len(kept), self.grain.shape[1]), _GRAIN_SD**2), 1.0)
        for _ in range(_STATE_STEPS):
            ratio, information, score = [], [], []
            for i in places:
                z, b, j = self._against(i, state)
                inner = np.linalg.inv(np.eye(b.shape[1]) + b.T @ b)
                away_j, away_z = (x - b @ (inner @ (b.T @ x)) for x in (j, z))
                a, h = j.T @ away_j, j.T @ away_z
                at = np.linalg.solve(a + np.diag(1.0 / state.grain[i]), h)
                ratio.append(float(z @ away_z - at @ h) / (len(z) - len(at)))
                information.append(a)
                score.append(h)
            every, rest = np.array(information), np.array(score)
            grain = np.tile(_scatter(every, rest), (len(kept), 1))
            for number, i in enumerate(places):
                others = np.arange(len(places)) != number
                grain[i] = _scatter(every[others], rest[others])
            state = _State(kept, grain, state.misfit * float(np.median(ratio)))
        return state

    def _against(self, i: int, state: _State) -> tuple[Array, Array, Array]:
        """Machine i against the other kept ones: residual, columns of the others' mean (unit weights), and of grain's slope."""
        count = self.surface.shape[1]
        normal, right = np.eye(count) / _SURFACE_SD**2, np.zeros(count)
        for k in np.flatnonzero(state.kept):
            if k == i:
                continue
            z, b, j = (part / np.sqrt(state.misfit) for part in (self._z[k], self._b[k], self._j[k]))
            m = j * np.sqrt(state.grain[k])
            small = np.linalg.inv(np.eye(m.shape[1]) + m.T @ m)
            mb, mz = m.T @ b, m.T @ z
            normal += b.T @ b - mb.T @ small @ mb
            right += b.T @ z - mb.T @ small @ mz
        covariance = np.linalg.inv(normal)
        mean = covariance @ right
        z, b, j = (part / np.sqrt(state.misfit) for part in (self._z[i], self._b[i], self._j[i]))
        return z - b @ mean, b @ np.linalg.cholesky(0.5 * (covariance + covariance.T)), j

    @cached_property
    def _drawn(self) -> list[Array]:
        """Signatures of all effects' points at each machine's visits, whitened, (visits, points)."""
        change = np.concatenate([s.change for s in self.signatures])
        return [m.whitened(change[:, m.cell].T) for m in self.machines]

    def _judge(self, i: int, state: _State) -> _Judge:
        z, b, j = self._against(i, state)
        return _Judge(z, np.concatenate((b, j * np.sqrt(state.grain[i])), axis=1))

    def _gains(self, i: int, state: _State) -> tuple[Array, Array]:
        """Gain in chi-square at each of the effects' points, and the share of its size at which it is had."""
        judge, drawn = self._judge(i, state), self._drawn[i] / np.sqrt(state.misfit)
        away = drawn - judge.columns @ (judge.inner @ (judge.columns.T @ drawn))
        norm2, along = np.einsum("ij,ij->j", away, drawn), away.T @ judge.residual
        # A signature bends with size; beyond a quarter more than its own the next point speaks.
        share = np.clip(np.divide(along, norm2, out=np.zeros(along.shape), where=norm2 > 1e-12), 0.0, 1.25)
        return 2.0 * share * along - share**2 * norm2, share

    def tail(self, state: _State) -> _Tail:
        """Largest gains of a machine like the others, by the visits of the first that is kept."""
        i = int(np.flatnonzero(state.kept)[0])
        judge, drawn = self._judge(i, state), self._drawn[i] / np.sqrt(state.misfit)
        gram = drawn.T @ drawn
        inside = judge.columns.T @ drawn
        gram -= inside.T @ judge.inner @ inside
        norm = np.sqrt(np.maximum(np.diag(gram), 0.0))
        seen = norm > 1e-6
        kept, axes = np.linalg.eigh(gram[np.ix_(seen, seen)] / np.outer(norm[seen], norm[seen]))
        large = kept > 1e-9 * kept[-1]
        draws = (axes[:, large] * np.sqrt(kept[large])) @ self.rng.standard_normal((int(large.sum()), _DRAWS))
        return _Tail(np.sort(np.max(np.maximum(draws, 0.0), axis=0) ** 2))

    def visible_from(self, state: _State, tail: _Tail) -> tuple[Visible, ...]:
        """From what size each effect shows at a machine of median sweeps."""
        needed = np.sqrt(tail.limit(self.policy.next_p / len(self.machines))) + _POWER_80
        lengths = []
        for i in np.flatnonzero(state.kept).tolist():
            judge, drawn = self._judge(i, state), self._drawn[i] / np.sqrt(state.misfit)
            inside = judge.columns.T @ drawn
            square = np.sum(drawn**2, axis=0) - np.sum(inside * (judge.inner @ inside), axis=0)
            lengths.append(np.sqrt(np.maximum(square, 0.0)))
        length, first, found = np.median(lengths, axis=0), 0, dict[str, Visible]()
        for s in self.signatures:
            one = _visible(s, length[first : first + len(s.points)], needed)
            first += len(s.points)
            # The effect's own law where that shows at all: sizes of different laws do not compare.
            if not np.isfinite(found.get(one.effect, one).size) or one.effect not in found:
                found[one.effect] = one
        return tuple(sorted(found.values(), key=lambda v: v.effect))

    def own(self, i: int, state: _State, tail: _Tail) -> Own:
        """What a machine shows beside the others."""
        gains, share = self._gains(i, state)
        best = float(gains.max())
        ends = np.cumsum([len(s.points) for s in self.signatures])
        ranked = []
        for s, end in zip(self.signatures, ends, strict=True):
            first = end - len(s.points)
            order = first + np.argsort(gains[first:end])[::-1][:_POINTS]
            guesses = [_Guess(s, int(k - first), float(share[k])) for k in order if gains[k] > 0.0]
            ranked.append((float(gains[order[0]]), guesses))
        ranked.sort(key=lambda item: -item[0])
        found = [guess for _, guesses in ranked[:_SHORTLIST] for guess in guesses]
        return Own(min(1.0, len(self.machines) * tail.p_value(best)), best, self._explained(i, state, found))

    def _explained(self, i: int, state: _State, found: Sequence[_Guess]) -> tuple[Explanation, ...]:
        """-2 log evidence of guesses, each effect's law off by `LAW_SD`; each family by its best."""
        judge, placed = self._judge(i, state), self.machines[i]
        smooth = self.smooth[placed.cell]
        judged = []
        for guess in found:
            change = guess.share * guess.signature.change[guess.point][placed.cell]
            white = placed.whitened(np.concatenate((change[:, None], LAW_SD * smooth * change[:, None]), axis=1))
            white /= np.sqrt(state.misfit)
            judged.append((guess, *judge.without(white[:, 0], white[:, 1:])))
        scale = max(min((chi2 for _, chi2, _ in judged), default=0.0) / len(judge.residual), 1.0)
        merits: dict[str, tuple[float, _Guess]] = {}
        for guess, chi2, volume in judged:
            merit = chi2 / scale + volume + self.policy.per_parameter * len(guess.signature.parameters) + guess.surprise
            family = family_of(guess.signature.law)
            if family not in merits or merit < merits[family][0]:
                merits[family] = (merit, guess)
        order = sorted(merits, key=lambda family: merits[family][0])
        return tuple(
            Explanation(
                family, merits[family][1].signature.law, merits[family][1].values, merits[family][0] - merits[order[0]][0]
            )
            for family in order
        )


@dataclass(frozen=True)
class _Guess:
    """A point of a signature, and the share of its distance from the null that fits best."""

    signature: Signature
    point: int
    share: float

    @property
    def values(self) -> dict[str, float]:
        s = self.signature
        moved = {p.name: p.start + self.share * (v - p.start) for p, v in zip(s.parameters, s.points[self.point], strict=True)}
        return {p.name: float(np.clip(moved[p.name], p.lower, p.upper)) for p in s.parameters}

    @property
    def surprise(self) -> float:
        """-2 log of how likely it is beforehand: its distance in wide prior widths, as in `selection.merit`, and its kind."""
        far = [(self.values[p.name] - p.start) / (5.0 * p.prior_sd) for p in self.signature.parameters if np.isfinite(p.prior_sd)]
        of_grain = get_effect(family_of(self.signature.law)).of_grain
        return float(sum(min(distance**2, 4.0) for distance in far)) + of_grain * _UNLIKELY


@dataclass(frozen=True)
class _Judge:
    """A machine's whitened residual (visits,) with noise of unit variance and columns (visits, columns) with unit weights."""

    residual: Array
    columns: Array

    @cached_property
    def inner(self) -> Array:
        """(1 + C'C)^-1, of Woodbury's inverse."""
        return np.asarray(np.linalg.inv(np.eye(self.columns.shape[1]) + self.columns.T @ self.columns))

    def without(self, change: Array, error: Array) -> tuple[float, float]:
        """Chi-square less a change whose law may be off by columns of error, and the log determinant that those add."""
        left = np.concatenate(((self.residual - change)[:, None], error), axis=1)
        inside = self.columns.T @ left
        gram = left.T @ left - inside.T @ self.inner @ inside
        small = np.eye(error.shape[1]) + gram[1:, 1:]
        chi2 = gram[0, 0] - gram[0, 1:] @ np.linalg.solve(small, gram[0, 1:])
        return float(chi2), float(np.linalg.slogdet(small)[1])


@dataclass(frozen=True)
class _Tail:
    """Largest gains of alike machines, ascending; beyond what was drawn, the tail of chi-square with one degree of freedom."""

    largest: Array

    def p_value(self, gain: float) -> float:
        drawn = len(self.largest)
        joint = self.largest[int(0.95 * drawn)]
        if gain <= joint:
            return float((1 + drawn - np.searchsorted(self.largest, gain)) / (1 + drawn))
        return float(0.05 * stats.chi2.sf(gain, 1) / stats.chi2.sf(joint, 1))

    def limit(self, p_value: float) -> float:
        """Gain with that p value, which is below 0.05."""
        joint = self.largest[int(0.95 * len(self.largest))]
        return float(stats.chi2.isf(p_value / 0.05 * stats.chi2.sf(joint, 1), 1))


def _visible(drawn: Signature, length: Array, needed: float) -> Visible:
    """length: of the signature at each of its points, in standard deviations, shape (points,)."""
    leading, rest = drawn.parameters[0], np.array([p.start for p in drawn.parameters[1:]])
    alone = np.all(drawn.points[:, 1:] == rest, axis=1) & (length > 1e-6)
    step = np.abs(drawn.points[alone, 0] - leading.start)
    size = float("inf")
    if step.size:
        # A signature bends with size: the point nearest to its own answer speaks.
        answers = step * needed / length[alone]
        size = float(answers[np.argmin(np.abs(np.log(answers / step)))])
    physical = size <= max(leading.upper - leading.start, leading.start - leading.lower)
    return Visible(family_of(drawn.law), leading.name.partition(".")[2], size if physical else float("inf"), leading.unit)


def _scatter(information: Array, score: Array) -> Array:
    """Variances of grain between machines, (parameters,): posterior means, one parameter after the other.

    information: of each machine about its grain, (machines, parameters, parameters). score: (machines, parameters).
    """
    count = score.shape[-1]
    variance = np.full(count, _GRAIN_SD**2)
    sd = _GRAIN_SD * _SCATTER_GRID
    prior = np.exp(-0.5 * _SCATTER_GRID**2) * np.gradient(sd)
    for _ in range(_SCATTER_SWEEPS):
        for k in range(count):
            tried = np.tile(np.sqrt(variance), (sd.size, 1))
            tried[:, k] = sd
            scaled = tried[:, None, :] * score
            small = np.eye(count) + tried[:, None, :, None] * information * tried[:, None, None, :]
            fitted = np.sum(scaled * np.linalg.solve(small, scaled[..., None])[..., 0], axis=-1)
            likely = 0.5 * np.sum(fitted - np.linalg.slogdet(small)[1], axis=-1)
            weight = np.exp(likely - likely.max()) * prior
            variance[k] = float(np.sum(weight * sd**2) / np.sum(weight))
    return variance


def _surface(frame: Frame) -> Array:
    """Columns of what all machines may show beside the model: a polynomial in load and speed at each angle, (cells, columns)."""
    grid = frame.cells
    axes = []
    for values, degree in ((np.log(grid.load), _SURFACE[0]), (np.log(grid.elevator_speed_rad_s), _SURFACE[1])):
        levels = len(np.unique(np.round(values, 6)))
        span = float(np.ptp(values))
        at = 2.0 * (values - values.min()) / span - 1.0 if span > 0.0 else np.zeros(values.shape)
        axes.append([np.polynomial.legendre.legval(at, np.eye(degree + 1)[k]) for k in range(min(degree, levels - 1) + 1)])
    most = max(_SURFACE)
    powers = [p for p in product(range(len(axes[0])), range(len(axes[1]))) if sum(p) <= most]
    angles = np.unique(np.round(grid.plate_angle_rad, 9))
    return np.stack(
        [(np.abs(grid.plate_angle_rad - angle) < 1e-8) * axes[0][k] * axes[1][m] for angle in angles for k, m in powers], axis=-1
    )


def _signature(known: Fit, law: str) -> Signature | None:
    frame = known.frame
    at = dict(known.values)
    effects = known.effects if law in known.effects else (*known.effects, law)
    parameters = tuple(replace(p, start=at[p.name]) if p.name in at else p for p in effect_parameters(law, frame.unit))
    points = []
    for i, p in enumerate(parameters):
        size = p.scale
        for share, sense in product(SIZES, (1.0, -1.0)):
            value = p.start + sense * share * size
            if p.lower <= value <= p.upper:
                points.append([value if k == i else q.start for k, q in enumerate(parameters)])
    if not points:
        return None
    drawn = np.array(points)
    batch: dict[str, ArrayLike] = {**at, **{p.name: drawn[:, i, None] for i, p in enumerate(parameters)}}
    without = real(predictions(frame, known.effects, at))
    with np.errstate(invalid="ignore", divide="ignore"):
        change = np.log(np.broadcast_to(real(predictions(frame, effects, batch)), (len(drawn), len(frame.cells))) / without)
    usable = np.all(np.isfinite(change), axis=1)
    if not np.any(usable):
        return None
    return Signature(law, parameters, drawn[usable], change[usable])


__all__ = ["Explanation", "Found", "Own", "Visible", "examine"]

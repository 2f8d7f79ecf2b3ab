"""Comparison of machines: ratio of each one's forces to those of the others, at equal force at home, angle and speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from yieldmon.discrepancy.candidates import lawful, library
from yieldmon.discrepancy.detectability import POWER_80
from yieldmon.discrepancy.fit import LAW_DEGREE, LAW_SD, Fit
from yieldmon.discrepancy.frame import Frame, predictions
from yieldmon.discrepancy.policy import Policy
from yieldmon.estimation import model_error
from yieldmon.physics.effects import family_of
from yieldmon.physics.numerics import Array, real

from .force_change import ForceChange, Guess, Visible, force_change, visible_size
from .gains import LargestGains, Residual
from .grain_scatter import GRAIN_SD, grain_scatter
from .lattice import Lattice

_SURFACE = (3, 2)
"""Degrees in load and speed, separately at each angle, of errors of the model common to all machines."""
_SURFACE_SD = 0.1
_DRAWS = 2000
_SHORTLIST, _POINTS = 24, 3
_STATE_STEPS = 3


@dataclass(frozen=True)
class Explanation:
    """An effect that explains a machine: its law, its values, and the difference of -2 log evidence to the best one."""

    effect: str
    law: str
    values: Mapping[str, float]
    behind: float


@dataclass(frozen=True)
class Own:
    """Difference of a machine from the others. Explanations: best first. p_value: of the best one if all machines are equal,
    corrected for all effects and machines. gain: in chi-square."""

    p_value: float
    gain: float
    explanations: tuple[Explanation, ...]


@dataclass(frozen=True)
class State:
    """State of a set of kept machines: variances of grain between machines, estimated for each one from the others, (machines,
    parameters), and misfit."""

    kept: NDArray[np.bool_]
    grain: Array
    misfit: float


class Comparison:
    """Comparison of machines with each other, with a model for the shape of effects."""

    def __init__(self, lattice: Lattice, known: Fit, rng: np.random.Generator, policy: Policy) -> None:
        self._machines = lattice.machines
        self._known = known
        self._policy = policy
        self._rng = rng
        frame = known.frame
        self._level = np.log(real(predictions(frame, known.effects, known.values)))
        grain = known.jacobian[:, : len(frame.base)] * frame.sd[:, None] / np.exp(self._level)[:, None]
        self._grain = grain * np.array([p.scale for p in frame.base])
        self._surface = _surface(frame)
        self._smooth = model_error.basis(
            frame.cells.plate_angle_rad, frame.cells.load, frame.cells.elevator_speed_rad_s, most=LAW_DEGREE
        )
        ok = np.isfinite(self._level)
        self._level = np.where(ok, self._level, 0.0)
        self._z = [m.whitened(m.log_force - self._level[m.cell]) for m in self._machines]
        self._b = [m.whitened(self._surface[m.cell]) for m in self._machines]
        self._j = [m.whitened(np.nan_to_num(self._grain)[m.cell]) for m in self._machines]

    @cached_property
    def _changes(self) -> tuple[ForceChange, ...]:
        """Changes by every law of every effect that a single machine may have, including more or less of the shared ones."""
        return tuple(s for s in (force_change(self._known, law) for law in self._laws()) if s is not None)

    def _laws(self) -> tuple[str, ...]:
        frame = self._known.frame
        others = {family_of(e) for e in self._known.effects}
        return (*self._known.effects, *lawful(e for e in library(frame) if e not in others))

    def settled(self, kept: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Which machines are equal to the others.

        First a backward search: the machine that differs most is left out, until none differs. The remaining machines may still
        contain some that look like scatter of grain because they made the estimated scatter large. Therefore a forward search
        (Atkinson and Riani 2000) follows: the more similar half, with its own scatter, is used to test all others, and accepted
        machines are added until nothing changes.
        """
        return self._grown(self._without_outlying(kept))

    def _without_outlying(self, kept: NDArray[np.bool_]) -> NDArray[np.bool_]:
        kept = kept.copy()
        most = (len(kept) - 1) // 2
        for _ in range(2 * most):
            gains, limit = self._largest(kept)
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

    def _grown(self, kept: NDArray[np.bool_]) -> NDArray[np.bool_]:
        least = len(kept) // 2 + 1
        gains, _ = self._largest(kept)
        like = np.zeros(len(kept), dtype=bool)
        tried: set[bytes] = set()
        while True:
            like[np.argsort(gains, kind="stable")[:least]] = True
            if like.tobytes() in tried:
                return like
            tried.add(like.tobytes())
            gains, limit = self._largest(like)
            like = gains <= limit

    def _largest(self, kept: NDArray[np.bool_]) -> tuple[Array, float]:
        """Each machine's largest gain relative to the kept ones, and the limit for machines equal to them."""
        state = self.state(kept)
        gains = np.array([float(self._gains(i, state)[0].max()) for i in range(len(kept))])
        return gains, self.tail(state).limit(self._policy.next_p / len(kept))

    def state(self, kept: NDArray[np.bool_]) -> State:
        """Estimates of the differences in grain and of the visits' noise from the machines kept."""
        places = [int(i) for i in np.flatnonzero(kept)]
        state = State(kept, np.full((len(kept), self._grain.shape[1]), GRAIN_SD**2), 1.0)
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
            grain = np.tile(grain_scatter(every, rest), (len(kept), 1))
            for number, i in enumerate(places):
                others = np.arange(len(places)) != number
                grain[i] = grain_scatter(every[others], rest[others])
            state = State(kept, grain, state.misfit * float(np.median(ratio)))
        return state

    def _against(self, i: int, state: State) -> tuple[Array, Array, Array]:
        """Machine i relative to the other kept ones: residual, columns of the others' mean (unit weights), and derivatives by
        grain."""
        count = self._surface.shape[1]
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
        """Whitened changes at each machine's visits for all points of all effects, (visits, points)."""
        change = np.concatenate([s.change for s in self._changes])
        return [m.whitened(change[:, m.cell].T) for m in self._machines]

    def _judge(self, i: int, state: State) -> Residual:
        z, b, j = self._against(i, state)
        return Residual(z, np.concatenate((b, j * np.sqrt(state.grain[i])), axis=1))

    def _gains(self, i: int, state: State) -> tuple[Array, Array]:
        """Gain in chi-square at each point of the effects, and the share of the point's size that gives it."""
        judge, drawn = self._judge(i, state), self._drawn[i] / np.sqrt(state.misfit)
        away = drawn - judge.columns @ (judge.inner @ (judge.columns.T @ drawn))
        norm2, along = np.einsum("ij,ij->j", away, drawn), away.T @ judge.residual
        # A change is nonlinear in size; beyond 1.25 times its own size the next point is used.
        share = np.clip(np.divide(along, norm2, out=np.zeros(along.shape), where=norm2 > 1e-12), 0.0, 1.25)
        return 2.0 * share * along - share**2 * norm2, share

    def tail(self, state: State) -> LargestGains:
        """Largest gains of a machine equal to the others, with the visits of the first kept one."""
        i = int(np.flatnonzero(state.kept)[0])
        judge, drawn = self._judge(i, state), self._drawn[i] / np.sqrt(state.misfit)
        gram = drawn.T @ drawn
        inside = judge.columns.T @ drawn
        gram -= inside.T @ judge.inner @ inside
        norm = np.sqrt(np.maximum(np.diag(gram), 0.0))
        seen = norm > 1e-6
        kept, axes = np.linalg.eigh(gram[np.ix_(seen, seen)] / np.outer(norm[seen], norm[seen]))
        large = kept > 1e-9 * kept[-1]
        draws = (axes[:, large] * np.sqrt(kept[large])) @ self._rng.standard_normal((int(large.sum()), _DRAWS))
        return LargestGains(np.sort(np.max(np.maximum(draws, 0.0), axis=0) ** 2))

    def visible_from(self, state: State, tail: LargestGains) -> tuple[Visible, ...]:
        """Smallest detectable size of each effect at a machine with median sweeps."""
        needed = np.sqrt(tail.limit(self._policy.next_p / len(self._machines))) + POWER_80
        lengths = []
        for i in np.flatnonzero(state.kept).tolist():
            judge, drawn = self._judge(i, state), self._drawn[i] / np.sqrt(state.misfit)
            inside = judge.columns.T @ drawn
            square = np.sum(drawn**2, axis=0) - np.sum(inside * (judge.inner @ inside), axis=0)
            lengths.append(np.sqrt(np.maximum(square, 0.0)))
        length, first, found = np.median(lengths, axis=0), 0, dict[str, Visible]()
        for s in self._changes:
            one = visible_size(s, length[first : first + len(s.points)], needed)
            first += len(s.points)
            # The effect's own law if it is detectable, since sizes of different laws are not comparable.
            if not np.isfinite(found.get(one.effect, one).size) or one.effect not in found:
                found[one.effect] = one
        return tuple(sorted(found.values(), key=lambda v: v.effect))

    def own(self, i: int, state: State, tail: LargestGains) -> Own:
        """Difference of a machine from the others, with its explanations."""
        gains, share = self._gains(i, state)
        best = float(gains.max())
        ends = np.cumsum([len(s.points) for s in self._changes])
        ranked = []
        for s, end in zip(self._changes, ends, strict=True):
            first = end - len(s.points)
            order = first + np.argsort(gains[first:end])[::-1][:_POINTS]
            guesses = [Guess(s, int(k - first), float(share[k])) for k in order if gains[k] > 0.0]
            ranked.append((float(gains[order[0]]), guesses))
        ranked.sort(key=lambda item: -item[0])
        found = [guess for _, guesses in ranked[:_SHORTLIST] for guess in guesses]
        return Own(min(1.0, len(self._machines) * tail.p_value(best)), best, self._explained(i, state, found))

    def _explained(self, i: int, state: State, found: Sequence[Guess]) -> tuple[Explanation, ...]:
        """-2 log evidence of guesses, integrated over sizes and errors `LAW_SD` of the laws; the best law of each effect."""
        judge, placed = self._judge(i, state), self._machines[i]
        smooth = self._smooth[placed.cell]
        judged = []
        for guess in found:
            change = guess.share * guess.change.change[guess.point][placed.cell]
            white = placed.whitened(np.concatenate((change[:, None], LAW_SD * smooth * change[:, None]), axis=1))
            white /= np.sqrt(state.misfit)
            judged.append((guess, judge.length(white[:, 0]), *judge.without(white[:, 0], white[:, 1:])))
        scale = max(min((chi2 for *_, chi2, _ in judged), default=0.0) / len(judge.residual), 1.0)
        merits: dict[str, tuple[float, Guess]] = {}
        for guess, length, chi2, volume in judged:
            merit = chi2 / scale + volume + guess.surprise(length)
            family = family_of(guess.change.law)
            if family not in merits or merit < merits[family][0]:
                merits[family] = (merit, guess)
        order = sorted(merits, key=lambda family: merits[family][0])
        return tuple(
            Explanation(family, merits[family][1].change.law, merits[family][1].values, merits[family][0] - merits[order[0]][0])
            for family in order
        )


def _surface(frame: Frame) -> Array:
    """Columns of model errors common to all machines: a polynomial in load and speed at each angle, (cells, columns)."""
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

"""Screening of pairs of effects, for cases in which each one alone explains little or is misleading."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from yieldmon.physics.numerics import Array

from .candidates import Score, Signature
from .fit import Fit

LONGEST = 1.5
"""Largest factor on a signature's size."""


@dataclass(frozen=True)
class PairScore:
    """Result of linear screening of two effects: remaining chi-square, and parameters to start a fit from."""

    effects: tuple[str, str]
    chi2: float
    start: dict[str, float]


def screen(base: Fit, drawn: Iterable[Signature], singles: Iterable[tuple[Fit, Iterable[Score]]]) -> list[PairScore]:
    """Each pair of effects once, the most promising first.

    drawn: signatures relative to `base`, combined in pairs. singles: fits with one effect, with the gain of each further effect.
    """
    best: dict[tuple[str, str], tuple[float, dict[str, float]]] = {}
    points = [(s, i) for s in drawn for i in range(len(s.points)) if float(np.sum(s.change[i] ** 2)) > 1e-12]
    if points:
        change = np.array([s.change[i] for s, i in points])
        gain, amplitude = best_of_two(change @ change.T, -(change @ base.residual))
        for i, (one, k) in enumerate(points):
            for j, (other, m) in enumerate(points[:i]):
                pair, chi2 = _ordered(one.effect, other.effect), base.chi2 - float(gain[i, j])
                if one.effect == other.effect or (pair in best and best[pair][0] <= chi2):
                    continue
                best[pair] = (chi2, _at(one, k, float(amplitude[i, j])) | _at(other, m, float(amplitude[j, i])))
    for alone, further in singles:
        for s in further:
            pair, chi2 = _ordered(alone.effects[0], s.effect), alone.chi2 - s.gain
            if pair not in best or chi2 < best[pair][0]:
                best[pair] = (chi2, alone.values | s.start)
    return sorted((PairScore(pair, chi2, start) for pair, (chi2, start) in best.items()), key=lambda p: (p.chi2, p.effects))


def best_of_two(gram: Array, along: Array) -> tuple[Array, Array]:
    """Gain in chi-square of every two signatures, each with a factor of 0 to `LONGEST`, and the factor of the row's one.

    gram: scalar products of the signatures, (n, n). along: scalar products with the misfit, (n,). The result is exact, since the
    optimum of a quadratic function in a box is the free one or lies on an edge.
    """
    first, second = along[:, None], along[None, :]
    norm_first, norm_second = np.diag(gram)[:, None], np.diag(gram)[None, :]
    determinant = norm_first * norm_second - gram**2
    free = determinant > 1e-9 * norm_first * norm_second
    inside = (first * norm_second - second * gram) / np.where(free, determinant, np.inf)
    edges = [np.zeros_like(gram), np.full_like(gram, LONGEST)]
    edges += [(first - gram * other) / norm_first for other in (0.0, LONGEST)]
    gain, taken = np.zeros_like(gram), np.zeros_like(gram)
    for trial in (inside, *edges):
        one = np.clip(trial, 0.0, LONGEST)
        two = np.clip((second - gram * one) / norm_second, 0.0, LONGEST)
        gained = 2.0 * (one * first + two * second) - one**2 * norm_first - two**2 * norm_second - 2.0 * one * two * gram
        better = gained > gain
        gain, taken = np.where(better, gained, gain), np.where(better, one, taken)
    return gain, taken


def _ordered(one: str, other: str) -> tuple[str, str]:
    return (one, other) if one < other else (other, one)


def _at(drawn: Signature, point: int, times: float) -> dict[str, float]:
    return {
        p.name: float(np.clip(p.start + times * (v - p.start), p.lower, p.upper))
        for p, v in zip(drawn.parameters, drawn.points[point], strict=True)
    }

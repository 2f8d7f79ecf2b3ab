"""Arrivals near a point from a second-order expansion, which is computed once for each cell of a grid.

Between successive windows flow, friction, heap shape, speed and plate angle hardly change. The expansion of a cell needs 31
throws, and two to check it; its evaluation needs two products of small matrices.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from yieldmon.physics.numerics import AnyArray, Array
from yieldmon.physics.pulse import Arrivals

CELL = np.array([0.08, 0.2, 0.1, 0.04, 0.03])
"""Width of a cell: ln volume flow, ln friction, ln shape ratio, ln elevator speed, plate angle (rad)."""
SHAPES = 3
"""Number of the first ones, which are fitted; speed and angle are given."""
_SIZE = CELL.size
_PAIRS = [(i, j) for i in range(_SIZE) for j in range(i + 1, _SIZE)]
_FIRST, _SECOND = np.array([i for i, _ in _PAIRS]), np.array([j for _, j in _PAIRS])
_CELLS_KEPT = 256
_LARGEST_ERROR = 1e-3
"""Largest error of an expansion at two corners of its cell: of the impulse, relative, and of arrival times in units of the
pulse's standard deviation."""
_SMALL = 1e-4
"""Argument below which sin(x) / x is computed by its series."""


@dataclass(frozen=True, slots=True)
class Expanded:
    """Arrivals and their derivatives, arrays (4, ..., paddles, nodes): the value, then the derivative for each fitted parameter.

    Attributes
    ----------
    impulse_n_s, middle_s, half_width_s : ndarray
        As in `Arrivals`.
    """

    impulse_n_s: Array
    middle_s: Array
    half_width_s: Array


@dataclass(frozen=True, slots=True)
class _Cell:
    """Value (n,), first derivatives (5, n) and second derivatives (5, 5 n) of n quantities at a cell's centre."""

    value: Array
    slopes: Array
    bends: Array

    def at(self, moves: Array) -> tuple[Array, Array]:
        """Values (m, n) and slopes (m, 5, n) at distances `moves` (m, 5). Each row is bit for bit independent of the others."""
        row = moves[:, None, :]
        slopes = self.slopes + (row @ self.bends).reshape(len(moves), *self.slopes.shape)
        return self.value + 0.5 * (row @ (self.slopes + slopes))[:, 0], slopes


class ArrivalExpansions:
    """Expansions by cell; the last few hundred are kept.

    Parameters
    ----------
    exact : callable
        Points (m, 5) in the order of `CELL` to arrivals (m, paddles, nodes).
    """

    def __init__(self, exact: Callable[[Array], Arrivals]) -> None:
        self._exact = exact
        self._cells: dict[tuple[int, ...], _Cell | None] = {}
        self._shape: tuple[int, ...] = ()

    def at(self, points: Array) -> tuple[Expanded, Array]:
        """Arrivals at points.

        A result depends on its point alone, and not on other points or earlier calls.

        Parameters
        ----------
        points : ndarray (m, 5)

        Returns
        -------
        Expanded
            Arrays (4, p, paddles, nodes), for the p points that have an expansion.
        ndarray of bool (m,)
            Which points these are. A point has none if the model in its cell is not smooth enough or not defined.
        """
        scaled = points / CELL
        places = np.rint(scaled)
        rows: dict[tuple[int, ...], list[int]] = {}
        for row, key in enumerate(places.astype(np.intp).tolist()):
            rows.setdefault(tuple(key), []).append(row)
        known, parts, cells = np.zeros(len(points), dtype=bool), [], self._cells_at(list(rows))
        for (_, chosen), cell in zip(rows.items(), cells, strict=True):
            if cell is not None:
                known[chosen] = True
                value, slopes = cell.at((scaled - places)[chosen])
                parts.append((chosen, np.concatenate((value[:, None], slopes[:, :SHAPES] / CELL[:SHAPES, None]), axis=1)))
        found = np.empty((len(points), 1 + SHAPES, 3, *self._shape))
        for chosen, part in parts:
            found[chosen] = part.reshape(len(chosen), 1 + SHAPES, 3, *self._shape)
        impulse, middle, half = found[known].transpose(2, 1, 0, *range(3, found.ndim))
        return Expanded(impulse, middle, half), known

    def _cells_at(self, keys: list[tuple[int, ...]]) -> list[_Cell | None]:
        new = [key for key in keys if key not in self._cells]
        if new:
            self._cells.update(zip(new, self._expansions(np.array(new) * CELL), strict=True))
        found = [self._cells[key] for key in keys]
        while len(self._cells) > _CELLS_KEPT:
            self._cells.pop(next(iter(self._cells)))
        return found

    def _expansions(self, centres: Array) -> list[_Cell | None]:
        """Expansions about centres (m, 5), with all throws computed in one call."""
        half = 0.5
        unit = half * np.eye(_SIZE)
        both = unit[_FIRST] + unit[_SECOND]
        corners = half * np.array([np.ones(_SIZE), [1, -1, 1, -1, 1]])
        moves = np.concatenate((np.zeros((1, _SIZE)), unit, -unit, both, -both, corners))
        parts = self._exact((centres[:, None] + moves * CELL).reshape(-1, _SIZE))
        self._shape = parts.impulse_n_s.shape[1:]
        values = np.stack((parts.impulse_n_s, parts.middle_s, parts.half_width_s), axis=1).reshape(len(centres), len(moves), -1)
        return [self._expansion(of_cell, moves) for of_cell in values]

    def _expansion(self, values: Array, moves: Array) -> _Cell | None:
        """Expansion of impulse, middle and half width of all nodes; distances in units of the cell's width. None if not
        accurate."""
        if not np.all(np.isfinite(values)):
            return None
        half, n, m = 0.5, _SIZE, len(_PAIRS)
        middle, up, down = values[0], values[1 : 1 + n], values[1 + n : 1 + 2 * n]
        mixed = values[1 + 2 * n : 1 + 2 * n + m] + values[1 + 2 * n + m : 1 + 2 * n + 2 * m]
        mixed = (mixed - (up + down)[_FIRST] - (up + down)[_SECOND] + 2.0 * middle) / (2.0 * half * half)
        bend = np.zeros((n, n, values.shape[1]))
        bend[_FIRST, _SECOND] = bend[_SECOND, _FIRST] = mixed
        bend[np.arange(n), np.arange(n)] = (up + down - 2.0 * middle) / (half * half)
        cell = _Cell(middle, (up - down) / (2.0 * half), bend.reshape(n, -1))
        if not all(self._near(found, true) for found, true in zip(cell.at(moves[-2:])[0], values[-2:], strict=True)):
            return None
        return cell

    def _near(self, found: Array, true: Array) -> bool:
        shown, exact = (Arrivals(*v.reshape(3, *self._shape)) for v in (found, true))
        size, width = exact.total_n_s[..., None], exact.sd_s[..., None]
        weight = np.abs(exact.impulse_n_s) / size
        off = np.abs(shown.impulse_n_s - exact.impulse_n_s) / size
        late = weight * (np.abs(shown.middle_s - exact.middle_s) + np.abs(shown.half_width_s - exact.half_width_s)) / width
        return bool(np.all(off.sum(axis=-1) < _LARGEST_ERROR) and np.all(late.sum(axis=-1) < _LARGEST_ERROR))


def spectrum_and_slopes(
    parts: Expanded, fundamental_rad_s: Array, harmonics: int, stretch: Array, log_stretch_slopes: Array
) -> AnyArray:
    """`yieldmon.physics.pulse.spectrum` of expanded arrivals, and its derivatives.

    Parameters
    ----------
    parts : Expanded
        (4, pulses, nodes).
    fundamental_rad_s : ndarray (pulses,)
        The frequencies are its multiples 1 .. harmonics.
    harmonics : int
        k.
    stretch : ndarray (pulses,)
    log_stretch_slopes : ndarray (n, pulses)
        Derivatives of ln stretch with respect to n parameters, the first three of which are those of `parts`.

    Returns
    -------
    ndarray (1 + n, pulses, k)
        Complex, N s: the spectrum, then its derivatives.
    """
    impulse, middle, half = parts.impulse_n_s, parts.middle_s, parts.half_width_s
    size = impulse[0].sum(axis=-1, keepdims=True)
    weight = impulse[0] / size
    mean = (weight * middle[0]).sum(axis=-1, keepdims=True)
    away, share = middle[0] - mean, impulse[1:] / size
    # Derivatives of the mean arrival through impulses and times of the parts, which the first parameters alone change.
    mean_slopes = (share * away + weight * middle[1:]).sum(axis=-1, keepdims=True)
    factor, slopes, given = stretch[:, None], log_stretch_slopes[..., None], len(mean_slopes)
    middle_slopes = factor * (slopes * away)
    middle_slopes[:given] += mean_slopes + factor * (middle[1:] - mean_slopes)
    half_slopes = factor * (slopes * half[0])
    half_slopes[:given] += factor * half[1:]
    base = fundamental_rad_s[:, None]
    order = np.arange(1.0, harmonics + 1.0)
    turn_cos, turn_sin = _multiples(-base * (mean + factor * away), harmonics)
    width = base * (factor * half[0])
    wide_cos, wide_sin = _multiples(width, harmonics)
    sinc, slope = _sinc_and_slope(order[:, None, None] * width, wide_sin, wide_cos)
    rows = np.concatenate((impulse, impulse[0] * middle_slopes)).transpose(1, 2, 0)
    node_cos, node_sin = _of_turns(turn_cos, turn_sin, sinc, rows)
    half_cos, half_sin = _of_turns(turn_cos, turn_sin, slope, (impulse[0] * half_slopes).transpose(1, 2, 0))
    frequency, known = (base * order)[..., None], 1 + given
    found = np.zeros((*half_cos.shape[:-1], 1 + len(slopes)), dtype=complex)
    found.real[..., :known], found.imag[..., :known] = node_cos[..., :known], node_sin[..., :known]
    # A later arrival turns the spectrum by -i times the frequency.
    found.real[..., 1:] += frequency * (half_cos + node_sin[..., known:])
    found.imag[..., 1:] += frequency * (half_sin - node_cos[..., known:])
    return np.asarray(np.moveaxis(found, -1, 0))


def _sinc_and_slope(x: Array, sine: Array, cosine: Array) -> tuple[Array, Array]:
    """sin(x) / x and its derivative; for small x by their series, since differences would lose precision."""
    thin = np.abs(x) < _SMALL
    if not thin.any():
        sinc = sine / x
        return sinc, (cosine - sinc) / x
    safe = np.where(thin, 1.0, x)
    sinc = np.where(thin, 1.0 - x * x / 6.0, sine / safe)
    return sinc, np.where(thin, -x / 3.0, (cosine - sinc) / safe)


def _multiples(angles: Array, count: int) -> tuple[Array, Array]:
    """Cosine and sine of 1 .. count times angles (p, n), each (count, p, n)."""
    cosine, sine = np.empty((2, count, *angles.shape))
    np.cos(angles, out=cosine[0])
    np.sin(angles, out=sine[0])
    known = 1
    while known < count:
        more = min(known, count - known)
        c, s, last_c, last_s = cosine[:more], sine[:more], cosine[known - 1], sine[known - 1]
        next_c, next_s = cosine[known : known + more], sine[known : known + more]
        np.multiply(c, last_c, out=next_c)
        next_c -= s * last_s
        np.multiply(s, last_c, out=next_s)
        next_s += c * last_s
        known += more
    return cosine, sine


def _of_turns(cosine: Array, sine: Array, size: Array, rows: Array) -> tuple[Array, Array]:
    """Real and imaginary part of sums over nodes of size * (cosine + i sine) * rows, (p, k, m).

    cosine, sine, size: (k, p, n); rows: (p, n, m).
    """
    rows = np.ascontiguousarray(rows)
    real, imag = ((part * size).transpose(1, 0, 2) @ rows for part in (cosine, sine))
    return np.asarray(real), np.asarray(imag)

"""Arrivals near a point, from a second-order expansion that is worked out once for a cell of a grid.

Between one window and the next flow, friction, heap shape, speed and plate angle hardly move. A cell's expansion needs 31 throws
and two to check it; an answer from it is two products of small matrices.
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
"""The first of them are fitted; speed and angle are given."""
_SIZE = CELL.size
_PAIRS = [(i, j) for i in range(_SIZE) for j in range(i + 1, _SIZE)]
_FIRST, _SECOND = np.array([i for i, _ in _PAIRS]), np.array([j for _, j in _PAIRS])
_CELLS_KEPT = 256
_LARGEST_ERROR = 1e-3
"""Of the expansion at two corners of the cell: of the impulse, and of the arrival times in the pulse's standard deviations."""


@dataclass(frozen=True, slots=True)
class Expanded:
    """Arrivals and their derivatives; arrays (4, ..., paddles, nodes), first the value, then one for each fitted parameter.

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
    """Value (n,), slopes (5, n) and bends (5, 5 n) of n quantities at a cell's centre."""

    value: Array
    slopes: Array
    bends: Array

    def at(self, moves: Array) -> tuple[Array, Array]:
        """Values (m, n) and slopes (m, 5, n), moves (m, 5) away; each as if it were alone, to the last bit."""
        row = moves[:, None, :]
        slopes = self.slopes + (row @ self.bends).reshape(len(moves), *self.slopes.shape)
        return self.value + 0.5 * (row @ (self.slopes + slopes))[:, 0], slopes


class ArrivalExpansions:
    """Expansions by cell, the last few hundred kept.

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
        """Arrivals at points (m, 5), (4, p, paddles, nodes), and which (m,) of them are among the p.

        Not those in whose cell the model is somewhere not smooth enough or without a value. An answer depends on its point alone,
        not on what was asked before or beside it.
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
        """About centres (m, 5), whose throws are worked out together."""
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
        """Of impulse, middle and half width of all nodes, in widths of the cell from its centre."""
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
        Derivatives of ln stretch by the n parameters, of which the first three are those of `parts`.

    Returns
    -------
    ndarray (1 + n, pulses, k)
        Complex, N s: first the spectrum itself.
    """
    impulse, middle, half = (_padded(v, len(log_stretch_slopes)) for v in (parts.impulse_n_s, parts.middle_s, parts.half_width_s))
    size = impulse[0].sum(axis=-1, keepdims=True)
    weight = impulse[0] / size
    mean = (weight * middle[0]).sum(axis=-1, keepdims=True)
    away, share = middle[0] - mean, impulse[1:] / size
    # Of the mean arrival: from the parts' impulses and from their times.
    mean_slopes = (share * away + weight * middle[1:]).sum(axis=-1, keepdims=True)
    factor, slopes = stretch[:, None], log_stretch_slopes[..., None]
    middle_slopes = mean_slopes + factor * (middle[1:] - mean_slopes + slopes * away)
    half_slopes = factor * (half[1:] + slopes * half[0])
    base = fundamental_rad_s[:, None]
    order = np.arange(1.0, harmonics + 1.0)
    turn_cos, turn_sin = _multiples(-base * (mean + factor * away), harmonics)
    width = base * (factor * half[0])
    wide_cos, wide_sin = _multiples(width, harmonics)
    # sin(x) / x and its derivative; their series where the difference would drown in rounding.
    spread = order[:, None] * width[:, None, :]
    thin = np.abs(spread) < 1e-4
    safe = np.where(thin, 1.0, spread)
    sinc = np.where(thin, 1.0 - spread * spread / 6.0, wide_sin / safe)
    slope = np.where(thin, -spread / 3.0, (wide_cos - sinc) / safe)
    rows = np.concatenate((impulse, impulse[0] * middle_slopes)).transpose(1, 2, 0)
    by_node = _of_turns(turn_cos, turn_sin, sinc, rows)
    by_half = _of_turns(turn_cos, turn_sin, slope, (impulse[0] * half_slopes).transpose(1, 2, 0))
    found = by_node[..., : len(impulse)]
    frequency = base * order
    found[..., 1:] += frequency[..., None] * (by_half - 1j * by_node[..., len(impulse) :])
    return np.asarray(np.moveaxis(found, -1, 0))


def _multiples(angles: Array, count: int) -> tuple[Array, Array]:
    """Cosine and sine (p, count, n) of 1 .. count times angles (p, n)."""
    cosine, sine = (np.empty((len(angles), count, angles.shape[1])) for _ in range(2))
    cosine[:, 0], sine[:, 0] = np.cos(angles), np.sin(angles)
    known = 1
    while known < count:
        more = min(known, count - known)
        c, s, last_c, last_s = cosine[:, :more], sine[:, :more], cosine[:, known - 1 : known], sine[:, known - 1 : known]
        cosine[:, known : known + more] = c * last_c - s * last_s
        sine[:, known : known + more] = s * last_c + c * last_s
        known += more
    return cosine, sine


def _of_turns(cosine: Array, sine: Array, size: Array, rows: Array) -> AnyArray:
    """Sums (p, k, m) over nodes of size (cosine + i sine), all (p, k, n), times rows (p, n, m)."""
    rows = np.ascontiguousarray(rows)
    return np.asarray((cosine * size) @ rows + 1j * ((sine * size) @ rows))


def _padded(values: Array, parameters: int) -> Array:
    """Zeros for the parameters that do not move the parts."""
    more = np.zeros((1 + parameters - len(values), *values.shape[1:]))
    return np.concatenate((values, more))

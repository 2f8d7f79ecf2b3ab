"""The delay from cutting to the sensor, estimated from the harvest itself, with an interval, or not at all.

For each shift the flow is put back by it, and the yields of neighbouring passes driven the opposite way are correlated. The curve
over the shifts peaks at the delay. Blocks of pairs (passes) are drawn again with replacement for the interval. No answer is given
where the peak is not clear of the rest of the curve, moves about from draw to draw, or lies at the end of the range.

Sources: Chung, Sudduth and Drummond, "Determining yield monitoring system delay time with geostatistical and data segmentation
approaches", Transactions of the ASAE 45 (2002); Efron and Tibshirani, "An introduction to the bootstrap" (1993), chapter 8.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from yieldmon.documents.harvest_map import DelayDocument

from .pairs import Pairs, of_like_passes
from .table import Array, Index
from .tracks import MIN_SPEED_M_S, Tracks

SHIFTS_S = np.arange(-45.0, 76.0)
TICK_S = 0.5
_ROOM = int(np.ceil(np.abs(SHIFTS_S).max() / TICK_S)) + 2
MAX_INTERVAL_S, MAX_TICKS = 10.0, 60_000_000
DRAWS = 200
MIN_PAIRS, MIN_BLOCKS = 200, 8
CLEAR_OF_S = 10.0
"""How far from the peak the rest of the curve begins."""
MIN_CONTRAST_SD = 3.0
MIN_STEADY_SHARE = 0.9
STEADY_WITHIN_S = 4.0
FLOOR_S = 1.0
"""Half-width that an interval has at least: flows and yields by area do not peak at quite the same shift, and the peak lies
before the mean delay of a machine that smears."""
EDGE_S = 2.0
POINT_S = 1.0
"""A flow is the mean of the interval before its point, so the shift from point to point exceeds the delay by half of it. What is
beyond that of a row a second is taken off."""
_WINSOR = (1.0, 99.0)
_LEAST_SHARE = 0.1
"""Of the median flow; less says nothing of the yield at a place, as the machine fills or empties, though it runs (EMPTY_SHARE of
tracks). Two passes shifted by half a pass have such flows at the same places, which is no agreement of yields."""


class Decision(StrEnum):
    """Where a delay comes from."""

    ESTIMATED = "estimated"
    CANNOT_TELL = "cannot tell"
    """The data do not decide; the default is kept."""
    DECLARED = "declared"
    """Given by a person."""


@dataclass(frozen=True)
class Curve:
    """Correlation of opposing pairs, a value a shift."""

    shift_s: Array
    correlation: Array


@dataclass(frozen=True)
class Delay:
    """A delay.

    Parameters
    ----------
    value_s : float
        What is used.
    low_s, high_s : float or None
        95 % interval, None unless it is estimated.
    decision : Decision
        Where the value comes from.
    declared_s : float or None
        What the machine itself declares.
    why : str
        One sentence.
    curve : Curve
        Empty where there are no pairs.
    no_shift, shifted, held_out : float
        Correlation of the pairs as they are, at the value, and on pairs that the value was not estimated from; NaN if unknown.
    pairs : int
        Number of pairs.
    """

    value_s: float
    low_s: float | None
    high_s: float | None
    decision: Decision
    declared_s: float | None
    why: str
    curve: Curve
    no_shift: float
    shifted: float
    held_out: float
    pairs: int

    def document(self) -> DelayDocument:
        """As JSON takes it."""
        return {
            "value": round(self.value_s, 3),
            "low": _rounded(self.low_s),
            "high": _rounded(self.high_s),
            "decision": self.decision.value,
            "declared": self.declared_s,
            "why": self.why,
        }


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)


def estimate_delay(
    steps: Tracks, pairs: Pairs, quantity: str, *, default_s: float, declared_s: float | None, generator: np.random.Generator
) -> Delay:
    """The delay of `quantity`: "flow" (yields of pairs agree) or "moisture" (moistures agree).

    Parameters
    ----------
    steps : Tracks
        Of the harvest.
    pairs : Pairs
        Of opposing passes.
    quantity : str
        "flow" or "moisture".
    default_s : float
        What is kept when the data do not decide, s.
    declared_s : float or None
        The machine's own.
    generator : numpy.random.Generator
        Draws the blocks.
    """
    empty = Curve(SHIFTS_S[:0], SHIFTS_S[:0])
    nan = float("nan")

    def refused(why: str, curve: Curve = empty, no_shift: float = nan, at_default: float = nan) -> Delay:
        return Delay(
            value_s=default_s,
            low_s=None,
            high_s=None,
            decision=Decision.CANNOT_TELL,
            declared_s=declared_s,
            why=why,
            curve=curve,
            no_shift=no_shift,
            shifted=at_default,
            held_out=nan,
            pairs=len(pairs),
        )

    if quantity == "flow":
        pairs = of_like_passes(steps, pairs)
    if len(pairs) < MIN_PAIRS or pairs.blocks < MIN_BLOCKS:
        return refused(f"{len(pairs)} pairs of opposing passes in {pairs.blocks} blocks; {MIN_PAIRS} in {MIN_BLOCKS} are needed")
    if steps.usual_interval_s > MAX_INTERVAL_S or _ticks(steps) > MAX_TICKS:
        return refused(f"points are {steps.usual_interval_s:.1f} s apart, or their clock steps back and forth")
    sums = block_sums(steps, pairs, quantity)
    everything = correlation_of(sums.sum(axis=1))
    if not np.isfinite(everything).any():
        known = np.isfinite(steps.moisture_pct if quantity == "moisture" else steps.flow_kg_s).any()
        return refused(f"the {quantity} is the same everywhere" if known else f"there is no {quantity}")
    curve = Curve(SHIFTS_S, everything)
    no_shift, at_default = (float(np.interp(s, SHIFTS_S, everything)) for s in (0.0, default_s))
    peak = _peak(everything)
    weights = generator.multinomial(pairs.blocks, np.full(pairs.blocks, 1.0 / pairs.blocks), size=DRAWS)
    drawn = correlation_of(np.einsum("db,qbs->qds", weights.astype(float), sums, optimize=True))
    why = _objection(everything, drawn, peak)
    if why:
        return refused(why, curve, no_shift, at_default)
    peaks = np.array([_peak(one, about=peak) for one in drawn])
    low, high = (float(value) for value in np.percentile(peaks, [2.5, 97.5]))
    floor = max(FLOOR_S, 0.5 * steps.usual_interval_s)
    value = peak - (0.5 * max(0.0, steps.usual_interval_s - POINT_S) if quantity == "flow" else 0.0)
    return Delay(
        value_s=value,
        low_s=min(low - peak, -floor) + value,
        high_s=max(high - peak, floor) + value,
        decision=Decision.ESTIMATED,
        declared_s=declared_s,
        why="one clear peak",
        curve=curve,
        no_shift=no_shift,
        shifted=float(np.interp(peak, SHIFTS_S, everything)),
        held_out=_held_out(sums),
        pairs=len(pairs),
    )


def given_delay(value_s: float, declared_s: float | None, estimated: Delay) -> Delay:
    """The user's own value, with what the data say about it."""
    at = estimated.curve
    agreement = float(np.interp(value_s, at.shift_s, at.correlation)) if len(at.shift_s) else float("nan")
    return Delay(
        value_s=value_s,
        low_s=None,
        high_s=None,
        decision=Decision.DECLARED,
        declared_s=declared_s,
        why="given on the command line",
        curve=at,
        no_shift=estimated.no_shift,
        shifted=agreement,
        held_out=agreement,
        pairs=estimated.pairs,
    )


def _series(steps: Tracks, quantity: str) -> tuple[Array, Array]:
    """What is shifted, and what divides it at the place (NaN where no yield is defined)."""
    if quantity == "moisture":
        value = np.where(steps.moisture_pct > 0, steps.moisture_pct, np.nan)
        return value, np.ones(len(steps))
    speed = np.where(np.nan_to_num(steps.speed_m_s) > MIN_SPEED_M_S, steps.speed_m_s, np.nan)
    flow = np.nan_to_num(steps.flow_kg_s)
    usual = float(np.median(flow[flow > 0])) if (flow > 0).any() else 0.0
    with np.errstate(invalid="ignore"):
        return np.where(flow > _LEAST_SHARE * usual, flow, np.nan), np.where(steps.width_m > 0, speed * steps.width_m, np.nan)


@dataclass(frozen=True)
class _Even:
    """Values on an even clock of TICK_S: `at` is the place of each step, gaps are NaN and as wide as the longest shift."""

    at: Index
    values: Array


def _ticks(steps: Tracks) -> float:
    first, last = steps.run_ends()
    return float((steps.time_s[last] - steps.time_s[first]).sum() / TICK_S) + _ROOM * len(first)


def _even(steps: Tracks, values: Array) -> _Even:
    first, last = steps.run_ends()
    length = np.round((steps.time_s[last] - steps.time_s[first]) / TICK_S).astype(np.int64) + 1
    start = _ROOM + np.concatenate(([0], np.cumsum(length + _ROOM)[:-1]))
    number = np.repeat(np.arange(len(first)), last - first + 1)
    # Each run keeps the phase of its own first point, so a clock of whole seconds stays exact.
    place = start[number] + (steps.time_s - steps.time_s[first][number]) / TICK_S
    total = int(start[-1] + length[-1] + _ROOM)
    grid = np.interp(np.arange(total), place, values)
    inside = np.zeros(total + 1, np.int64)
    np.add.at(inside, start, 1)
    np.add.at(inside, start + length, -1)
    grid[np.cumsum(inside)[:-1] == 0] = np.nan
    return _Even(np.round(place).astype(np.int64), grid)


def block_sums(steps: Tracks, pairs: Pairs, quantity: str, shifts_s: Array = SHIFTS_S) -> Array:
    """Sums over the pairs of each block that a correlation needs, for each shift: shape (6, blocks, shifts)."""
    values, divisor = _series(steps, quantity)
    even = _even(steps, values)
    by_first, by_second = divisor[pairs.first], divisor[pairs.second]
    with np.errstate(invalid="ignore", divide="ignore"):
        plain = values[pairs.first] / by_first
    known = plain[np.isfinite(plain)]
    low, high = np.percentile(known, _WINSOR) if known.size else (0.0, 1.0)
    # Centred and scaled, or sums of squares lose the correlation of large numbers.
    middle, scale = 0.5 * (low + high), max(high - low, 1e-12)
    first, second = even.at[pairs.first], even.at[pairs.second]
    out = np.zeros((6, pairs.blocks, len(shifts_s)))
    for k, shift in enumerate(np.round(shifts_s / TICK_S).astype(int)):
        p = (np.clip(even.values[first + shift] / by_first, low, high) - middle) / scale
        q = (np.clip(even.values[second + shift] / by_second, low, high) - middle) / scale
        both = np.isfinite(p) & np.isfinite(q)
        p, q, block = p[both], q[both], pairs.block[both]
        out[0, :, k] = np.bincount(block, minlength=pairs.blocks)
        for j, term in enumerate((p, q, p * p, q * q, p * q), 1):
            out[j, :, k] = np.bincount(block, term, pairs.blocks)
    return out


def correlation_of(sums: Array) -> Array:
    """From sums over pairs, either order of a pair counting the same; NaN with less than a quarter of the pairs."""
    count, p, q, pp, qq, pq = sums
    enough = count >= 0.25 * np.max(count, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = 0.5 * (p + q) / count
        variance = 0.5 * (pp + qq) / count - mean**2
        return np.where(enough & (variance > 1e-12), (pq / count - mean**2) / variance, np.nan)


def _peak(correlation: Array, about: float | None = None) -> float:
    """Shift of the highest value, between shifts by a parabola; `about`: the highest within STEADY_WITHIN_S of it."""
    seen = np.nan_to_num(correlation, nan=-2.0)
    if about is not None:
        seen = np.where(np.abs(SHIFTS_S - about) <= STEADY_WITHIN_S, seen, -2.0)
    k = int(np.argmax(seen))
    if 0 < k < len(seen) - 1 and min(seen[k - 1], seen[k + 1]) > -2.0:
        left, here, right = seen[k - 1], seen[k], seen[k + 1]
        bend = left - 2 * here + right
        if bend < 0:
            return float(SHIFTS_S[k] + 0.5 * (left - right) / bend)
    return float(SHIFTS_S[k])


def _objection(curve: Array, drawn: Array, peak: float) -> str:
    """Why the curve cannot be trusted; empty if it can."""
    known = SHIFTS_S[np.isfinite(curve)]
    if peak <= known[0] + EDGE_S or peak >= known[-1] - EDGE_S:
        return f"the curve is highest at the end of its range, {peak:.0f} s"
    at = int(np.argmin(np.abs(SHIFTS_S - peak)))
    rest = np.flatnonzero((np.abs(SHIFTS_S - peak) > CLEAR_OF_S) & np.isfinite(curve))
    if not len(rest):
        return "the curve has no shifts on both sides of its peak"
    rival = rest[int(np.argmax(curve[rest]))]
    contrast = drawn[:, at] - drawn[:, rival]
    spread = float(np.nanstd(contrast))
    if curve[at] - curve[rival] < MIN_CONTRAST_SD * spread:
        return (
            f"no single clear peak: {curve[at]:.2f} at {SHIFTS_S[at]:.0f} s, {curve[rival]:.2f} at {SHIFTS_S[rival]:.0f} s, "
            f"sd {spread:.2f}"
        )
    highest = np.array([SHIFTS_S[int(np.argmax(np.nan_to_num(one, nan=-2.0)))] for one in drawn])
    steady = float(np.mean(np.abs(highest - peak) <= STEADY_WITHIN_S))
    if steady < MIN_STEADY_SHARE:
        return f"the peak moves: {100 * steady:.0f} % of {DRAWS} draws within {STEADY_WITHIN_S:.0f} s of {peak:.1f} s"
    return ""


def _held_out(sums: Array) -> float:
    """Correlation on blocks that the peak was not found on, the mean of both directions."""
    halves = [correlation_of(sums[:, k::2].sum(axis=1)) for k in (0, 1)]
    return float(np.mean([np.interp(_peak(halves[k]), SHIFTS_S, halves[1 - k]) for k in (0, 1)]))

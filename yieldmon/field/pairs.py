"""Pairs of steps of neighbouring passes driven the opposite way: the same ground's yield, seen from both sides of the delay.

What a delay moves along one pass it moves the other way along its neighbour, so the agreement of such pairs is best at the true
delay.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from .table import Index
from .tracks import MIN_SPEED_M_S, Tracks

MAX_PAIRS = 60_000
_NEIGHBOURS = 16
_REACH_WIDTHS = 1.6
_OPPOSITE = -0.95
_BLOCK_S = 60.0
_MIN_PASSES_AS_BLOCKS = 24
_SAME_LEVEL, _MOST_UNLIKE = 1.5, 0.25
"""Ratio of two passes' median yields from which on one of them cut less than its width, and the share of pairs that may be of
such passes: with more, the yields themselves differ."""


@dataclass(frozen=True)
class Pairs:
    """Steps `first` and `second` of each pair, and the block (a pass or a part of one) that the pair belongs to."""

    first: Index
    second: Index
    block: Index
    blocks: int

    def __len__(self) -> int:
        return len(self.first)


def opposing_pairs(steps: Tracks) -> Pairs:
    """Each harvesting step with the nearest one of a neighbouring pass in the opposite direction; every pair once."""
    use = np.flatnonzero(
        steps.down & np.isfinite(steps.heading_rad) & (np.nan_to_num(steps.speed_m_s) > MIN_SPEED_M_S) & (steps.width_m > 0)
    )
    if len(use) < 2:
        return Pairs(use[:0], use[:0], use[:0], 0)
    reach = _REACH_WIDTHS * float(np.median(steps.width_m[use]))
    places = np.column_stack((steps.x_m[use], steps.y_m[use]))
    asked = use[:: max(1, len(use) // MAX_PAIRS)]
    asked_places = np.column_stack((steps.x_m[asked], steps.y_m[asked]))
    tree = cKDTree(places)
    distance, found = (
        np.asarray(part) for part in tree.query(asked_places, k=min(_NEIGHBOURS, len(use)), distance_upper_bound=reach)
    )
    near = np.isfinite(distance)
    first = np.repeat(asked, near.sum(axis=1))
    second = use[found[near]]
    turn = steps.heading_rad[first] - steps.heading_rad[second]
    east, north = steps.x_m[second] - steps.x_m[first], steps.y_m[second] - steps.y_m[first]
    along = east * np.sin(steps.heading_rad[first]) + north * np.cos(steps.heading_rad[first])
    across = np.sqrt(np.maximum(east**2 + north**2 - along**2, 0.0))
    width = 0.5 * (steps.width_m[first] + steps.width_m[second])
    keep = (np.cos(turn) < _OPPOSITE) & (across > 0.4 * width) & (np.abs(along) < 0.7 * reach)
    first, second, along = first[keep], second[keep], along[keep]
    order = np.lexsort((np.abs(along), first))
    first, second = first[order], second[order]
    nearest = np.r_[True, np.diff(first) != 0][: len(first)]
    first, second = first[nearest], second[nearest]
    low, high = np.minimum(first, second), np.maximum(first, second)
    _, once = np.unique(low * len(steps) + high, return_index=True)
    low, high = low[once], high[once]
    block = _blocks(steps, low)
    return Pairs(low, high, block, int(block.max()) + 1 if len(block) else 0)


def of_like_passes(steps: Tracks, pairs: Pairs) -> Pairs:
    """The pairs without those of passes whose median yields differ by over a half, where these are few.

    A last pass half over ground without a crop has half its neighbour's yield everywhere, whatever the delay is.

    Parameters
    ----------
    steps : Tracks
    pairs : Pairs
        Of its opposing passes.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        amount = steps.flow_kg_s / (steps.speed_m_s * steps.width_m)
    grain = np.flatnonzero((amount > 0) & np.isfinite(amount) & (steps.pass_number >= 0))
    if not len(pairs) or not grain.size:
        return pairs
    number = steps.pass_number[grain]
    order = np.lexsort((amount[grain], number))
    begin = np.flatnonzero(np.diff(number[order], prepend=-1))
    length = np.diff(begin, append=len(order))
    usual = np.full(int(steps.pass_number.max()) + 1, np.nan)
    usual[number[order][begin]] = amount[grain][order][begin + length // 2]
    with np.errstate(invalid="ignore"):
        ratio = usual[steps.pass_number[pairs.first]] / usual[steps.pass_number[pairs.second]]
        unlike = np.abs(np.log(ratio)) > np.log(_SAME_LEVEL)
    if not 0.0 < unlike.mean() <= _MOST_UNLIKE:
        return pairs
    names, block = np.unique(pairs.block[~unlike], return_inverse=True)
    return Pairs(pairs.first[~unlike], pairs.second[~unlike], block.astype(np.intp), len(names))


def _blocks(steps: Tracks, member: Index) -> Index:
    passes = steps.pass_number[member]
    if len(np.unique(passes)) >= _MIN_PASSES_AS_BLOCKS:
        names = passes
    else:
        started = np.searchsorted(steps.pass_number[steps.down], passes)
        since = steps.time_s[member] - steps.time_s[steps.down][np.minimum(started, steps.down.sum() - 1)]
        names = passes * 100_000 + (np.nan_to_num(since) // _BLOCK_S).astype(int)
    return np.unique(names, return_inverse=True)[1].astype(np.intp)

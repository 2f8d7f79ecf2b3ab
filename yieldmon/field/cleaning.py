"""Which points are kept, and for each of the others why not. Nothing is deleted: a point has one reason, the first that holds."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .cleaning_rules import RULES, Context
from .neighbours import local_outliers, shared
from .placed import Placed
from .table import Flags, Index

KEPT = "kept"
NO_PLACE = "no place"
"""Mass measured at a time whose place, one delay before, is not in the record."""
LOCAL = "local outlier"
NAMES = (*tuple(rule.name for rule in RULES), LOCAL)
ABOUT = {rule.name: rule.about for rule in RULES} | {
    LOCAL: "far from the median of its neighbours, by the field's own scatter, and adjacent passes do not show the same",
    NO_PLACE: "its place, one delay before, is not in the record",
}
"""Reasons in words."""
#: Rules without which a point has no yield at a place; they cannot be switched off.
NEEDED = ("no position", "no flow", "header up")
_MIN_PART, _MAX_PARTS = 200, 200
"""Rows from which on a source and crop have thresholds of their own, and how many such parts there may be."""
_MUCH = 0.25
"""Share of the mass from which on what one rule leaves out gets a note."""


@dataclass(frozen=True)
class Cleaned:
    """reason: index into `names` of each row's first reason, 0 for kept."""

    reason: NDArray[np.int8]
    names: tuple[str, ...]

    @property
    def kept(self) -> Flags:
        """Rows without a reason."""
        return np.asarray(self.reason == 0)

    def points_by_reason(self) -> dict[str, int]:
        """Rows of each reason that has some; `kept` first."""
        counts = np.bincount(self.reason, minlength=len(self.names))
        return {name: int(counts[k]) for k, name in enumerate(self.names) if counts[k] or k == 0}


def clean(at: Context, without: Collection[str] = ()) -> Cleaned:
    """Reasons of all rows.

    Parameters
    ----------
    at : Context
        A harvest with mass at its places.
    without : collection of str
        Names of rules that are off.
    """
    reason = np.zeros(len(at.table), np.int8)
    parts = _parts(at)
    contexts = [at] if len(parts) == 1 else [at.of_rows(rows) for rows in parts]
    for k, rule in enumerate(RULES):
        if rule.name in without and rule.name not in NEEDED:
            continue
        if rule.across or len(parts) == 1:
            flags = rule.flags(at)
        else:
            flags = np.zeros(len(at.table), bool)
            for rows, context in zip(parts, contexts, strict=True):
                flags[rows] = rule.flags(context)
        reason = np.where((reason == 0) & flags, k + 1, reason).astype(np.int8)
    if LOCAL not in without:
        flags = np.zeros(len(at.table), bool)
        for rows, context in zip(parts, contexts, strict=True):
            steps, amount, among = context.steps, context.yield_kg_m2, reason[rows] == 0
            off = local_outliers(steps.row_x_m, steps.row_y_m, amount, among)
            flags[rows] = off & ~shared(steps, np.where(among, amount, np.nan), off)
        reason = np.where((reason == 0) & flags, len(RULES) + 1, reason).astype(np.int8)
    return Cleaned(reason, (KEPT, *NAMES))


def _parts(at: Context) -> list[Index]:
    """Rows that have thresholds of their own: those of each source and crop that has enough of them, and the others together."""
    source, label = at.table.source_of_row.astype(np.intp), at.table.labels["crop"]
    names, number, count = np.unique(source * len(label.names) + label.codes, return_inverse=True, return_counts=True)
    large = count >= _MIN_PART
    if len(names) < 2 or large.sum() + (not large.all()) < 2 or len(names) > _MAX_PARTS:
        return [np.arange(len(at.table))]
    out = [np.flatnonzero(number == k) for k in np.flatnonzero(large)]
    rest = np.flatnonzero(~large[number])
    return [*out, rest] if len(rest) else out


def mass_by_reason(cleaned: Cleaned, placed: Placed) -> Mapping[str, float]:
    """Kept mass and, by reason, the mass left out, kg: together all that was measured."""
    mass = np.nan_to_num(placed.mass_kg)
    sums = np.bincount(cleaned.reason, mass, len(cleaned.names))
    out = {name: float(sums[k]) for k, name in enumerate(cleaned.names) if sums[k] or k == 0}
    if placed.lost_kg:
        out[NO_PLACE] = placed.lost_kg
    return out


def much_left_out(cleaned: Cleaned, mass_kg: Mapping[str, float]) -> tuple[str, ...]:
    """A note on each reason that takes a quarter of the mass or more. mass_kg: as of mass_by_reason."""
    total, points = sum(mass_kg.values()), cleaned.points_by_reason()
    return tuple(
        f"{100 * mass / total:.0f} % of the mass, {points[name]} points, is left out as {name!r} ({ABOUT[name]})"
        + ("" if name in NEEDED else f"; --without {name!r} keeps it")
        for name, mass in mass_kg.items()
        if name in ABOUT.keys() & points.keys() and total > 0 and mass >= _MUCH * total
    )

"""Masses, areas and mean yield of a map, with their 95 % intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from yieldmon.estimation.gaussian import REACH_95

from .cleaning import Cleaned, mass_by_reason
from .loads import LoadResult
from .placed import Placed, measured_mass_kg
from .swath import Swaths
from .table import Array, HarvestTable
from .tracks import Tracks

_DRAWS = 400
"""Of passes, for the interval of the mean yield."""


@dataclass(frozen=True)
class Totals:
    """Masses in kg, areas in m2.

    Parameters
    ----------
    machine_kg : float or None
        Of all sources, where each has its own.
    measured_kg : float
        Flow times interval over all rows, as measured.
    corrected_kg : float
        The same by the weighed loads.
    low_kg, high_kg : float or None
        Its 95 % interval; None where no load is weighed.
    by_reason : dict
        `kept` and each reason -> kg (corrected), together corrected_kg.
    area_m2 : float
        Ground newly cut.
    kept_area_m2 : float
        Of the points kept.
    yield_kg_m2, low_kg_m2, high_kg_m2 : float
        Kept mass over kept area, and its 95 % interval from passes drawn again.
    """

    machine_kg: float | None
    measured_kg: float
    corrected_kg: float
    low_kg: float | None
    high_kg: float | None
    by_reason: dict[str, float]
    area_m2: float
    kept_area_m2: float
    yield_kg_m2: float
    low_kg_m2: float
    high_kg_m2: float


def totals_of(
    table: HarvestTable,
    steps: Tracks,
    placed: Placed,
    ground: Swaths,
    cleaned: Cleaned,
    *,
    loads: Sequence[LoadResult],
    weighed: bool,
    generator: np.random.Generator,
) -> Totals:
    """Masses and areas of a map.

    Parameters
    ----------
    table, steps, placed, ground, cleaned
        Of the map.
    loads : sequence of LoadResult
        Its loads.
    weighed : bool
        Whether one of them was weighed.
    generator : numpy.random.Generator
        Draws passes for the interval of the yield.
    """
    machine = [source.mass_kg for source in table.sources]
    kept = cleaned.kept
    mass = np.nan_to_num(placed.mass_kg)
    kept_kg, kept_m2 = float(mass[kept].sum()), float(ground.area_m2[kept].sum())
    measured = float(measured_mass_kg(table).sum())
    corrected = float(placed.measured_kg.sum())
    low, high = _yield_interval(steps.pass_number[steps.step_of_row][kept], mass[kept], ground.area_m2[kept], generator)
    sd = _mass_sd(loads) if weighed else None
    return Totals(
        machine_kg=None if None in machine else float(sum(one for one in machine if one is not None)),
        measured_kg=measured,
        corrected_kg=corrected,
        low_kg=None if sd is None else corrected - REACH_95 * sd,
        high_kg=None if sd is None else corrected + REACH_95 * sd,
        by_reason=dict(mass_by_reason(cleaned, placed)),
        area_m2=float(ground.area_m2.sum()),
        kept_area_m2=kept_m2,
        yield_kg_m2=kept_kg / kept_m2 if kept_m2 > 0 else float("nan"),
        low_kg_m2=low,
        high_kg_m2=high,
    )


def _mass_sd(loads: Sequence[LoadResult]) -> float:
    """Standard deviation of the corrected mass, kg."""
    weighed = [one for one in loads if one.weighed_kg is not None]
    own = [one.measured_kg * max((one.factor_sd or 0.0) ** 2 - one.common_sd**2, 0.0) ** 0.5 for one in weighed]
    # So do those that another combine's monitor brings.
    common = sum(one.measured_kg * one.common_sd for one in weighed)
    # The factor of loads that were not weighed is one and the same, so their errors go together.
    others = sum(one.measured_kg * (one.factor_sd or 0.0) for one in loads if one.weighed_kg is None)
    return float(np.sqrt(sum(value**2 for value in own) + common**2 + others**2))


def _yield_interval(passes: Array, mass: Array, area: Array, generator: np.random.Generator) -> tuple[float, float]:
    """95 % interval of the mean yield, kg/m2, from passes drawn with replacement; NaN with fewer than two passes."""
    if not len(passes):
        return float("nan"), float("nan")
    _, inverse = np.unique(passes, return_inverse=True)
    by_pass = np.stack((np.bincount(inverse, mass), np.bincount(inverse, area)))
    count = by_pass.shape[1]
    if count < 2:
        return float("nan"), float("nan")
    drawn = by_pass @ generator.multinomial(count, np.full(count, 1.0 / count), size=_DRAWS).T
    with np.errstate(invalid="ignore", divide="ignore"):
        low, high = np.nanpercentile(drawn[0] / drawn[1], [2.5, 97.5])
    return float(low), float(high)

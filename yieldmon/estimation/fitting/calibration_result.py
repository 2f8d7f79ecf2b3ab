"""What a calibration found: parameters, minima, quality of the fit, profiles, and sentences for the user."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.priors import at_bound_sentence
from yieldmon.physics.numerics import Array

from .scatter_law import OUTLIER_SDS

CONFIDENCE = 0.95

_CERTAIN_P, _LIKELY_P = 0.001, 0.01
"""Probabilities of a larger lack of fit by noise alone, below which an effect is missing, and may be."""
_WIDER = 1.5
"""Standard deviation over standard error from which the difference is said."""
_LISTED = 10
"""Largest number of outliers that are listed."""


@dataclass(frozen=True, slots=True)
class FittedParameter:
    """One free parameter. interval: profile likelihood, CONFIDENCE; an end at a bound is open: the data do not limit it."""

    name: str
    value: float
    standard_error: float
    """inf where the data do not fix it."""
    interval: tuple[float, float]
    open_below: bool
    open_above: bool
    at_bound: str
    """"lower", "upper" or ""."""

    @property
    def determined(self) -> bool:
        """Whether the data limit it on both sides."""
        return not (self.open_below or self.open_above or self.at_bound or not np.isfinite(self.standard_error))


@dataclass(frozen=True, slots=True)
class Basin:
    """One distinct minimum: values in the order of the free names, half the sum of squares over that of the best, starts."""

    values: tuple[float, ...]
    relative_cost: float
    starts: int


@dataclass(frozen=True, slots=True)
class Residuals:
    """Quality of the fit. rms in the momentum's unit; pure error and lack of fit from replicates, nan where there are none."""

    rows: int
    rms: float
    rms_over_max_pct: float
    noise_sd: float
    """Standard deviation of one row that errors and intervals are based on; 1 where the rows' own sigma was given."""
    pure_error_sd: float
    pure_error_dof: int
    lack_of_fit_f: float
    lack_of_fit_p: float
    outlier_rows: tuple[int, ...]
    """Indices in the table."""


@dataclass(frozen=True)
class Calibration:
    """The result of `calibrate`.

    Parameters
    ----------
    parameter_set : ParameterSet
        Of the best fit, to be saved or used.
    parameters : tuple of FittedParameter
        n free ones: value, standard error, interval (95 %), and whether the data determine it.
    correlation : ndarray
        (n, n) in the order of `parameters`.
    basins : tuple of Basin
        Distinct minima, the best first.
    starts : int
        Number of starting points.
    residuals : Residuals
        Quality of the fit.
    predicted : ndarray
        (rows,) momentum in the order of the measurements.
    jacobian : ndarray
        (rows, n): derivatives of the predictions.
    sentences : tuple of str
        On the fit, for the user.

    Examples
    --------
    See `calibrate`.
    """

    parameter_set: ParameterSet
    parameters: tuple[FittedParameter, ...]
    correlation: Array
    basins: tuple[Basin, ...]
    starts: int
    residuals: Residuals
    predicted: Array = field(repr=False)
    jacobian: Array = field(repr=False)
    sentences: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """The free parameters."""
        return tuple(p.name for p in self.parameters)


@dataclass(frozen=True)
class ProfileCurve:
    """Misfit against one parameter, every other free one refitted at each point.

    values: ascending, (points,). rise: root of the growth of chi-square over the best fit, (points,), negative below the best
    value; a straight line where the model is linear, flat where the data say nothing, nan where the model cannot carry the loads.
    limit: the rise at the ends of the CONFIDENCE interval.
    """

    name: str
    values: Array
    rise: Array
    limit: float


def sentences(
    fitted: Sequence[FittedParameter],
    correlation: Array,
    basins: Sequence[Basin],
    starts: int,
    quality: Residuals,
    effects: Sequence[str],
) -> Iterable[str]:
    """Sentences for the user on a fit of a model with these effects."""
    for parameter in fitted:
        yield from _determination(parameter)
    for i in range(len(fitted)):
        for j in range(i):
            if abs(correlation[i, j]) > 0.98:
                yield (
                    f"{fitted[j].name} and {fitted[i].name} trade off against each other (correlation "
                    f"{correlation[i, j]:.4f}); know one from elsewhere to fix the other."
                )
    if len(basins) > 1 and starts > 1:
        counts = ", ".join(str(b.starts) for b in basins)
        yield f"{len(basins)} distinct minima were found (starts that ended in each: {counts}); the best one is reported."
    found = f"lack-of-fit F = {quality.lack_of_fit_f:.3g}"
    if _CERTAIN_P <= quality.lack_of_fit_p < _LIKELY_P:
        gravity = "" if "gravity" in effects else " Gravity acts on every machine: --effects gravity."
        yield (
            f"the model may miss something ({found}, p = {quality.lack_of_fit_p:.2g}), and the intervals hold where it does not; "
            f"see yieldmon diagnose.{gravity}"
        )
    if quality.lack_of_fit_p < _CERTAIN_P:
        yield (
            f"the model misses by more than the replicates scatter ({found}, p < {_CERTAIN_P:g}): "
            "an effect is missing; see yieldmon diagnose."
        )
    if quality.lack_of_fit_p > 1.0 - _CERTAIN_P:
        yield (
            f"repeated rows scatter by more than their means allow ({found}, p > {1.0 - _CERTAIN_P:g}): some are of another "
            "unit, machine or grain, and no repetitions."
        )


def of_outliers(rows: Sequence[int], *, robust: bool) -> Iterable[str]:
    """Which rows lie far from the fit. rows: indices in the table."""
    if not rows:
        return
    numbers = ", ".join(str(i + 1) for i in rows[:_LISTED])
    if (more := len(rows) - _LISTED) > 0:
        numbers += f" and {more} more"
    which, them = (f"row {numbers} lies", "it") if len(rows) == 1 else (f"rows {numbers} lie", "them")
    remedy = f"look at {them}" if robust else f"look at {them}, or use --robust"
    yield f"{which} more than {OUTLIER_SDS:g} robust standard deviations from the fit; {remedy}."


def of_model_error(fitted: Sequence[FittedParameter], known: ParameterSet) -> Iterable[str]:
    """That errors and intervals are by the rows' scatter, where the model's own error makes parameters less certain; and where
    the rows do not show that error."""
    if known.model_error is None:
        yield (
            "the rows do not show how far the model itself is off: flows beyond their range are stated by what machines differ "
            "by; more angles and loads, with replicates or sigma, would show it."
        )
        return
    sd = {p.name: known.standard_deviation(p.name) for p in fitted}
    if known.model_error > 0.0 and any(sd[p.name] > _WIDER * p.standard_error for p in fitted):
        each = ", ".join(f"{name} {value:.3g}" for name, value in sd.items())
        own = f"the model's own error of {100.0 * known.model_error:.2g} %, by angles and loads left out,"
        yield (
            f"standard errors and intervals are by the rows' scatter alone; {own} makes the standard deviations {each}, as in "
            "the parameter file."
        )


def _determination(p: FittedParameter) -> Iterable[str]:
    """Whether and how the data limit a parameter, where they do not on both sides."""
    low, high = p.interval
    if p.open_below and p.open_above:
        yield f"{p.name} is not determined: every value from {low:.6g} to {high:.6g} fits these data within their noise."
    elif p.at_bound:
        yield at_bound_sentence(p.name, p.at_bound, p.value)
    elif p.open_below or p.open_above:
        side = f"at or below {high:.6g}" if p.open_below else f"at or above {low:.6g}"
        yield f"{p.name} is determined on one side only: the data say it is {side}."
    elif not np.isfinite(p.standard_error):
        yield f"{p.name} is not determined: another parameter can make up for any change of it."

"""Notes of a diagnosis in addition to its verdict, one sentence each."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from yieldmon.estimation.fitting.measurements import Measurements
from yieldmon.estimation.gaussian import REACH_95
from yieldmon.estimation.priors import at_bound_sentence
from yieldmon.estimation.weighing import unit_question
from yieldmon.physics.model import ForwardModel

from .choice import Choice, rows_searched
from .fit import Fit, fit
from .lack_of_fit import LackOfFit, fills, lack_of_fit_but_one, lack_without_pattern
from .merit import left_by_own_law, merit, misfit
from .noise import Noise
from .observations import Rows
from .policy import DEFAULT, Policy
from .run_order import blocked_by, drift
from .validation import Validation

_SURE = 1e-3
"""p value below which conditions scatter more than repetitions."""
_GAINS = (0.5, 4.0)
"""Impact gains of grain, with a wide margin."""
MOST_SCATTER = 0.2
"""Relative scatter of repetitions at the median reading from which no effect is named."""
_MANY = 0.05
"""Share of outliers from which they are reported."""
_NEARLY_ALL = 0.9
"""Share of the outliers, and of a trial's rows, from which this trial is called their cause."""
_NAMED_ROWS = 6
"""Largest number of outliers that are listed."""


def refuted(names: tuple[str, ...], validation: Validation) -> str:
    """That the held-out rows do not confirm the effects that were found."""
    where = f"; {', '.join(validation.worse)} worse than before" if validation.worse else ""
    low, high = (100.0 * (validation.cross_fitted.value + s * validation.cross_fitted.sd) for s in (-REACH_95, REACH_95))
    return (
        f"{' + '.join(names)} is not named: held-out rows show {low:.0f} to {high:.0f} % of the change that it predicts, where "
        f"more than 50 % is needed{where}"
    )


def of_objection(choice: Choice) -> str:
    """Why the effects that were found are only leading candidates."""
    return f"{' + '.join(step.added for step in choice.steps)} is not named: {choice.objection}"


def of_one_cell(choice: Choice, noise: Noise) -> list[str]:
    """The one cell that causes the remaining misfit of a named verdict."""
    if choice.verdict != "effect":
        return []
    (without, worst), with_it = lack_of_fit_but_one(choice.best, noise), choice.lack_of_fit_after
    if with_it.p_value >= DEFAULT.lack_of_fit_p or without.p_value < DEFAULT.lack_of_fit_p:
        return []
    cells = choice.best.frame.cells
    load = "kg on a paddle" if cells.rows.load_name == "paddle_mass_kg" else "kg/s"
    cell = f"plate {np.degrees(cells.plate_angle_rad[worst]):.0f} deg and {cells.load[worst]:.3g} {load}"
    f = f"F = {without.f:.2f} (p = {without.p_value:.1g}) {rows_searched(choice.best)}"
    return [f"the remaining lack of fit comes from one cell, {cell}: without it {f}; check that measurement"]


def of_own_law(choice: Choice, noise: Noise, policy: Policy) -> list[str]:
    """That another shape of a named effect's law explains the remaining misfit."""
    excess = max(choice.base.chi2 - choice.base.dof, 1e-9)
    large = choice.lack_of_fit_after.p_value < policy.lack_of_fit_p or choice.lack_of_fit_after.f > policy.unexplained_f
    if choice.verdict != "effect" or not large or not left_by_own_law(choice.best, choice.steps, noise, excess, policy):
        return []
    left = 100.0 * max(choice.best.chi2 - choice.best.dof, 0.0) / excess
    f = f"F = {choice.lack_of_fit_after.f:.2f}, {left:.1f} % of the excess"
    return [f"{choice.named[0]} leaves a misfit ({f}) that another shape of its law explains: its size is uncertain by as much"]


def noise_assumed(choice: Choice) -> str:
    """Why no effect is named if the rows do not determine their noise."""
    return f"{' + '.join(choice.named)} is not named: how much these rows scatter is not known"


def not_trusted(choice: Choice) -> str:
    """Why effects that were found are not named: similar cases too often have another cause."""
    first = choice.steps[0]
    names = " or ".join((first.added, *first.equivalent))
    return f"{names}: not named, right in {100.0 * first.confidence:.0f} of 100 cases that look like this one"


def of_limited_confidence(stated: Choice, limited: Choice, found: Fit) -> list[str]:
    """Why less confidence is stated than for a model within its bounds. stated, limited: before and after. found: the fit."""
    first = next((after for before, after in zip(stated.steps, limited.steps, strict=True) if after is not before), None)
    if first is None:
        return []
    grain = [p.name for p in found.frame.base if p.name in found.at_bound]
    names = " and ".join((*grain, *found.leading_at_bound))
    return [
        f"with {' + '.join(step.added for step in limited.steps)}, {names} end{'s' * (' and ' not in names)} at a bound: names "
        f"beside which this happens are often wrong, so the confidence is at most {first.confidence:.2f}"
    ]


def of_bounds(found: Fit, before: Fit | None = None) -> list[str]:
    """The parameters that ended at a bound: all, or those of a model with effects that did not end at this one `before` these."""
    known = {} if before is None else {name: before.values[name] for name in before.at_bound}
    beside = f"with {' + '.join(found.effects)}, " if before is not None else ""
    return [
        beside + at_bound_sentence(p.name, "lower" if float(x) < 0.5 * (p.lower + p.upper) else "upper", float(x))
        for p, x in zip(found.parameters, found.x, strict=True)
        if p.name in found.at_bound and not (p.name in known and abs(float(x) - known[p.name]) < 0.5 * (p.upper - p.lower))
    ]


def of_gain(base: Fit) -> list[str]:
    """That the impact gain is impossible for grain, from a reading in SI units: a unit or the speed may be wrong."""
    if not base.frame.cells.rows.si or "k1" not in base.values:
        return []
    gain = float(np.median(base.values["k1"] * fills(base) + base.values["k2"]))
    if _GAINS[0] <= gain <= _GAINS[1]:
        return []
    said = f"the impact gain is {gain:.2g} (k1 M / M_full + k2, median), where that of grain, 1 + restitution, is 1 to 2"
    if gain < _GAINS[0] and not _other_units(base):
        return [f"{said}: grain misses the plate or comes slower; no other unit would make these rows those of grain"]
    return [f"{said}: are reading, load and speed those of this machine, in the units that their columns say?"]


def _other_units(base: Fit) -> tuple[str, ...]:
    """Units with which the rows would be plausible for grain."""
    cells, of_force = base.frame.cells, base.frame.cells.rows.of == "force"
    passes = cells.rows.machine.passes_per_s(cells.elevator_speed_rad_s)
    data = Measurements(cells.conditions(), cells.mean / passes if of_force else cells.mean)
    columns = (cells.rows.load_name, "force_n" if of_force else "momentum_kg_m_s")
    return unit_question.possible(ForwardModel(cells.rows.machine), data, columns)


def scatter_share(noise: Noise, rows: Rows) -> float:
    """Relative standard deviation of a row at the median reading."""
    level = float(np.median(np.abs(rows.value)))
    return float(noise.sd(np.array(level))) / max(level, 1e-300)


def many_left_out(outliers: int, rows: int) -> bool:
    """Whether so many rows are outliers that the table itself is in doubt."""
    return outliers > _MANY * rows


def of_scatter(noise: Noise, rows: Rows, outlying: NDArray[np.bool_]) -> list[str]:
    """That rows of one condition differ so much that the columns may not belong together. outlying: (rows,) rows left out."""
    outliers = int(np.count_nonzero(outlying))
    scatter = scatter_share(noise, rows)
    out = []
    if scatter > MOST_SCATTER:
        out.append(
            f"rows of one condition scatter by {100.0 * scatter:.0f} % of the median reading, far more than the cases on which "
            "confidence was fitted (1 to 3 %), so nothing is named: is a column shuffled, or a condition not recorded?"
        )
    if many_left_out(outliers, len(rows)):
        trials = [trial for trial, off in zip(rows.trial, outlying, strict=True) if off]
        usual = max(sorted(set(trials)), key=trials.count)
        alone = trials.count(usual) >= _NEARLY_ALL * max(outliers, rows.trial.count(usual)) and len(set(rows.trial)) > 1
        ask = (
            f"nearly all are of trial {usual} and make up nearly all of it: was its unit, machine or grain another?"
            if alone
            else "do the columns of a row belong together?"
        )
        out.append(f"{outliers} outliers of {len(rows)} rows are many: {ask}")
    return out


def of_noise(noise: Noise) -> str:
    """Source and size of the noise."""
    how = {
        "replicates": f"noise from replicates ({noise.dof:.0f} degrees of freedom)",
        "smooth": "no replicates: noise from the scatter about a smooth surface through the rows",
        "stated": "noise as stated, not measured in this table"
        if noise.times == 1.0
        else f"noise of {noise.times:.3g} times the stated sigma, since repeated rows scatter that much more",
        "assumed": "noise assumed: too few rows to see it (state sigma, or repeat rows)",
    }[noise.how]
    form = f"sd = {noise.constant:.4g}" + (
        f" + {100.0 * noise.proportional:.2g} % of reading (in quadrature)" if noise.proportional else ""
    )
    return f"{how}: {form}"


def of_outliers(outlying: Rows) -> list[str]:
    """Which rows are left out as outliers, identified by their columns in the table."""
    count = len(outlying)
    if not count:
        return []
    unit = "kg" if outlying.load_name == "paddle_mass_kg" else "kg/s"
    rows = zip(np.degrees(outlying.plate_angle_rad), outlying.load, outlying.value, strict=True)
    named = [f"{value:.4g} at {angle:.3g} deg and {load:.3g} {unit}" for angle, load, value in rows]
    more = ", ..." if count > _NAMED_ROWS else ""
    return [f"{count} outlying row{'s' * (count > 1)} left out: {', '.join(named[:_NAMED_ROWS])}{more}"]


def of_all_rows(left: LackOfFit) -> str:
    """That all rows together have a misfit that the searched rows do not have."""
    return (
        f"with these effects all rows together leave F = {left.f:.2f} (p = {left.p_value:.1g}): something else is missing too, "
        "or their laws are not quite these"
    )


def repetitions_hide(choice: Choice, noise: Noise) -> bool:
    """Whether repetitions scatter so much more than conditions do that they differ by more than noise."""
    return noise.how == "replicates" and bool(scipy.stats.f.cdf(choice.lack_of_fit_after.f, choice.best.dof, noise.dof) < _SURE)


def of_repetitions(choice: Choice, noise: Noise) -> list[str]:
    """That conditions scatter more than repetitions without a pattern, so that no model could explain it; or that they scatter
    less."""
    if repetitions_hide(choice, noise):
        return [
            f"repetitions scatter more than conditions do (F = {choice.lack_of_fit_after.f:.2f}): trials that differ as a whole "
            "(warm-up, zero), or rows of another machine or grain among them, hide what is missing"
        ]
    found = lack_without_pattern(choice.base, noise)
    if choice.verdict != "unknown" or found.p_value > _SURE or found.f - 1.0 < 0.5 * (choice.lack_of_fit_before.f - 1.0):
        return []
    return [
        f"conditions scatter more than repetitions do, without a pattern (F = {found.f:.2f}, p = {found.p_value:.1g}): "
        "repetitions share an error (one weighing, one zero), or the noise is stated too small; no effect explains that"
    ]


def of_run_order(choice: Choice, policy: Policy) -> list[str]:
    """That a drift over the run explains the named effects as well, if the rows are sorted by load or by angle.

    It is a note and no objection, since tables are commonly sorted in this way after measuring in another order.
    """
    found = choice.best
    rows = found.frame.cells.rows
    how = blocked_by(rows) if choice.verdict == "effect" else ""
    if not how:
        return []
    scale = misfit([found])
    most = merit(found, scale, policy) + policy.tie
    out = []
    for step in choice.steps:
        without = fit(found.frame, tuple(law for law in found.effects if law != step.law), found.values)
        if without is not None and drift(without, scale, policy.per_parameter).merit <= most:
            out.append(step.added)
    if not out:
        return []
    return [
        f"the table has its rows {how}: if they were measured in that order, a drift over the run explains them as well as "
        f"{' or '.join(out)}; randomize the order, or state `time_s`"
    ]


def of_overfull(opened: NDArray[np.bool_], proven_rows: int) -> list[str]:
    """How many of the held-out rows cannot be used. proven_rows: number of those that can."""
    lost = int(np.count_nonzero(opened)) - proven_rows
    return [f"{lost} held-out rows are not used: they overfill the paddles of the model fitted without them"] if lost else []


def of_undetectable(effects: tuple[str, ...]) -> list[str]:
    """Effects that this design cannot detect."""
    return [f"not detectable with these rows at any physical size: {', '.join(effects)}"] if effects else []

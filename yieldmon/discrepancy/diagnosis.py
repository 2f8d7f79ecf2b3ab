"""The whole workflow: seal rows, fit the published model, find the gap, name effects, prove them on the sealed rows, plan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from yieldmon.documents.diagnose import Verdict
from yieldmon.errors import InputError
from yieldmon.estimation import angle_lines, model_error
from yieldmon.estimation.gaussian import REACH_95
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.estimation.priors import EXCHANGED, at_bound_sentence
from yieldmon.files.table import Table
from yieldmon.physics.effects import family_of, laws
from yieldmon.physics.machine import Machine
from yieldmon.physics.numerics import Array

from . import diagnosis_notes
from . import observations as obs
from .candidates import library, signature
from .choice import Choice, withdrawn
from .confidence import calibrated, doubted, shipped
from .detectability import minimum_detectable, size_seen
from .experiment import Plan, plan
from .fit import Fit, Frame, base_frame, fit, fit_base
from .gap import LackOfFit, Region, change_with_load, lack_of_fit, noise_floor, row_rms, where
from .noise import Noise, estimate
from .policy import Policy
from .proof import Proof, Share, mean_square_interval, prove, share
from .selection import choose
from .stopgap import Correction, correction

Progress = Callable[[str, float], None]
_SAME = 0.01
"""p value from which readings at one angle and speed are the same at every load."""
_SURE = 0.999
"""Power from which a change with load would have shown."""


@dataclass(frozen=True)
class Options:
    """How `diagnose` works.

    Parameters
    ----------
    form : {"auto", "restitution", "exchange"}
        Of the impact: one restitution, or k1 and k2.
    hold_out : str
        Rows that are sealed away until the end: "cells", "trials", "none", or a column and value such as "plate_angle_deg=70".
    without : tuple of str
        Effects taken out of the library.
    keep_effects : bool
        The model has the effects that the parameters name, at their values, instead of none.
    seed : int
    policy : Policy
        When an effect is named.

    Examples
    --------
    >>> api.Options(hold_out="none").form
    'auto'
    """

    form: str = "auto"
    hold_out: str = "cells"
    without: tuple[str, ...] = ()
    keep_effects: bool = False
    seed: int = 1
    policy: Policy = field(default_factory=Policy)


@dataclass(frozen=True)
class Measure:
    """How far model and rows are apart: rms in the reading's unit; the two lack-of-fit numbers only where they apply."""

    rms: float
    rms_over_max_pct: float
    lack_of_fit_f: float | None
    p_value: float | None


@dataclass(frozen=True)
class HeldOut:
    """The sealed rows, opened once: how many, before and after, the noise floor, and 100 (before - after) / (before - floor);
    None where these rows miss no more than they scatter, so that there is no gap to close."""

    rows: int
    before: Measure
    after: Measure
    noise_floor_rms: float
    closed_pct: float | None
    closed_interval_pct: tuple[float, float] | None = None
    """95 %: what the same rows' noise and the model's own error leave open."""
    f_interval: tuple[tuple[float, float], tuple[float, float]] | None = None
    """95 % intervals of the lack of fit before and after."""
    share: Share | None = None


@dataclass(frozen=True)
class Diagnosis:
    """All that `diagnose` found.

    Parameters
    ----------
    options : Options
    form : str
        Of the impact: "restitution" or "exchange".
    noise : Noise
        Of the rows.
    outliers : int
        Rows that are left out.
    choice : Choice
        Steps, candidates and confidence; fitted to the unsealed rows alone.
    base, best : Fit
        Without and with the effects that are named; fitted to every row but outliers.
    leading : Fit, optional
        The same with the leading candidates, where the verdict is "unknown" in spite of them.
    rows : Rows
    sealed : ndarray of bool
        (n,) rows that were held out.
    before, after : Measure
        Gap between model and rows without and with the effects.
    with_leading : Measure, optional
        The same with the leading candidates.
    held_out : HeldOut, optional
        The same on the sealed rows; None where there are none.
    noise_floor_rms : float
        In the reading's unit.
    regions, remaining : tuple of Region
        Where the model misses, before and after.
    plan : Plan
        The next experiment.
    minimum_detectable : dict of str to float
        Smallest size of each effect that these rows would show.
    undetectable : tuple of str
        Effects that these rows would not show at any size within physical bounds; none that is named or tied.
    correction : Correction, optional
        A stopgap for the remaining gap.
    notes : tuple of str

    Examples
    --------
    See `diagnose`.
    """

    options: Options
    form: str
    noise: Noise
    outliers: int
    choice: Choice
    base: Fit
    best: Fit
    rows: obs.Rows
    sealed: NDArray[np.bool_]
    before: Measure
    after: Measure
    held_out: HeldOut | None
    noise_floor_rms: float
    regions: tuple[Region, ...]
    remaining: tuple[Region, ...]
    plan: Plan
    minimum_detectable: dict[str, float]
    undetectable: tuple[str, ...]
    correction: Correction | None
    notes: tuple[str, ...] = field(default=())
    leading: Fit | None = None
    with_leading: Measure | None = None

    @property
    def verdict(self) -> Verdict:
        """ "effect", "none" or "unknown"."""
        return self.choice.verdict

    @property
    def fitted_rows(self) -> str:
        """The rows that `before`, `after` and `with_leading` are fitted to and judged on."""
        return f"all {len(self.rows) - self.outliers} rows"

    @property
    def closed_pct(self) -> float | None:
        """Share of the gap closed on held-out rows; on all rows where none were held out. None: no effect, or no gap there."""
        if self.verdict != "effect":
            return None
        if self.held_out is not None:
            return self.held_out.closed_pct
        return share_closed_pct(self.before.rms, self.after.rms, self.noise_floor_rms)


def diagnose(
    table: Table, machine: Machine, parameters: ParameterSet, options: Options = Options(), progress: Progress | None = None
) -> Diagnosis:
    """Find which effects a model lacks, from one table.

    Parameters
    ----------
    table : Table
    machine : Machine
    parameters : ParameterSet
        Parameters of the present model.
    options : Options
    progress : callable, optional
        Called with the step in progress and the share done, 0 .. 1.

    Returns
    -------
    Diagnosis

    Raises
    ------
    InputError
        For a table that does not allow a diagnosis.

    Examples
    --------
    >>> columns = {"plate_angle_deg": np.full(3, 70.0), "mass_flow_kg_s": np.arange(5.0, 20.0, 5.0), "force_n": np.full(3, 90.0)}
    >>> table = api.Table("bench.csv", "", "mass_flow_kg_s", "force_n", columns, {})
    >>> api.diagnose(table, api.Machine(), api.load_parameters()).verdict
    Traceback (most recent call last):
        ...
    yieldmon.errors.InputError: bench.csv: has 3 rows with load and reading; expected at least 8
    """
    return diagnose_rows(obs.from_table(table, machine), parameters, options, progress, table.path)


def diagnose_rows(
    rows: obs.Rows, parameters: ParameterSet, options: Options = Options(), progress: Progress | None = None, name: str = "table"
) -> Diagnosis:
    """`diagnose` on rows already in memory."""
    return conclude(examine(rows, parameters, options, progress, name), rows, options, progress, name)


def conclude(
    seen: Examination, rows: obs.Rows, options: Options = Options(), progress: Progress | None = None, name: str = "table"
) -> Diagnosis:
    """What follows from `examine` of the same rows with the same options: refits on all rows, regions, next experiment."""
    report = progress or (lambda text, share: None)
    chosen, noise, base = seen.choice, seen.noise, seen.choice.base
    rng = np.random.default_rng([options.seed, 3])
    found = chosen.best if chosen.verdict == "effect" else chosen.base
    every = rows.take(~seen.outlier)
    grouped = obs.cells(every)
    whole = base.frame.with_cells(grouped, noise.of_cells(grouped))
    base_all = _refit(whole, (), base, name)
    best_all = _refit(whole, found.effects, found, name) if found.effects else base_all
    partial = chosen.best if chosen.verdict == "unknown" and chosen.steps else None
    leading = _refit(whole, partial.effects, partial, name) if partial is not None else None
    left = lack_of_fit(best_all, noise)
    notes = list(seen.notes)
    if found.effects and left.p_value < options.policy.gap_p <= chosen.best_gap.p_value:
        notes.append(diagnosis_notes.of_all_rows(left))
    report("where", 0.9)
    regions = where(base_all, noise, rng)
    remaining = where(best_all, noise, rng) if found.effects else regions
    report("next experiment", 0.95)
    signatures = [signature(base_all, e) for e in library(whole, options.without)]
    detectable = minimum_detectable(signatures)
    spoken_of = {*map(family_of, found.effects), *(e for step in chosen.steps for e in step.equivalent)}
    shown = {
        family_of(s.effect)
        for s in (*signatures, *(signature(base_all, law) for e in library(whole, options.without) for law in laws(e)[1:]))
        if not all(np.isinf(size_seen(s, i)) for i in range(len(s.parameters)))
    }
    undetectable = tuple(s.effect for s in signatures if s.effect not in spoken_of | shown)
    return Diagnosis(
        options=options,
        form=seen.form,
        noise=noise,
        outliers=int(seen.outlier.sum()),
        choice=chosen,
        base=base_all,
        best=best_all,
        rows=rows,
        sealed=seen.sealed,
        before=_measure(base_all, every, noise),
        after=_measure(best_all, every, noise),
        held_out=seen.held_out,
        noise_floor_rms=noise_floor(noise, best_all, every),
        regions=regions if chosen.verdict != "none" else (),
        remaining=remaining,
        plan=plan(*_to_separate(chosen), noise),
        minimum_detectable=detectable,
        undetectable=undetectable,
        correction=correction(base_all) if chosen.verdict == "unknown" else None,
        notes=(*notes, *diagnosis_notes.of_undetectable(undetectable)),
        leading=leading,
        with_leading=_measure(leading, every, noise) if leading is not None else None,
    )


@dataclass(frozen=True)
class Examination:
    """The verdict and its proof, without what is made of them: `sealed` and `outlier` mark rows, shape (rows,)."""

    form: str
    noise: Noise
    choice: Choice
    held_out: HeldOut | None
    sealed: NDArray[np.bool_]
    outlier: NDArray[np.bool_]
    notes: tuple[str, ...]
    proof: Proof | None = None


def examine(
    rows: obs.Rows, parameters: ParameterSet, options: Options = Options(), progress: Progress | None = None, name: str = "table"
) -> Examination:
    """Seal rows, fit the published model, choose effects; then the unseen rows decide. Raises InputError as `diagnose`."""
    report = progress or (lambda text, share: None)
    rng = np.random.default_rng([options.seed, 2])
    sealed = obs.seal(rows, options.hold_out, options.seed)
    report("noise", 0.0)
    noise, outlying = estimate(rows.take(~sealed))
    outlier = np.zeros(len(rows), dtype=bool)
    outlier[np.flatnonzero(~sealed)[outlying]] = True
    training = rows.take(~sealed & ~outlier)
    report("published model", 0.05)
    form, frame, base, why = _published(training, noise, parameters, options.form, name, options.keep_effects)
    _check_load(base, noise, name)
    chosen = choose(
        base, noise, library(frame, options.without), rng, options.policy, lambda text, share: report(text, 0.1 + 0.7 * share)
    )
    report("sealed rows", 0.85)
    held_out, outlying_sealed = _open(rows, sealed, chosen.base, chosen.best, noise)
    outlier |= outlying_sealed
    proven_rows = held_out.rows if held_out is not None else 0
    angles = _angles_asked(training, base, noise, parameters, form, options.keep_effects)
    notes = [
        *diagnosis_notes.of_noise(noise, int(outlier.sum())),
        *diagnosis_notes.of_scatter(noise, rows, int(outlier.sum())),
        *why,
        *diagnosis_notes.of_gain(base),
        *angles,
        *diagnosis_notes.of_overfull(sealed & ~outlier, proven_rows),
    ]
    if chosen.against:
        notes.append(diagnosis_notes.against(chosen))
    proof = None
    if chosen.steps:
        proof = prove(chosen.base, chosen.best, held_out.share if held_out is not None else None, rng)
    if proof is not None and chosen.verdict == "effect" and not proof.agrees:
        notes.append(diagnosis_notes.refuted(chosen.named, proof))
        chosen = withdrawn(chosen, options.policy)
    if chosen.verdict == "effect" and angles:
        chosen = withdrawn(chosen, options.policy)
    if chosen.verdict == "effect" and noise.how == "assumed":
        notes.append(diagnosis_notes.noise_assumed(chosen))
        chosen = withdrawn(chosen, options.policy)
    if chosen.verdict == "effect" and diagnosis_notes.scatter_share(noise, rows) > diagnosis_notes.MOST_SCATTER:
        chosen = withdrawn(chosen, options.policy)
    chosen = calibrated(chosen, shipped())
    if doubted(chosen, options.policy):
        notes.append(diagnosis_notes.not_trusted(chosen))
        chosen = withdrawn(chosen, options.policy)
    notes += diagnosis_notes.of_own_law(chosen, noise, options.policy)
    notes += diagnosis_notes.of_run_order(chosen, options.policy)
    notes += [*diagnosis_notes.of_one_cell(chosen, noise), *diagnosis_notes.of_repetitions(chosen, noise)]
    if chosen.verdict != "effect" and held_out is not None:
        held_out, _ = _open(rows, sealed, chosen.base, chosen.base, noise)
    return Examination(form, noise, chosen, held_out, sealed, outlier, tuple(notes), proof)


def _check_load(base: Fit, noise: Noise, name: str) -> None:
    """Raises InputError where readings do not change with load, though the model's change would have shown."""
    change, power = change_with_load(base, noise)
    if change.p_value >= _SAME and power > _SURE:
        raise InputError(
            name,
            f"has readings that do not change with load beyond their scatter (F = {change.f:.2f}, p = {change.p_value:.1g})",
            "readings of these loads; the right columns?",
        )


def _published(
    training: obs.Rows, noise: Noise, parameters: ParameterSet, wanted: str, name: str, keep_effects: bool
) -> tuple[str, Frame, Fit, list[str]]:
    grouped = obs.cells(training)
    sd = noise.of_cells(grouped)
    form = wanted
    notes: list[str] = []
    if wanted == "auto":
        form = "exchange" if "k1" in parameters.values or not training.si else "restitution"
    frame = base_frame(grouped, sd, parameters, form, keep_effects=keep_effects)
    if len(frame.base) + 3 > len(grouped):
        raise InputError(name, f"has {len(grouped)} distinct conditions to fit", f"at least {len(frame.base) + 3}")
    try:
        base = fit_base(frame)
        if wanted == "auto" and form == "restitution" and "restitution" in base.at_bound:
            notes.append(EXCHANGED)
            form = "exchange"
            frame = base_frame(grouped, sd, parameters, form, keep_effects=keep_effects)
            base = fit_base(frame)
    except ValueError as error:
        raise InputError(name, str(error), "loads that a paddle of this machine can hold") from error
    for p in base.parameters:
        if p.name in base.at_bound:
            value = base.values[p.name]
            notes.append(at_bound_sentence(p.name, "lower" if value < 0.5 * (p.lower + p.upper) else "upper", value))
    return form, frame, base, notes


def _angles_asked(
    training: obs.Rows, base: Fit, noise: Noise, parameters: ParameterSet, form: str, keep_effects: bool
) -> list[str]:
    """A question where the published model explains the rows far better with plate angles from another line."""

    def misfit(found: Fit, rows: obs.Rows) -> float:
        away = found.predict(rows) - rows.value
        return float(np.sqrt(np.mean(away**2)) / np.max(np.abs(rows.value)))

    def refit(plate_angle_rad: Array) -> float:
        turned = replace(training, plate_angle_rad=plate_angle_rad)
        return misfit(_published(turned, noise, parameters, form, "table", keep_effects)[2], turned)

    asked = angle_lines.question(training.plate_angle_rad, misfit(base, training), refit)
    return [asked] if asked else []


def _open(
    rows: obs.Rows, sealed: NDArray[np.bool_], base: Fit, best: Fit, noise: Noise
) -> tuple[HeldOut | None, NDArray[np.bool_]]:
    outlying = np.zeros(len(rows), dtype=bool)
    if not np.any(sealed):
        return None, outlying
    kept = rows.take(sealed)
    before, after = base.predict(kept), best.predict(kept)
    sd = noise.of_rows(kept, after)
    # A row that both models miss by as much, and by far, is the sensor's doing, not the model's.
    with np.errstate(invalid="ignore"):
        nearest = np.minimum(np.abs(before - kept.value), np.abs(after - kept.value))
    same_cell = np.array([np.median(kept.value[kept.cell == c]) for c in kept.cell])
    unreplicated = np.array([np.count_nonzero(kept.cell == c) for c in kept.cell]) < 3
    contradicted = (nearest > 8.0 * sd) & (unreplicated | (np.abs(kept.value - same_cell) > 5.0 * sd))
    usable = np.isfinite(before) & np.isfinite(after) & ~contradicted
    outlying[np.flatnonzero(sealed)[contradicted]] = True
    if not np.any(usable):
        return None, outlying
    top = float(np.max(np.abs(rows.value)))
    rms = [float(np.sqrt(np.mean((p[usable] - kept.value[usable]) ** 2))) for p in (before, after)]
    floor = float(np.sqrt(np.mean(sd[usable] ** 2)))
    whitened = [(p[usable] - kept.value[usable]) / sd[usable] for p in (before, after)]
    square = [float(np.mean(r**2)) for r in whitened]
    count = int(usable.sum())
    measures = [Measure(v, 100.0 * v / top, f, float(stats.chi2.sf(f * count, count))) for v, f in zip(rms, square, strict=True)]
    error = base.frame.model_error * model_error.basis(
        kept.plate_angle_rad[usable], kept.load[usable], kept.elevator_speed_rad_s[usable]
    )
    error = error * (model_error.level(after[usable]) / sd[usable])[:, None]
    found = share(whitened[0], whitened[1], error)
    interval = None
    if found.power > 0.0 and square[0] > 1.0:
        ends = [
            (2.0 * (found.value + s * found.sd) - 1.0) * found.power / (count * (square[0] - 1.0)) for s in (-REACH_95, REACH_95)
        ]
        interval = (100.0 * ends[0], 100.0 * ends[1])
    intervals = (mean_square_interval(square[0], count), mean_square_interval(square[1], count))
    closed = share_closed_pct(rms[0], rms[1], floor)
    return HeldOut(count, measures[0], measures[1], floor, closed, interval, intervals, found), outlying


def share_closed_pct(before: float, after: float, floor: float) -> float | None:
    """Share of a gap (rms before and after, of noise alone) that is closed, %; None where there is none above the noise."""
    return 100.0 * (before - after) / (before - floor) if before > floor else None


def _refit(frame: Frame, effects: tuple[str, ...], start: Fit, name: str) -> Fit:
    """The model fitted to every row, from the densest grain where the loads overfill the paddles at `start`'s density."""
    densest = {p.name: p.upper for p in frame.base if p.name == "density"}
    for values in (start.values, start.values | densest):
        refitted = fit(frame, effects, values, tolerance=1e-6)
        if refitted is not None:
            return refitted
    raise InputError(
        name, "has loads that overfill the paddles at every admissible density", "loads that a paddle of this machine can hold"
    )


def _measure(fitted: Fit, rows: obs.Rows, noise: Noise) -> Measure:
    gap: LackOfFit = lack_of_fit(fitted, noise)
    rms = row_rms(fitted, rows)
    return Measure(rms, 100.0 * rms / float(np.max(np.abs(rows.value))), gap.f, gap.p_value)


def _to_separate(choice: Choice) -> tuple[Fit, list[Fit]]:
    """The leading explanation and those to distinguish it from: its ties, else the next best in its place."""
    if choice.rivals:
        return choice.best, list(choice.rivals)
    if choice.steps:
        named = {family_of(e) for e in choice.best.effects}
        seconds = [c.fit for c in choice.steps[0].candidates if family_of(c.effect) not in named]
        return choice.best, seconds[:1]
    if choice.verdict == "unknown" and choice.looked_at:
        return choice.looked_at[0].fit, [c.fit for c in choice.looked_at[1:3]]
    return choice.best, []


__all__ = ["Diagnosis", "Examination", "Options", "conclude", "diagnose", "diagnose_rows", "examine"]

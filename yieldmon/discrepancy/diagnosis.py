"""The whole diagnosis: hold rows out, fit the published model, test its lack of fit, name effects, validate them on
the held-out rows, plan the next experiment."""

from __future__ import annotations

import numpy as np

from yieldmon.arguments import require_type
from yieldmon.errors import InputError
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.files.table import Table
from yieldmon.physics.effects import family_of, laws
from yieldmon.physics.machine import Machine

from . import diagnosis_notes, published
from . import observations as obs
from .candidates import Signature, library, signature
from .choice import Choice, withdrawn
from .confidence import calibrated, doubted, limited, shipped, without_confidence
from .detectability import minimum_detectable, size_seen
from .diagnosis_result import DEFAULT, Diagnosis, Examination, HeldOut, Measure, Options
from .experiment import plan
from .fit import Fit, fit
from .frame import Frame
from .held_out_rows import score_held_out
from .lack_of_fit import lack_of_fit, noise_floor, row_rms, where
from .merit import merit, misfit
from .noise import Noise, estimate
from .selection import Progress, choose
from .stopgap import correction
from .validation import Validation, validate

__all__ = ["Diagnosis", "Examination", "HeldOut", "Measure", "Options", "conclude", "diagnose", "diagnose_rows", "examine"]


def diagnose(
    table: Table, machine: Machine, parameters: ParameterSet, options: Options = DEFAULT, progress: Progress | None = None
) -> Diagnosis:
    """Find the effects that a model lacks.

    Parameters
    ----------
    table : Table
    machine : Machine
    parameters : ParameterSet
        Parameters of the present model.
    options : Options
    progress : callable, optional
        Called with the present step and the share that is done, 0 .. 1.

    Returns
    -------
    Diagnosis

    Raises
    ------
    InputError
        For a table that is not sufficient for a diagnosis, and an argument of another type.

    Examples
    --------
    >>> columns = {"plate_angle_deg": np.full(3, 70.0), "mass_flow_kg_s": np.arange(5.0, 20.0, 5.0), "force_n": np.full(3, 90.0)}
    >>> table = api.Table("bench.csv", "", "mass_flow_kg_s", "force_n", columns, {})
    >>> api.diagnose(table, api.Machine(), api.load_parameters()).verdict
    Traceback (most recent call last):
        ...
    yieldmon.errors.InputError: bench.csv: has 3 rows with load and reading; expected at least 8
    """
    require_type("table", table, Table, "a Table, as `load_table` gives it")
    require_type("machine", machine, Machine, "a Machine")
    require_type("parameters", parameters, ParameterSet, "a ParameterSet")
    require_type("options", options, Options, "Options")
    return diagnose_rows(obs.from_table(table, machine), parameters, options, progress, table.path)


def diagnose_rows(
    rows: obs.Rows, parameters: ParameterSet, options: Options = DEFAULT, progress: Progress | None = None, name: str = "table"
) -> Diagnosis:
    """`diagnose` on rows already in memory."""
    return conclude(examine(rows, parameters, options, progress, name), rows, options, progress, name)


def conclude(
    seen: Examination, rows: obs.Rows, options: Options = DEFAULT, progress: Progress | None = None, name: str = "table"
) -> Diagnosis:
    """Complete the result of `examine` for the same rows and options: refits on all rows, regions, next experiment."""
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
    of_all = best_all if leading is None else leading
    stated, chosen = chosen, limited(chosen, of_all)
    notes = [*seen.notes, *diagnosis_notes.of_limited_confidence(stated, chosen, of_all)]
    if found.effects and left.p_value < options.policy.lack_of_fit_p <= chosen.lack_of_fit_after.p_value:
        notes.append(diagnosis_notes.of_all_rows(left))
    if found.effects:
        notes += diagnosis_notes.of_bounds(best_all, base_all)
    report("where", 0.9)
    regions = where(base_all, noise, rng)
    remaining = where(best_all, noise, rng) if found.effects else regions
    report("next experiment", 0.95)
    effects = library(whole, options.without)
    signatures = [signature(base_all, effect) for effect in effects]
    named_or_tied = {*map(family_of, found.effects), *(e for step in chosen.steps for e in step.equivalent)}
    other_laws = [signature(base_all, law) for effect in effects for law in laws(effect)[1:]]
    shown = {family_of(s.effect) for s in (*signatures, *other_laws) if _shows(s)}
    undetectable = tuple(s.effect for s in signatures if s.effect not in named_or_tied | shown)
    return Diagnosis(
        options=options,
        form=seen.form,
        noise=noise,
        outliers=int(seen.outlier.sum()),
        choice=chosen,
        base=base_all,
        best=best_all,
        rows=rows,
        is_held_out=seen.is_held_out,
        before=_measure(base_all, every, noise),
        after=_measure(best_all, every, noise),
        held_out=seen.held_out,
        noise_floor_rms=noise_floor(noise, best_all, every),
        regions=regions if chosen.verdict != "none" else (),
        remaining=remaining,
        plan=plan(*_to_separate(chosen), noise),
        minimum_detectable=minimum_detectable(signatures),
        undetectable=undetectable,
        correction=correction(base_all) if chosen.verdict == "unknown" else None,
        notes=(*notes, *diagnosis_notes.of_undetectable(undetectable)),
        leading=leading,
        with_leading=_measure(leading, every, noise) if leading is not None else None,
    )


def examine(
    rows: obs.Rows, parameters: ParameterSet, options: Options = DEFAULT, progress: Progress | None = None, name: str = "table"
) -> Examination:
    """Hold rows out, fit the published model, choose effects, validate them on the held-out rows. Raises InputError as
    `diagnose`."""
    report = progress or (lambda text, share: None)
    rng = np.random.default_rng([options.seed, 2])
    is_held_out = obs.hold_out(rows, options.hold_out, options.seed)
    report("noise", 0.0)
    noise, outlying = estimate(rows.take(~is_held_out))
    outlier = np.zeros(len(rows), dtype=bool)
    outlier[np.flatnonzero(~is_held_out)[outlying]] = True
    training = rows.take(~is_held_out & ~outlier)
    report("published model", 0.05)
    model = published.fit_published(training, noise, parameters, form=options.form, keep_effects=options.keep_effects, name=name)
    published.check_load(model.base, noise, name)
    searched = library(model.frame, options.without)
    chosen = choose(model.base, noise, searched, rng, options.policy, lambda text, share: report(text, 0.1 + 0.7 * share))
    model, chosen = _in_the_better_form(model, chosen, training, noise, parameters, options, name)
    report("held-out rows", 0.85)
    held_out, outlying_held_out = score_held_out(rows, is_held_out, chosen.base, chosen.best, noise)
    outlier |= outlying_held_out
    asked = [
        ask(training, model, noise, parameters, keep_effects=options.keep_effects)
        for ask in (published.angles_asked, published.response_asked)
    ]
    asked = [question for question in asked if question]
    notes = [
        diagnosis_notes.of_noise(noise),
        *diagnosis_notes.of_outliers(rows.take(outlier)),
        *diagnosis_notes.of_scatter(noise, rows, outlier),
        *model.notes,
        *diagnosis_notes.of_gain(model.base),
        *asked,
        *diagnosis_notes.of_overfull(is_held_out & ~outlier, held_out.rows if held_out is not None else 0),
    ]
    if chosen.objection:
        notes.append(diagnosis_notes.of_objection(chosen))
    validation = None
    if chosen.steps:
        validation = validate(chosen.base, chosen.best, held_out.share if held_out is not None else None, rng)
    chosen, doubts = _confirmed(chosen, validation, noise, rows, options, columns_doubted=bool(asked))
    notes += doubts
    notes += diagnosis_notes.of_own_law(chosen, noise, options.policy)
    notes += diagnosis_notes.of_run_order(chosen, options.policy)
    notes += [*diagnosis_notes.of_one_cell(chosen, noise), *diagnosis_notes.of_repetitions(chosen, noise)]
    if chosen.verdict != "effect" and held_out is not None:
        held_out, _ = score_held_out(rows, is_held_out, chosen.base, chosen.base, noise)
    return Examination(model.form, noise, chosen, held_out, is_held_out, outlier, tuple(notes), validation)


def _in_the_better_form(
    model: published.Published,
    chosen: Choice,
    rows: obs.Rows,
    noise: Noise,
    parameters: ParameterSet,
    options: Options,
    name: str,
) -> tuple[published.Published, Choice]:
    """The published model and the chosen effects, in the better form of the impact.

    The form with k1 and k2 is used if 1 + restitution is hardly more than 1, unless the choice with the restitution explains the
    rows better by more than a tie. If the restitution is in the range of grain with the effects, any advantage is sufficient, so
    that k1 and k2 are used on evidence alone.
    """
    if options.form != "auto":
        return model, chosen
    other = published.exchange_instead(model, rows, noise, parameters, keep_effects=options.keep_effects, name=name)
    if other is None:
        return model, chosen
    rng, policy = np.random.default_rng([options.seed, 4]), options.policy
    beside = choose(other.base, noise, library(other.frame, options.without), rng, policy)
    scale = misfit([chosen.best, beside.best])
    restored = chosen.best.values["restitution"] >= published.LEAST_RESTITUTION
    ahead = 0.0 if restored else policy.tie
    better = merit(chosen.best, scale, policy) + ahead < merit(beside.best, scale, policy)
    return (model, chosen) if better else (other, beside)


def _confirmed(
    choice: Choice, validation: Validation | None, noise: Noise, rows: obs.Rows, options: Options, *, columns_doubted: bool
) -> tuple[Choice, list[str]]:
    """The choice with its confidence, and notes on it; no effect is named if there is an objection from outside the search."""
    policy, notes = options.policy, list[str]()
    if validation is not None and choice.verdict == "effect" and not validation.agrees:
        notes.append(diagnosis_notes.refuted(choice.named, validation))
        choice = withdrawn(choice, policy)
    # Hardly any of these is in the cases on which confidence was fitted.
    assumed = noise.how == "assumed"
    scattered = diagnosis_notes.scatter_share(noise, rows) > diagnosis_notes.MOST_SCATTER
    unlike = columns_doubted or assumed or scattered or (validation is not None and validation.cross_fitted.value < 0.5)
    if choice.verdict == "effect" and unlike:
        if assumed and not columns_doubted:
            notes.append(diagnosis_notes.noise_assumed(choice))
        choice = withdrawn(choice, policy)
    choice = without_confidence(choice) if unlike else calibrated(choice, shipped())
    stated, choice = choice, limited(choice, choice.best)
    notes += diagnosis_notes.of_limited_confidence(stated, choice, choice.best)
    if doubted(choice, policy):
        notes.append(diagnosis_notes.not_trusted(choice))
        choice = withdrawn(choice, policy)
    return choice, notes


def _shows(seen: Signature) -> bool:
    """Whether the rows could show an effect's law at some size within its physical bounds."""
    return not all(np.isinf(size_seen(seen, number)) for number in range(len(seen.parameters)))


def _refit(frame: Frame, effects: tuple[str, ...], start: Fit, name: str) -> Fit:
    """The model fitted to every row. If the loads overfill the paddles at the density of `start`, it starts at the highest
    density."""
    densest = {p.name: p.upper for p in frame.base if p.name == "density"}
    for values in (start.values, start.values | densest):
        refitted = fit(frame, effects, values, tolerance=1e-6)
        if refitted is not None:
            return refitted
    raise InputError(
        name, "has loads that overfill the paddles at every admissible density", "loads that a paddle of this machine can hold"
    )


def _measure(fitted: Fit, rows: obs.Rows, noise: Noise) -> Measure:
    test = lack_of_fit(fitted, noise)
    rms = row_rms(fitted, rows)
    return Measure(rms, 100.0 * rms / float(np.max(np.abs(rows.value))), test.f, test.p_value)


def _to_separate(choice: Choice) -> tuple[Fit, list[Fit]]:
    """The leading explanation, and those to separate from it: its ties, or the next best one if there are none."""
    if choice.rivals:
        return choice.best, list(choice.rivals)
    if choice.steps:
        named = {family_of(e) for e in choice.best.effects}
        seconds = [c.fit for c in choice.steps[0].candidates if family_of(c.effect) not in named]
        return choice.best, seconds[:1]
    if choice.verdict == "unknown" and choice.looked_at:
        return choice.looked_at[0].fit, [c.fit for c in choice.looked_at[1:3]]
    return choice.best, []

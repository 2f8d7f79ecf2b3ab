"""Calibration by loads: what weighed loads determine of a machine that measured them.

Loads at one plate angle determine two things: how much the monitor weighs altogether, and how that changes with the flow. Both
live in density and impact gain (1 + restitution, or k1 and k2), which move in their logarithms; all others are held with their
standard deviations, and go on counting in the covariance of the result (a consider filter after Schmidt). A direction
about which the loads say less than was known before is held as well.

The scale counts: density and gain start with the standard deviations in `LoadSettings`, whatever the parameters claim. One
load among four or more that the others contradict is named and left out; smaller departures lose weight (Huber).

Source: Schmidt, "Application of state-space methods to navigation problems" (1966). The fit itself: `load_fit`.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from yieldmon.physics.model import ForwardModel
from yieldmon.physics.numerics import Array

from .closed_loop import self_calibrate
from .closed_loop_inputs import MassAnchor, Sweep
from .closed_loop_settings import ClosedLoopSettings
from .density_and_gain import DENSITY, gain_names, moved, widened
from .flow_curve_fit import fit_loads
from .load_fit import LoadFit, LoadProblem
from .load_inputs import LoadSettings, WeighedLoad
from .load_law import LawAverage, against_others, average, carrying, inliers, law_problem, left_out, placed
from .load_outcome import AnotherLaw, Contradiction, LoadCalibration, LoadResult, WrongTicket, sentences
from .load_pattern import EFFECT
from .parameters import ParameterSet
from .ticket_slips import SlipKind, slips, tare_kg

LEAST_LOADS = 3
"""Fewer weighed loads say nothing against a further one."""
_MODELS_OWN = 0.2
"""Probability of another curve up to which the model's own is used."""
_WRONG, _PERHAPS_WRONG = 0.5, 0.2
"""Probability of a wrong ticket from which nothing is learnt, and from which it is asked about (studies/load_laws)."""
_WRONG_OF_TWO, _PERHAPS_WRONG_OF_TWO = 0.25, 0.1
"""The same of two loads, where a third is soon weighed."""
_WRONG_OF_MANY = 0.8
"""The former of four loads or more, of which the one that is likely to be wrong is left out already."""
_DOUBTED = 0.2
"""Probability of a wrong ticket beyond which a load that contradicts the model's curve waits for one that agrees with it."""
_EXPONENTS, _EXPONENTS_OF_TWO, _BESIDE = (0.5, 1.6), (0.55, 1.6), 0.1
"""Powers of the flow with which a plate's force may grow between two of several loads, or where there are but two, and ln mass by
which two loads may be further apart."""
_EXPLAINED_SDS, _LARGE_SDS = 2.0, 6.0
"""Standard deviations up to which a known slip explains a load that the others contradict, and from which it is far off."""
_NAMED = 0.8
"""Share of that probability that the loads named have together."""
_MOST_STRAIN, _MOST_LEFT = 5.0, 0.3
"""Standard deviations of density, gain and curve, all together, and ln error of a load, beyond which no machine explains them."""
_CONTRADICTED = 2.0
"""Standard deviations, rms, by which loads left out are further off than another curve or scatter explains."""
_LEFT_OUT_WEIGHT = 0.632
_PRIOR_LOADS = 4.0
"""What the stated deviations count for, in loads, beside the scatter that the loads themselves show."""


def calibrate_loads(
    model: ForwardModel,
    prior: ParameterSet,
    loads: Sequence[WeighedLoad],
    *,
    sweeps: Sequence[Sweep] = (),
    settings: LoadSettings | None = None,
    sweep_settings: ClosedLoopSettings | None = None,
    learnt: Container[str] = (),
) -> LoadCalibration:
    """Density and impact gain from weighed loads, and with `sweeps` what these determine of the rest first.

    Parameters
    ----------
    model : ForwardModel
        Of the machine that measured the loads, with the prior's effects.
    prior : ParameterSet
        What measured the loads, or the crop's shipped parameters.
    loads : sequence of WeighedLoad
        One or more.
    sweeps : sequence of Sweep
        Of the same grain: fitted together with the loads that do not contradict each other, as in `self_calibrate`.
    learnt : container of str
        Names of loads that the prior has learnt from: that it measures these well says nothing for it.

    Returns
    -------
    LoadCalibration
        With `refused` where loads left out are measured worse than before.

    Raises
    ------
    ValueError
        Without loads, or where a load holds more force than a full paddle gives.
    """
    if not loads:
        raise ValueError("no weighed load to learn from")
    settings = LoadSettings() if settings is None else settings
    condensed = [load.condensed() for load in loads]
    problem = LoadProblem(model, prior, widened(prior, settings), condensed, settings)
    law = law_problem(problem)
    every = np.ones(len(loads), dtype=bool)
    whole = average(law, every)
    active = every if _of_several(whole) else inliers(problem, law)
    found = whole if np.all(active) else average(law, active)
    active, found = _without_wrong(problem, law, active, found)
    if found is None or found.strain > _MOST_STRAIN:
        # In words with the masses where the model's own curve does not explain them either.
        problem.fit(active, 2)
    likely, perhaps = (_WRONG, _PERHAPS_WRONG) if active.sum() >= LEAST_LOADS else (_WRONG_OF_TWO, _PERHAPS_WRONG_OF_TWO)
    likely = _WRONG_OF_MANY if active.sum() > LEAST_LOADS else likely
    no_plate = _by_no_plate(problem, active)
    if found is not None and (found.wrong > likely or (no_plate and active.sum() < LEAST_LOADS)):
        return _with_wrong_ticket(problem, law, active, found, len(sweeps))
    if found is not None and np.max(np.abs(found.error[active])) > _MOST_LEFT:
        problem.fit(active, 2)
    if found is None or not _is_another(found, problem, active):
        if sweep_settings is None:
            sweep_settings = ClosedLoopSettings(flow="process", model_error=0.01)
        calibration = _calibration(problem, active, sweeps, sweep_settings, learnt)
    else:
        calibration = _by_another_law(problem, law, active, found, learnt)
    wrong = _wrong_ticket(law, active, found) if found is not None and (no_plate or found.wrong > perhaps) else None
    calibration = replace(calibration, wrong_ticket=wrong, slips=_known_slips(law, active))
    return replace(calibration, sentences=tuple(sentences(calibration, len(sweeps))))


def contradicted(
    model: ForwardModel,
    prior: ParameterSet,
    before: Sequence[WeighedLoad],
    load: WeighedLoad,
    settings: LoadSettings | None = None,
    *,
    least: int = LEAST_LOADS,
) -> float | None:
    """Relative error of a weighed mass by what the loads before it say, where that is beyond any scatter; else None.

    Nothing is said with fewer than `least` loads before it. Raises ValueError as `calibrate_loads`.
    """
    if len(before) < least:
        return None
    settings = LoadSettings() if settings is None else settings
    problem = LoadProblem(model, prior, widened(prior, settings), [w.condensed() for w in (*before, load)], settings)
    try:
        error = None if EFFECT in prior.effects else problem.last_against_others()
        if error is None and EFFECT not in prior.effects:
            return None
    except ValueError:
        error = None
    law, every = law_problem(problem), np.ones(len(problem.loads), dtype=bool)
    found = average(law, every)
    if found is None or not _is_doubted(found, len(before)):
        return None
    if error is None:
        error = float(np.expm1(-against_others(law, every & (np.arange(every.size) < len(before)), len(before)).error))
    return error


def _is_doubted(found: LawAverage, k: int) -> bool:
    """Whether load k's ticket may well be wrong; of two loads none is the likelier one."""
    if found.error.size < LEAST_LOADS:
        return found.wrong > _WRONG_OF_TWO
    return sum(likely for slip, likely in found.slips if k in slip.loads and slip.kind is not SlipKind.TARE) > _DOUBTED


def known_slip(
    model: ForwardModel,
    prior: ParameterSet,
    before: Sequence[WeighedLoad],
    load: WeighedLoad,
    settings: LoadSettings | None = None,
) -> str:
    """What explains the ticket of a load that those before it contradict, such as another unit; "" where nothing known does."""
    settings = LoadSettings() if settings is None else settings
    problem = LoadProblem(model, prior, widened(prior, settings), [w.condensed() for w in (*before, load)], settings)
    return _known_slip(law_problem(problem), np.arange(len(problem.loads)) < len(before), len(before))


def departure(
    model: ForwardModel, known: ParameterSet, load: WeighedLoad, settings: LoadSettings | None = None
) -> tuple[float, float]:
    """Relative error of a load as these parameters measure it, and its standard deviation by their covariance and the scale.

    Both are nan where the load holds more force than a full paddle gives.
    """
    errors, std_devs = departures(model, known, [load], settings)
    return float(errors[0]), float(std_devs[0])


def departures(
    model: ForwardModel, known: ParameterSet, loads: Sequence[WeighedLoad], settings: LoadSettings | None = None
) -> tuple[Array, Array]:
    """`departure` of several loads, which all know their moisture or none does: (n,) errors and their standard deviations."""
    problem = _measured(model, known, loads, settings)
    return np.expm1(_ln_errors(problem)), np.hypot(problem.spreads(known), problem.sd)


def errors_of(
    model: ForwardModel, known: ParameterSet, loads: Sequence[WeighedLoad], settings: LoadSettings | None = None
) -> Array:
    """The errors of `departures` alone."""
    return np.expm1(_ln_errors(_measured(model, known, loads, settings)))


def _measured(
    model: ForwardModel, known: ParameterSet, loads: Sequence[WeighedLoad], settings: LoadSettings | None
) -> LoadProblem:
    settings = LoadSettings() if settings is None else settings
    return LoadProblem(model, known, known, [load.condensed() for load in loads], settings)


def _ln_errors(problem: LoadProblem) -> Array:
    return np.asarray(np.log(problem.mass(problem.start) / problem.weighed))


def _calibration(
    problem: LoadProblem,
    active: NDArray[np.bool_],
    sweeps: Sequence[Sweep],
    sweep_settings: ClosedLoopSettings,
    learnt: Container[str],
) -> LoadCalibration:
    fit, directions, errors, full = _fitted(problem, active)
    against = problem.contradicts(fit, active, max(directions, 1))
    shown = float(np.nan_to_num(_expected_rms(fit.error[active], errors[active]))) if against else 0.0
    posterior, next_sd, level_sd = _posterior(problem, fit, active, directions, full, shown)
    after = problem.weighed * np.exp(fit.error)
    together = _together(problem, fit, sweeps, active, sweep_settings) if sweeps else None
    if together is not None:
        posterior, after = together, problem.mass(together)
        errors = _left_out_together(problem, fit, sweeps, active, sweep_settings)
        next_sd, level_sd = problem.spread(posterior, active)
    before = problem.mass(problem.given)
    unseen = active & np.array([load.name not in learnt for load in problem.loads])
    judges = unseen if np.any(unseen) else active
    rms_before, rms_after = _rms(np.log(before / problem.weighed)[judges]), _rms(errors[judges])
    expected = _expected_rms(np.log(after / problem.weighed)[judges], errors[judges])
    refused = bool(active.sum() > 1 and expected > rms_before)
    chosen, after = (problem.given, before) if refused else (posterior, after)
    results = _results(problem, before, after, errors, active)
    moving = _moved_names(problem.given, chosen)
    calibration = LoadCalibration(
        parameter_set=chosen,
        names=moving,
        held=tuple(n for n in chosen.values if n not in moving),
        loads=results,
        scale=float(after[active].sum() / before[active].sum()),
        scale_sd=level_sd,
        load_dependence=directions == 2 and not refused,
        next_load_sd=next_sd,
        rms_before=rms_before,
        rms_left_out=rms_after,
        refused=refused,
        sweeps_used=0 if together is None else len(sweeps),
        contradiction=_contradiction(problem, errors) if (against or not active.all()) and together is None else None,
    )
    return calibration


def _results(
    problem: LoadProblem, before: Array, after: Array, errors: Array, active: NDArray[np.bool_]
) -> tuple[LoadResult, ...]:
    return tuple(
        LoadResult(load.name, load.weighed_kg, float(b), float(a), float(np.expm1(e)), not bool(ok))
        for load, b, a, e, ok in zip(problem.loads, before, after, errors, active, strict=True)
    )


def _moved_names(given: ParameterSet, chosen: ParameterSet) -> tuple[str, ...]:
    """Of a refused calibration none, since the set given is the one chosen."""
    return tuple(n for n, v in chosen.values.items() if given.values.get(n) != v)


def _is_another(found: LawAverage, problem: LoadProblem, active: NDArray[np.bool_]) -> bool:
    """Whether what the loads say of the curve is to be used: not where enough loads have shown that it is the model's."""
    return EFFECT in problem.given.effects or active.sum() < LEAST_LOADS or found.law > _MODELS_OWN


def _by_another_law(
    problem: LoadProblem, law: LoadProblem, active: NDArray[np.bool_], found: LawAverage, learnt: Container[str]
) -> LoadCalibration:
    """The calibration where the force may follow another curve over the flow than the model's."""
    errors, away = left_out(law, active, found.step)
    after = problem.weighed * np.exp(found.error)
    before = problem.mass(problem.given)
    unseen = active & np.array([load.name not in learnt for load in problem.loads])
    judges = unseen if np.any(unseen) else active
    rms_before, rms_after = _rms(np.log(before / problem.weighed)[judges]), _rms(errors[judges])
    expected = _expected_rms(found.error[judges], errors[judges])
    # A load that another curve may well put there says nothing against the calibration, however far it is.
    refused = bool(active.sum() > 1 and expected > rms_before and _rms(away[judges]) > _CONTRADICTED)
    chosen = problem.given if refused else _as_law_set(law, found)
    after = before if refused else after
    information = problem.information(LoadFit(found.step[:2], found.error, found.by_step[:, :2]), active)
    mean = np.column_stack((found.by_held, found.by_step))[active].mean(axis=0)
    results = _results(problem, before, after, errors, active)
    moving = _moved_names(problem.given, chosen)
    calibration = LoadCalibration(
        parameter_set=chosen,
        names=moving,
        held=tuple(n for n in chosen.values if n not in moving),
        loads=results,
        scale=float(after[active].sum() / before[active].sum()),
        scale_sd=float(np.sqrt(mean @ found.covariance @ mean)),
        load_dependence=bool(not refused and np.all(information >= problem.settings.least_information)),
        next_load_sd=_next_sd(problem, active, found),
        rms_before=rms_before,
        rms_left_out=rms_after,
        refused=refused,
        sweeps_used=0,
        another_law=AnotherLaw(found.law, found.scatter, found.scatters),
    )
    return calibration


def _next_sd(problem: LoadProblem, active: NDArray[np.bool_], found: LawAverage) -> float:
    """Relative standard deviation of a further load like the active ones."""
    rows = np.column_stack((found.by_held, found.by_step))[active]
    spread = np.einsum("ki,ij,kj->k", rows, found.covariance, rows)
    return float(np.sqrt(np.mean(spread) + np.mean(problem.own[active] ** 2) + found.scatter**2))


def _by_no_plate(problem: LoadProblem, active: NDArray[np.bool_]) -> bool:
    """Whether between two of the active loads the force changes with the flow as on no plate."""
    count = int(active.sum())
    if count < LEAST_LOADS - 1:
        return False
    low, high = _EXPONENTS if count >= LEAST_LOADS else _EXPONENTS_OF_TWO
    seconds = np.bincount(problem.of_load, problem.duration)
    force = np.bincount(problem.of_load, problem.duration * problem.force / problem.speed) / seconds
    by_flow, by_force = (np.subtract.outer(v, v) for v in (np.log(problem.weighed / seconds)[active], np.log(force)[active]))
    nearest = np.sign(by_flow) * np.clip(by_force * np.sign(by_flow), low * np.abs(by_flow), high * np.abs(by_flow))
    return bool(np.any(np.abs(by_force - nearest) > _BESIDE))


def _without_wrong(
    problem: LoadProblem, law: LoadProblem, active: NDArray[np.bool_], found: LawAverage | None
) -> tuple[NDArray[np.bool_], LawAverage | None]:
    """The active loads without those of which one's ticket is likelier wrong than not, and what they say; at least three, and
    more than half of all, are left."""
    while found is not None and active.sum() >= problem.settings.outlier_least and 2 * (active.sum() - 1) > active.size:
        of_load = np.zeros(int(active.sum()))
        for slip, likely in found.slips:
            if slip.kind is SlipKind.ONE:
                of_load[slip.loads[0]] += likely
        if of_load.max() < _WRONG:
            break
        active = active.copy()
        active[np.flatnonzero(active)[int(np.argmax(of_load))]] = False
        found = average(law, active)
    return active, found


def _of_several(found: LawAverage | None) -> bool:
    """Whether two tickets are exchanged or a tare is in all of them, by all loads together."""
    return found is not None and sum(likely for slip, likely in found.slips if slip.kind is not SlipKind.ONE) > _WRONG


def _known_slips(law: LoadProblem, active: NDArray[np.bool_]) -> tuple[tuple[str, str], ...]:
    """Names of the loads left out whose ticket a known slip explains, and that slip."""
    each = ((law.loads[k].name, _known_slip(law, active, k)) for k in np.flatnonzero(~active).tolist())
    return tuple((name, what) for name, what in each if what)


def _known_slip(law: LoadProblem, others: NDArray[np.bool_], k: int) -> str:
    """The known slip that explains a load's ticket by the others; "" where none does."""
    said = against_others(law, others, k)
    known = [slip for slip in slips(law.weighed, [load.name for load in law.loads]) if slip.loads == (k,) and slip.what]
    away = [abs(said.error + slip.shift[k]) / said.std_dev for slip in known]
    best = int(np.argmin(away))
    return known[best].what if away[best] < _EXPLAINED_SDS and abs(said.error) > _LARGE_SDS * said.std_dev else ""


def _wrong_ticket(law: LoadProblem, active: NDArray[np.bool_], found: LawAverage) -> WrongTicket:
    """Which ticket is likely to be wrong, and how."""
    where = np.flatnonzero(active).tolist()
    by_loads: dict[tuple[SlipKind, tuple[int, ...]], float] = {}
    for slip, likely in found.slips:
        by_loads[slip.kind, slip.loads] = by_loads.get((slip.kind, slip.loads), 0.0) + likely
    kind, first = max(by_loads, key=lambda key: by_loads[key])
    alike = [(likely, slip, along) for (slip, likely), along in zip(found.slips, found.along, strict=True) if slip.kind is kind]
    if kind is SlipKind.TARE:
        weighed_kg = law.weighed[active]
        lightest = int(np.argmin(weighed_kg))
        ln = [slip.shift[lightest] + along * slip.along[lightest] for _, slip, along in alike]
        mean = float(np.average(ln, weights=[likely for likely, _, _ in alike]))
        names = tuple(law.loads[k].name for k in where)
        return WrongTicket(found.wrong, names, kind, 1.0, tare_kg(weighed_kg, mean), "")
    likely, what = max((likely, slip.what) for likely, slip, _ in alike if slip.loads == first)
    what = what if likely > _WRONG * by_loads[kind, first] else ""
    of_load = {
        k: sum(likely for (of, loads), likely in by_loads.items() if k in loads and of is not SlipKind.TARE)
        for k in range(len(where))
    }
    exchanged = kind is SlipKind.EXCHANGED
    suspects = list(first) if exchanged else sorted(of_load, key=lambda k: (k != first[0], -of_load[k]))
    count = 1 if len(where) > LEAST_LOADS - 1 else len(where)
    while not exchanged and count < len(where) and sum(of_load[k] for k in suspects[:count]) < _NAMED * found.wrong:
        count += 1
    named = tuple(law.loads[where[k]].name for k in (suspects if exchanged else suspects[:count]))
    k = where[first[0]]
    said = against_others(law, active & (np.arange(active.size) != k), k)
    ratio = float(np.exp(-said.error))
    weighed = float(law.weighed[k])
    probability = found.wrong if not _by_no_plate(law, active) else None
    return WrongTicket(probability, named, kind, ratio, weighed * (1.0 - 1.0 / ratio), what)


def _with_wrong_ticket(
    problem: LoadProblem, law: LoadProblem, active: NDArray[np.bool_], found: LawAverage, sweeps: int
) -> LoadCalibration:
    """Nothing learnt: a ticket is wrong."""
    errors, _ = left_out(law, active, found.step)
    before = problem.mass(problem.given)
    error = np.log(before / problem.weighed)[active]
    mean = np.column_stack((found.by_held, found.by_step))[active].mean(axis=0)
    calibration = LoadCalibration(
        parameter_set=problem.given,
        names=(),
        held=tuple(problem.given.values),
        loads=_results(problem, before, before, errors, active),
        scale=1.0,
        scale_sd=float(np.sqrt(mean @ found.covariance @ mean)),
        load_dependence=False,
        next_load_sd=_next_sd(problem, active, found),
        rms_before=_rms(error),
        rms_left_out=_rms(errors[active]),
        refused=True,
        sweeps_used=0,
        wrong_ticket=_wrong_ticket(law, active, found),
    )
    return replace(calibration, sentences=tuple(sentences(calibration, sweeps)))


def _as_law_set(law: LoadProblem, found: LawAverage) -> ParameterSet:
    """With the pattern's weights, and what loads scatter by in the gain: it is common to a load's seconds."""
    count = len(law.held)
    covariance = found.covariance.copy()
    covariance[count + 1, count + 1] += (found.scatter / float(np.mean(found.by_step[:, 1]))) ** 2
    return carrying(_as_set(law, placed(law.start, found.step), covariance[: count + 2, : count + 2]), law, covariance)


def _fitted(problem: LoadProblem, active: NDArray[np.bool_]) -> tuple[LoadFit, int, Array, LoadFit | None]:
    """The fit, along how many directions it moved, and the errors of loads left out; and the fit along both where the loads
    determine both but one is enough."""
    both = problem.fit(active, 2)
    directions = int(np.sum(problem.information(both, active) >= problem.settings.least_information))
    errors = problem.left_out(active, directions).error
    if directions == 2 and not problem.contradicts(one := problem.fit(active, 1), active, 1):
        simpler = problem.left_out(active, 1).error
        if _rms(simpler[active]) < _rms(errors[active]):
            return one, 1, simpler, both
    return (both if directions == 2 else problem.fit(active, directions)), directions, errors, None


def _together(
    problem: LoadProblem, near: LoadFit, sweeps: Sequence[Sweep], active: NDArray[np.bool_], settings: ClosedLoopSettings
) -> ParameterSet | None:
    """Sweeps and loads in one fit that begins where the loads alone lead; None where it learns nothing."""
    anchors = [
        MassAnchor(
            load.weighed_kg,
            float(sd) * load.weighed_kg,
            load.duration_s,
            load.force_n,
            load.plate_angle_rad,
            load.elevator_speed_rad_s,
            load.moisture_pct,
        )
        for load, sd, ok in zip(problem.loads, problem.sd, active, strict=True)
        if ok
    ]
    centre = moved(problem.start, *map(float, near.step))
    outcome = self_calibrate(problem.model, centre, sweeps, anchors=anchors, settings=settings)
    if not outcome.updated:
        return None
    return replace(outcome.parameter_set, version=problem.given.version + 1)


def _left_out_together(
    problem: LoadProblem, near: LoadFit, sweeps: Sequence[Sweep], active: NDArray[np.bool_], settings: ClosedLoopSettings
) -> Array:
    errors = np.full(len(problem.loads), np.nan)
    for k in range(len(problem.loads)):
        others = active & (np.arange(len(problem.loads)) != k)
        found = _together(problem, near, sweeps, others, settings) if np.any(others) else None
        if found is not None:
            errors[k] = np.log(problem.mass(found)[k] / problem.weighed[k])
    return errors


def _posterior(
    problem: LoadProblem, fit: LoadFit, active: NDArray[np.bool_], directions: int, full: LoadFit | None, shown: float
) -> tuple[ParameterSet, float, float]:
    """The new set, and relative standard deviations of a further load and of these loads' common level.

    shown: the former as loads left out show it, where they contradict the model's curve, else 0: the least that is stated.
    full: the fit along both directions where `fit` moved along one of the two that the loads determine. What they say of the
    other counts in the covariance, with the distance between the fits as an error of its own.
    """
    centre = moved(problem.start, *map(float, fit.step))
    h = np.column_stack((problem.held_slopes(centre), fit.by_step))
    rows = h[active]
    determined = directions if full is None else 2
    basis = np.zeros((h.shape[1], determined))
    basis[-2:] = problem.basis(fit.by_step, active.astype(float))[:, :determined]
    noise = problem.sd[active] ** 2
    moving = rows @ basis
    gain = basis @ moving.T @ np.linalg.inv(moving @ moving.T + np.diag(noise))
    left = np.eye(h.shape[1]) - gain @ rows
    chi2, dof = float(np.sum(fit.error[active] ** 2 / noise)), max(int(active.sum()) - directions, 0)
    inflation = (_PRIOR_LOADS + chi2) / (_PRIOR_LOADS + dof)
    held, by_noise = left @ problem.prior @ left.T, gain @ np.diag(noise) @ gain.T
    own = np.mean(problem.own[active] ** 2)
    each = [np.einsum("ki,ij,kj->k", rows, part, rows).mean() for part in (held, by_noise)]
    inflation = max(inflation, float((shown**2 - each[0]) / (each[1] + own)))
    covariance = held + inflation * by_noise
    if full is not None:
        covariance[-2:, -2:] += np.outer(full.step - fit.step, full.step - fit.step)
    spread = np.einsum("ki,ij,kj->k", rows, covariance, rows)
    next_sd = float(np.sqrt(np.mean(spread) + inflation * own))
    mean = rows.mean(axis=0)
    return _as_set(problem, centre, covariance), next_sd, float(np.sqrt(mean @ covariance @ mean))


def _as_set(problem: LoadProblem, centre: ParameterSet, covariance: Array) -> ParameterSet:
    values, gain = centre.values, gain_names(centre)
    size = 1.0 + values["restitution"] if len(gain) == 1 else 1.0
    rows: list[Array] = list(np.eye(len(covariance))[: len(problem.held)])
    unit = np.eye(len(covariance))
    rows.append(unit[-2] * values[DENSITY])
    names: list[str] = [*problem.held, DENSITY]
    for name in gain:
        weight = size if name == "restitution" else values[name]
        if weight != 0.0:
            rows.append(unit[-1] * weight)
            names.append(name)
    # k1 and k2 move together here; a hair of their own keeps the covariance of both positive definite.
    own = np.zeros(len(names))
    if "k1" in names and "k2" in names:
        own[-2:] = [(1e-3 * values[n]) ** 2 for n in ("k1", "k2")]
    to = np.stack(rows)
    full = to @ covariance @ to.T + np.diag(own)
    full = 0.5 * (full + full.T)
    return replace(centre, covariance_names=tuple(names), covariance=full, version=problem.given.version + 1)


def _contradiction(problem: LoadProblem, errors: Array) -> Contradiction:
    """Of all loads, those among them that count for nothing."""
    try:
        found = fit_loads(problem.loads, problem.model.machine.home_plate_angle_rad)
    except ValueError:
        return Contradiction(_rms(errors), float("nan"))
    return Contradiction(_rms(errors), _rms(np.array(found.left_out_error)))


def _expected_rms(fitted: Array, left_out: Array) -> float:
    """Of a further load: fitted errors are too small and, where three loads are two without the one, those of left-out loads too
    large. Source: the 0.632 estimator, B. Efron, J. American Statistical Association 78 (1983) 316."""
    return float(np.hypot(np.sqrt(1.0 - _LEFT_OUT_WEIGHT) * _rms(fitted), np.sqrt(_LEFT_OUT_WEIGHT) * _rms(left_out)))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")

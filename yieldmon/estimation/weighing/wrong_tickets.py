"""Tickets that contradict other loads: which ones are likely to be wrong, and by which slip."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from yieldmon.estimation.load_pattern import EFFECT
from yieldmon.estimation.parameters import ParameterSet
from yieldmon.physics.model import ForwardModel

from .density_and_gain import widened
from .load_fit import LoadProblem
from .load_inputs import LoadSettings, WeighedLoad
from .load_law import LawAverage, LawProblem, against_others, average, law_problem
from .load_outcome import WrongTicket
from .ticket_slips import SlipKind, slips, tare_kg

LEAST_LOADS = 3
"""Least number of loads that can contradict a further one."""
_WRONG, _PERHAPS_WRONG = 0.5, 0.2
"""Probability of a wrong ticket from which nothing is updated, and from which the user is asked (studies/load_laws)."""
_WRONG_OF_TWO, _PERHAPS_WRONG_OF_TWO = 0.25, 0.1
"""The same for two loads, since a third is usually weighed soon."""
_WRONG_OF_MANY = 0.8
"""`_WRONG` for four loads or more, where a single load that is likely to be wrong has been left out already."""
_DOUBTED = 0.2
"""Probability of a wrong ticket beyond which a load that contradicts the model's curve is kept back until another agrees with
it."""
_EXPONENTS, _EXPONENTS_OF_TWO, _BESIDE = (0.5, 1.6), (0.55, 1.6), 0.1
"""Range of the exponent of force over flow that is possible on a plate, for three loads or more and for two, and the deviation of
ln force that is tolerated in addition."""
_EXPLAINED_SDS, _LARGE_SDS = 2.0, 6.0
"""Largest deviation of a load from the others once its slip is corrected, and least one before, in standard deviations."""
_NAMED = 0.8
"""Share of the probability of a wrong ticket that the named loads must have together."""


def probabilities(count: int) -> tuple[float, float]:
    """Probabilities of a wrong ticket among `count` loads from which nothing is updated, and from which the user is asked."""
    if count < LEAST_LOADS:
        return _WRONG_OF_TWO, _PERHAPS_WRONG_OF_TWO
    return _WRONG_OF_MANY if count > LEAST_LOADS else _WRONG, _PERHAPS_WRONG


def contradicted(
    model: ForwardModel,
    prior: ParameterSet,
    before: Sequence[WeighedLoad],
    load: WeighedLoad,
    settings: LoadSettings | None = None,
    *,
    least: int = LEAST_LOADS,
) -> float | None:
    """Relative error of a ticket that the loads before it contradict.

    Parameters
    ----------
    model : ForwardModel
    prior : ParameterSet
    before : sequence of WeighedLoad
        Loads before it.
    load : WeighedLoad
    settings : LoadSettings, optional
    least : int
        Least number of loads before it for a verdict.

    Returns
    -------
    float or None
        Relative error of the measured mass as predicted from the loads before; None if scatter explains it, or if they are
        fewer than `least`.

    Raises
    ------
    ValueError
        As `calibrate_loads`.
    """
    if len(before) < least:
        return None
    settings = LoadSettings() if settings is None else settings
    problem = LoadProblem(model, prior, widened(prior, settings), [w.condensed for w in (*before, load)], settings)
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
    """Whether the ticket of load k is doubtful; of two loads, whether either is."""
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
    """Known slip, such as another unit, that explains a ticket that the loads before contradict; "" if none does."""
    settings = LoadSettings() if settings is None else settings
    problem = LoadProblem(model, prior, widened(prior, settings), [w.condensed for w in (*before, load)], settings)
    return _known_slip(law_problem(problem), np.arange(len(problem.loads)) < len(before), len(before))


def by_no_plate(problem: LoadProblem, active: NDArray[np.bool_]) -> bool:
    """Whether between two of the active loads the force changes with the flow in a way that is possible on no plate."""
    count = int(active.sum())
    if count < LEAST_LOADS - 1:
        return False
    low, high = _EXPONENTS if count >= LEAST_LOADS else _EXPONENTS_OF_TWO
    windows = problem.windows
    seconds = np.bincount(windows.of_load, windows.duration_s)
    force = np.bincount(windows.of_load, windows.duration_s * windows.force_n / windows.elevator_speed_rad_s) / seconds
    by_flow, by_force = (np.subtract.outer(v, v) for v in (np.log(problem.weighed / seconds)[active], np.log(force)[active]))
    nearest = np.sign(by_flow) * np.clip(by_force * np.sign(by_flow), low * np.abs(by_flow), high * np.abs(by_flow))
    return bool(np.any(np.abs(by_force - nearest) > _BESIDE))


def without_wrong(
    problem: LoadProblem, law: LawProblem, active: NDArray[np.bool_], found: LawAverage | None
) -> tuple[NDArray[np.bool_], LawAverage | None]:
    """Leave out, one at a time, loads whose ticket is more likely wrong than right.

    At least three loads, and more than half of all, are kept.

    Returns
    -------
    ndarray of bool
        The active loads that are kept, (n,).
    LawAverage or None
        The average over these.
    """
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


def of_several(found: LawAverage | None) -> bool:
    """Whether all loads together indicate that two tickets are exchanged or that a tare is in all of them."""
    return found is not None and sum(likely for slip, likely in found.slips if slip.kind is not SlipKind.ONE) > _WRONG


def known_slips(law: LawProblem, active: NDArray[np.bool_]) -> tuple[tuple[str, str], ...]:
    """Name and slip of each load left out whose ticket a known slip explains."""
    each = ((law.loads[k].name, _known_slip(law, active, k)) for k in np.flatnonzero(~active).tolist())
    return tuple((name, what) for name, what in each if what)


def _known_slip(law: LawProblem, others: NDArray[np.bool_], k: int) -> str:
    """The known slip that explains the ticket of load k, given the other loads; "" if none does."""
    said = against_others(law, others, k)
    known = [slip for slip in slips(law.weighed, [load.name for load in law.loads]) if slip.loads == (k,) and slip.what]
    away = [abs(said.error + slip.shift[k]) / said.std_dev for slip in known]
    best = int(np.argmin(away))
    return known[best].what if away[best] < _EXPLAINED_SDS and abs(said.error) > _LARGE_SDS * said.std_dev else ""


def wrong_ticket(law: LawProblem, active: NDArray[np.bool_], found: LawAverage) -> WrongTicket:
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
    probability = found.wrong if not by_no_plate(law, active) else None
    return WrongTicket(probability, named, kind, ratio, weighed * (1.0 - 1.0 / ratio), what)

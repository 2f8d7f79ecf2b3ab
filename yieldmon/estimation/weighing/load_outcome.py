"""The result of a calibration by loads, and the sentences that describe it to the user."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isfinite, log

from yieldmon.estimation.parameters import ParameterSet
from yieldmon.units import counted

from .ticket_slips import SlipKind, title

_A_LOT = 0.5
"""Change of ln scale from which the user is asked about units: a wrong unit changes it by 0.8 or more, and the error of a machine
before its first load is within 0.3."""
_ENOUGH_LOADS = 3
"""Least number of loads that can be checked against each other at different flows."""
LIKELY_ANOTHER = 0.8
"""Probability of another curve from which it is stated as a fact."""
_LIKELY_WRONG = 0.25
"""Probability of a wrong ticket from which it is stated as a fact."""
_SCATTERS, _LIKELY_SCATTERS = 0.01, 0.5
"""Least relative standard deviation beyond the stated one that is reported, and least probability that there is any."""


@dataclass(frozen=True, slots=True)
class LoadResult:
    """One load.

    Attributes
    ----------
    name : str
    weighed_kg : float
    before_kg, after_kg : float
        Measured mass with the parameters before and after the calibration, kg.
    left_out_error : float
        Relative error of the mass measured with parameters fitted to the other loads only; nan for a single load.
    outlier : bool
        Whether the other loads contradict it; such a load is not used.
    """

    name: str
    weighed_kg: float
    before_kg: float
    after_kg: float
    left_out_error: float
    outlier: bool


@dataclass(frozen=True, slots=True)
class Contradiction:
    """Leave-one-out errors where the model does not explain the loads within their standard deviations.

    Attributes
    ----------
    model_rms : float
        Relative rms error by the model.
    curve_rms : float
        The same by an alpha-beta curve; nan if none can be fitted.
    """

    model_rms: float
    curve_rms: float


@dataclass(frozen=True, slots=True)
class AnotherLaw:
    """Evidence that the force does not follow the model's curve over the flow.

    Attributes
    ----------
    probability : float
        Probability of another curve.
    scatter : float
        Relative standard deviation of the loads beyond the stated one.
    scatters : float
        Probability that the loads scatter by more than stated.
    """

    probability: float
    scatter: float
    scatters: float


@dataclass(frozen=True, slots=True)
class WrongTicket:
    """A ticket that contradicts the others, two that are exchanged, or a tare in all of them.

    Attributes
    ----------
    probability : float or None
        Probability that a ticket is wrong; None if between two loads the force changes with the flow as on no real plate.
    loads : tuple of str
        Names of the loads whose ticket may be wrong, the likeliest first: both if two are exchanged, all if it is a tare.
    kind : SlipKind
    ratio, apart_kg : float
        Ratio and difference of the first load's ticket to its mass predicted from the other loads; for a tare, 1 and the tare.
    what : str
        The known slip that explains it, "" if none does.
    """

    probability: float | None
    loads: tuple[str, ...]
    kind: SlipKind
    ratio: float
    apart_kg: float
    what: str


@dataclass(frozen=True)
class LoadCalibration:
    """The result of `calibrate_loads`.

    Attributes
    ----------
    parameter_set : ParameterSet
        To use from now on; the given one if refused.
    names, held : tuple of str
        Parameters that changed, and those that did not.
    loads : tuple of LoadResult
    scale, scale_sd : float
        Measured mass of all loads after over before, and its relative standard deviation.
    load_dependence : bool
        Whether the loads determine how the error changes with the flow.
    next_load_sd : float
        Expected relative standard deviation of a further load like these.
    rms_before, rms_left_out : float
        rms of the loads' ln errors with the given parameters, and when each is left out of the new calibration.
    refused : bool
        Whether the given parameters stay in use.
    sweeps_used : int
    contradiction : Contradiction or None
    another_law : AnotherLaw or None
    wrong_ticket : WrongTicket or None
    range_dropped : bool
        Whether the loads contradict the given parameters, whose calibrated range is then dropped.
    slips : tuple of (str, str)
        Names of loads left out, and the known slip that explains the ticket of each.
    sentences : tuple of str
        For the user.
    """

    parameter_set: ParameterSet
    names: tuple[str, ...]
    held: tuple[str, ...]
    loads: tuple[LoadResult, ...]
    scale: float
    scale_sd: float
    load_dependence: bool
    next_load_sd: float
    rms_before: float
    rms_left_out: float
    refused: bool
    sweeps_used: int
    contradiction: Contradiction | None = None
    another_law: AnotherLaw | None = None
    wrong_ticket: WrongTicket | None = None
    range_dropped: bool = False
    slips: tuple[tuple[str, str], ...] = ()
    sentences: tuple[str, ...] = field(default=())

    @property
    def outliers(self) -> tuple[str, ...]:
        """Names of the loads that the others contradict."""
        return tuple(load.name for load in self.loads if load.outlier)


def sentences(found: LoadCalibration, sweeps: int) -> list[str]:
    """Sentences for the user. sweeps: number of sweeps that were given to the calibration."""
    out = [
        f"{title(load.name)} contradicts the others by {100.0 / (1.0 + load.left_out_error) - 100.0:+.1f} % and counts for "
        f"nothing: {_cause(found, load.name)}"
        for load in found.loads
        if load.outlier
    ]
    if found.wrong_ticket is not None:
        out.append(wrong_ticket_sentence(found))
    elif found.refused:
        out += _refused(found)
    if found.refused:
        return out
    out.append(_scale(found))
    if found.range_dropped:
        out.append(
            "the parameters before do not allow for these masses: their calibrated range is another machine's, and that of these "
            "loads takes its place."
        )
    return out + (_another_law(found, found.another_law, sweeps) if found.another_law is not None else _by_model(found, sweeps))


def _by_model(found: LoadCalibration, sweeps: int) -> list[str]:
    """Sentences if the force follows the model's curve over the flow."""
    out = []
    if found.load_dependence:
        out.append("they also determine how the error changes with the flow: density and impact gain moved apart.")
    else:
        out.append("they do not determine how the error changes with the flow: held; weigh a load at another flow.")
    if found.sweeps_used:
        out.append(f"fitted with them: {counted(found.sweeps_used, 'sweep')} of the plate; held: {', '.join(found.held)}.")
    else:
        out.append(f"held, because weighed loads cannot separate them from the scale: {', '.join(found.held)}.")
    if sweeps and not found.sweeps_used:
        out.append("the sweeps contradict the model or add too little to the loads; they are left out.")
    if found.contradiction is not None:
        out += _contradiction(found.contradiction, bool(found.outliers))
    out += _next_load(found)
    return out


def _next_load(found: LoadCalibration) -> list[str]:
    expected = f"a next load like these is expected within {100.0 * found.next_load_sd:.2f} % (one standard deviation)"
    if len(found.loads) > 1:
        return [f"{expected}."]
    return [
        "one load alone cannot be checked against others; weigh two more.",
        f"{expected} if its ticket is right: one that is wrong by 10 % would not show, and every load would be off by as much.",
    ]


def _cause(found: LoadCalibration, name: str) -> str:
    """Possible cause for a load that the others contradict."""
    what = dict(found.slips).get(name, "")
    if what:
        return f"it looks as if {what}; correct the ticket."
    return "another truck's grain, a wrong number or a part of the load that was not measured?"


def wrong_ticket_sentence(found: LoadCalibration) -> str:
    """Sentence on the ticket that is or may be wrong; "" if there is none."""
    wrong, count, refused = found.wrong_ticket, len(found.loads), found.refused
    if wrong is None:
        return ""
    chance = "the force would change with the flow as on no plate"
    if wrong.probability is not None:
        chance = f"probability {100.0 * min(wrong.probability, 0.99):.0f} %"
    sure = refused and (wrong.probability is None or wrong.probability > _LIKELY_WRONG)
    begin = f"{'refused: ' if refused else ''}a ticket {'is' if sure else 'may be'} wrong ({chance})"
    if wrong.kind is SlipKind.TARE:
        what = "the tare was not taken off" if wrong.apart_kg > 0.0 else "the tare was taken off twice"
        plural = begin.replace("a ticket is", "the tickets are").replace("a ticket may", "the tickets may")
        left = "correct them" if refused else "if they are right, further loads of one flow and unlike masses show it"
        return f"{plural}: each holds about {wrong.apart_kg:+.0f} kg beside the grain, as if {what}. Check the tickets; {left}."
    if wrong.kind is SlipKind.EXCHANGED:
        left = "seem to be exchanged; correct them" if refused else "may be exchanged; check them"
        return f"{begin}: those of {' and '.join(map(title, wrong.loads))} {left}."
    first, *others = map(title, wrong.loads)
    apart = f"weighs {wrong.ratio:.2f} times ({wrong.apart_kg:+.0f} kg) what"
    if not others:
        said = f"{first} {apart} the others make of it"
    elif count == 2:
        said = f"{first} {apart} {others[0]} makes of it, and one of the two is wrong"
    else:
        said = f"{first} or {' or '.join(others)}; {first} {apart} the others make of it"
    cause = f", as if {wrong.what}" if wrong.what else ""
    check = "" if wrong.what else " Another truck's grain, the tare, a wrong number, or a part of the load that was not measured?"
    if not refused:
        left = "if they are right, a further load shows it"
    else:
        left = "correct it or leave that load out" if count > 2 else "correct it, or weigh a third load"
    return f"{begin}: {said}{cause}.{check} Check the tickets; {left}."


def _refused(found: LoadCalibration) -> list[str]:
    out = [
        f"refused: on loads left out the new calibration errs by {100.0 * found.rms_left_out:.2f} %, the present one by "
        f"{100.0 * found.rms_before:.2f} %; the parameters stay."
    ]
    if len(found.loads) - len(found.outliers) < _ENOUGH_LOADS:
        out.append("two loads cannot be checked against each other; weigh a third, at another flow, and give all three.")
    return out


def _scale(found: LoadCalibration) -> str:
    if not isfinite(found.scale):
        return "with the parameters before, a load held more force than a full paddle gives: it was not measured whole."
    return scale_sentence(found.scale)


def scale_sentence(scale: float) -> str:
    """Sentence on what loads weigh against what was measured, a question where that is a lot. scale: weighed over measured."""
    question = ", which is a lot: are the tickets in the unit of their column, and of these loads?" if is_a_lot(scale) else "."
    return f"the loads weigh {100.0 * (scale - 1.0):+.2f} % against what was measured{question}"


def is_a_lot(scale: float) -> bool:
    """Whether weighed over measured is so far from 1 that the tickets are doubtful."""
    return abs(log(scale)) > _A_LOT


def curve_sentence(found: LoadCalibration) -> str:
    """Sentence on the probability of another curve than the model's; "" if the model's own is used."""
    if found.another_law is None or found.refused:
        return ""
    known = found.parameter_set
    exponent, std_dev = known.values["load_pattern.exponent"], known.standard_deviation("load_pattern.exponent")
    chance = f"{100.0 * min(found.another_law.probability, 0.99):.0f} %"
    if found.another_law.probability > LIKELY_ANOTHER:
        return (
            f"the force follows another curve over the flow than the model's (probability {chance}): beside it goes a power of "
            f"the flow, {exponent:+.2f} (sd {std_dev:.2f}), fitted with density and impact gain (effect load_pattern)."
        )
    return (
        "these loads do not show whether the force follows the model's curve over the flow (probability of another one "
        f"{chance}): both count, in the values and in the standard deviation at other flows; weigh loads at other flows."
    )


def _another_law(found: LoadCalibration, law: AnotherLaw, sweeps: int) -> list[str]:
    """Sentences if the force may follow another curve over the flow than the model's."""
    out = [curve_sentence(found)]
    if law.scatter > _SCATTERS and law.scatters > _LIKELY_SCATTERS:
        out.append(
            f"the loads scatter by more than their tickets' deviations, about {100.0 * law.scatter:.1f} %: a ticket is wrong, or "
            "the machine or the grain changes from load to load."
        )
    if sweeps:
        out.append("sweeps of the plate are left out: what they show rests on the model's curve.")
    out += _next_load(found)
    return out


def _contradiction(found: Contradiction, named: bool) -> list[str]:
    """Sentence on the contradiction. named: whether a sentence already names a load that contradicts the others."""
    model, curve = (f"{100.0 * rms:.1f} % rms" for rms in (found.model_rms, found.curve_rms))
    better = found.curve_rms < found.model_rms
    if named:
        said = "if every ticket is right, the force follows another curve here: `--estimator alpha_beta` misses each left out by"
        return [f"{said} {curve}."] if better else []
    said = "no parameters of the model explain the loads together: a ticket is wrong, or the force follows another curve here"
    instead = f", and `--estimator alpha_beta` by {curve}: use that" if better else ""
    return [f"{said}; the model misses each load left out by {model}{instead}."]

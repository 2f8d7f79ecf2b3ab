"""Possible unmeasured mass in seconds whose flow is recomputed with another zero."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from yieldmon.engine.mass.missed_mass import NO_LOAD
from yieldmon.engine.mass.silences import Missing, Silences
from yieldmon.engine.mass.unseen import UnseenChange, UnseenMass


@dataclass(frozen=True, slots=True)
class RemeasuredSecond:
    """A second as it was counted, and as it is recomputed.

    Attributes
    ----------
    load_number : int
    duration_s : float
    covered_s : float
        Time with samples, at most `duration_s`; 0 if nothing was measured.
    enough : bool
        Whether the mean of the covered time is used for the whole second.
    elevator_speed_rad_s : float
        nan if it is not known.
    stands : bool
        Whether the elevator is too slow to bring grain.
    before_kg_s, after_kg_s : float
        Flow with the zero that is undone, and with the one that is restored.
    hidden : bool
        Whether the zero that is undone mistook grain for an empty plate, so that the second was not counted.
    """

    load_number: int
    duration_s: float
    covered_s: float
    enough: bool
    elevator_speed_rad_s: float
    stands: bool
    before_kg_s: float
    after_kg_s: float
    hidden: bool


def remeasured_unseen(seconds: Sequence[RemeasuredSecond], open_load: int) -> tuple[dict[int, UnseenChange], UnseenMass]:
    """Compute the possible unmeasured mass of successive seconds, as `Loads.count` does second by second.

    Parameters
    ----------
    seconds : sequence of RemeasuredSecond
        In order of time.
    open_load : int
        Number of the load that is open after the last second; `NO_LOAD` for none.

    Returns
    -------
    dict of int to UnseenChange
        By load number.
    UnseenMass
        State after the last second, with the restored zero.
    """
    before, _ = _unseen_by_load(seconds, [None if s.hidden else s.before_kg_s for s in seconds], open_load)
    after, since = _unseen_by_load(seconds, [s.after_kg_s for s in seconds], open_load)
    hidden: dict[int, float] = {}
    for second in seconds:
        if second.hidden and not second.enough:
            _add(hidden, second.load_number, second.after_kg_s * max(second.duration_s - second.covered_s, 0.0))
    numbers = sorted(before.keys() | after.keys())
    return {n: UnseenChange(before.get(n, 0.0), after.get(n, 0.0), hidden.get(n, 0.0)) for n in numbers}, since


def _unseen_by_load(
    seconds: Sequence[RemeasuredSecond], rates: Sequence[float | None], open_load: int
) -> tuple[dict[int, float], UnseenMass]:
    """Unmeasured mass by load number, kg, and the state after the last second. rates: flow of each second, kg/s; None if
    hidden."""
    found: dict[int, float] = {}
    unseen, silences, number = UnseenMass(), _while_running(), NO_LOAD
    for second, rate in zip(seconds, rates, strict=True):
        if second.load_number != number:
            _add(found, number, unseen.cut())
            number = second.load_number
        stands, speed, duration_s = second.stands, second.elevator_speed_rad_s, second.duration_s
        missing = None if second.covered_s > 0.0 else Missing.of(sampled=False, speed=speed, in_range=True, zeroed=True)
        whole = silences.lacks_nothing(duration_s, missing, stands=stands)
        if rate is None:
            continue
        _add(found, number, unseen.second(duration_s, rate, missing, whole=whole, stands=stands, silent=not speed >= 0.0))
        if missing is None and not second.enough:
            _add(found, number, rate * max(duration_s - second.covered_s, 0.0))
    if number != open_load:
        _add(found, number, unseen.cut())
    return found, unseen


def _while_running() -> Silences:
    """The state after a second in which the elevator ran."""
    silences = Silences()
    silences.lacks_nothing(1.0, None)
    return silences


def _add(to: dict[int, float], number: int, kg: float) -> None:
    if kg > 0.0:
        to[number] = to.get(number, 0.0) + kg

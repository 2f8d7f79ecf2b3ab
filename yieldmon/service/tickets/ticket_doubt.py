"""What is asked about a ticket as it is entered: a mass that contradicts its load by more than both are uncertain by.

A wrong unit, another load on the same ticket or the ticket of another load each make a known factor of the mass; where one of
them explains the ticket, the question names it with the mass that it would be. The ticket counts all the same: it may be right,
and it is the one moment at which an error of scale shows.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import exp, hypot, log

from yieldmon.estimation.weighing.ticket_slips import UNIT_SLIPS
from yieldmon.files.crops import crops, find_crop
from yieldmon.service.storage.batch import Load
from yieldmon.units import KG_PER_LB

_BUSHELS_LN = 0.2
"""Of two crops' bushels that may be taken for each other."""
_NAMED = 2
"""Explanations that a question names."""
_NEIGHBOURS = 3
"""Loads before and after, one of whose tickets may be taken for this one."""
_LEAST_SD = 0.012
"""Of ln of a load's mass: what no parameters know it better than."""
UNWEIGHED_SD = 0.25
"""The same beside what is stated, until a ticket has counted: a crop's parameters know nothing of the machine."""
_FAR_SDS, _LIKE_SDS, _NEARER = 3.0, 2.0, 3.0
"""Standard deviations from which a ticket contradicts its load, within which a slip explains it, and by which share it is then
nearer."""
_GROSS_SDS, _GROSS_LN = 4.0, log(1.25)
"""From which a ticket is asked about though nothing known explains it."""
_FIRST_SDS, _SECOND_SDS = 2.0, 2.5
"""In place of both where no ticket has counted, as it sets the scale alone, and where a single one has, which it checks."""
_TARES_KG = (3_000.0, 20_000.0)
"""Of trucks and trailers."""


@dataclass(frozen=True)
class Departure:
    """ln of a ticket over the mass that its loads are known to hold, and the standard deviation of that. first, second: no ticket
    has counted for these parameters, or a single one."""

    ln: float
    std_dev: float
    first: bool = False
    second: bool = False

    def beyond(self, sds: float, least_ln: float = 0.0) -> bool:
        """Whether it is further off than so many deviations and so much, or than a first or second ticket may be."""
        if self.first or self.second:
            return abs(self.ln) > (_FIRST_SDS if self.first else _SECOND_SDS) * self.std_dev
        return abs(self.ln) > sds * self.std_dev and abs(self.ln) > least_ln


def combined(parts: Sequence[tuple[float, tuple[float, float]]], *, weighed_before: bool, only_one: bool = False) -> Departure:
    """Of a ticket for several loads. parts: each load's share of the mass with what its own weighing departs by. weighed_before,
    only_one: a ticket has counted for these parameters, and a single one."""
    whole = sum(share for share, _ in parts)
    # The parameters are off alike for all of them.
    shares = [(share / whole, ln, sd) for share, (ln, sd) in parts]
    std_dev = max(sum(w * sd for w, _, sd in shares), _LEAST_SD)
    ln = sum(w * ln for w, ln, _ in shares)
    return Departure(ln, std_dev, second=only_one) if weighed_before else Departure(ln, hypot(std_dev, UNWEIGHED_SD), first=True)


def question(
    weighed_kg: float,
    found: Departure,
    covered: Sequence[Load],
    known_kg: Mapping[int, float],
    weighed: set[int],
    before_kg: Mapping[int, float] | None = None,
) -> str:
    """What is asked about a ticket that contradicts its loads; "" for any other.

    covered: its loads. known_kg: of each load, by number. weighed: loads with a ticket of their own. before_kg: of tickets that
    stand for the same loads, by number.
    """
    parts = [(weighed_kg / (weighed_kg + kg), f"ticket {number} is its other part") for number, kg in (before_kg or {}).items()]
    slips = _explaining(found, covered, known_kg, weighed, parts)
    if not slips and not found.beyond(_GROSS_SDS, _GROSS_LN):
        return ""
    expected_kg = weighed_kg * exp(-found.ln)
    tare_kg = weighed_kg - expected_kg
    if not slips and _TARES_KG[0] <= tare_kg <= _TARES_KG[1]:
        slips = [(weighed_kg / expected_kg, f"the truck's own {_mass(tare_kg)} or another combine's grain (--other) is on it")]
    more = "more" if found.ln > 0.0 else "less"
    off = f"{100.0 * abs(exp(found.ln) - 1.0):.1f} % {more} than the {_mass(expected_kg)} +- {100.0 * found.std_dev:.1f} %"
    what = " or ".join(f"{words} (then {_mass(weighed_kg / factor)})" for factor, words in slips)
    return f"{_mass(weighed_kg)} is {off} that it is known to hold{f', as if {what}' if what else ''}"


def _explaining(
    found: Departure,
    covered: Sequence[Load],
    known_kg: Mapping[int, float],
    weighed: set[int],
    parts: Sequence[tuple[float, str]],
) -> list[tuple[float, str]]:
    """The factors that explain a ticket, each with how it came in words: parts of a load, then units before others, at most
    two."""
    if not found.beyond(_FAR_SDS):
        return []
    near = min(_LIKE_SDS * found.std_dev, abs(found.ln) / _NEARER)
    each = [*parts, *UNIT_SLIPS, *sorted(_slips(covered, known_kg, weighed), key=lambda slip: abs(found.ln - log(slip[0])))]
    return [slip for slip in each if abs(found.ln - log(slip[0])) < near][:_NAMED]


def _slips(covered: Sequence[Load], known_kg: Mapping[int, float], weighed: set[int]) -> Iterator[tuple[float, str]]:
    own = {load.number for load in covered}
    own_kg = sum(known_kg[number] for number in own)
    for number, kg in known_kg.items():
        if number in own or not kg > 0.0:
            continue
        if number in (min(own) - 1, max(own) + 1) and number not in weighed:
            yield (own_kg + kg) / own_kg, f"load {number} is on it too"
        if len(own) == 1 and abs(number - min(own)) <= _NEIGHBOURS:
            yield kg / own_kg, f"it is that of load {number}"
    for number in own if len(own) > 1 else ():
        if 0.0 < known_kg[number] < own_kg:
            yield (own_kg - known_kg[number]) / own_kg, f"load {number} is not on it"
    known = find_crop(covered[-1].crop)
    for other in crops().values() if known is not None else ():
        if known is not None and 0.0 < abs(log(other.bushel_lb / known.bushel_lb)) < _BUSHELS_LN:
            yield other.bushel_lb / known.bushel_lb, f"its bushels were reckoned with the {other.bushel_lb:g} lb of {other.name}"


def _mass(kg: float) -> str:
    return f"{kg:,.0f} kg ({kg / KG_PER_LB:,.0f} lb)"

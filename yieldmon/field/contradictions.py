"""Tickets that the others of a harvest do not bear out: of another unit or another load."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from math import exp, log

import numpy as np

from yieldmon.estimation.weighing.ticket_slips import UNIT_SLIPS
from yieldmon.estimation.weighing.unlike_others import LEAST_LOADS, unlike_the_others
from yieldmon.files.ticket_file import unit_slip

_NEAR_LN = 0.07
"""Within which a factor may be that of a unit."""
_FAR_LN = 0.2
"""By which two tickets that are all there are contradict each other."""
_DOUBTFUL_LN = 0.7
"""By which a ticket differs from the monitor, with no third one that bears it out, where it is asked about: twice."""


@dataclass(frozen=True)
class HeldTicket:
    """A ticket as it stands against the harvest. name: of its loads, as it was given; mass_kg: weighed; loads: places of those
    that it is for."""

    name: str
    mass_kg: float
    loads: tuple[int, ...]


def contradictions(
    tickets: Sequence[HeldTicket], measured_kg: Mapping[int, float], kind: Mapping[int, Hashable]
) -> tuple[frozenset[int], tuple[str, ...]]:
    """Which tickets are left out, and lines on these, on pairs of which either may be wrong, and on one or two that are far from
    what was measured. One by a factor that no monitor is off by is left out, whatever the others are.

    Parameters
    ----------
    tickets : sequence of HeldTicket
        One at most for each load.
    measured_kg : mapping of int to float
        By the place of each load.
    kind : mapping of int to hashable
        Of each load: its ticket is held against those of loads of the same one.

    Returns
    -------
    left_out : frozenset of int
        Places in `tickets`.
    lines : tuple of str
    """
    left_out, lines = set[int](), list[str]()
    by_kind: dict[Hashable, list[int]] = {}
    for number, ticket in enumerate(tickets):
        if slip := unit_slip(ticket.mass_kg, sum(measured_kg[load] for load in ticket.loads)):
            left_out.add(number)
            lines.append(f"ticket of load {ticket.name} {slip}: left out; is its unit, its load or the harvest's unit wrong?")
            continue
        by_kind.setdefault(frozenset(kind[load] for load in ticket.loads), []).append(number)
    for numbers in by_kind.values():
        factors = [tickets[n].mass_kg / sum(measured_kg[load] for load in tickets[n].loads) for n in numbers]
        off = unlike_the_others(-np.log(factors))
        usual = exp(float(np.median(np.log(factors)[~off]))) if off.any() else 1.0
        for number, factor, is_off in zip(numbers, factors, off, strict=True):
            if is_off:
                left_out.add(number)
                lines.append(_left_out(tickets[number], factor / usual))
        if 1 < len(numbers) < LEAST_LOADS and abs(log(factors[0] / factors[1])) > _FAR_LN:
            names = " and ".join(tickets[n].name for n in numbers)
            lines.append(
                f"tickets of loads {names} contradict each other, {factors[0]:.3g} and {factors[1]:.3g} times what was measured: "
                "one is of another unit or load"
            )
        elif len(numbers) < LEAST_LOADS:
            lines += [
                _far(tickets[n], factor) for n, factor in zip(numbers, factors, strict=True) if abs(log(factor)) > _DOUBTFUL_LN
            ]
    return frozenset(left_out), tuple(lines)


def _far(ticket: HeldTicket, times: float) -> str:
    return (
        f"ticket of load {ticket.name} weighs {ticket.mass_kg:.0f} kg, {times:.3g} times what was measured{_slip(times)}: "
        "are its unit and load right?"
    )


def _slip(times: float) -> str:
    return next((f", as if {what}" for factor, what in UNIT_SLIPS if abs(log(times / factor)) < _NEAR_LN), "")


def _left_out(ticket: HeldTicket, times: float) -> str:
    says = f"{ticket.mass_kg:.0f} kg, {times:.3g} times what the other tickets give for it"
    return f"ticket of load {ticket.name} weighs {says}{_slip(times)}: left out"

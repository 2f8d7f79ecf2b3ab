"""Tickets that the others of a harvest do not bear out: of another unit, another load, or of loads that two tickets weigh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import exp, log

import numpy as np

from yieldmon.estimation.weighing.ticket_slips import UNIT_SLIPS
from yieldmon.estimation.weighing.unlike_others import LEAST_LOADS, unlike_the_others

_NEAR_LN = 0.07
"""Within which a factor may be that of a unit."""
_FAR_LN = 0.2
"""By which two tickets that are all there are contradict each other."""


@dataclass(frozen=True)
class HeldTicket:
    """A ticket as it stands against the harvest. name: of its loads, as it was given; mass_kg: weighed; loads: places of those
    that it is for."""

    name: str
    mass_kg: float
    loads: tuple[int, ...]


def contradictions(
    tickets: Sequence[HeldTicket], measured_kg: Mapping[int, float], owner: Mapping[int, int]
) -> tuple[frozenset[int], tuple[str, ...]]:
    """Which tickets are left out, and lines on these and on pairs of which either may be wrong.

    Parameters
    ----------
    tickets : sequence of HeldTicket
    measured_kg : mapping of int to float
        By the place of each load.
    owner : mapping of int to int
        The machine of each load: they are held against others of the same one.

    Returns
    -------
    left_out : frozenset of int
        Places in `tickets`.
    lines : tuple of str
    """
    by_owner: dict[int, list[list[int]]] = {}
    for group in _sharing_loads(tickets):
        by_owner.setdefault(owner[tickets[group[0]].loads[0]], []).append(group)
    left_out, lines = set[int](), list[str]()
    for groups in by_owner.values():
        masses_kg = [sum(tickets[n].mass_kg for n in group) for group in groups]
        factors = [kg / _measured(tickets, group, measured_kg) for kg, group in zip(masses_kg, groups, strict=True)]
        off = unlike_the_others(-np.log(factors))
        usual = exp(float(np.median(np.log(factors)[~off]))) if off.any() else 1.0
        for group, kg, factor, is_off in zip(groups, masses_kg, factors, off, strict=True):
            if is_off:
                left_out.update(group)
                lines.append(_left_out([tickets[n].name for n in group], kg, factor / usual))
        if 1 < len(groups) < LEAST_LOADS and abs(log(factors[0] / factors[1])) > _FAR_LN:
            names = " and ".join(tickets[n].name for group in groups for n in group)
            lines.append(
                f"tickets of loads {names} contradict each other, {factors[0]:.3g} and {factors[1]:.3g} times what was measured: "
                "one is of another unit or load"
            )
    return frozenset(left_out), tuple(lines)


def _sharing_loads(tickets: Sequence[HeldTicket]) -> list[list[int]]:
    """Tickets that have a load in common, directly or by others between them, go together."""
    groups: list[tuple[set[int], list[int]]] = []
    for number, ticket in enumerate(tickets):
        loads, members = set(ticket.loads), [number]
        apart = []
        for known, of_known in groups:
            if known & loads:
                loads |= known
                members = [*of_known, *members]
            else:
                apart.append((known, of_known))
        groups = [*apart, (loads, members)]
    return [sorted(members) for _, members in groups]


def _measured(tickets: Sequence[HeldTicket], group: Sequence[int], measured_kg: Mapping[int, float]) -> float:
    return sum(measured_kg[load] for load in {load for number in group for load in tickets[number].loads})


def _left_out(names: Sequence[str], kg: float, times: float) -> str:
    says = f"{kg:.0f} kg, {times:.3g} times what the other tickets say of"
    if len(names) > 1:
        whole = ", ".join(names)
        return f"tickets of loads {whole} weigh {says} these: left out; of a load on two tickets each needs its part alone"
    slip = next((f", as where {what}" for factor, what in UNIT_SLIPS if abs(log(times / factor)) < _NEAR_LN), "")
    return f"ticket of load {names[0]} weighs {says} it{slip}: left out"

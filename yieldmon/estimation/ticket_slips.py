"""Ways in which tickets can be wrong, each as a hypothesis about the loads' masses.

A wrong ticket is either a known slip, which shifts the logarithm of a mass by a known amount (pounds for kilograms, two digits or
two tickets exchanged), or any error, which leaves the load saying nothing.

Source: Box and Tiao, "A Bayesian approach to some outlier problems", Biometrika 55 (1968) 119.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from yieldmon.physics.numerics import Array
from yieldmon.units import KG_PER_LB

_KG_PER_SHORT_TON = 2000.0 * KG_PER_LB
_UNITS = (
    (1.0 / KG_PER_LB, "pounds were taken for kilograms"),
    (KG_PER_LB, "kilograms were taken for pounds"),
    (1000.0 / _KG_PER_SHORT_TON, "short tons were taken for tonnes"),
)
"""Ticket over the load's mass, where the ticket is of another unit than its column."""
_ANY = ((0.12, 0.01), (0.6, 0.005))
"""Standard deviations of ln of a ticket that is wrong in no known way, by some of the load or by much of it, and the probability
of either before any load."""
_OF_UNIT, _OF_DIGITS, _OF_PAIR = 0.002, 0.001, 0.004
"""The same of a unit, of two digits exchanged, and of two tickets exchanged, each shared among those there may be: assumptions.
`_ANY` was chosen on a linear model of loads that is not kept (studies/load_laws)."""
_LEAST_LN = 0.03
"""Error of a mass below which a slip is no gross one."""


@dataclass(frozen=True)
class Slip:
    """One way for the tickets to be wrong.

    loads: whose tickets. shift: (n,) ln of ticket over the load's mass by it. variance: (n,) of ln beside what is stated. prior:
    its probability before the loads. what: what happened, in words, "" for an error of no known kind.
    """

    loads: tuple[int, ...]
    shift: Array
    variance: Array
    prior: float
    what: str


def slips(weighed_kg: Array) -> tuple[Slip, ...]:
    """All for loads of these tickets, (n,); none for a single load, which is accepted."""
    return tuple(_each(weighed_kg)) if weighed_kg.size > 1 else ()


def _each(weighed_kg: Array) -> Iterator[Slip]:
    count, none = weighed_kg.size, np.zeros(weighed_kg.size)
    for k in range(count):
        one = np.eye(count)[k]
        for std_dev, likely in _ANY:
            yield Slip((k,), none, std_dev**2 * one, likely, "")
        for factor, what in _UNITS:
            yield Slip((k,), np.log(factor) * one, none, _OF_UNIT, what)
        exchanged = list(_digits(float(weighed_kg[k])))
        for other_kg in exchanged:
            ln = float(np.log(weighed_kg[k] / other_kg))
            yield Slip((k,), ln * one, none, _OF_DIGITS / len(exchanged), f"two digits of {other_kg:.0f} kg were exchanged")
    pairs = list(combinations(range(count), 2))
    for i, j in pairs:
        ln = float(np.log(weighed_kg[i] / weighed_kg[j]))
        if abs(ln) > _LEAST_LN:
            yield Slip(
                (i, j), ln * (np.eye(count)[i] - np.eye(count)[j]), none, _OF_PAIR / len(pairs), "two tickets were exchanged"
            )


def _digits(weighed_kg: float) -> Iterator[float]:
    """Masses whose digits, two neighbours exchanged, are this one's."""
    text = f"{weighed_kg:.0f}"
    for i in range(len(text) - 1):
        other_kg = float(text[:i] + text[i + 1] + text[i] + text[i + 2 :])
        if other_kg > 0.0 and abs(np.log(weighed_kg / other_kg)) > _LEAST_LN:
            yield other_kg

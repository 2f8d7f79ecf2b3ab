"""Ways in which tickets can be wrong, each as a hypothesis about the loads' masses.

There are three kinds: a known slip, which shifts the logarithm of a mass by a known amount (pounds for kilograms, two digits or
two tickets exchanged, another load on the same ticket); a tare that is the same in all tickets; and an arbitrary error, after
which the ticket contains no information on the load.

Source: Box and Tiao, "A Bayesian approach to some outlier problems", Biometrika 55 (1968) 119.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import Enum
from itertools import combinations

import numpy as np

from yieldmon.physics.numerics import Array
from yieldmon.units import KG_PER_LB, KG_PER_SHORT_TON, KG_PER_T

UNIT_SLIPS = (
    (1.0 / KG_PER_LB, "pounds were taken for kilograms"),
    (KG_PER_LB, "kilograms were taken for pounds"),
    (KG_PER_T / KG_PER_SHORT_TON, "short tons were taken for tonnes"),
    (KG_PER_SHORT_TON / KG_PER_T, "tonnes were taken for short tons"),
)
"""Ratio of ticket to mass if the ticket is in another unit than its column. The last one is tried only among several loads."""
_ANY = ((0.12, 0.01), (0.6, 0.005))
"""(standard deviation of ln, prior probability) of an arbitrary error of a ticket: by part of the load, and by much of it."""
_OF_UNIT, _OF_DIGITS, _OF_NEIGHBOUR, _OF_PAIR, _OF_TARE = 0.002, 0.001, 0.001, 0.004, 0.01
"""Prior probabilities (assumptions) of a wrong unit, two exchanged digits, a neighbouring load on the same ticket, two exchanged
tickets, and a tare in all of them. Each is divided among the possible slips of its kind. `_ANY` was chosen on a linear model of
loads that is not kept (studies/load_laws)."""
_LEAST_OF_SEVERAL = 3
"""Number of loads below which a tare, a neighbouring load on a ticket and tonnes for short tons look like any other error."""
_UNLIKE = 1.3
"""Ratio of the heaviest to the lightest ticket below which a tare changes all masses by nearly the same factor."""
_LEAST_LN = 0.03
"""Least change of ln mass by a slip that is considered."""
_TARES_LN, _TARE_SD = (-0.75, -0.45, -0.15, 0.15, 0.45, 0.75, 1.05), 0.15
"""Changes of ln of the lightest ticket by a tare that are tried, and the standard deviation about each; negative: the tare was
subtracted twice."""


class SlipKind(Enum):
    """Kind of error: one wrong ticket, two exchanged tickets, or a tare in all tickets."""

    ONE = "one"
    EXCHANGED = "exchanged"
    TARE = "tare"


@dataclass(frozen=True)
class Slip:
    """One hypothesis of how the tickets of n loads are wrong.

    Attributes
    ----------
    loads : tuple of int
        Indices of the loads whose tickets are wrong.
    shift : ndarray (n,)
        Mean ln(ticket / mass) of each load.
    variance : ndarray (n,)
        Variance of ln of each ticket beyond the stated one, independent between loads.
    prior : float
        Prior probability.
    what : str
        Description for the user, "" for an arbitrary error.
    kind : SlipKind
    along : ndarray (n,) or (0,)
        One standard deviation of an error of ln common to the loads; empty if there is none.
    """

    loads: tuple[int, ...]
    shift: Array
    variance: Array
    prior: float
    what: str
    kind: SlipKind = SlipKind.ONE
    along: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def covariance(self) -> Array:
        """Covariance of ln(ticket / mass), (n, n)."""
        own = np.diag(self.variance)
        return own + np.outer(self.along, self.along) if self.along.size else own


def slips(weighed_kg: Array, names: Sequence[str], *, all_off: bool = False) -> tuple[Slip, ...]:
    """All hypotheses for a sequence of loads; none for a single load, which is always accepted.

    Parameters
    ----------
    weighed_kg : ndarray (n,)
        Tickets in the order of weighing, kg.
    names : sequence of str
        Names of the loads.
    all_off : bool
        Whether all masses are off by a factor too large for a tare.
    """
    if weighed_kg.size < 2:
        return ()
    unlike = weighed_kg.size >= _LEAST_OF_SEVERAL and np.max(weighed_kg) > _UNLIKE * np.min(weighed_kg) and not all_off
    return (*_of_one(weighed_kg, names), *_exchanged(weighed_kg), *(_tares(weighed_kg) if unlike else ()))


def title(name: str) -> str:
    """Name of a load in a sentence. Loads of the daemon already begin with "load"."""
    return name if name.startswith("load ") else f"load {name}"


def tare_kg(weighed_kg: Array, lightest_ln: float) -> float:
    """The tare in every ticket that changes ln of the lightest one by `lightest_ln`, kg."""
    return float(np.min(weighed_kg) * -np.expm1(-lightest_ln))


def _of_one(weighed_kg: Array, names: Sequence[str]) -> Iterator[Slip]:
    count, none = weighed_kg.size, np.zeros(weighed_kg.size)
    for k in range(count):
        one = np.eye(count)[k]
        for std_dev, likely in _ANY:
            yield Slip((k,), none, std_dev**2 * one, likely, "")
        for factor, what in UNIT_SLIPS if count >= _LEAST_OF_SEVERAL else UNIT_SLIPS[:-1]:
            yield Slip((k,), np.log(factor) * one, none, _OF_UNIT, what)
        meant = list(_digits(float(weighed_kg[k])))
        for other_kg in meant:
            ln = float(np.log(weighed_kg[k] / other_kg))
            yield Slip((k,), ln * one, none, _OF_DIGITS / len(meant), f"two digits of {other_kg:.0f} kg were exchanged")
        for j in (k - 1, k + 1) if count >= _LEAST_OF_SEVERAL else ():
            if 0 <= j < count and weighed_kg[k] > weighed_kg[j]:
                ln = float(-np.log1p(-weighed_kg[j] / weighed_kg[k]))
                yield Slip((k,), ln * one, none, 0.5 * _OF_NEIGHBOUR, f"{title(names[j])} is on its ticket too")


def _exchanged(weighed_kg: Array) -> Iterator[Slip]:
    count, none = weighed_kg.size, np.zeros(weighed_kg.size)
    pairs = list(combinations(range(count), 2))
    for i, j in pairs:
        ln = float(np.log(weighed_kg[i] / weighed_kg[j]))
        if abs(ln) > _LEAST_LN:
            shift = ln * (np.eye(count)[i] - np.eye(count)[j])
            yield Slip((i, j), shift, none, _OF_PAIR / len(pairs), "two tickets were exchanged", SlipKind.EXCHANGED)


def _tares(weighed_kg: Array) -> Iterator[Slip]:
    every, none = tuple(range(weighed_kg.size)), np.zeros(weighed_kg.size)
    for ln in _TARES_LN:
        grain_kg = weighed_kg - tare_kg(weighed_kg, ln)
        # d(shift) / d(ln of the lightest), which is 1 for the lightest itself.
        along = _TARE_SD * float(np.min(weighed_kg)) * float(np.exp(-ln)) / grain_kg
        shift = np.log(weighed_kg / grain_kg)
        yield Slip(every, shift, none, _OF_TARE / len(_TARES_LN), "", SlipKind.TARE, along)


def _digits(weighed_kg: float) -> Iterator[float]:
    """Masses that become this one when two neighbouring digits are exchanged."""
    text = f"{weighed_kg:.0f}"
    for i in range(len(text) - 1):
        other_kg = float(text[:i] + text[i + 1] + text[i] + text[i + 2 :])
        if other_kg > 0.0 and abs(np.log(weighed_kg / other_kg)) > _LEAST_LN:
            yield other_kg

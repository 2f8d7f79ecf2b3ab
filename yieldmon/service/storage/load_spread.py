"""How far the mass of a load may be off that was corrected: by tickets, by parameters that measured it again, or as measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, sqrt

from yieldmon.engine.mass.budget import MassBudget

_OWN_OF_COMMON = 0.1
"""Of the variance by an error that loads are stated with in common, where nothing says at which flow it is how large: the part
that is of each load's own flow, so that a ticket for it together with others leaves it."""


def divided(common: float) -> tuple[float, float]:
    """Such an error's standard deviation: the part that loads share, and that of each load alone."""
    return (1.0 - _OWN_OF_COMMON) ** 0.5 * common, _OWN_OF_COMMON**0.5 * common


@dataclass(frozen=True)
class ParameterSpread:
    """Relative standard deviation of a load's mass by the parameters that measured it again.

    Parameters
    ----------
    shared : tuple of float
        By directions in which the parameters are unsure, independent of one another; the same ones, in this order, for all loads
        that were measured again together.
    own : float
        By the model's own error.
    """

    shared: tuple[float, ...]
    own: float

    @property
    def document(self) -> list[float]:
        """As it is kept: `own` last."""
        return [*(float(f"{part:.4g}") for part in self.shared), float(f"{self.own:.4g}")]

    @classmethod
    def of_document(cls, numbers: Sequence[float]) -> ParameterSpread:
        """Inverse of `document`."""
        return cls(tuple(map(float, numbers[:-1])), float(numbers[-1]))


@dataclass(frozen=True)
class LoadSpread:
    """Relative standard deviation of a load's mass as measured or measured again: what it shares with others, and the rest.

    Parameters
    ----------
    shared : tuple of float
        By independent causes, each the same error in all loads that have it at this place.
    own : float
        By what is of this load alone.
    measured_by : int
        Number of the action that measured it again, 0 for a load as measured: loads with another one have other causes.
    """

    shared: tuple[float, ...]
    own: float
    measured_by: int = 0

    @property
    def std_dev(self) -> float:
        """All causes together."""
        return hypot(*self.shared, self.own)

    @classmethod
    def of(cls, mass_kg: float, budget: MassBudget, again: ParameterSpread | None, measured_by: int) -> LoadSpread:
        """Of a load with this mass, above 0, and budget as measured. again: None where it is as it was measured, or nothing else
        is known."""
        moisture, zero, motion = (kg / mass_kg for kg in (budget.moisture_kg, budget.zero_kg, budget.motion_kg))
        noise = sqrt(budget.noise_kg2) / mass_kg
        if again is None:
            shared, own = divided(budget.parameters_kg / mass_kg)
            return cls((moisture, zero, motion, shared), hypot(noise, own), 0)
        return cls((moisture, zero, motion, *again.shared), hypot(noise, again.own), measured_by)


def shares_std_dev(spreads: Sequence[LoadSpread], shares: Sequence[float], of_all: float) -> list[float]:
    """Relative standard deviations of loads that together are known by a ticket, and divide its mass as they were measured.

    What all of them are off by does not matter, only by how much one is off otherwise than the others.

    Parameters
    ----------
    spreads : sequence of LoadSpread
    shares : sequence of float
        Of the ticket's mass, 1 together, or less where a part of it is of loads that are not known.
    of_all : float
        Relative standard deviation of the ticket.

    Returns
    -------
    list of float
    """
    alike = len({(spread.measured_by, len(spread.shared)) for spread in spreads}) == 1
    if not alike:
        # What is common to loads that were measured by different parameters is not known.
        spreads = [LoadSpread((), spread.std_dev) for spread in spreads]
    lost = max(1.0 - sum(shares), 0.0)
    if lost > 0.0:
        widest = max(spreads, key=lambda spread: spread.std_dev)
        spreads, shares = [*spreads, LoadSpread(tuple(0.0 for _ in widest.shared), widest.std_dev)], [*shares, lost]
    mean = [sum(w * s.shared[k] for w, s in zip(shares, spreads, strict=True)) for k in range(len(spreads[0].shared))]
    own = [w * s.own for w, s in zip(shares, spreads, strict=True)]
    found = []
    for i, (share, spread) in enumerate(zip(shares, spreads, strict=True)):
        apart = (here - all_of_them for here, all_of_them in zip(spread.shared, mean, strict=True))
        others = (part for j, part in enumerate(own) if j != i)
        found.append(hypot(of_all, *apart, (1.0 - share) * spread.own, *others))
    return found if not lost else found[:-1]

"""What is said of a ticket that none of its machine's others bears out, and of a machine that none of the others does."""

from __future__ import annotations

from math import exp

from yieldmon.estimation.weighing.ticket_slips import UNIT_SLIPS
from yieldmon.units import KG_PER_T

_SLIPS = (
    *UNIT_SLIPS,
    (KG_PER_T, "kilograms were taken for tonnes"),
    (1.0 / KG_PER_T, "tonnes were taken for kilograms"),
)
_MANY = 1000.0
_NEAR = 1.15
"""Within which a factor may be that of a slip, beside how machines differ."""


def in_words(weighed_kg: float, times: float) -> str:
    """A ticket of so many kg, so many times what the machine's other tickets make of its load.

    Examples
    --------
    >>> in_words(9120.0, 2.0)
    "weighs 9120 kg, 2 times what the machine's other tickets say of it"
    """
    return f"weighs {weighed_kg:.0f} kg, {times:.3g} times what the machine's other tickets say of it"


def in_words_of_density(machine: str, log_times: float) -> str:
    """A machine whose tickets together ask for grain exp(log_times) times as dense as that of the other machines.

    Examples
    --------
    >>> in_words_of_density("m2", -1.4)
    "m2: its tickets contradict each other, as where a weight is wrong: they ask for grain 0.247 times as dense as others' do"
    """
    return (
        f"{machine}: its tickets contradict each other, as where a weight is wrong: "
        f"they ask for grain {exp(log_times):.3g} times as dense as others' do"
    )


def in_words_of_all(machine: str, log_times: float) -> str:
    """A machine whose tickets weigh exp(log_times) times what those of the other machines make of its loads.

    Examples
    --------
    >>> in_words_of_all("m2", 0.8)
    "m2: its tickets weigh 2.23 times what the other machines' say of its loads, as where pounds were taken for kilograms"
    """
    times = exp(log_times)
    return f"{machine}: its tickets weigh {times:.3g} times what the other machines' say of its loads{_as_where(times)}"


def in_words_of_measured(log_times: float) -> str:
    """A machine whose tickets weigh exp(log_times) times what was measured of its loads.

    Examples
    --------
    >>> in_words_of_measured(6.9)
    "the machine's tickets weigh 992 times what was measured, as where kilograms were taken for tonnes"
    """
    times = exp(log_times)
    shown = f"{times:.3g}" if times < _MANY else f"{times:.0f}"
    return f"the machine's tickets weigh {shown} times what was measured{_as_where(times)}"


def _as_where(times: float) -> str:
    slip = next((what for factor, what in _SLIPS if 1.0 / _NEAR < times / factor < _NEAR), "")
    return f", as where {slip}" if slip else ""

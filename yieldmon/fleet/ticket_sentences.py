"""Sentences on tickets that contradict the other tickets of their machine, or those of the other machines."""

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
"""From which factors are shown as whole numbers."""
_NEAR = 1.15
"""A factor that differs by less than this from that of a slip may be the slip, as machines differ too."""


def contradicting_ticket(weighed_kg: float, times: float) -> str:
    """On a ticket of a mass in kg; times: what it is of the mass by the machine's other tickets.

    Examples
    --------
    >>> contradicting_ticket(9120.0, 2.0)
    "weighs 9120 kg, 2 times what the machine's other tickets make of its load"
    """
    return f"weighs {weighed_kg:.0f} kg, {times:.3g} times what the machine's other tickets make of its load"


def contradicting_density(machine: str, log_times: float) -> str:
    """On a machine whose tickets together imply grain exp(log_times) times as dense as that of the other machines.

    Examples
    --------
    >>> contradicting_density("m2", -1.4)
    "m2: its tickets contradict each other, as if a weight were wrong: they imply grain 0.247 times as dense as the others'"
    """
    return (
        f"{machine}: its tickets contradict each other, as if a weight were wrong: "
        f"they imply grain {exp(log_times):.3g} times as dense as the others'"
    )


def contradicting_machine(machine: str, log_times: float) -> str:
    """On a machine whose tickets weigh exp(log_times) times what those of the other machines make of its loads.

    Examples
    --------
    >>> contradicting_machine("m2", 0.8)
    "m2: its tickets weigh 2.23 times what the other machines' make of its loads, as if pounds were taken for kilograms"
    """
    times = exp(log_times)
    return f"{machine}: its tickets weigh {times:.3g} times what the other machines' make of its loads{_as_if(times)}"


def contradicting_measurement(log_times: float) -> str:
    """On a machine whose tickets weigh exp(log_times) times the measured mass of its loads.

    Examples
    --------
    >>> contradicting_measurement(6.9)
    "the machine's tickets weigh 992 times what was measured, as if kilograms were taken for tonnes"
    """
    times = exp(log_times)
    shown = f"{times:.3g}" if times < _MANY else f"{times:.0f}"
    return f"the machine's tickets weigh {shown} times what was measured{_as_if(times)}"


def _as_if(times: float) -> str:
    slip = next((what for factor, what in _SLIPS if 1.0 / _NEAR < times / factor < _NEAR), "")
    return f", as if {slip}" if slip else ""

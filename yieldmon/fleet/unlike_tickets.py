"""What is said of a ticket that none of its machine's others bears out."""

from __future__ import annotations


def in_words(weighed_kg: float, times: float) -> str:
    """A ticket of so many kg, so many times what the machine's other tickets make of its load.

    Examples
    --------
    >>> in_words(9120.0, 2.0)
    "weighs 9120 kg, 2 times what the machine's other tickets say of it"
    """
    return f"weighs {weighed_kg:.0f} kg, {times:.3g} times what the machine's other tickets say of it"

"""What a DBC's names say of a switch: which raw value is which state of the quantity."""

from __future__ import annotations

import re
from collections.abc import Mapping

from yieldmon.bus.databases import SignalBits

_END = r"(?![a-z])"
_ON = rf"on{_END}|engaged|active|working|running"
_OFF = rf"off{_END}|disengaged|inactive|idle|stopped|not"
_NAMES: Mapping[str, tuple[str, str]] = {
    "header_down": (rf"down{_END}|lowered|cutting|working", rf"up{_END}|raised|lifted|transport|not"),
    "work_state": (_ON, _OFF),
    "unloading": (rf"{_ON}|unloading", _OFF),
}
"""Quantity -> names of raw values that are its codes 1 and 0; those of 0 first: "inactive" is not "active"."""


def codes_by_name(quantity: str, bits: SignalBits) -> Mapping[int, int]:
    """Raw value -> code where the DBC's names say that they differ; empty where they do not, or say nothing.

    Parameters
    ----------
    quantity : str
    bits : SignalBits
        Its value table is looked at and, of a header's switch without one that tells, the signal's own name.

    Returns
    -------
    dict of int to int
    """
    if quantity not in _NAMES:
        return {}
    on, off = (re.compile(rf"(?<![a-z])(?:{names})", re.IGNORECASE) for names in _NAMES[quantity])
    of_off = {raw for name, raw in bits.choices.items() if off.search(name)}
    of_on = {raw for name, raw in bits.choices.items() if on.search(name)} - of_off
    if len(of_on) == len(of_off) == 1 and (of_on, of_off) != ({1}, {0}):
        return {of_on.pop(): 1, of_off.pop(): 0}
    name = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", bits.name)
    if quantity == "header_down" and not of_on | of_off and off.search(name) and not on.search(name):
        return {0: 1, 1: 0}
    return {}

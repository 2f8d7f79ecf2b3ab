"""What brings parameters into use, as stores, datasets and documents name it."""

from __future__ import annotations

from enum import StrEnum


class ParameterOrigin(StrEnum):
    """What brought the parameters in use.

    Attributes
    ----------
    FILE
        A parameter file.
    STORE
        The store remembers them from before the start.
    HARDWARE
        They begin anew after a change of the machine's parts.
    CROP
        A change of crop.
    SWEEP, TICKET, KERNELS
        An update by a sweep, by a reference mass alone, by kernel noise.
    DRIFT
        Between updates, their estimated steady drift.
    UNDO
        An undo restored them.
    """

    FILE = "file"
    STORE = "store"
    HARDWARE = "hardware"
    CROP = "crop"
    SWEEP = "sweep"
    TICKET = "ticket"
    KERNELS = "kernels"
    DRIFT = "drift"
    UNDO = "undo"

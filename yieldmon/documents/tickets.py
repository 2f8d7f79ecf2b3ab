"""What `yieldmon ticket ... --json` prints."""

from __future__ import annotations

from typing import TypedDict

from .common import Answered, Number
from .undo import TicketUndone


class TruckDocument(TypedDict):
    """A weighed truck that another combine filled as well. other_kg: by that one's own monitor."""

    truck_kg: float
    other_kg: float
    other_std_dev_kg: float


class StillReplaced(TypedDict):
    """A ticket, and the one by which it is replaced."""

    ticket: int
    by: int


class TicketEntered(TypedDict):
    """A ticket, and what comes of it.

    weighed_mass_kg: of these loads; of a truck the best of what the other combine leaves (own_mass_kg) and of what was measured.
    known_mass_kg: measured_mass_kg as corrected before. factor: weighed over measured. is_reference: whether it is a reference
    mass for the calibration, else why_no_reference; waits_for_crop: for whose return. question: what is doubtful of it. replaces:
    tickets that stood for these loads and count no more; taken_back: what became of their updates; without_ticket: their other
    loads with grain; still_replaced: tickets that they alone replace, which an undo of them brings back.
    sets_scale_pct: of the first ticket, what it moves the scale by.
    """

    crop: str
    ticket: int
    first_load: int
    last_load: int
    weighed_mass_kg: float
    truck: TruckDocument | None
    own_mass_kg: float
    own_std_dev_kg: float
    measured_mass_kg: float
    known_mass_kg: float
    factor: float
    is_reference: bool
    why_no_reference: str
    waits_for_crop: str
    question: str
    replaces: list[int]
    taken_back: list[TicketUndone]
    without_ticket: list[int]
    still_replaced: list[StillReplaced]
    sets_scale_pct: Number


class TicketDocument(TicketEntered, Answered):
    """`yieldmon ticket LOAD MASS --json`."""


class TicketRow(TypedDict):
    """A ticket as entered. time_s, undone_s: Unix time; who, undone_by: the user."""

    time_s: float
    first_load: int
    last_load: int
    weighed_mass_kg: float
    measured_mass_kg: float
    note: str
    number: int
    who: str
    truck: TruckDocument | None
    undone_s: Number
    undone_by: str | None


class ListedTicket(TicketRow):
    """The same with what became of it."""

    state: str


class Tickets(TypedDict):
    """All tickets, in order."""

    tickets: list[ListedTicket]


class TicketListDocument(Tickets, Answered):
    """`yieldmon ticket list --json`."""


class TicketUndoDocument(TicketUndone, Answered):
    """`yieldmon ticket undo --json`."""

"""What was taken back, of a ticket or a calibration."""

from __future__ import annotations

from typing import NotRequired, TypedDict


class NotUpdated(TypedDict):
    """A ticket that updates the parameters no more, and why."""

    ticket: int
    why: str


class CalibrationUndone(TypedDict):
    """A calibration that was taken back. undone to until: versions of the parameters that went with it; version, effects, crop:
    of those from before them; crop "" for the one harvested now. silenced: tickets that only correct their loads from now on.
    updated_again: tickets that update the parameters from before again; standing_tickets: those that do not. sweeps_undone:
    sweeps, and kernel noise, whose updates went."""

    undone: int
    until: int
    version: int
    effects: list[str]
    crop: str
    silenced: list[int]
    updated_again: list[int]
    standing_tickets: list[int]
    not_updated_again: list[NotUpdated]
    sweeps_undone: int


class TicketUndone(TypedDict):
    """A ticket that was taken back. undone to until: versions of the parameters that went with it; version, effects, crop: of
    those from before them; crop "" for the one harvested now. updated_again: tickets that update these again; standing_tickets:
    those that do not. sweeps_undone: sweeps, and kernel noise, whose updates went. update_kept_because: why its update
    could not be taken back."""

    ticket: int
    first_load: int
    last_load: int
    undone: NotRequired[int]
    until: NotRequired[int]
    version: NotRequired[int]
    effects: NotRequired[list[str]]
    crop: NotRequired[str]
    standing_tickets: NotRequired[list[int]]
    update_kept_because: NotRequired[str]
    updated_again: NotRequired[list[int]]
    not_updated_again: NotRequired[list[NotUpdated]]
    sweeps_undone: NotRequired[int]

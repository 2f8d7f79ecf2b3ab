"""What `yieldmon load ACTION --json` prints."""

from __future__ import annotations

from typing import NotRequired, TypedDict

from .common import Answered, Number
from .undo import NotUpdated, TicketUndone


class CropParameters(TypedDict):
    """Parameters in use. crop: that they are of, null where nothing says so; changed: by this command; carried_from: the crop
    whose weighed loads set the scale, where it is another one's, else ""."""

    version: int
    crop: str | None
    changed: bool
    carried_from: str


class LoadStarted(TypedDict):
    """A load that began. crop_known: whether there are parameters of the crop."""

    load: int
    field: str
    crop: str
    parameters: CropParameters
    crop_known: bool


class LoadStartDocument(LoadStarted, Answered):
    """`yieldmon load start --json`."""


class LoadStopped(TypedDict):
    """A load that is complete. mass_kg: as measured."""

    load: int
    mass_kg: float
    crop: str


class LoadStopDocument(LoadStopped, Answered):
    """`yieldmon load stop --json`."""


class ListedLoad(TypedDict):
    """A load. started_s, ended_s: Unix time; mass_kg with std_dev_kg, dry_mass_kg: as measured; posted_mass_kg: as recomputed
    with newer parameters; ticket_mass_kg: as weighed for all loads of the ticket; corrected_mass_kg with corrected_std_dev_kg,
    corrected_dry_mass_kg: the best of these."""

    number: int
    field: str
    crop: str
    started_s: Number
    ended_s: Number
    mass_kg: float
    dry_mass_kg: Number
    area_m2: Number
    posted_mass_kg: Number
    ticket_mass_kg: Number
    corrected_mass_kg: float
    corrected_dry_mass_kg: Number
    ticket_id: int | None
    std_dev_kg: Number
    corrected_std_dev_kg: Number


class Loads(TypedDict):
    """Loads, in order. empty_loads: numbers of the complete loads in which nothing was measured; loads has them with `--all`
    only."""

    loads: list[ListedLoad]
    empty_loads: list[int]


class LoadSum(TypedDict):
    """Loads with grain of a field and crop, from one harvest of them. started_s, ended_s: Unix time, of the first and the last;
    weighed: how many have a ticket; masses as of `ListedLoad`, with the area null where one load's is not known."""

    field: str
    crop: str
    started_s: Number
    ended_s: Number
    loads: int
    weighed: int
    mass_kg: float
    corrected_mass_kg: float
    corrected_std_dev_kg: Number
    corrected_dry_mass_kg: Number
    area_m2: Number


class LoadListDocument(Loads, Answered):
    """`yieldmon load list --json`. sums: with `--sums`."""

    sums: NotRequired[list[LoadSum]]


class NotMeasured(TypedDict):
    """A load that was not recomputed, and why."""

    load: int
    why: str


class LoadsCorrected(TypedDict):
    """Loads with other names; field, crop: null where it stays. measured_again: loads, by the crop's parameters; updated_again:
    tickets that update these; taken_back: their updates of the other crop. goes_on: the crop that the next load still has, ""
    for the same. Without another crop there are names only."""

    first_load: int
    last_load: int
    field: str | None
    crop: str | None
    goes_on: str
    measured_again: NotRequired[list[int]]
    not_measured_again: NotRequired[list[NotMeasured]]
    updated_again: NotRequired[list[int]]
    not_updated_again: NotRequired[list[NotUpdated]]
    taken_back: NotRequired[list[TicketUndone]]


class LoadCorrectDocument(LoadsCorrected, Answered):
    """`yieldmon load correct --json`."""
